"""``mbfmu modes``."""

from __future__ import annotations

import argparse

from mbfmu.errors import UserError
from mbfmu.files import write_text
from mbfmu.steady.linear import modes_as_text
from mbfmu.steady.problem import equilibrium

from .common import (
    Commands,
    add_output,
    add_steady,
    reader,
    scene_of,
    scene_part,
    show,
    show_more,
    start_of,
    wrote,
)
from .results import results


def add(commands: Commands) -> None:
    """Describe ``mbfmu modes``."""
    p = commands.add_parser(
        "modes",
        help="natural frequencies and damping about a steady state, and the shapes of sheets and beams",
        description="""Find the steady state next to the start, and the natural modes about it: all of a small
mechanism, the lowest of a large one. A drive that runs up has done so.

The results are in a folder such as results/sheet/default-modes:
  modes.txt   what is printed
  shapes.png  the shapes of a sheet, or of elastic bodies, where the model has these""",
        epilog="examples:\n  mbfmu modes sheet -n 4\n"
        "  mbfmu modes fourbar --set coupler_modes=2 --from crank=-1.5    about the state that hangs\n",
    )
    add_steady(p)
    p.add_argument("-n", "--count", type=reader(int), default=8, metavar="N", help="show at most N modes (8)")
    add_output(p, "MODEL/SCENE-modes")
    p.set_defaults(command=command_modes)


def command_modes(options: argparse.Namespace) -> int:
    """Print the modes; draw their shapes where the model has a surface or an elastic body."""
    from mbfmu.studies.report import plot_bars, plot_shapes

    if options.count < 1:
        raise UserError(f"--count is {options.count}; allowed: 1 or more")
    scene = scene_of(options)
    with results(options.output, scene, f"{scene_part(scene)}-modes") as place:
        found = equilibrium(scene.model, start_of(options))
        modes = found.shapes(options.count)
        text = "\n".join(
            (
                f"{scene.name}: modes about the steady state found from {found.found_from} ({found.stability})",
                *(f"note: {note}" for note in found.notes),
                modes_as_text([shape.mode for shape in modes]),
            )
        )
        write_text(place.file("modes.txt"), text + "\n")
        mechanism = found.plant.mechanism
        if modes and (mechanism.surfaces or mechanism.flexible_bodies):
            plot = plot_shapes if mechanism.surfaces else plot_bars
            plot(found.plant, found.q, modes, f"{scene.name}: natural modes", place.file("shapes.png"))
        show(options, text)
        show_more(options, found.effort)
        if found.stability == "unstable":
            show(
                options,
                "`mbfmu equilibrium` lists the steady states it finds; --from COORDINATE=VALUE starts next to another",
            )
        wrote(options, place.keep())
    return 0
