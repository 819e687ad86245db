"""``mbfmu models``."""

from __future__ import annotations

import argparse

from mbfmu.interface import CHANGES, Role, columns, interface, parameters
from mbfmu.model import Model, models
from mbfmu.scene import load_scene
from mbfmu.table import table

from . import scenes
from .common import Commands
from .completion import complete, scene_names


def add(commands: Commands) -> None:
    """Describe ``mbfmu models``."""
    p = commands.add_parser(
        "models",
        help="list the models and their parameters, or all variables of one",
        description="List the models that are installed, with their parameters. Of a model that is named, list every "
        "variable its FMU has, with unit and range: parameters, settings of the solver, inputs and outputs; and its "
        "scenes.",
        epilog="examples:\n  mbfmu models\n  mbfmu models governor\n  mbfmu models my_model.py:MyModel\n",
    )
    named = p.add_argument(
        "scenes", metavar="model", nargs="*", help="a model, one of its scenes, a scene file, or my_model.py:MyModel"
    )
    complete(named, scene_names)
    p.set_defaults(command=command_models)


def command_models(options: argparse.Namespace) -> int:
    """List the models, or the variables of some."""
    for reference in options.scenes:
        scene = load_scene(reference)
        print(f"{scene.model.name}: {scene.model.title()}")
        variables = interface(scene.model, scene.settings)
        for role in Role:
            if told := columns([v for v in variables if v.role is role]):
                print(f"\n{role.plural}\n{table(list(told), list(zip(*told.values(), strict=True)))}")
        if scene.reference in models():
            print(f"\nScenes\n{scenes.as_text({scene.reference: type(scene.model)})}")
    if not options.scenes:
        for name, model in sorted(models().items()):
            print(f"{name}: {model.title()}")
            print("\n".join(brief(model)))
        print("\n`mbfmu models NAME` lists all variables of a model, and its scenes; `mbfmu scenes` lists all scenes.")
    return 0


def brief(model: type[Model]) -> list[str]:
    """Return a line for every parameter of a model."""
    lines = []
    for v in parameters(model()):
        unit = "" if v.unit == "1" else f" {v.unit}"
        changes = f"; changes {CHANGES[v.variability]}" if v.variability in CHANGES else ""
        lines.append(f"    {v.name} = {v.start_in_words}{unit}  {v.description} ({v.allowed}{changes})")
    return lines
