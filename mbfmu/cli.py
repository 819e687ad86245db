"""The command ``mbfmu``."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

import mbfmu
from mbfmu.errors import UserError
from mbfmu.model import models, span
from mbfmu.scene import Scene, load_scene
from mbfmu.simulation import Result, communication_points, run
from solvers import SOLVERS

EXAMPLES = """examples:
  mbfmu run fourbar                        export the FMU, run it through FMPy, write CSV and PNG
  mbfmu run fourbar --solver adams --native
  mbfmu run fourbar/paper                  a scene that ships with a model
  mbfmu run my_scene.toml
  mbfmu export fourbar --set crank_length=0.8 -o fourbar.fmu
  mbfmu export my_model.py:MyModel
  mbfmu compare fourbar --json rows.json   what accuracy costs in time
  mbfmu models                             every model with its parameters
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0, 1 for a run that stopped early, 2 for a user's mistake."""
    options = parser().parse_args(arguments)
    try:
        return int(options.command(options))
    except UserError as error:
        print(f"mbfmu: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mbfmu: interrupted", file=sys.stderr)
        return 130


def parser() -> argparse.ArgumentParser:
    """Return the parser of all subcommands."""
    top = argparse.ArgumentParser(
        prog="mbfmu",
        description="Multibody mechanisms in relative coordinates, as FMUs.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"mbfmu {mbfmu.__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    add_run(commands)
    add_export(commands)
    add_compare(commands)
    listing = commands.add_parser("models", help="list the models and their parameters")
    listing.set_defaults(command=command_models)
    return top


def add_run(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe ``mbfmu run``."""
    p = commands.add_parser("run", help="run a scene or a model and write CSV and PNG")
    p.add_argument("scene", help="scene file, model name, model/scene, or my_model.py:MyModel")
    p.add_argument("--native", action="store_true", help="run without the FMU")
    add_changes(p)
    p.add_argument("--stop-time", type=float, metavar="S", help="end of the run, s")
    p.add_argument("--interval", type=float, metavar="S", help="time between outputs, s")
    p.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="DIR", help="folder for CSV and PNG")
    p.set_defaults(command=command_run)


def add_export(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe ``mbfmu export``."""
    p = commands.add_parser("export", help="write a model as an FMU (FMI 2.0 co-simulation)")
    p.add_argument("scene", metavar="model", help="model name, scene, or my_model.py:MyModel")
    add_changes(p)
    p.add_argument("-o", "--output", type=Path, metavar="FILE", help="FMU file; MODEL.fmu by default")
    p.set_defaults(command=command_export)


def add_compare(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Describe ``mbfmu compare``."""
    p = commands.add_parser("compare", help="every solver's accuracy against its time")
    p.add_argument("scene", help="scene file, model name or model/scene")
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="change a parameter")
    p.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON")
    p.add_argument("--repeats", type=int, default=5, metavar="N", help="runs the median is taken of (5)")
    p.add_argument("-o", "--output", type=Path, default=Path("results"), metavar="DIR", help="folder for the plots")
    p.set_defaults(command=command_compare)


def add_changes(p: argparse.ArgumentParser) -> None:
    """Add what changes a scene from the command line."""
    p.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="change a parameter")
    p.add_argument("--solver", metavar="NAME", help=f"one of {', '.join(SOLVERS)} (default ida)")
    p.add_argument("--partition", metavar="NAME", help="of adams: projection, lu or hybrid")
    p.add_argument("--tolerance", type=float, metavar="RTOL", help="relative tolerance (default 1e-6)")
    p.add_argument("--max-step", type=float, metavar="S", help="largest step, s; 0: no limit")


def scene_of(options: argparse.Namespace) -> Scene:
    """Return the scene with the command line's changes."""
    scene = load_scene(options.scene)
    values = {}
    for text in options.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise UserError(f"--set {text!r}: write NAME=VALUE")
        values[name.strip()] = value.strip()
    return scene.changed(
        model=scene.model.with_values(values),
        solver=getattr(options, "solver", None),
        partition=getattr(options, "partition", None),
        tolerance=getattr(options, "tolerance", None),
        max_step=getattr(options, "max_step", None),
        stop_time=getattr(options, "stop_time", None),
        output_interval=getattr(options, "interval", None),
    )


def folder(path: Path) -> Path:
    """Make the folder for results."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"folder {str(path)!r} cannot be made: {error.strerror}") from error
    return path


def command_run(options: argparse.Namespace) -> int:
    """Run a scene; write CSV and PNG; print a summary."""
    from mbfmu.report import plot_result

    scene = scene_of(options)
    target = folder(options.output)
    begin = time.perf_counter()
    times = communication_points(scene.stop_time, scene.output_interval)
    with tqdm(total=scene.stop_time, unit="s", desc=scene.name, leave=False, disable=not sys.stderr.isatty()) as bar:

        def progress(t: float) -> None:
            bar.update(t - bar.n)

        if options.native:
            result = run(scene.model, scene.settings, times, progress)
        else:
            from mbfmu.fmi.run import run_fmu

            with tempfile.TemporaryDirectory(prefix="mbfmu_") as place:
                result = run_fmu(scene.model, scene.settings, times, Path(place) / "model.fmu", progress)
    total = time.perf_counter() - begin
    csv, png = target / f"{scene.name}.csv", target / f"{scene.name}.png"
    result.write_csv(csv)
    plot_result(result, f"{scene.name}, {scene.settings.name}, tolerance {scene.settings.tolerance:g}", png)
    print(summary(scene, result, total))
    print(f"wrote {csv} and {png}")
    if result.failure:
        print(f"mbfmu: {result.failure}", file=sys.stderr)
        return 1
    return 0


def summary(scene: Scene, result: Result, total: float) -> str:
    """Return what a run cost and how well it kept its invariants."""
    outputs, s = result.as_dict(), result.statistics
    lines = [
        f"{scene.name}: {scene.settings.name}, tolerance {scene.settings.tolerance:g}, "
        f"{result.times[-1]:g} s simulated",
        f"  run {result.wall_time:.3f} s; in all {total:.2f} s with start, compilation and export",
        (f"  {s.steps} steps ({s.rejected} rejected), " if s.steps else "  ")  # IDA's binding does not tell
        + f"{s.rhs_evals} evaluations, {s.partition_switches} partition switches",
    ]
    if "energy" in outputs:
        lines.append(f"  energy drift {np.abs(outputs['energy'] - outputs['energy'][0]).max():.2e} J")
    for key, unit in (("position_residual", "m"), ("velocity_residual", "m/s")):
        if key in outputs:
            lines.append(f"  largest {key.replace('_', ' ')} {outputs[key].max():.2e} {unit}")
    return "\n".join(lines)


def command_export(options: argparse.Namespace) -> int:
    """Write an FMU."""
    from mbfmu.fmi import export

    scene = scene_of(options)
    path = export(scene.model, options.output or Path(f"{scene.name}.fmu"), scene.settings)
    print(f"wrote {path}")
    return 0


def command_compare(options: argparse.Namespace) -> int:
    """Compare all solvers; print a table, draw two plots."""
    from mbfmu.compare import as_text, compare
    from mbfmu.report import plot_energy, plot_work_precision

    scene = scene_of(options)
    if options.repeats < 1:
        raise UserError(f"--repeats is {options.repeats}; allowed: 1 or more")
    target = folder(options.output)
    with tqdm(total=4 * len(SOLVERS), desc="compare", leave=False, disable=not sys.stderr.isatty()) as bar:
        rows, energies = compare(scene, repeats=options.repeats, progress=lambda _: bar.update())
    print(as_text(rows))
    pictures = target / f"{scene.name}_work_precision.png", target / f"{scene.name}_energy.png"
    plot_work_precision(rows, f"{scene.name}: error against run time", pictures[0])
    plot_energy(energies, f"{scene.name}: energy", pictures[1])
    print(f"wrote {pictures[0]} and {pictures[1]}")
    if options.json:
        try:
            options.json.write_text(json.dumps([row.as_dict() for row in rows], indent=1) + "\n")
        except OSError as error:
            raise UserError(f"{str(options.json)!r} cannot be written: {error.strerror}") from error
    return 0


def command_models(options: argparse.Namespace) -> int:
    """List the models."""
    for name, model in sorted(models().items()):
        print(f"{name}: {model.title()}")
        for p in model.parameters():
            tunable = ", tunable" if p.tunable else ""
            unit = "" if p.unit == "1" else f" {p.unit}"
            print(f"    {p.name} = {p.default:g}{unit}  {p.doc} ({span(p)}{tunable})")
    return 0
