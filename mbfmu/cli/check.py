"""``mbfmu check``."""

from __future__ import annotations

import argparse
import sys

from .common import Commands, add_json, add_scene, add_set, add_solver, reader, scene_of, show, writable, write_json


def add(commands: Commands) -> None:
    """Describe ``mbfmu check``."""
    p = commands.add_parser(
        "check",
        help="whether a scene is hard, and why; which solver suits it",
        description="""Run a scene, watched, and tell in words with numbers whether it is hard, and why:

  singular positions  the nearest one: when, how near, in which loop, and whether it is passed exactly or missed
  redundant rows      constraints that say what others say: the forces between them are not determined
  stiffness           the fastest eigenvalue of the linearized motion against the rate of what moves
  steps               what sets their length: accuracy, stability, singular positions, drives, or max_step
  loops               through which bodies each goes, its size, and how well it is closed
  solver              the one that suits, as --solver auto would take it at these states

A scene that cannot start or fails is no mistake here: check says why. What it did not look at it says too. The exit
code is 0 whatever is found, and 2 for a mistake in what you ask for.""",
        epilog="examples:\n  mbfmu check fourbar\n  mbfmu check fourbar/flexible --solver adams --stop-time 2\n"
        "  mbfmu check my_model.py:MyModel --json findings.json\n",
    )
    add_scene(p)
    add_set(p)
    p.add_argument("--stop-time", type=reader(float), metavar="S", help="end of the run, s")
    p.add_argument(
        "--patience",
        type=reader(float),
        metavar="S",
        help="leave the run where it is after so long, s of this machine (default 10)",
    )
    add_json(p)
    add_solver(p)
    p.set_defaults(command=command_check)


def command_check(options: argparse.Namespace) -> int:
    """Check a scene; print the findings."""
    from mbfmu.studies.check import PATIENCE, check

    if options.json:
        writable(options.json)
    found = check(scene_of(options), patience=PATIENCE if options.patience is None else options.patience)
    if options.json:
        write_json(found.as_dict(), options.json)
    if not options.json or str(options.json) != "-":
        show(options, found.as_text())
    if options.quiet and found.failure:
        print(f"mbfmu: {found.failure}", file=sys.stderr)
    return 0
