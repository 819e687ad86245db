"""``mbfmu linearize``."""

from __future__ import annotations

import argparse
from pathlib import Path

from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.linear import modes_as_text

from .common import AGAIN, RESULTS, Commands, add_steady, scene_of, scene_part, show, show_more, start_of, wrote
from .results import results

NAME = "state_space.npz"


def add(commands: Commands) -> None:
    """Describe ``mbfmu linearize``."""
    p = commands.add_parser(
        "linearize",
        help="state matrices at a steady state",
        description="Find the steady state nearest to the start and write the state matrices A, B, C, D at this "
        "state, from "
        "the inputs to the outputs. numpy.load reads .npz files for scipy.signal.StateSpace and control.ss; MATLAB and "
        "Octave read .mat files.",
        epilog="examples:\n  mbfmu linearize governor\n  mbfmu linearize governor/free --set stiffness=2000\n"
        "  mbfmu linearize governor -o governor.mat\n",
    )
    add_steady(p)
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help=f"file, .npz or .mat (default: {RESULTS}/MODEL/SCENE-linear/{NAME}); an existing file is overwritten. "
        f"{AGAIN}",
    )
    p.set_defaults(command=command_linearize)


def command_linearize(options: argparse.Namespace) -> int:
    """Write the state matrices; print the eigenvalues."""
    scene = scene_of(options)
    found = equilibrium(scene.model, start_of(options))
    space = found.state_space
    if options.output:
        space.write(options.output)
        path = options.output
    else:
        with results(RESULTS, scene, f"{scene_part(scene)}-linear") as place:
            space.write(place.file(NAME))
            path = place.keep() / NAME
    show(options, f"{scene.name}: linearized about the steady state found from {found.found_from} ({found.stability})")
    show_more(options, found.effort)
    for note in (*found.notes, *space.notes):
        show(options, f"note: {note}")
    if space.periodic:
        show(
            options,
            f"note: periodic coefficients: {', '.join(space.periodic)} hold at the drives' positions at time 0 only",
        )
    inputs = ", ".join(space.inputs) or "none"
    show(options, f"states {', '.join(space.states)}; inputs {inputs}; {len(space.outputs)} outputs")
    show(options, modes_as_text(space.modes()))
    wrote(options, path)
    return 0
