"""``mbfmu run``."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import nullcontext
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from mbfmu.curves import matching
from mbfmu.direct import Result, communication_points, loops, run
from mbfmu.energy_check import VARIABLES
from mbfmu.files import write_text
from mbfmu.scene import Scene, as_toml
from mbfmu.settings import AUTO
from mbfmu.simulation import Simulation
from mbfmu.viewer import Recorder
from solvers.compiled.cache import NotCompiled, compiling_nothing

from .common import (
    Commands,
    add_output,
    add_scene,
    add_set,
    add_solver,
    add_times,
    progress,
    run_part,
    scene_of,
    scene_part,
    show,
    show_more,
    wrote,
)
from .completion import complete, output_names
from .results import Results, results

QUICK = 5.0  # s; an FMU's run that took less is repeated for its poses
CSV, PICTURE, SAVED, POSES = "outputs.csv", "outputs.png", "result.npz", "motion.npz"

EXAMPLES = """examples:
  mbfmu run fourbar                                                      the model as it is
  mbfmu run fourbar/paper --direct                                       a scene that ships with it, without the FMU
  mbfmu run fourbar --solver adams --tolerance 1e-8 --set crank_mass=2   other settings, and another parameter
  mbfmu run governor --plot 'rod*.force' --plot energy                   a picture of these outputs only
  cat "$(mbfmu -q run fourbar)/outputs.csv"                              the path of the results in a script
"""


class CalledDirect(argparse.Action):
    """What was called ``--native`` until 0.2."""

    def __call__(self, _: Any, options: argparse.Namespace, *__: Any) -> None:
        """Act as ``--direct``, and report it."""
        options.direct = True
        print("mbfmu: --native is called --direct: native is machine code without Python", file=sys.stderr)


def add(commands: Commands) -> None:
    """Describe ``mbfmu run``."""
    p = commands.add_parser(
        "run",
        help="run a scene or a model; write its outputs, a picture and the motion",
        description=f"""Run a scene or a model: export it as an FMU, and drive that through FMPy.

The FMU is machine code where the runtime is there (`mbfmu runtime`) and solver and model go into it; else it calls
Python. The summary says which it was.

The results are in a folder such as results/fourbar/paper-hybrid-1e-4:
  {CSV}  every output over time
  {PICTURE}  the outputs as curves
  {SAVED}   all of it, for mbfmu.Result.load
  {POSES}   where the bodies were, for `mbfmu view`
  paper.toml   the scene with every value, for `mbfmu run`

The folder of a run that ended early ends in -failed. That of a run that lost its energy balance ends in -inaccurate.
The exit code of both is 1. A mistake in what you ask for gives 2, and an interrupted run 130; these write nothing.

An FMU does not tell poses. They come from a direct repeat of the run, which is left out where the FMU took more than
{QUICK:g} s, and where all went without compiling and the repeat would not.""",
        epilog=EXAMPLES,
    )
    add_scene(p)
    p.add_argument("--direct", action="store_true", help="run without the FMU: faster, with the same numbers")
    p.add_argument("--native", action=CalledDirect, dest="direct", nargs=0, help=argparse.SUPPRESS)
    shown = p.add_argument(
        "--plot",
        action="append",
        default=[],
        metavar="OUTPUT",
        help="draw this output, or all that a pattern such as 'coupler.*' fits; may be repeated. Without it all are "
        "drawn, but no more than a dozen in one panel",
    )
    complete(shown, output_names)
    add_set(p)
    add_times(p, "end of the run", "time between outputs")
    add_output(p, "MODEL/SCENE-SOLVER-TOLERANCE")
    add_solver(p)
    p.set_defaults(command=command_run)


def command_run(options: argparse.Namespace) -> int:
    """Run a scene; write what it gives into a folder; print a summary."""
    begin = time.perf_counter()
    scene = scene_of(options)
    outputs = [name for name, *_ in scene.model.built().outputs]
    matching([*outputs, *(v.name for v in VARIABLES)], options.plot)  # complains before the run
    with results(options.output, scene, run_part(scene, options.set)) as place:
        recorder = Recorder()
        result, way, notes = ran(scene, options, recorder)
        total = time.perf_counter() - begin
        if way is not Way.DIRECT and result.wall_time < QUICK:
            recorder = repeated(scene, result, compiles=way is not Way.NATIVE)
        elif way is not Way.DIRECT and scene.settings.solver == AUTO:
            result.remarks = (str(Simulation(scene.model, scene.settings).pick),)
        write(place, scene, result, recorder, options.plot)
        show(options, "\n".join((summary(scene, result, way, total), *(f"  {line}" for line in notes))))
        show_more(options, statistics(result))
        wrote(options, place.keep(mark(result)))
    if not recorder.used:
        show(options, f"see the motion with `mbfmu view {options.scene}`, or after a run with --direct")
    for text in filter(None, (result.coarse and f"warning: {result.coarse}", result.failure)):
        print(f"mbfmu: {text}", file=sys.stderr)
    return 1 if mark(result) else 0


class Way(Enum):
    """Description of how a scene was run."""

    DIRECT = "directly"
    NATIVE = "as a native FMU"
    COUPLED = "as an FMU that calls Python"


def ran(scene: Scene, options: argparse.Namespace, recorder: Recorder) -> tuple[Result, Way, list[str]]:
    """Return the result of a scene, through its FMU or directly, and what is to be said of its loops."""
    times = communication_points(scene.stop_time, scene.output_interval)
    with progress(scene, options.quiet) as bar:
        if options.direct:
            result, way, notes = run(scene.model, scene.settings, times, bar, recorder, warn), Way.DIRECT, None
        else:
            from mbfmu.fmi import export
            from mbfmu.fmi.apart import make_for_a_run
            from mbfmu.fmi.run import run_fmu

            with tempfile.TemporaryDirectory(prefix="mbfmu_") as place:
                path = Path(place) / "model.fmu"
                notes = make_for_a_run(scene, path)
                way = Way.COUPLED if notes is None else Way.NATIVE
                if way is Way.COUPLED:
                    export(scene.model, path, scene.settings)
                result = run_fmu(path, scene.model, scene.settings, times, bar, warn)
    result.name = scene.name
    return result, way, loops(scene.model) if notes is None else notes


def repeated(scene: Scene, result: Result, *, compiles: bool) -> Recorder:
    """Repeat a run directly for its poses and messages, which an FMU does not return; return the recorder.

    Where it may compile nothing and would have to, it is left out.
    """
    recorder = Recorder()
    try:
        with nullcontext() if compiles else compiling_nothing():
            result.remarks = run(scene.model, scene.settings, result.t, watch=recorder).remarks
    except NotCompiled:
        return Recorder()
    return recorder


def mark(result: Result) -> str:
    """Return the suffix of the folder name of a run that may be wrong; empty if no problem is known."""
    return "failed" if result.failure else "inaccurate" if result.verdict else ""


def write(place: Results, scene: Scene, result: Result, recorder: Recorder, shown: list[str]) -> None:
    """Write the files of a run."""
    from mbfmu.studies.report import plot_result

    result.write_csv(place.file(CSV))
    result.save(place.file(SAVED))
    plot_result(result, place.file(PICTURE), shown)
    write_text(place.file(f"{scene_part(scene)}.toml"), as_toml(scene))
    if recorder.used:
        recorder.motion(scene.name).save(place.file(POSES))


def warn(text: str) -> None:
    """Print at once that the energy balance is lost, or that another solver is far cheaper."""
    tqdm.write(f"mbfmu: {text}", file=sys.stderr)


def summary(scene: Scene, result: Result, way: Way, total: float) -> str:
    """Return how a scene was run, what that cost, and how well it kept its invariants."""
    outputs, s = result.as_dict(), result.statistics
    lines = [
        f"{result.title}: {result.t[-1]:g} s simulated",
        f"  run {way.value} in {result.wall_time:.3f} s; in all {total:.2f} s with start, compilation and export",
        f"  {s.steps} steps ({s.rejected} rejected), {s.rhs_evals} evaluations, "
        f"{s.partition_switches} partition switches",
    ]
    if 2 * s.stability_limited > s.steps:
        lines.append(
            f"  stability, not accuracy, set the length of {s.stability_limited} steps: a looser tolerance will not "
            "help; `mbfmu check` tells which solver takes fewer"
        )
    if scene.settings.energy_check:
        worst, exchanged = np.abs(outputs["energy_error"]).max(), outputs["energy_throughput"][-1]
        part = f", {worst / exchanged:.1e} of the {exchanged:.3g} J exchanged" if worst < exchanged else ""
        held = f"{worst:.2e} J{part}{': LOST' if result.verdict else ''}"
        lines.append(f"  energy error {held if np.isfinite(worst) else 'not held: the drives leave nothing free'}")
    for key, unit in (("position_residual", "m"), ("velocity_residual", "m/s")):
        if key in outputs:
            lines.append(f"  largest {key.replace('_', ' ')} {outputs[key].max():.2e} {unit}")
    lines += [f"  note: {remark}" for remark in result.remarks]
    return "\n".join(lines)


def statistics(result: Result) -> str:
    """Return all counters and all settings of the solver."""
    assert result.settings is not None
    told = "\n".join(f"    {name} = {value}" for name, value in asdict(result.settings).items())
    counts = "\n".join(f"    {name} = {value:g}" for name, value in asdict(result.statistics).items())
    return f"  settings\n{told}\n  statistics of the solver\n{counts}"
