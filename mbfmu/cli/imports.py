"""``mbfmu import``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mbfmu.util.diagnostics import render
from mbfmu.util.errors import UserError
from mbfmu.util.files import write_text

from .common import Commands, print_paths, print_unless_quiet


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu import``."""
    p = commands.add_parser(
        "import",
        help=about,
        description="Write a model in Python from the description of a robot or a machine: a URDF file (<robot>) or an "
        "MJCF file (<mujoco>). Bodies, joints, masses, springs, damping, dry friction, rotor inertias, ranges, loops, "
        "couplings and drives are imported; masses, start positions and other values become parameters. Joints of URDF "
        "files and actuators of MJCF files become inputs. Joint coordinates, points (sites) and the last bodies of "
        "chains become outputs. The command lists what is not imported, such as contact. The written file is the model "
        "from then on: edit it, and run or export it. The package mujoco-core (extra `import`) reads the file.",
        epilog="examples:\n  mbfmu import robot.urdf -o robot.py\n"
        "  mbfmu import robot.urdf --floating       the base of the robot moves freely\n"
        "  mbfmu import linkage.urdf --close rod_end pin  a ball joint closes the loop\n"
        "  mbfmu import linkage.urdf --close loops.toml   a file lists the loops\n"
        "  mbfmu import gripper.xml --strict        an error if something is not imported\n"
        "  mbfmu run robot.py --solver adams        simulate the written model\n"
        "  mbfmu export robot.py                    export it as an FMU\n",
    )
    p.add_argument("file", type=Path, help="URDF or MJCF file")
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="Python file (default: the name of the imported file with .py); an existing file is not overwritten; "
        "-: standard output",
    )
    p.add_argument(
        "--floating",
        action="store_true",
        help="bodies that the file fixes to the ground move freely, such as the base of a mobile robot",
    )
    p.add_argument(
        "--close",
        nargs="+",
        action="append",
        default=[],
        metavar=("BODY", "BODY KIND"),
        help="close a loop between two bodies, since URDF describes trees only. KIND of the joint: spherical (default; "
        "the origins of the bodies coincide), revolute (also their z axes) or weld (also their orientations); or a "
        "TOML file with tables [[close]]: a, b, joint, and optional points at_a, at_b and axes axis_a, axis_b in the "
        "frames of the bodies. Give the imported file before this option. May be repeated",
    )
    p.add_argument("--strict", action="store_true", help="refuse a file if any element is not imported")
    p.set_defaults(command=command_import)


def command_import(options: argparse.Namespace) -> int:
    """Write a model."""
    from mbfmu.formats import source_code
    from mbfmu.formats.imported import model_of

    path = options.output or Path(f"{options.file.stem}.py")
    prints = str(path) == "-"
    if not prints and path.exists():
        raise UserError(f"{str(path)!r} exists and may have been edited; delete it, or give another name by -o")
    code, found = source_code(options.file, strict=options.strict, floating=options.floating, close=options.close)
    model = model_of(code)
    if prints:
        sys.stdout.write(code)
        return 0
    write_text(path, code)
    for line in render(found):
        print_unless_quiet(options, line)
    mechanism = model.built()
    joints, constraints = sum(body.joint.nv > 0 for body in mechanism.bodies), len(mechanism.constraints)
    print_unless_quiet(
        options,
        f"{type(model).__name__}: {len(mechanism.bodies) - 1} bodies, {joints} joints, {constraints} loops and "
        f"couplings, {len(model.parameters())} parameters, {len(mechanism.outputs)} outputs",
    )
    print_paths(options, path)
    return 0
