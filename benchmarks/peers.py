"""Error against computing time of mbfmu and of other engines: ``python benchmarks/peers.py``.

Four-bar, governor without gravity, swing pendulum, and a row of four-bars (A02 of the IFToMM library), 10 s with 1001
outputs. Engines that are installed are run (extra ``bench``: CasADi, MuJoCo, Exudyn, Pinocchio), each with a list of
settings; the others are named. The error is the largest of one angle at the outputs, against SciPy on an equation of
motion in minimal coordinates. Times are the least CPU times of several runs of one process, compilation and building
excluded. Of every engine the settings are drawn that no other setting of it surpasses in both error and time.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import chdir
from importlib import import_module, metadata
from pathlib import Path
from typing import NamedTuple

import numpy as np
from engines.problems import END, TIMES, Array, Problem, Run, problems

from mbfmu.plotting.figures import finish, subplots
from mbfmu.session.saved_states import Checkpoint
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.text_table import format_table
from solvers.compiled.cache import measure_compilation_time

ENGINES = {"casadi": "CasADi", "mujoco": "MuJoCo", "exudyn": "Exudyn", "pinocchio": "Pinocchio"}
SOLVERS = ("adams", "hybrid", "ida")
TOLERANCES = 10.0 ** np.arange(-3.0, -11.5, -0.5)
MAX_ERROR = 0.1  # rad: larger errors are another motion
ERRORS = (1e-3, 1e-6, 1e-9)  # rad, of the table


class Point(NamedTuple):
    """A setting of an engine, its error, rad, and its CPU time, s."""

    engine: str
    setting: str
    error: float
    seconds: float


def ours(problem: Problem) -> Iterator[tuple[str, Run]]:
    """Yield a setting of mbfmu and what runs the problem with it and records all its outputs."""
    for solver in SOLVERS:
        for tolerance in TOLERANCES:
            simulation = Simulation(problem.ours(), Settings(solver=solver, tolerance=float(tolerance)))
            fresh = simulation.checkpoint()
            place = [variable.name for variable in simulation.variables].index(problem.angle)
            values = np.zeros((len(TIMES) - 1, len(simulation.variables)))
            first = float(simulation.outputs()[place])

            def run(
                simulation: Simulation = simulation,
                fresh: Checkpoint = fresh,
                values: Array = values,
                place: int = place,
                first: float = first,
            ) -> Array:
                simulation.rollback(fresh)
                if simulation.record(TIMES[1:], values) < len(values):
                    raise RuntimeError("the run stops early")
                return np.concatenate(([first], values[:, place]))

            yield f"{solver} {tolerance:.0e}", run


def measure(
    name: str, runs: Iterator[tuple[str, Run]], exact: Array, repeats: int, budget: float, longest: float
) -> Iterator[Point]:
    """Yield the point of every setting that finishes, until the CPU time without compilation exceeds ``budget`` (s).

    Settings that need more than ``longest`` (s) are run once.
    """
    begin = time.process_time()
    with measure_compilation_time() as compilation_time:
        for setting, run in runs:
            try:
                first = time.process_time()
                error = float(np.abs(run() - exact).max())
                least = time.process_time() - first
                for _ in range(repeats if least < longest and error < MAX_ERROR else 0):
                    start = time.process_time()
                    run()
                    least = min(least, time.process_time() - start)
            except Exception as failure:  # engines raise their own errors
                print(f"  {name} {setting}: {str(failure).strip().splitlines()[-1][:100]}")
                continue
            if np.isfinite(error) and error < MAX_ERROR:
                yield Point(name, setting, error, least)
            if time.process_time() - begin - compilation_time() > budget:
                print(f"  {name}: stopped after {budget:g} s")
                return


def best(points: list[Point]) -> list[Point]:
    """Return the points that no other one of the same engine surpasses, by error."""
    found: list[Point] = []
    for point in sorted(points, key=lambda p: (p.seconds, p.error)):
        if not found or point.error < found[-1].error:
            found.append(point)
    return found


def draw(found: dict[str, list[Point]], titles: dict[str, str], path: Path) -> None:
    """Draw error against time, one picture for a problem."""
    figure, axes = subplots(1, len(found), size=(4.2 * len(found), 4.2), squeeze=False)
    engines = list(dict.fromkeys(point.engine for points in found.values() for point in points))
    for ax, (name, points) in zip(axes[0], found.items(), strict=True):
        for k, engine in enumerate(engines):
            own = best([point for point in points if point.engine == engine])
            if own:
                ax.loglog(
                    [p.error for p in own],
                    [1e3 * p.seconds for p in own],
                    "os^vD"[k % 5] + "-",
                    color=f"C{k}",
                    label=engine,
                )
        ax.set_title(titles[name])
        ax.set_xlabel("largest error [rad]")
        ax.grid(alpha=0.3, which="major")
    axes[0][0].set_ylabel("CPU time [ms]")
    known = {label: line for ax in axes[0] for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    axes[0][0].legend(known.values(), known.keys(), fontsize=8)
    finish(figure, path)


def table(found: dict[str, list[Point]], titles: dict[str, str]) -> str:
    """Return the fastest setting of every engine for several errors."""
    lines = []
    for name, points in found.items():
        for engine in dict.fromkeys(point.engine for point in points):
            cells = []
            for error in ERRORS:
                own = [p for p in points if p.engine == engine and p.error <= error]
                fastest = min(own, key=lambda p: p.seconds, default=None)
                cells.append("-" if fastest is None else f"{1e3 * fastest.seconds:.3g} ({fastest.setting})")
            lines.append((titles[name], engine, *cells))
    return format_table(("mechanism", "engine", *(f"ms at {error:.0e} rad" for error in ERRORS)), lines)


def main() -> None:
    """Measure, print the table and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="PROBLEM", help="fourbar, governor, pendulum, a02; default: all")
    parser.add_argument("-o", "--output", type=Path, default=Path(), metavar="FOLDER")
    parser.add_argument("--loops", type=int, default=40, help="number of four-bars in the row")
    parser.add_argument("--repeats", type=int, default=5, help="runs of every setting after the first")
    parser.add_argument(
        "--budget", type=float, default=60.0, help="CPU time for one engine and mechanism, without compilation, s"
    )
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    chosen = {n: p for n, p in problems(options.loops).items() if not options.names or n in options.names}
    modules = {}
    for package, title in ENGINES.items():
        try:
            modules[package] = import_module(f"engines.with_{package}")
        except ImportError:
            print(f"{title} is not installed and is skipped")
    print(
        f"mbfmu {metadata.version('mbfmu')}: adams, hybrid and ida at tolerances of 1e-3 to 1e-11, all outputs recorded"
    )
    for module in modules.values():
        print(f"{module.NAME}: {module.SETTINGS}")
    found: dict[str, list[Point]] = {}
    with tempfile.TemporaryDirectory() as folder, chdir(folder):  # for files of compilers and logs of the engines
        for name, problem in chosen.items():
            exact, limits = problem.exact(), (options.repeats, options.budget, END)
            print(problem.title, flush=True)
            found[name] = list(measure("mbfmu", ours(problem), exact, *limits))
            for module in modules.values():
                found[name] += measure(module.NAME, module.runs(name, options.loops), exact, *limits)
    titles = {name: problem.title for name, problem in chosen.items()}
    print(table(found, titles))
    draw(found, titles, options.output / "peers.png")


if __name__ == "__main__":
    main()
