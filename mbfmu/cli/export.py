"""``mbfmu export``."""

from __future__ import annotations

import argparse
from pathlib import Path

from .common import Commands, add_set, add_solver, scene_of


def add(commands: Commands) -> None:
    """Describe ``mbfmu export``."""
    p = commands.add_parser("export", help="write a model as an FMU (FMI 2.0 co-simulation)")
    p.add_argument("scene", metavar="model", help="model name, scene, or my_model.py:MyModel")
    add_set(p)
    add_solver(p)
    p.add_argument(
        "--inputs", metavar="HOW", help="loads that the host sets: hold (default) until the next point, or linear"
    )
    p.add_argument("--stop-time", type=float, metavar="S", help="end of the default experiment, s")
    p.add_argument("--interval", type=float, metavar="S", help="its step between communication points, s")
    p.add_argument("-o", "--output", type=Path, metavar="FILE", help="FMU file; MODEL.fmu by default")
    p.set_defaults(command=command_export)


def command_export(options: argparse.Namespace) -> int:
    """Write an FMU."""
    from mbfmu.fmi import export

    scene = scene_of(options)
    path = export(
        scene.model,
        options.output or Path(f"{scene.name}.fmu"),
        scene.settings,
        stop_time=scene.stop_time,
        output_interval=scene.output_interval,
    )
    print(f"wrote {path}")
    return 0
