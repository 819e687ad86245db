"""``mbfmu models``."""

from __future__ import annotations

import argparse

from mbfmu.model import models, span

from .common import Commands


def add(commands: Commands) -> None:
    """Describe ``mbfmu models``."""
    commands.add_parser("models", help="list the models and their parameters").set_defaults(command=command_models)


def command_models(options: argparse.Namespace) -> int:
    """List the models."""
    for name, model in sorted(models().items()):
        print(f"{name}: {model.title()}")
        for p in model.parameters():
            tunable = ", tunable" if p.tunable else ", fixed at export" if p.structural else ""
            unit = "" if p.unit == "1" else f" {p.unit}"
            word = isinstance(p.default, str | bool)
            default = str(p.default).lower() if word else f"{p.default:g}"
            print(f"    {p.name} = {default}{unit}  {p.doc} ({span(p)}{tunable})")
    return 0
