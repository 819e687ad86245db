"""``mbfmu run``."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from mbfmu.modeling.replaced_inputs import describe, is_approximated
from mbfmu.modeling.scene import Scene, as_toml
from mbfmu.modeling.variables import ENERGY_OUTPUTS
from mbfmu.plotting.time_series import errors_of, matching
from mbfmu.session.run import Result, communication_points, run
from mbfmu.util.diagnostics import INACCURATE_CODES, Diagnostic, render
from mbfmu.util.files import write_text
from mbfmu.viewer import Recorder
from solvers.compiled.cache import CompilationNeeded, forbid_compilation, is_notified

from .common import (
    Commands,
    add_input,
    add_output,
    add_scene,
    add_set,
    add_solver,
    add_times,
    print_if_verbose,
    print_paths,
    print_unless_quiet,
    progress,
    run_part,
    scene_of,
    scene_part,
)
from .completion import complete, output_names
from .results import Results, results

MAX_REPEATED_RUN_TIME = 5.0  # s; an FMU's run that took less is repeated for its poses
CSV_FILE, PICTURE_FILE, ERROR_PICTURE_FILE, RESULT_FILE, MOTION_FILE = (
    "outputs.csv",
    "outputs.png",
    "residuals.png",
    "result.npz",
    "motion.npz",
)

RUN_EXAMPLES = """examples:
  mbfmu run fourbar                                                      the model with its default values
  mbfmu run fourbar/paper --direct                                       a scene of the model, without an FMU
  mbfmu run fourbar --solver adams --tolerance 1e-8 --set crank_mass=2   other settings, and another parameter value
  mbfmu run governor --plot 'rod*.force' --plot energy                   a picture of these outputs only
  cat "$(mbfmu -q run fourbar)/outputs.csv"                              the path of the results in a script
"""


class CalledDirect(argparse.Action):
    """What was called ``--native`` until 0.2."""

    def __call__(self, _: Any, options: argparse.Namespace, *__: Any) -> None:
        """Act as ``--direct``, and report it."""
        options.direct = True
        print("mbfmu: the option --native of `mbfmu run` is now --direct", file=sys.stderr)


def add(commands: Commands, about: str) -> None:
    """Describe ``mbfmu run``."""
    p = commands.add_parser(
        "run",
        help=about,
        description=f"""Export a scene or a model as an FMU, simulate the FMU with FMPy, and write the results.

The FMU is native (machine code) if possible. The first native FMU with a solver builds the machine code of this solver,
which takes one to two minutes. If the model, the solver or this machine does not permit a native
FMU, the FMU calls Python, and the command prints the reason.

The results are in a folder such as results/fourbar/paper-hybrid-1e-4:
  {CSV_FILE}    all outputs over time
  {PICTURE_FILE}    curves of the outputs
  {ERROR_PICTURE_FILE}  residuals of the constraints and the energy error over time
  {RESULT_FILE}     outputs, statistics and messages, for mbfmu.Result.load
  {MOTION_FILE}     positions of the bodies, for `mbfmu view`
  paper.toml     the scene with all parameters and settings, for `mbfmu run`

The name of the folder ends in -failed if the run ended early, and in -inaccurate if the energy error is too large. The
exit code is 1 in both cases, 2 for an invalid argument, and 130 for an interrupted run. The last two write no files.

An FMU does not provide the positions of bodies. They are computed by a direct repeat of the run. It is omitted if the
FMU took more than {MAX_REPEATED_RUN_TIME:g} s, or if the repeat would need compilation and the FMU did not.

If a function or an expression of time replaces an input, the run is direct (--direct): short pulses are not missed.""",
        epilog=RUN_EXAMPLES,
    )
    add_scene(p)
    p.add_argument("--direct", action="store_true", help="simulate without an FMU: the same results, without an export")
    p.add_argument("--native", action=CalledDirect, dest="direct", nargs=0, help=argparse.SUPPRESS)
    shown = p.add_argument(
        "--plot",
        action="append",
        default=[],
        metavar="OUTPUT",
        help="output to plot, or a pattern such as 'coupler.*'; may be repeated. By default all outputs are plotted, "
        "the first twelve of each unit",
    )
    complete(shown, output_names)
    add_set(p)
    add_input(p)
    add_times(p, "stop time", "interval between outputs")
    add_output(p, "MODEL/SCENE-SOLVER-TOLERANCE")
    add_solver(p)
    p.set_defaults(command=command_run)


def command_run(options: argparse.Namespace) -> int:
    """Run a scene, write the results into a folder, print a summary."""
    begin = time.perf_counter()
    scene = scene_of(options)
    outputs = [name for name, *_ in scene.model.built().outputs]
    matching([*outputs, *(v.name for v in ENERGY_OUTPUTS)], options.plot)  # raises before the run
    with results(options.output, scene, run_part(scene, options.set)) as place:
        recorder, shown = Recorder(), list[Diagnostic]()

        def warn(found: Diagnostic) -> None:
            """Print at once that the energy error is too large, or that another solver is far cheaper."""
            shown.append(found)
            tqdm.write(f"mbfmu: {render([found])[0]}", file=sys.stderr)

        result, method = run_scene(scene, options, recorder, warn)
        total = time.perf_counter() - begin
        if method is not RunMethod.DIRECT and result.wall_time < MAX_REPEATED_RUN_TIME:
            recorder = repeat_directly(scene, result, compiles=method is not RunMethod.NATIVE or is_notified())
        write(place, scene, result, recorder, options.plot)
        print_unless_quiet(options, summary(scene, result, method, total))
        print_if_verbose(options, statistics(result))
        problems = result.problems
        for line in render((d for d in result.diagnostics if d not in problems), details=options.verbose):
            print_unless_quiet(options, f"  {line}")
        print_paths(options, place.keep(mark(result)))
    if not recorder.used:
        print_unless_quiet(options, f"no motion was recorded: use `mbfmu view {options.scene}`, or run with --direct")
    for line in render(d for d in problems if d not in shown):
        print(f"mbfmu: {line}", file=sys.stderr)
    return 1 if mark(result) else 0


class RunMethod(Enum):
    """Description of how a scene was run."""

    DIRECT = "direct run"
    NATIVE = "native FMU"
    COUPLED = "FMU that calls Python"


def run_scene(
    scene: Scene, options: argparse.Namespace, recorder: Recorder, warn: Callable[[Diagnostic], None]
) -> tuple[Result, RunMethod]:
    """Return the result of a scene, through its FMU or directly; ``warn`` is called during the run."""
    times, found = communication_points(scene.stop_time, scene.output_interval), list[Diagnostic]()
    with progress(scene, options.quiet) as bar:
        if options.direct or any(
            map(is_approximated, scene.model.replaced_inputs.values())
        ):  # an FMU does not know the length of the run
            result, method = run(scene.model, scene.settings, times, bar, recorder, warn), RunMethod.DIRECT
        else:
            from mbfmu.fmi.export import FmuKind, export_scene
            from mbfmu.fmi.run import run_fmu

            with tempfile.TemporaryDirectory(prefix="mbfmu_") as place:
                path = Path(place) / "model.fmu"
                kind = export_scene(scene, path, FmuKind.ONE_RUN, report=found.append)
                method = RunMethod.COUPLED if kind is FmuKind.PYTHON else RunMethod.NATIVE
                result = run_fmu(path, scene.model, scene.settings, times, bar, warn)
    result.name = scene.name
    add_missing(result, found)
    return result, method


def add_missing(result: Result, others: Sequence[Diagnostic]) -> None:
    """Add diagnostics of a direct run or an export, which are more, and more precise, than those that an FMU logs."""
    found = [d for d in others if d.severity != "error" and d.code not in INACCURATE_CODES]
    known = {diagnostic.code for diagnostic in found}
    result.diagnostics = (*found, *(d for d in result.diagnostics if d.code not in known))


def repeat_directly(scene: Scene, result: Result, *, compiles: bool) -> Recorder:
    """Repeat a run directly for its poses and diagnostics that an FMU does not report; return the recorder.

    It is omitted if it would have to compile and may not.
    """
    recorder = Recorder()
    try:
        with nullcontext() if compiles else forbid_compilation():
            add_missing(result, run(scene.model, scene.settings, result.t, watch=recorder).diagnostics)
    except CompilationNeeded:
        return Recorder()
    return recorder


def mark(result: Result) -> str:
    """Return the suffix of the folder name of a run that may be wrong; empty if no problem is known."""
    return "failed" if result.failed else "inaccurate" if result.inaccurate else ""


def write(place: Results, scene: Scene, result: Result, recorder: Recorder, shown: list[str]) -> None:
    """Write the files of a run."""
    from mbfmu.plotting.time_series import plot_result

    result.write_csv(place.file(CSV_FILE))
    result.save(place.file(RESULT_FILE))
    plot_result(result, place.file(PICTURE_FILE), shown)
    if errors := errors_of(result):
        plot_result(result, place.file(ERROR_PICTURE_FILE), errors)
    write_text(place.file(f"{scene_part(scene)}.toml"), as_toml(scene))
    if recorder.used:
        recorder.motion(scene.name).save(place.file(MOTION_FILE))


def summary(scene: Scene, result: Result, method: RunMethod, total: float) -> str:
    """Return how a scene was run, what that cost and how large the errors of its invariants are: six lines at most."""
    outputs, s = result.as_dict(), result.statistics
    steps = f"{s.steps} steps ({s.rejected} rejected), {s.rhs_evals} evaluations of the equations of motion"
    switches = f", {s.partition_switches} partition switches" if s.partition_switches else ""
    made = "including compilation" if method is RunMethod.DIRECT else "including compilation and export"
    lines = [
        f"{result.title}: {result.t[-1]:g} s simulated",
        f"  {method.value}: {result.wall_time:.3g} s; total {total:.3g} s {made}",
        f"  {steps}{switches}",
    ]
    if 2 * s.stability_limited > s.steps:
        lines.append(
            f"  the step size was limited by stability in {s.stability_limited} steps: a larger tolerance does not "
            "help; `mbfmu check` recommends a solver"
        )
    lines += [f"  {line}" for line in describe(scene.model.replaced_inputs)]
    if scene.settings.energy_check:
        lines.append(f"  {energy_line(result)}")
    residuals = (("position_residual", "m"), ("velocity_residual", "m/s"))
    found = [f"{key.replace('_', ' ')} {outputs[key].max():.1e} {unit}" for key, unit in residuals if key in outputs]
    return "\n".join([*lines, f"  largest {', '.join(found)}"] if found else lines)


def energy_line(result: Result) -> str:
    """Return the largest energy error, J, and its ratio to the energy that was exchanged."""
    worst, exchanged = np.abs(result["energy_error"]).max(), result["energy_throughput"][-1]
    if not np.isfinite(worst):
        return "energy balance not checked: the model has no degree of freedom (all joints are driven)"
    part = f" ({worst / exchanged:.1e} of the {exchanged:.3g} J of energy exchanged)" if worst < exchanged else ""
    return f"energy error {worst:.1e} J{part}{'; LARGER than the tolerance explains' if result.inaccurate else ''}"


def statistics(result: Result) -> str:
    """Return all counters and all settings of the solver."""
    assert result.settings is not None
    settings = "\n".join(f"    {name} = {value}" for name, value in asdict(result.settings).items())
    counts = "\n".join(f"    {name} = {value:g}" for name, value in asdict(result.statistics).items())
    return f"  settings\n{settings}\n  statistics of the solver\n{counts}"
