"""Error and cost of inputs that change at every communication point: ``python benchmarks/cosimulation.py [-o FOLDER]``.

Four-bar with a sinusoidal torque that is held between points, or extrapolated linearly. The cranks are equal, so that
the coupler translates and the motion is that of one inertia. The reference is SciPy's integration of this motion: with
the torque as it was held (integration error) and with the sine (error of holding or extrapolating the torque).

Prints a table, medians of several runs with the kernels compiled, and writes ``cosimulation.png``.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import cache
from math import pi, sin
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from timing import median_times

from fmus.fourbar import FourBar
from mbfmu.plotting.figures import finish
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.text_table import format_table

START, END, AMPLITUDE = 0.4, 1.0, 5.0  # rad, s, N m
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4)  # s
SOLVERS = ("adams", "hybrid", "ida")
TOLERANCE = 1e-6


class Row(NamedTuple):
    """What one run came to."""

    own: float  # rad, error under the torque as it was held
    held: float  # rad, under the sine
    gone_on: float  # rad, under the sine, where the torque continues
    time: float  # us a point
    evaluations: float  # a point
    steps: float  # a point


def torque(t: float) -> float:
    """The sine, N m."""
    return AMPLITUDE * sin(2.0 * pi * t)


@cache
def angle(step: float) -> float:
    """The crank's angle at the end (rad), the torque held over ``step`` (s); 0: not held."""
    model = FourBar()
    inertia = (model.crank_mass + model.rocker_mass) / 3.0 + model.coupler_mass
    weight = (0.5 * (model.crank_mass + model.rocker_mass) + model.coupler_mass) * model.gravity

    def rates(load: Callable[[float], float]) -> Callable[[float, NDArray[np.float64]], list[float]]:
        return lambda t, y: [y[1], (load(t) - weight * np.cos(y[0])) / inertia]

    spans = [(0.0, END)] if not step else [(k * step, (k + 1) * step) for k in range(round(END / step))]
    y = np.array([START, 0.0])
    for span in spans:
        held = torque(span[0])
        load = (lambda _t, held=held: held) if step else torque
        y = solve_ivp(rates(load), span, y, rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1]
    return float(y[0])


def drive(solver: str, step: float, *, changing: bool = True, inputs: str = "hold") -> Simulation:
    """Run to the end in steps of ``step``, s."""
    settings = Settings(solver=solver, tolerance=TOLERANCE, input_interpolation=inputs)
    simulation = Simulation(FourBar(start_angle=START), settings)
    for k in range(round(END / step)):
        if changing:
            simulation.set_input("crank.torque", torque(k * step))
        simulation.advance((k + 1) * step)
    return simulation


def measure(solver: str, step: float) -> tuple[Row, float]:
    """Return the row of a run, and the time of a point at which nothing changes, us."""
    points = round(END / step)
    simulation = drive(solver, step)
    found = simulation.outputs()[0]
    counts = simulation.statistics
    changing, constant, start = median_times(
        lambda: drive(solver, step),
        lambda: drive(solver, step, changing=False),
        lambda: Simulation(FourBar(start_angle=START), Settings(solver=solver, tolerance=TOLERANCE)),
        repeats=5,
    )
    row = Row(
        abs(found - angle(step)),
        abs(found - angle(0.0)),
        abs(drive(solver, step, inputs="linear").outputs()[0] - angle(0.0)),
        1e6 * (changing - start) / points,
        counts.rhs_evals / points,
        counts.steps / points,
    )
    return row, 1e6 * (constant - start) / points


def picture(rows: dict[tuple[str, float], Row], path: Path) -> None:
    """Draw error and cost over the communication step."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 5), layout="constrained")
    for solver in SOLVERS:
        own = [rows[solver, step] for step in STEPS]
        left.loglog(STEPS, [row.own for row in own], "o-", label=f"integration error, {solver}")
        right.loglog(STEPS, [row.time for row in own], "o-", label=solver)
    left.loglog(STEPS, [rows["adams", step].held for step in STEPS], "k--", label="error of the held torque")
    left.loglog(STEPS, [rows["adams", step].gone_on for step in STEPS], "k:", label="error of linear extrapolation")
    left.set_xlabel("communication step [s]")
    left.set_ylabel("error of the angle after 1 s [rad]")
    right.set_xlabel("communication step [s]")
    right.set_ylabel("CPU time per communication point [us]")
    right.set_ylim(10.0, 1000.0)
    for axes in (left, right):
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    figure.suptitle(f"Four-bar, sinusoidal torque set at every communication point, tolerance {TOLERANCE:g}")
    finish(figure, path)


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("results"), metavar="DIR", help="folder of the picture"
    )
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    rows, lines = {}, []
    for solver in SOLVERS:
        for step in STEPS:
            row, constant = measure(solver, step)
            rows[solver, step] = row
            lines.append(
                (
                    solver, f"{1e3 * step:g} ms", f"{row.own:.1e}", f"{row.held:.1e}", f"{row.gone_on:.1e}",
                    f"{row.time:.1f}",
                    f"{constant:.1f}", f"{row.evaluations:.1f}", f"{row.steps:.2f}",
                )
            )  # fmt: skip
    header = (
        "solver",
        "step",
        "integration error, rad",
        "hold",
        "linear",
        "us per point",
        "constant",
        "evaluations",
        "steps",
    )
    print(format_table(header, lines))
    picture(rows, folder / "cosimulation.png")


if __name__ == "__main__":
    main()
