"""``mbfmu scenes``."""

from __future__ import annotations

import argparse

from mbfmu.modeling.model import Model
from mbfmu.modeling.registry import find, models
from mbfmu.modeling.scene import load_scene, scenes
from mbfmu.util.text_table import format_table, format_tolerance

from .common import Commands
from .completion import complete, model_names


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu scenes``."""
    p = commands.add_parser(
        "scenes",
        help=about,
        description="List the scenes of the models with solver, tolerance, stop time and purpose. `mbfmu run "
        "fourbar/paper` "
        "simulates one of them.",
        epilog="examples:\n  mbfmu scenes\n  mbfmu scenes fourbar sheet\n",
    )
    named = p.add_argument("models", metavar="model", nargs="*", help="model (default: all models)")
    complete(named, model_names)
    p.set_defaults(command=command_scenes)


def command_scenes(options: argparse.Namespace) -> int:
    """List the scenes of some models, or of all."""
    print(as_text({name: find(name) for name in options.models or sorted(models())}))
    return 0


def as_text(chosen: dict[str, type[Model]]) -> str:
    """Return a line for every scene of these models."""
    rows = []
    for model, cls in chosen.items():
        for case, path in scenes(cls).items():
            scene = load_scene(f"{model}/{case}")
            first = path.read_text("utf-8").partition("\n")[0] if path else ""
            about = first.removeprefix("#").strip() if first.startswith("#") else "" if path else "default values"
            how = (scene.settings.solver, format_tolerance(scene.settings.tolerance), f"{scene.stop_time:g} s")
            rows.append((f"{model}/{case}", *how, about))
    return format_table(("scene", "solver", "tolerance", "stop time", "purpose"), rows)
