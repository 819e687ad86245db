"""``mbfmu effects``."""

from __future__ import annotations

import argparse

from mbfmu.util.errors import UserError, suggest

from .common import (
    Commands,
    add_solver,
    add_steady,
    bar,
    print_inputs,
    print_unless_quiet,
    reader,
    scene_of,
    start_of,
)
from .completion import complete, output_names


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu effects``."""
    p = commands.add_parser(
        "effects",
        help=about,
        description="Simulate a model with its own effects, and with one effect switched on or off at a time. "
        "Print the CPU "
        "time of an evaluation and of the run, the first natural frequency at the steady state, and the largest change "
        "of outputs relative to their ranges. An effect that changes no output by more than 0.1 % is recommended to "
        "be switched off.",
        epilog="examples:\n  mbfmu effects sheet\n  mbfmu effects sheet --stop-time 0.1 --show tip.y --show energy\n",
    )
    add_steady(p)
    add_solver(p)
    p.add_argument("--stop-time", type=reader(float), metavar="S", help="stop time, s")
    shown = p.add_argument(
        "--show",
        action="append",
        default=[],
        metavar="OUTPUT",
        help="output whose change is shown and decides on the recommendation; may be repeated (default: all outputs)",
    )
    complete(shown, output_names)
    p.set_defaults(command=command_effects)


def command_effects(options: argparse.Namespace) -> int:
    """Print the costs."""
    from mbfmu.studies.effects import EFFECT_ROUNDS, as_text, costs

    scene = scene_of(options)
    known = [variable.name for variable in scene.model.compile().outputs]
    for name in options.show:
        if name not in known:
            raise UserError(f"--show: there is no output {name!r}{suggest(name, known)}")
    first = ["tip.y"] if "tip.y" in known else known[:1]
    shown = options.show or [*first, *({"energy"}.intersection(known).difference(first))]
    total = (1 + len(scene.model.effects)) * (1 + EFFECT_ROUNDS)
    with bar(total, "effects", options.quiet) as seen:
        entries = costs(
            scene.model, scene.settings, scene.stop_time, start_of(options), lambda _: seen.update(), options.show
        )
    print_inputs(options, scene)
    print_unless_quiet(options, as_text(entries, shown))
    return 0
