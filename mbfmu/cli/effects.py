"""``mbfmu effects``."""

from __future__ import annotations

import argparse

from mbfmu.errors import UserError, suggest

from .common import Commands, add_solver, add_steady, bar, reader, scene_of, show, start_of
from .completion import complete, output_names


def add(commands: Commands) -> None:
    """Describe ``mbfmu effects``."""
    p = commands.add_parser(
        "effects",
        help="what each effect of a model costs, and what it changes",
        description="Run a model as it is, and with one of its effects switched at a time. Print the parameters, the "
        "CPU time of an evaluation and of the run, the first natural frequency about the steady state next to the "
        "start, and by how much outputs change at most over the run, of their ranges; and what to do with each effect: "
        "leave it off where it changes nothing above 0.1 %.",
        epilog="examples:\n  mbfmu effects sheet\n  mbfmu effects sheet --stop-time 0.1 --show tip.y --show energy\n",
    )
    add_steady(p)
    add_solver(p)
    p.add_argument("--stop-time", type=reader(float), metavar="S", help="end of the run, s")
    shown = p.add_argument(
        "--show",
        action="append",
        default=[],
        metavar="OUTPUT",
        help="show this output, and judge effects by it; may be repeated (all judge)",
    )
    complete(shown, output_names)
    p.set_defaults(command=command_effects)


def command_effects(options: argparse.Namespace) -> int:
    """Print the costs."""
    from mbfmu.studies.effects import ROUNDS, as_text, costs

    scene = scene_of(options)
    known = [variable.name for variable in scene.model.plant().outputs]
    for name in options.show:
        if name not in known:
            raise UserError(f"--show {name!r}: no such output{suggest(name, known)}")
    first = ["tip.y"] if "tip.y" in known else known[:1]
    shown = options.show or [*first, *({"energy"}.intersection(known).difference(first))]
    total = (1 + len(scene.model.effects)) * (1 + ROUNDS)
    with bar(total, "effects", options.quiet) as seen:
        entries = costs(
            scene.model, scene.settings, scene.stop_time, start_of(options), lambda _: seen.update(), options.show
        )
    show(options, as_text(entries, shown))
    return 0
