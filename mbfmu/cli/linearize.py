"""``mbfmu linearize``."""

from __future__ import annotations

import argparse
from pathlib import Path

from mbfmu.steady.equilibrium import equilibrium
from mbfmu.steady.linear import modes_as_text
from mbfmu.util.diagnostics import Diagnostic, render

from .common import (
    EXISTING_FOLDER_TEXT,
    RESULTS_FOLDER,
    Commands,
    add_steady,
    print_if_verbose,
    print_inputs,
    print_paths,
    print_unless_quiet,
    scene_of,
    scene_part,
    start_of,
)
from .results import results

STATE_SPACE_FILE = "state_space.npz"


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu linearize``."""
    p = commands.add_parser(
        "linearize",
        help=about,
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
        help=f"file, .npz or .mat (default: {RESULTS_FOLDER}/MODEL/SCENE-linear/{STATE_SPACE_FILE}); "
        "an existing file is overwritten. "
        f"{EXISTING_FOLDER_TEXT}",
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
        with results(RESULTS_FOLDER, scene, f"{scene_part(scene)}-linear") as place:
            space.write(place.file(STATE_SPACE_FILE))
            path = place.keep() / STATE_SPACE_FILE
    print_inputs(options, scene)
    print_unless_quiet(
        options, f"{scene.name}: linearized about the steady state found from {found.found_from} ({found.stability})"
    )
    print_if_verbose(options, found.effort)
    diagnostics = [*found.diagnostics, *space.diagnostics]
    if space.periodic:
        text = f"periodic coefficients: {', '.join(space.periodic)} hold at the drives' positions at time 0 only"
        diagnostics.append(Diagnostic.note("periodic-coefficients", text))
    for line in render(diagnostics):
        print_unless_quiet(options, line)
    inputs = ", ".join(space.inputs) or "none"
    print_unless_quiet(options, f"states {', '.join(space.states)}; inputs {inputs}; {len(space.outputs)} outputs")
    print_unless_quiet(options, modes_as_text(space.modes()))
    print_paths(options, path)
    return 0
