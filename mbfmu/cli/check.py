"""``mbfmu check``."""

from __future__ import annotations

import argparse
import sys

from mbfmu.util.diagnostics import render

from .common import (
    Commands,
    add_input,
    add_json,
    add_scene,
    add_set,
    add_solver,
    print_inputs,
    print_unless_quiet,
    reader,
    scene_of,
    writable,
    write_json,
)


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu check``."""
    p = commands.add_parser(
        "check",
        help=about,
        description="""Simulate a scene, monitor the run, and report numerical difficulties with their size:

  singular configurations  the nearest one: time, distance, loop, and whether it is passed or missed
  redundant constraints    constraints that depend on others; their reaction forces are not unique
  stiffness                fastest eigenvalue of the linearized motion, compared with the rate of the motion
  steps                    what limits the step size: accuracy, stability, singular configurations, drives or max_step
  loops                    bodies of each loop, its size, and its residual
  solver                   recommended solver, as --solver auto selects it at these states

A scene that fails is reported too. Aspects that were not examined are listed.

The exit code is 1 if the scene cannot start, if its run ends early, or if its energy error is too large. It is 0
otherwise: difficulties are findings and no failures, and neither is the end of the run by --patience a failure.""",
        epilog="examples:\n  mbfmu check fourbar\n  mbfmu check fourbar/flexible --solver adams --stop-time 2\n"
        "  mbfmu check my_model.py:MyModel --json findings.json\n",
    )
    add_scene(p)
    add_set(p)
    add_input(p)
    p.add_argument("--stop-time", type=reader(float), metavar="S", help="stop time, s")
    p.add_argument(
        "--patience",
        type=reader(float),
        metavar="S",
        help="stop the run after this wall-clock time, s (default 10)",
    )
    add_json(p)
    add_solver(p)
    p.set_defaults(command=command_check)


def command_check(options: argparse.Namespace) -> int:
    """Check a scene and print the findings; return 1 if it fails or its energy error is too large."""
    from mbfmu.studies.check import DEFAULT_PATIENCE, check

    if options.json:
        writable(options.json)
    scene = scene_of(options)
    found = check(scene, patience=DEFAULT_PATIENCE if options.patience is None else options.patience)
    if options.json:
        write_json(found.as_dict(), options.json)
    if not options.json or str(options.json) != "-":
        print_inputs(options, scene)
        print_unless_quiet(options, found.as_text())
    for line in render(d for d in found.diagnostics if options.quiet and d.severity == "error"):
        print(f"mbfmu: {line}", file=sys.stderr)
    return 1 if found.failed or found.inaccurate else 0
