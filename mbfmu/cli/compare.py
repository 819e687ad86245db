"""``mbfmu compare``."""

from __future__ import annotations

import argparse
from pathlib import Path

from mbfmu.errors import UserError
from solvers import SOLVERS

from .common import (
    Commands,
    add_output,
    add_scene,
    add_set,
    bar,
    reader,
    scene_of,
    scene_part,
    tell,
    tell_more,
    writable,
    write_json,
    wrote,
)
from .results import results


def add(commands: Commands) -> None:
    """Describe ``mbfmu compare``."""
    p = commands.add_parser(
        "compare",
        help="every solver's accuracy against its time",
        description="""Run every solver at tolerances from 1e-4 to 1e-10, and show its error against its time. A model
that settles when it is damped is also run into its steady state, beside the solution of the equilibrium equations.

The results are in a folder such as results/fourbar/default-compare:
  work_precision.png  error against time
  energy.png          the energy balance at the scene's tolerance
  rows.json           a row a run
  table.txt           what is printed""",
        epilog="examples:\n  mbfmu compare fourbar\n  mbfmu compare governor/damped --repeats 1\n",
    )
    add_scene(p)
    add_set(p)
    p.add_argument("--json", type=Path, metavar="FILE", help="write the rows here too; - is standard output")
    p.add_argument("--repeats", type=reader(int), default=5, metavar="N", help="take the median time of N runs (5)")
    add_output(p, "MODEL/SCENE-compare")
    p.set_defaults(command=command_compare)


def command_compare(options: argparse.Namespace) -> int:
    """Compare all solvers; print a table, draw two plots."""
    from mbfmu.studies.compare import TOLERANCES, as_text, compare
    from mbfmu.studies.report import plot_energy, plot_work_precision
    from mbfmu.studies.settling import Settled, settle
    from mbfmu.studies.settling import as_text as settled_as_text

    scene = scene_of(options)
    if options.repeats < 1:
        raise UserError(f"--repeats is {options.repeats}; allowed: 1 or more")
    if options.json:
        writable(options.json)
    settling = scene.model.settling
    total = len(TOLERANCES) * len(SOLVERS) * (2 if settling else 1)
    settled: list[Settled] = []
    with results(options.output, scene, f"{scene_part(scene)}-compare") as place:
        with bar(total, "compare", options.quiet) as shown:

            def done(run: str) -> None:
                tell_more(options, f"done: {run}")
                shown.update()

            rows, energies = compare(scene, repeats=options.repeats, progress=done)
            if settling:
                damped = scene.model.with_values(settling)
                settled = settle(damped, tolerances=TOLERANCES, repeats=options.repeats, progress=done)
        text = as_text(rows)
        if settled:
            text += f"\n\ninto the steady state, with {', '.join(f'{k} = {v:g}' for k, v in settling.items())}:\n"
            text += settled_as_text(settled)
        content = [*(row.as_dict() for row in rows), *(row.as_dict() for row in settled)]
        plot_work_precision(rows, f"{scene.name}: error against run time", place.file("work_precision.png"))
        plot_energy(energies, f"{scene.name}: energy balance", place.file("energy.png"))
        write_json(content, place.file("rows.json"))
        place.file("table.txt").write_text(text + "\n")
        if str(options.json) != "-":
            tell(options, text)
        if options.json:
            write_json(content, options.json)
        kept = place.keep()
    if str(options.json) != "-":
        wrote(options, kept)
    return 0
