"""``mbfmu compare``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mbfmu.modeling.replaced_inputs import describe
from mbfmu.modeling.scene import Scene, as_toml
from mbfmu.modeling.settings import offered_solvers
from mbfmu.util.diagnostics import render
from mbfmu.util.errors import UserError
from mbfmu.util.files import write_text

from .common import (
    EXISTING_FOLDER_TEXT,
    RESULTS_FOLDER,
    Commands,
    add_input,
    add_scene,
    add_set,
    add_times,
    assignments,
    bar,
    print_if_verbose,
    print_inputs,
    print_paths,
    print_unless_quiet,
    reader,
    scene_of,
    scene_part,
    writable,
    write_json,
)
from .completion import complete, output_names
from .results import Results, results

OWN_RESOLUTION = "own"  # resolution: the scene's

COMPARE_EXAMPLES = """examples:
  mbfmu compare fourbar
  mbfmu compare governor/damped --repeats 1
  mbfmu compare fourbar --solver adams --solver hybrid --tolerance 1e-5 --tolerance 1e-7
  mbfmu compare sheet --output tip.y --resolution nx=7,nz=5 --resolution nx=13,nz=9
  mbfmu compare sheet --resolution own --tolerance 1e-4    the grid of the scene: only errors of the time integration
  mbfmu compare fourbar --target 1e-6                      recommended solver and tolerance for this error
  mbfmu compare sheet --target "1 mm" --output tip.y --save quick.toml
"""


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu compare``."""
    p = commands.add_parser(
        "compare",
        help=about,
        description="""Simulate a scene with several solvers and tolerances, and with several discretisations if the
model declares them (grid sizes, numbers of modes). Print and plot the error of each run against its CPU time. Small
models that settle if they are damped are also run into their steady state, which is compared with the equilibrium.

The error of a run is the largest error of any output, relative to the range of that output. The text below the table
lists the reference and its uncertainty, the outputs that are excluded, and the runs that were omitted to save time.
Pareto-optimal runs (no cheaper run is as accurate) are marked by *.

The results are in a folder such as results/fourbar/default-compare:
  work_precision.png  error against CPU time, with the Pareto front
  energy.png          energy error at the tolerance of the scene
  rows.json           one entry per run
  table.txt           the printed table

With --target no folder is written. One line recommends a solver, a tolerance and a discretisation, with the CPU time
and the expected error; --save writes the recommendation as a scene.""",
        epilog=COMPARE_EXAMPLES,
    )
    add_scene(p)
    add_set(p)
    add_input(p)
    add_times(p, "stop time", "interval between outputs")
    names = offered_solvers()
    named = p.add_argument(
        "--solver",
        action="append",
        metavar="NAME",
        help=f"solver; may be repeated (default: all that differ for the model): {', '.join(names)}",
    )
    complete(named, list(names))
    p.add_argument(
        "--tolerance",
        action="append",
        type=reader(float),
        metavar="X",
        help="tolerance; may be repeated (default: 1e-4 to 1e-10; fewer with several discretisations, larger for large "
        "models)",
    )
    p.add_argument(
        "--resolution",
        action="append",
        metavar="NAME=N[,NAME=N]",
        help="values of the discretisation parameters; may be repeated, three or more give the order of convergence "
        f"(default: those that the model declares; {OWN_RESOLUTION}: those of the scene)",
    )
    judged = p.add_argument(
        "--output",
        dest="outputs",
        action="append",
        default=[],
        metavar="OUTPUT",
        help="output that is compared; may be repeated (default: all that are not prescribed). For the folder use -o",
    )
    complete(judged, output_names)
    p.add_argument(
        "--repeats",
        type=reader(int),
        default=5,
        metavar="N",
        help="number of timed runs, of which the median is used (default 5)",
    )
    p.add_argument(
        "--budget",
        type=reader(float),
        default=120.0,
        metavar="S",
        help="CPU time for all runs, s (default 120); runs that exceed it are omitted and listed",
    )
    p.add_argument(
        "--target",
        metavar="ERROR",
        help="recommend the cheapest settings with at most this error, relative to the range of an output (1e-4) or "
        "absolute ('0.2 mm')",
    )
    p.add_argument("--save", type=Path, metavar="FILE.toml", help="write the recommendation of --target as a scene")
    p.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="also write the results of all runs to this file; - is standard output",
    )
    p.add_argument(
        "-o",
        dest="output",
        type=Path,
        default=RESULTS_FOLDER,
        metavar="DIR",
        help=f"write the folder DIR/MODEL/SCENE-compare (DIR: {RESULTS_FOLDER}). {EXISTING_FOLDER_TEXT}",
    )
    p.set_defaults(command=command_compare)


def command_compare(options: argparse.Namespace) -> int:
    """Compare: print a table and draw two plots, or recommend settings for a target."""
    scene = scene_of_compare(options)
    for path in filter(None, (options.json, options.save)):
        writable(path)
    return command_table(options, scene) if options.target is None else command_target(options, scene)


def scene_of_compare(options: argparse.Namespace) -> Scene:
    """Return the scene; solvers and tolerances are many here, and not the scene's."""
    if options.save and options.target is None:
        raise UserError("--save is given without --target; add a target, as in --target 1e-4")
    if options.save and options.save.suffix != ".toml":
        raise UserError(f"--save is {str(options.save)!r}; allowed: a file whose name ends in .toml")
    return scene_of(argparse.Namespace(**vars(options) | {"solver": None, "tolerance": None}))


def common_arguments(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments that both ways to compare have in common."""
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
    return [
        {} if text == OWN_RESOLUTION else assignments("--resolution", text.replace(",", " ").split()) for text in texts
    ]


def counting(options: argparse.Namespace, shown: Any) -> Callable[[str, float], None]:
    """Return the callback that reports each finished run and moves a progress bar of 100 by its share."""
    reached = 0.0

    def done(what: str, share: float) -> None:
        nonlocal reached
        print_if_verbose(options, f"done: {what}")
        reached += share
        shown.update(int(100.0 * reached) - shown.n)

    return done


def command_table(options: argparse.Namespace, scene: Scene) -> int:
    """Compare, print the table and draw the plots."""
    from mbfmu.studies.compare import DEFAULT_TOLERANCES, compare, solvers_of
    from mbfmu.studies.comparison_report import as_text
    from mbfmu.studies.settling import Settled, settle
    from mbfmu.studies.settling import as_text as settled_as_text

    compiled = scene.model.compile()
    settling = scene.model.settling if compiled.system.has_matrices else {}
    settled: list[Settled] = []
    with results(options.output, scene, f"{scene_part(scene)}-compare") as place:
        with bar(100, "compare", options.quiet, "%") as shown:
            found = compare(
                scene, **common_arguments(options), repeats=options.repeats, progress=counting(options, shown)
            )
        if settling:
            tolerances, solvers = options.tolerance or DEFAULT_TOLERANCES, options.solver or solvers_of(compiled)
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
            text += f"\n\nruns into the steady state, with {', '.join(f'{k} = {v:g}' for k, v in settling.items())}:\n"
            text += settled_as_text(settled)
        content = [*(row.as_dict() for row in found.rows), *(row.as_dict() for row in settled)]
        draw(found, scene, place)
        write_json(content, place.file("rows.json"))
        text = "\n".join([*describe(scene.model.replaced_inputs), text])
        write_text(place.file("table.txt"), text + "\n")
        if str(options.json) != "-":
            print_unless_quiet(options, text)
        if options.json:
            write_json(content, options.json)
        kept = place.keep()
    if str(options.json) != "-":
        print_paths(options, kept)
    return 0


def draw(found: Any, scene: Scene, place: Results) -> None:
    """Draw the pictures of a comparison."""
    from mbfmu.studies.work_precision import plot_energy, plot_work_precision

    plot_work_precision(found, f"{scene.name}: error against CPU time", place.file("work_precision.png"))
    plot_energy(found, f"{scene.name}: energy error", place.file("energy.png"))


def command_target(options: argparse.Namespace, scene: Scene) -> int:
    """Recommend settings for a target; write them as a scene."""
    from mbfmu.studies.recommendation import recommend_solver

    with bar(100, "compare", options.quiet, "%") as shown:
        found = recommend_solver(scene, options.target, **common_arguments(options), progress=counting(options, shown))
    if options.save:
        write_text(options.save, as_toml(found.scene))
    if options.json:
        write_json([row.as_dict() for row in found.rows], options.json)
    if str(options.json) != "-":
        print_inputs(options, scene)
        print(found.sentence)
        for line in render(d for d in found.diagnostics if options.verbose or d.code == "not-examined"):
            print_unless_quiet(options, line)
        if options.save:
            print_paths(options, options.save)
    return 0
