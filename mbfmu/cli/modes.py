"""``mbfmu modes``."""

from __future__ import annotations

import argparse

from mbfmu.modeling.replaced_inputs import describe
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.util.diagnostics import render
from mbfmu.util.errors import UserError
from mbfmu.util.files import write_text
from solvers.statics.spectrum import Stability

from .common import (
    Commands,
    add_output,
    add_steady,
    print_if_verbose,
    print_paths,
    print_unless_quiet,
    reader,
    scene_of,
    scene_part,
    start_of,
)
from .results import results


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu modes``."""
    p = commands.add_parser(
        "modes",
        help=about,
        description="""Find the steady state nearest to the start and the natural modes about it: all modes of a
small model, the lowest of a large one. Drives have their final speed.

The results are in a folder such as results/sheet/default-modes:
  modes.txt   the printed table
  shapes.png  mode shapes of sheets or flexible bodies, if the model has any""",
        epilog="examples:\n  mbfmu modes sheet -n 4\n"
        "  mbfmu modes fourbar --set coupler_modes=2 --from crank=-1.5    at the hanging position\n",
    )
    add_steady(p)
    p.add_argument(
        "-n", "--count", type=reader(int), default=8, metavar="N", help="maximum number of modes (default 8)"
    )
    add_output(p, "MODEL/SCENE-modes")
    p.set_defaults(command=command_modes)


def command_modes(options: argparse.Namespace) -> int:
    """Print the modes; draw their shapes where the model has a surface or a flexible body."""
    from mbfmu.viewer.mode_shapes import plot_bars, plot_shapes

    if options.count < 1:
        raise UserError(f"--count is {options.count}; allowed: 1 or more")
    scene = scene_of(options)
    with results(options.output, scene, f"{scene_part(scene)}-modes") as place:
        found = equilibrium(scene.model, start_of(options))
        modes = found.shapes(options.count)
        text = "\n".join(
            (
                f"{scene.name}: modes about the steady state found from {found.found_from} ({found.stability})",
                *describe(scene.model.replaced_inputs),
                *render(found.diagnostics),
                str(modes),
            )
        )
        write_text(place.file("modes.txt"), text + "\n")
        mechanism = found.compiled.mechanism
        if modes and (mechanism.surfaces or mechanism.beams()):
            plot = plot_shapes if mechanism.surfaces else plot_bars
            plot(found.compiled, found.q, modes, f"{scene.name}: natural modes", place.file("shapes.png"))
        print_unless_quiet(options, text)
        print_if_verbose(options, found.effort)
        if found.stability is Stability.UNSTABLE:
            print_unless_quiet(
                options,
                "`mbfmu equilibrium` lists the steady states it finds; --from COORDINATE=VALUE starts next to another",
            )
        print_paths(options, place.keep())
    return 0
