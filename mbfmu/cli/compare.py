"""``mbfmu compare``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mbfmu.errors import UserError
from mbfmu.files import write_text
from mbfmu.model import declared
from mbfmu.scene import Scene, as_toml
from mbfmu.settings import Settings

from .common import (
    AGAIN,
    RESULTS,
    Commands,
    add_scene,
    add_set,
    add_times,
    assignments,
    bar,
    reader,
    scene_of,
    scene_part,
    show,
    show_more,
    writable,
    write_json,
    wrote,
)
from .completion import complete, output_names
from .results import Results, results

OWN = "own"  # resolution: the scene's

EXAMPLES = """examples:
  mbfmu compare fourbar
  mbfmu compare governor/damped --repeats 1
  mbfmu compare fourbar --solver adams --solver hybrid --tolerance 1e-5 --tolerance 1e-7
  mbfmu compare sheet --output tip.y --resolution nx=7,nz=5 --resolution nx=13,nz=9
  mbfmu compare sheet --resolution own --tolerance 1e-4    the scene's own grid: errors in time alone
  mbfmu compare fourbar --target 1e-6                      which solver and tolerance to take for this error
  mbfmu compare sheet --target "1 mm" --output tip.y --save quick.toml
"""


def add(commands: Commands) -> None:
    """Describe ``mbfmu compare``."""
    p = commands.add_parser(
        "compare",
        help="what accuracy costs in time, or what to take for a target",
        description="""Run solvers at several tolerances, and at several resolutions where the model declares some
(grids, numbers of modes); show the error of each run against its CPU time. A small model that settles when it is damped
is also run into its steady state, beside the solution of the equilibrium equations.

The error is the largest of any output over the run, as a part of the range of that output. What it is against, how well
that is known, which outputs do not judge and what was left out for its time is printed below the table. In it * marks
the best choices: nothing that is cheaper is as accurate.

The results are in a folder such as results/fourbar/default-compare:
  work_precision.png  error against time, with the hull of best choices
  energy.png          the energy balance at the scene's tolerance
  rows.json           a row a run
  table.txt           what is printed

With --target nothing is written: one sentence says which solver, tolerance and resolution to take, what a run costs and
which error to expect; --save writes that as a scene.""",
        epilog=EXAMPLES,
    )
    add_scene(p)
    add_set(p)
    add_times(p, "end of the runs", "time between outputs")
    names = next(setting.choices for setting in declared(Settings) if setting.name == "solver")
    named = p.add_argument(
        "--solver",
        action="append",
        metavar="NAME",
        help=f"try this solver; may be repeated: {', '.join(names)} (all that differ on the model)",
    )
    complete(named, list(names))
    p.add_argument(
        "--tolerance",
        action="append",
        type=reader(float),
        metavar="X",
        help="try this tolerance; may be repeated (1e-4 to 1e-10; fewer at several resolutions, looser in large trees)",
    )
    p.add_argument(
        "--resolution",
        action="append",
        metavar="NAME=N[,NAME=N]",
        help="try these values of the parameters of resolution; may be repeated, and three or more tell the order of "
        f"convergence (what the model declares). {OWN}: as the scene is",
    )
    judged = p.add_argument(
        "--output",
        dest="outputs",
        action="append",
        default=[],
        metavar="OUTPUT",
        help="judge by this output; may be repeated (all that move freely). Where results go says -o",
    )
    complete(judged, output_names)
    p.add_argument("--repeats", type=reader(int), default=5, metavar="N", help="take the median time of N runs (5)")
    p.add_argument(
        "--budget",
        type=reader(float),
        default=120.0,
        metavar="S",
        help="CPU time for all runs, s (120); what does not fit is left out, and named",
    )
    p.add_argument(
        "--target",
        metavar="ERROR",
        help="find the cheapest that errs no more: 1e-4 of the range of an output, or absolute as in '0.2 mm'",
    )
    p.add_argument("--save", type=Path, metavar="FILE.toml", help="write what --target found as a scene")
    p.add_argument("--json", type=Path, metavar="FILE", help="write the rows here too; - is standard output")
    p.add_argument(
        "-o",
        dest="output",
        type=Path,
        default=RESULTS,
        metavar="DIR",
        help=f"write the folder DIR/MODEL/SCENE-compare; without this DIR is {RESULTS}. {AGAIN}",
    )
    p.set_defaults(command=command_compare)


def command_compare(options: argparse.Namespace) -> int:
    """Compare; print a table and draw two plots, or say what to take for a target."""
    scene = scene_of_compare(options)
    for path in filter(None, (options.json, options.save)):
        writable(path)
    return command_table(options, scene) if options.target is None else command_target(options, scene)


def scene_of_compare(options: argparse.Namespace) -> Scene:
    """Return the scene; solvers and tolerances are many here, and not the scene's."""
    if options.save and options.target is None:
        raise UserError("--save writes what --target finds; give a target, as in --target 1e-4")
    if options.save and options.save.suffix != ".toml":
        raise UserError(f"--save {str(options.save)!r}: a scene must end in .toml")
    return scene_of(argparse.Namespace(**vars(options) | {"solver": None, "tolerance": None}))


def asked(options: argparse.Namespace) -> dict[str, Any]:
    """Return what both ways to compare take."""
    return {
        "solvers": options.solver,
        "tolerances": options.tolerance,
        "resolutions": resolutions(options.resolution),
        "outputs": options.outputs,
        "budget": options.budget,
    }


def resolutions(texts: list[str] | None) -> list[dict[str, str]] | None:
    """Return the values of repeated ``NAME=N,NAME=N``; of ``own`` there are none."""
    if texts is None:
        return None
    return [{} if text == OWN else assignments("--resolution", text.replace(",", " ").split()) for text in texts]


def counting(options: argparse.Namespace, shown: Any) -> Callable[[str, float], None]:
    """Return the callback that reports each finished run and moves a progress bar of 100 by its share."""
    reached = 0.0

    def done(what: str, share: float) -> None:
        nonlocal reached
        show_more(options, f"done: {what}")
        reached += share
        shown.update(int(100.0 * reached) - shown.n)

    return done


def command_table(options: argparse.Namespace, scene: Scene) -> int:
    """Compare, print the table and draw the plots."""
    from mbfmu.studies.compare import TOLERANCES, compare, solvers_of
    from mbfmu.studies.settling import Settled, settle
    from mbfmu.studies.settling import as_text as settled_as_text
    from mbfmu.studies.words import as_text

    plant = scene.model.plant()
    settling = scene.model.settling if plant.system.has_matrices else {}
    settled: list[Settled] = []
    with results(options.output, scene, f"{scene_part(scene)}-compare") as place:
        with bar(100, "compare", options.quiet, "%") as shown:
            found = compare(scene, **asked(options), repeats=options.repeats, progress=counting(options, shown))
        if settling:
            tolerances, solvers = options.tolerance or TOLERANCES, options.solver or solvers_of(plant)
            total = options.repeats * (1 + len(tolerances) * len(solvers))
            with bar(total, "settling", options.quiet) as shown:
                settled = settle(
                    scene.model.with_values(settling),
                    tolerances=tolerances,
                    solvers=solvers,
                    repeats=options.repeats,
                    progress=lambda _: shown.update(),
                )
        text = as_text(found)
        if settled:
            text += f"\n\ninto the steady state, with {', '.join(f'{k} = {v:g}' for k, v in settling.items())}:\n"
            text += settled_as_text(settled)
        content = [*(row.as_dict() for row in found.rows), *(row.as_dict() for row in settled)]
        draw(found, scene, place)
        write_json(content, place.file("rows.json"))
        write_text(place.file("table.txt"), text + "\n")
        if str(options.json) != "-":
            show(options, text)
        if options.json:
            write_json(content, options.json)
        kept = place.keep()
    if str(options.json) != "-":
        wrote(options, kept)
    return 0


def draw(found: Any, scene: Scene, place: Results) -> None:
    """Draw the pictures of a comparison."""
    from mbfmu.studies.work_precision import plot_energy, plot_work_precision

    plot_work_precision(found, f"{scene.name}: error against CPU time", place.file("work_precision.png"))
    plot_energy(found, f"{scene.name}: energy balance", place.file("energy.png"))


def command_target(options: argparse.Namespace, scene: Scene) -> int:
    """Say what to take for a target; write it as a scene."""
    from mbfmu.studies.recommendation import recommend_solver

    with bar(100, "compare", options.quiet, "%") as shown:
        found = recommend_solver(scene, options.target, **asked(options), progress=counting(options, shown))
    if options.save:
        write_text(options.save, as_toml(found.scene))
    if options.json:
        write_json([row.as_dict() for row in found.rows], options.json)
    if str(options.json) != "-":
        print(found.sentence)
        if found.held_inputs:
            show(options, f"not evaluated: {found.held_inputs}")
        show_more(options, "\n".join(found.notes))
        if options.save:
            wrote(options, options.save)
    return 0
