"""Kim and Kim's Figs. 3-8 and CPU times of the four-bar, rigid and elastic: ``python benchmarks/fourbar_paper.py``.

Writes the pictures into ``fmus/fourbar/figures`` and prints a table each.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from mbfmu.modeling.scene import load_scene
from mbfmu.plotting.figures import SOLVER_COLORS, finish, subplots
from mbfmu.session.run import Result, communication_points, run
from mbfmu.session.simulation import Simulation
from mbfmu.util.text_table import format_table

METHODS = {"LU": "adams-lu", "projection": "adams", "hybrid": "hybrid"}
ACCELERATION = ("coupler.acceleration.y", "vertical acceleration of the coupler [m/s$^2$]")
ENERGY = ("energy", "total energy [J]")
FIGURES = {  # of each scene: name of the picture, output, label
    "fourbar/paper": (
        ("fig3_acceleration", *ACCELERATION),
        ("fig4_position", "coupler.position.y", "vertical position of the coupler [m]"),
        ("fig5_energy", *ENERGY),
    ),
    "fourbar/flexible_paper": (
        ("fig6_modal_acceleration", "coupler.mode[1].acceleration", "acceleration of the first mode [m/s$^2$]"),
        ("fig7_acceleration", *ACCELERATION),
        ("fig8_energy", *ENERGY),
    ),
}
REPEATS = 7


def main() -> None:
    """Study both scenes."""
    for name in FIGURES:
        study(name)


def study(name: str) -> None:
    """Run the three methods with the paper's settings, draw and tabulate."""
    scene = load_scene(name)
    times = communication_points(scene.stop_time, scene.output_interval)
    results: dict[str, Result] = {}
    lines = []
    for method, solver in METHODS.items():
        settings = scene.changed(solver=solver).settings
        result = results[method] = run(scene.model, settings, times)
        s = result.statistics
        runs = [advance_alone(Simulation(scene.model, settings), scene.stop_time) for _ in range(REPEATS)]
        wall = statistics.median(runs)
        gap = scene.model.branch_gap(result.as_dict())
        assert gap is not None
        lines.append(
            (
                method,
                f"{1e3 * wall:.2f}",
                str(s.steps),
                str(s.rhs_evals),
                f"{1e6 * wall / s.steps:.1f}",
                str(s.partition_switches),
                f"{gap.max():.1e}",
                result.failure.partition(". ")[0] or "ok",
            )
        )
    header = ("method", "time [ms]", "steps", "evals", "us a step", "switches", "gap [rad]", "outcome")
    print(f"{name}\n{format_table(header, lines)}\n")
    draw(name, results)


def advance_alone(simulation: Simulation, end: float) -> float:
    """Return the time of the integration without outputs on the way, s."""
    begin = time.perf_counter()
    simulation.advance(end)
    return time.perf_counter() - begin


def draw(scene: str, results: dict[str, Result]) -> None:
    """One picture a figure, the three methods in each."""
    folder = Path("fmus/fourbar/figures")
    folder.mkdir(exist_ok=True)
    for name, output, label in FIGURES[scene]:
        figure, ax = subplots(size=(8.0, 3.6))
        for method, style in (("LU", "-"), ("projection", "-"), ("hybrid", "--")):
            result = results[method]
            ax.plot(result.t, result[output], style, lw=1.2, color=SOLVER_COLORS[METHODS[method]], label=method)
        exact_span = results["projection"][output]
        margin = 0.6 * (exact_span.max() - exact_span.min())
        ax.set_ylim(exact_span.min() - margin, exact_span.max() + margin) if margin > 1e-3 else None
        ax.set_xlabel("time [s]")
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
        ax.legend()
        finish(figure, folder / f"{name}.png")


if __name__ == "__main__":
    main()
