"""``mbfmu linearize``."""

from __future__ import annotations

import argparse
from pathlib import Path

from mbfmu.steady.linear import modes_as_text
from mbfmu.steady.problem import equilibrium

from .common import Commands, add_steady, scene_of, start_of


def add(commands: Commands) -> None:
    """Describe ``mbfmu linearize``."""
    p = commands.add_parser(
        "linearize",
        help="state matrices about a steady state",
        description="Write A, B, C, D of the motion about a steady state, from the inputs to the outputs. "
        'Read them with numpy.load("FILE.npz") for scipy.signal.StateSpace or control.ss, or in MATLAB from FILE.mat.',
    )
    add_steady(p)
    p.add_argument("-o", "--output", type=Path, metavar="FILE", help=".npz or .mat; MODEL_linear.npz by default")
    p.set_defaults(command=command_linearize)


def command_linearize(options: argparse.Namespace) -> int:
    """Write the state matrices; print the eigenvalues."""
    scene = scene_of(options)
    found = equilibrium(scene.model, start_of(options))
    space = found.state_space
    path = options.output or Path(f"{scene.name}_linear.npz")
    space.write(path)
    print(f"{scene.name}: linearised about the steady state found from {found.found_from} ({found.stability})")
    for note in found.notes:
        print(f"note: {note}")
    print(f"states {', '.join(space.states)}; inputs {', '.join(space.inputs) or 'none'}; {len(space.outputs)} outputs")
    print(modes_as_text(space.modes()))
    print(f"wrote {path}")
    return 0
