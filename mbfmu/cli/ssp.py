"""``mbfmu ssp``."""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

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
    assignments,
    file_name,
    print_inputs,
    print_paths,
    print_unless_quiet,
    scene_of,
)


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu ssp``."""
    p = commands.add_parser(
        "ssp",
        help=about,
        description="Export a model or a scene as an FMU and write it, with other FMUs and the connections between "
        "them, as one file of System Structure and Parameterization (SSP) 1.0. FMPy, libcosim and other tools "
        "simulate such files. The component of the model has the name of the model. Its FMU is of FMI 2.0 and for "
        "this machine; for other platforms export it by `mbfmu export --platforms` and use `mbfmu.write_ssp`.",
        epilog="examples:\n  mbfmu ssp governor --set driven=false\n"
        "  mbfmu ssp governor --with engine=engine.fmu --connect engine.shaft_torque=governor.spindle.torque\n",
    )
    add_scene(p)
    add_set(p)
    add_input(p)
    add_times(p, "stop time of the system", "communication step size in the description of the model's FMU")
    p.add_argument(
        "--with",
        dest="components",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=FILE",
        help="further components, each with its FMU of FMI 2.0",
    )
    p.add_argument(
        "--connect",
        nargs="+",
        action="extend",
        default=[],
        metavar="OUTPUT=INPUT",
        help="connections, each from an output to an input, both as COMPONENT.VARIABLE",
    )
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="SSP file (default: MODEL.ssp); an existing file is overwritten",
    )
    add_solver(p)
    add_fmu_kind(p)
    p.set_defaults(command=command_ssp)


def command_ssp(options: argparse.Namespace) -> int:
    """Write a system of FMUs."""
    from mbfmu.fmi.export import FmuKind, export_scene
    from mbfmu.fmi.ssp import connectors_of, write_ssp

    scene = scene_of(options)
    name = re.sub(r"\W", "_", file_name(scene.model.name), flags=re.ASCII)
    others = assignments("--with", options.components)
    if name in others:
        raise UserError(f"--with: component {name!r} is the model itself; give the other FMU another name")
    connections = []
    for text in options.connect:
        output, equals, end = text.partition("=")
        if not equals:
            raise UserError(f"--connect {text!r}; allowed: OUTPUT=INPUT, both as COMPONENT.VARIABLE")
        connections.append((output.strip(), end.strip()))
    path, found = options.output or Path(f"{name}.ssp"), list[Diagnostic]()
    with tempfile.TemporaryDirectory(prefix="mbfmu_") as folder:
        own = Path(folder) / f"{name}.fmu"
        kind = FmuKind.PYTHON if options.python else FmuKind.NATIVE
        export_scene(scene, own, kind, report=found.append, falls_back=not options.native)
        known = connectors_of(name, own)
        values = {
            f"{name}.{parameter}": getattr(scene.model, parameter)
            for parameter in assignments("--set", options.set)
            if parameter in known
        }
        write_ssp(path, {name: own, **others}, connections, values, stop_time=float(scene.stop_time))
    print_inputs(options, scene)
    for line in render(found, details=options.verbose):
        print_unless_quiet(options, line)
    print_paths(options, path)
    return 0
