"""``mbfmu export``."""

from __future__ import annotations

import argparse
from pathlib import Path

from mbfmu.scene import DEFAULT

from .common import (
    Commands,
    add_scene,
    add_set,
    add_solver,
    add_times,
    file_name,
    scene_of,
    scene_part,
    tell_more,
    wrote,
)


def add(commands: Commands) -> None:
    """Describe ``mbfmu export``."""
    p = commands.add_parser(
        "export",
        help="write a model as an FMU (FMI 2.0 co-simulation)",
        description="Write a model as an FMU for co-simulation, FMI 2.0. What you give here are the values it starts "
        "with; a host may set them before a run. `mbfmu models NAME` lists its variables.",
        epilog="examples:\n  mbfmu export fourbar\n  mbfmu export fourbar --set crank_mass=2 -o heavy.fmu\n"
        "  mbfmu export my_model.py:MyModel --solver adams\n",
    )
    add_scene(p)
    add_set(p)
    add_times(p, "end of the default experiment", "its time between communication points")
    p.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="write this file; MODEL.fmu without it, or MODEL_SCENE.fmu. A file that is there is replaced",
    )
    add_solver(p)
    p.set_defaults(command=command_export)


def command_export(options: argparse.Namespace) -> int:
    """Write an FMU."""
    from mbfmu.fmi import export

    scene = scene_of(options)
    name, part = file_name(scene.model.name), scene_part(scene)
    path = export(
        scene.model,
        options.output or Path(f"{name}.fmu" if part == DEFAULT else f"{name}_{part}.fmu"),
        scene.settings,
        stop_time=scene.stop_time,
        output_interval=scene.output_interval,
    )
    wrote(options, path)
    tell_more(options, f"{path.stat().st_size / 1e3:.0f} kB; `mbfmu models {options.scene}` lists its variables")
    return 0
