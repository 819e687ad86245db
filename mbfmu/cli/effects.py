"""``mbfmu effects``."""

from __future__ import annotations

import argparse
import sys

from tqdm import tqdm

from mbfmu.errors import UserError
from mbfmu.model import suggest

from .common import Commands, add_solver, add_steady, scene_of, start_of


def add(commands: Commands) -> None:
    """Describe ``mbfmu effects``."""
    p = commands.add_parser(
        "effects",
        help="what each effect of a model costs, and what it changes",
        description="Run a model as it is, and with each of its effects turned over alone; print the time of an "
        "evaluation and of the run, the first natural frequency about the steady state next to the start, and outputs "
        "at the end.",
    )
    add_steady(p)
    add_solver(p)
    p.add_argument("--stop-time", type=float, metavar="S", help="end of the run, s")
    p.add_argument("--show", action="append", default=[], metavar="OUTPUT", help="output to show; may be repeated")
    p.set_defaults(command=command_effects)


def command_effects(options: argparse.Namespace) -> int:
    """Print the ledger."""
    from mbfmu.studies.effects import as_text, ledger

    scene = scene_of(options)
    known = [variable.name for variable in scene.model.plant().outputs]
    for name in options.show:
        if name not in known:
            raise UserError(f"--show {name!r}: no such output{suggest(name, known)}")
    first = ["tip.y"] if "tip.y" in known else known[:1]
    shown = options.show or [*first, *({"energy"}.intersection(known).difference(first))]
    total = 1 + len(scene.model.effects)
    with tqdm(total=total, desc="effects", leave=False, disable=not sys.stderr.isatty()) as bar:
        entries = ledger(scene.model, scene.settings, scene.stop_time, start_of(options), lambda _: bar.update())
    print(as_text(entries, shown))
    return 0
