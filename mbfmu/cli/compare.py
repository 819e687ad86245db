"""``mbfmu compare``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from mbfmu.errors import UserError
from solvers import SOLVERS

from .common import Commands, add_output, add_set, folder, scene_of, writable, write_json


def add(commands: Commands) -> None:
    """Describe ``mbfmu compare``."""
    p = commands.add_parser(
        "compare",
        help="every solver's accuracy against its time",
        description="Run every solver at tolerances from 1e-4 to 1e-10 and show its error against its time. A model "
        "that settles when it is damped is also run into its steady state, beside the solution of the equilibrium "
        "equations.",
    )
    p.add_argument("scene", help="scene file, model name or model/scene")
    add_set(p)
    p.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON")
    p.add_argument("--repeats", type=int, default=5, metavar="N", help="runs the median is taken of (5)")
    add_output(p, "the plots")
    p.set_defaults(command=command_compare)


def command_compare(options: argparse.Namespace) -> int:
    """Compare all solvers; print a table, draw two plots."""
    from mbfmu.studies.compare import TOLERANCES, as_text, compare
    from mbfmu.studies.report import plot_energy, plot_work_precision
    from mbfmu.studies.settling import SOLVER_NAMES as SETTLING_SOLVERS
    from mbfmu.studies.settling import Settled, settle
    from mbfmu.studies.settling import as_text as settled_as_text

    scene = scene_of(options)
    if options.repeats < 1:
        raise UserError(f"--repeats is {options.repeats}; allowed: 1 or more")
    target = folder(options.output)
    if options.json:
        writable(options.json)
    settling = scene.model.settling
    total = len(TOLERANCES) * (len(SOLVERS) + len(SETTLING_SOLVERS) * bool(settling))
    settled: list[Settled] = []
    with tqdm(total=total, desc="compare", leave=False, disable=not sys.stderr.isatty()) as bar:
        rows, energies = compare(scene, repeats=options.repeats, progress=lambda _: bar.update())
        if settling:
            damped = scene.model.with_values(settling)
            settled = settle(damped, tolerances=TOLERANCES, repeats=options.repeats, progress=lambda _: bar.update())
    print(as_text(rows))
    if settled:
        print(f"\ninto the steady state, with {', '.join(f'{k} = {v:g}' for k, v in settling.items())}:")
        print(settled_as_text(settled))
    pictures = target / f"{scene.name}_work_precision.png", target / f"{scene.name}_energy.png"
    plot_work_precision(rows, f"{scene.name}: error against run time", pictures[0])
    plot_energy(energies, f"{scene.name}: energy balance", pictures[1])
    print(f"wrote {pictures[0]} and {pictures[1]}")
    if options.json:
        write_json([*(row.as_dict() for row in rows), *(row.as_dict() for row in settled)], options.json)
    return 0
