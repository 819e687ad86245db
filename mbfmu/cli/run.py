"""``mbfmu run``."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from mbfmu.native import Result, communication_points, run
from mbfmu.scene import Scene
from mbfmu.viewer import Recorder

from .common import (
    Commands,
    add_output,
    add_set,
    add_solver,
    files_of,
    folder,
    progress,
    scene_of,
    stem_of,
    writing,
)

QUICK = 5.0  # s; an FMU's run that took less is repeated for its poses


def add(commands: Commands) -> None:
    """Describe ``mbfmu run``."""
    p = commands.add_parser(
        "run",
        help="run a scene or a model and write CSV and PNG",
        description="Run a scene or a model; write its outputs as CSV and PNG, and the poses of its bodies as NAME.npz "
        "for `mbfmu view`. The names tell the solver (fourbar_ida.csv), and of a run that "
        "ended early (fourbar_ida_failed.csv). An FMU does not tell poses: they come from a native repeat of the run, "
        f"which is left out where the FMU took more than {QUICK:g} s.",
    )
    p.add_argument("scene", help="scene file, model name, model/scene, or my_model.py:MyModel")
    p.add_argument("--native", action="store_true", help="run without the FMU")
    add_set(p)
    add_solver(p)
    p.add_argument("--stop-time", type=float, metavar="S", help="end of the run, s")
    p.add_argument("--interval", type=float, metavar="S", help="time between outputs, s")
    add_output(p, "CSV, PNG and poses")
    p.set_defaults(command=command_run)


def command_run(options: argparse.Namespace) -> int:
    """Run a scene; write CSV, PNG and poses; print a summary."""
    from mbfmu.studies.report import plot_result

    scene = scene_of(options)
    target, stem = folder(options.output), stem_of(scene)
    files, failed = files_of(target, stem), files_of(target, f"{stem}_failed")  # what went well before stays
    begin = time.perf_counter()
    times = communication_points(scene.stop_time, scene.output_interval)
    recorder = Recorder()
    with progress(scene) as bar:
        if options.native:
            result = run(scene.model, scene.settings, times, bar, recorder, warn)
        else:
            from mbfmu.fmi.run import run_fmu

            with tempfile.TemporaryDirectory(prefix="mbfmu_") as place:
                result = run_fmu(scene.model, scene.settings, times, Path(place) / "model.fmu", bar, warn)
    total, result.name = time.perf_counter() - begin, scene.name
    csv, png, poses = failed if result.failure else files
    with writing(target):
        result.write_csv(csv)
        plot_result(result, png)
    print("\n".join((summary(scene, result, total), *(f"  {line}" for line in loops(scene)))))
    if not options.native and result.wall_time < QUICK:
        run(scene.model, scene.settings, result.t, watch=recorder)
    if recorder.used:
        with writing(target):
            recorder.motion(scene.name).save(poses)
        print(f"wrote {csv}, {png} and {poses}")
    else:
        print(f"wrote {csv} and {png}; see the motion with `mbfmu view {options.scene}` or after a run with --native")
    if result.coarse:
        print(f"mbfmu: warning: {result.coarse}", file=sys.stderr)
    if result.failure:
        print(f"mbfmu: {result.failure}", file=sys.stderr)
    return 1 if result.failure or result.verdict else 0


def warn(text: str) -> None:
    """Say at once that the energy balance is lost."""
    tqdm.write(f"mbfmu: {text}", file=sys.stderr)


def loops(scene: Scene) -> list[str]:
    """Return what is void or redundant in the loops of a scene at its start."""
    plant = scene.model.plant()
    return plant.loops(0.0, plant.assemble()[0]) if plant.mechanism.constraints else []


def summary(scene: Scene, result: Result, total: float) -> str:
    """Return what a run cost and how well it kept its invariants."""
    outputs, s = result.as_dict(), result.statistics
    lines = [
        f"{scene.name}: {scene.settings.name}, tolerance {scene.settings.tolerance:g}, {result.t[-1]:g} s simulated",
        f"  run {result.wall_time:.3f} s; in all {total:.2f} s with start, compilation and export",
        f"  {s.steps} steps ({s.rejected} rejected), {s.rhs_evals} evaluations, "
        f"{s.partition_switches} partition switches",
    ]
    if 2 * s.stability_limited > s.steps:
        lines.append(
            f"  stability, not accuracy, set the length of {s.stability_limited} steps: a looser tolerance will not "
            "help; where the fast motion is damped, ida takes fewer"
        )
    if scene.settings.audit:
        worst, exchanged = np.abs(outputs["energy_imbalance"]).max(), outputs["energy_exchanged"][-1]
        part = f", {worst / exchanged:.1e} of the {exchanged:.3g} J exchanged" if exchanged else ""
        held = f"{worst:.2e} J{part}{': LOST' if result.verdict else ''}"
        lines.append(f"  energy imbalance {held if np.isfinite(worst) else 'not held: the drives leave nothing free'}")
    for key, unit in (("position_residual", "m"), ("velocity_residual", "m/s")):
        if key in outputs:
            lines.append(f"  largest {key.replace('_', ' ')} {outputs[key].max():.2e} {unit}")
    lines += [f"  note: {remark}" for remark in result.remarks]
    return "\n".join(lines)
