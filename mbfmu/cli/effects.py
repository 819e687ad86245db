"""``mbfmu effects``."""

from __future__ import annotations

import argparse
import sys

from tqdm import tqdm

from mbfmu.errors import UserError
from mbfmu.model import suggest

from .common import Commands, add_set, add_solver, scene_of


def add(commands: Commands) -> None:
    """Describe ``mbfmu effects``."""
    p = commands.add_parser(
        "effects",
        help="what each effect of a model costs, and what it changes",
        description="Run a model as it is, and with each of its effects turned over alone; print the time of an "
        "evaluation and of the run, the first natural frequency, and outputs at the end.",
    )
    p.add_argument("scene", metavar="model", help="model name, scene, or my_model.py:MyModel")
    add_set(p)
    add_solver(p)
    p.add_argument("--stop-time", type=float, metavar="S", help="end of the run, s")
    p.add_argument("--show", action="append", default=[], metavar="OUTPUT", help="output to show; may be repeated")
    p.set_defaults(command=command_effects)


def command_effects(options: argparse.Namespace) -> int:
    """Print the ledger."""
    from mbfmu.effects import as_text, ledger

    scene = scene_of(options)
    known = [variable.name for variable in scene.model.build().compile().outputs]
    for name in options.show:
        if name not in known:
            raise UserError(f"--show {name!r}: no such output{suggest(name, known)}")
    shown = options.show or [name for name in ("tip.y", "energy") if name in known] or known[:2]
    total = 1 + len(scene.model.effects)
    with tqdm(total=total, desc="effects", leave=False, disable=not sys.stderr.isatty()) as bar:
        entries = ledger(scene.model, scene.settings, scene.stop_time, lambda _: bar.update())
    print(as_text(entries, shown))
    return 0
