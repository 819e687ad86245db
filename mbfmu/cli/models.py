"""``mbfmu models``."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from textwrap import wrap

from mbfmu.modeling.registry import models
from mbfmu.modeling.scene import load_scene
from mbfmu.modeling.variables import Role, ScalarVariable, columns, list_variables, parameters
from mbfmu.util.text_table import format_table

from . import scenes
from .common import Commands
from .completion import complete, scene_names

MAX_CELL_WIDTH = 40  # characters


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu models``."""
    p = commands.add_parser(
        "models",
        help=about,
        description="List the installed models with their parameters. If a model is given, list all variables of its "
        "FMU with units and ranges (parameters, settings of the solver, inputs and outputs) and its scenes. A tunable "
        "parameter may be set between communication steps, a fixed one before the start, and one that is fixed at "
        "export only before the export. A native FMU can have more constants; `mbfmu export` lists them.",
        epilog="examples:\n  mbfmu models\n  mbfmu models governor\n  mbfmu models my_model.py:MyModel\n",
    )
    named = p.add_argument(
        "scenes", metavar="model", nargs="*", help="model, scene, scene file, or my_model.py:MyModel"
    )
    complete(named, scene_names)
    p.set_defaults(command=command_models)


def command_models(options: argparse.Namespace) -> int:
    """List the models, or the variables of some."""
    for reference in options.scenes:
        scene = load_scene(reference)
        print(f"{scene.model.name}: {scene.model.title()}")
        variables = list_variables(scene.model, scene.settings)
        for role in Role:
            if chosen := [v for v in variables if v.role is role]:
                print(f"\n{role.plural}\n{as_table(chosen)}")
        if scene.reference in models():
            print(f"\nScenes\n{scenes.as_text({scene.reference: type(scene.model)})}")
    if not options.scenes:
        for name, model in sorted(models().items()):
            print(f"{name}: {model.title()}\n\n{as_table(tuple(parameters(model())))}\n")
        print("`mbfmu models NAME` lists all variables and scenes of a model. `mbfmu scenes` lists all scenes.")
    return 0


def as_table(variables: Sequence[ScalarVariable]) -> str:
    """Return the variables as a table."""
    cells = columns(variables)
    rows = zip(*cells.values(), strict=True)
    return format_table(list(cells), [["\n".join(wrap(cell, MAX_CELL_WIDTH)) for cell in row] for row in rows])
