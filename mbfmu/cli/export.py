"""``mbfmu export``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mbfmu.modeling.scene import DEFAULT_SCENE, SETTING_NAMES
from mbfmu.util.diagnostics import Diagnostic, render
from mbfmu.util.errors import UserError

from .common import (
    Commands,
    add_fmu_kind,
    add_input,
    add_scene,
    add_set,
    add_solver,
    add_times,
    file_name,
    print_if_verbose,
    print_inputs,
    print_paths,
    print_unless_quiet,
    scene_of,
    scene_part,
)
from .runtime import add_platforms

if TYPE_CHECKING:
    from mbfmu.modeling import Model

DEFAULT_FMI = 2
RUN_OPTIONS = (*SETTING_NAMES, "stop_time", "interval")  # which only FMUs have, as the following; None: not given
FMU_FLAGS = ("platforms", "python", "native")


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu export``."""
    p = commands.add_parser(
        "export",
        help=about,
        description="Export a model or a scene as an FMU for co-simulation and model exchange. Values given here are "
        "start values of its variables; `mbfmu models NAME` lists these. The importing tool can change them, except "
        "in a native FMU --solver, --input-interpolation, --start-at-equilibrium and the parameters that this command "
        "lists as constant. The FMU is native if possible: it contains machine code and does not require Python. The "
        "first native FMU with a solver builds the machine code of this solver, which takes one to two minutes. "
        "If the model, the solver or this machine does not permit a native FMU, the FMU calls Python, and the "
        "importing tool requires Python with this version of mbfmu. The command prints the reason. With --mjcf or "
        "--urdf the rigid mechanism is written as a file for other programs; the command lists what is "
        "not exported.",
        epilog="examples:\n  mbfmu export fourbar\n"
        "  mbfmu export fourbar --fmi 3 --platforms x86_64-linux x86_64-windows\n"
        "  mbfmu export fourbar --set crank_mass=2 -o heavy.fmu\n"
        "  mbfmu export my_model.py:MyModel --solver adams\n"
        "  mbfmu export fourbar --python\n"
        "  mbfmu export fourbar --mjcf -o fourbar.xml\n",
    )
    add_scene(p)
    add_set(p)
    add_input(p)
    add_times(p, "stop time of the default experiment", "its communication step size")
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="file (default: MODEL.fmu or MODEL_SCENE.fmu; with --mjcf .xml, with --urdf .urdf); an existing file is "
        "overwritten",
    )
    add_solver(p)
    add_fmu_kind(p)
    p.add_argument(
        "--fmi", type=int, choices=(2, 3), default=DEFAULT_FMI, help="version of FMI (default 2); 3 for native FMUs"
    )
    add_platforms(p, "platforms of a native FMU (default: this machine)")
    formats = p.add_mutually_exclusive_group()
    formats.add_argument("--mjcf", action="store_true", help="write an MJCF file of MuJoCo instead of an FMU")
    formats.add_argument(
        "--urdf", action="store_true", help="write a URDF file instead of an FMU; loops are not exported"
    )
    p.add_argument("--strict", action="store_true", help="with --mjcf or --urdf: an error if something is not exported")
    p.set_defaults(command=command_export)


def command_export(options: argparse.Namespace) -> int:
    """Write an FMU."""
    from mbfmu.fmi.export import FmuKind, export_scene

    scene = scene_of(options)
    name, part = file_name(scene.model.name), scene_part(scene)
    if options.mjcf or options.urdf:
        return _write_description(options, scene.model, name)
    if options.strict:
        raise UserError("--strict is given without --mjcf or --urdf; leave it out: an FMU contains the whole model")
    path = options.output or Path(f"{name}.fmu" if part == DEFAULT_SCENE else f"{name}_{part}.fmu")
    found: list[Diagnostic] = []
    export_scene(
        scene,
        path,
        FmuKind.PYTHON if options.python else FmuKind.NATIVE,
        fmi=options.fmi,
        platforms=options.platforms,
        report=found.append,
        falls_back=not options.native,
    )
    print_inputs(options, scene)
    for line in render(found, details=options.verbose):
        print_unless_quiet(options, line)
    print_paths(options, path)
    print_if_verbose(options, f"{path.stat().st_size / 1e3:.0f} kB; `mbfmu models {options.scene}` lists its variables")
    return 0


def _write_description(options: argparse.Namespace, model: Model, name: str) -> int:
    """Write an MJCF or URDF file; raises UserError if options are given that only FMUs have."""
    from mbfmu.formats import write_mjcf, write_urdf

    settings = {name: getattr(options, name) for name in RUN_OPTIONS}
    given = [f"no_{name}" if value is False else name for name, value in settings.items() if value is not None]
    given += [name for name in FMU_FLAGS if getattr(options, name)]
    given += ["fmi"] if options.fmi != DEFAULT_FMI else []
    if given:
        words = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise UserError(
            f"{words} is given with {'--mjcf' if options.mjcf else '--urdf'}; allowed: options of the mechanism, such "
            "as --set. The file contains no solver and no settings of a run; leave this option out"
        )
    write, suffix = (write_mjcf, ".xml") if options.mjcf else (write_urdf, ".urdf")
    path = options.output or Path(f"{name}{suffix}")
    found = write(model, path, strict=options.strict)
    for line in render(found, details=options.verbose):
        print_unless_quiet(options, line)
    print_paths(options, path)
    return 0
