"""``mbfmu modes``."""

from __future__ import annotations

import argparse

from mbfmu.errors import UserError
from mbfmu.steady.linear import modes_as_text
from mbfmu.steady.problem import equilibrium

from .common import Commands, add_output, add_steady, folder, scene_of, start_of


def add(commands: Commands) -> None:
    """Describe ``mbfmu modes``."""
    p = commands.add_parser(
        "modes",
        help="natural frequencies and damping about a steady state, and the shapes of sheets and beams",
        description="Find the steady state next to the start, and the natural modes about it: all of a small "
        "mechanism, the lowest of a large one. Shapes of a surface, or of elastic bodies, are "
        "drawn. A drive that runs up has done so.",
    )
    add_steady(p)
    p.add_argument("-n", "--count", type=int, default=8, metavar="N", help="modes to show (8)")
    add_output(p, "the picture")
    p.set_defaults(command=command_modes)


def command_modes(options: argparse.Namespace) -> int:
    """Print the modes; draw their shapes where the model has a surface or an elastic body."""
    from mbfmu.studies.report import plot_bars, plot_shapes

    if options.count < 1:
        raise UserError(f"--count is {options.count}; allowed: 1 or more")
    scene = scene_of(options)
    found = equilibrium(scene.model, start_of(options))
    print(f"{scene.name}: modes about the steady state found from {found.found_from} ({found.stability})")
    for note in found.notes:
        print(f"note: {note}")
    modes = found.shapes(options.count)
    print(modes_as_text([shape.mode for shape in modes]))
    if found.stability == "unstable":
        print("`mbfmu equilibrium` lists the steady states it finds; --from COORDINATE=VALUE starts next to another")
    mechanism = found.plant.mechanism
    if modes and (mechanism.surfaces or mechanism.elastics):
        picture = folder(options.output) / f"{scene.name}_modes.png"
        plot = plot_shapes if mechanism.surfaces else plot_bars
        plot(found.plant, found.q, modes, f"{scene.name}: natural modes", picture)
        print(f"wrote {picture}")
    return 0
