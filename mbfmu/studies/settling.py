"""Two ways to a steady state: let the damped motion settle, or solve for it.

The paper's claim is that the second replaces the first; this measures what each costs and how near it comes.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mbfmu.model import Model
from mbfmu.settings import Settings
from mbfmu.simulation import Simulation
from mbfmu.steady.problem import EquilibriumProblem
from mbfmu.table import table
from solvers import SOLVERS

LEFT = 1e-10  # of the first deviation, when the slowest mode has settled
NEWTON = "newton"


@dataclass(frozen=True, kw_only=True)
class Settled:
    """The steady state as one method gives it.

    Attributes
    ----------
    solver, rtol
        ``newton`` and None for the solution of the equilibrium equations.
    wall_s
        Median time of the method alone, without compilation and start, s.
    settle_time
        Time simulated, s: till the slowest mode has decayed to 1e-10.
    steps
        Time steps, or Newton iterations; None where the solver does not tell.
    max_error
        Largest difference of an output from the closed form, or from Newton's where no closed form is known, rad or m.
    """

    solver: str
    rtol: float | None
    wall_s: float
    settle_time: float | None
    steps: int | None
    max_error: float | None
    status: str
    study: str = "settling"

    def as_dict(self) -> dict[str, Any]:
        """Return the row for JSON."""
        return asdict(self)


def settle(
    model: Model,
    *,
    tolerances: Sequence[float],
    solvers: Sequence[str] = tuple(SOLVERS),
    repeats: int = 5,
    progress: Callable[[str], None] | None = None,
) -> list[Settled]:
    """Let a model's motion settle with every solver at every tolerance; Newton's row comes first.

    ``model`` must be damped: :attr:`Model.settling` holds parameters that see to it.
    """
    balance = EquilibriumProblem(model)
    found = balance.solve()
    exact = model.exact_equilibrium()
    decay = -max(mode.eigenvalue.real for mode in found.modes)
    end = float(-np.log(LEFT) / decay)

    def error(outputs: dict[str, float]) -> float:
        target = exact or found.outputs
        return max(abs(outputs[name] - target[name]) for name in target)

    wall = statistics.median(balance.solve().solve_time for _ in range(10 * repeats))
    rows = [
        Settled(
            solver=NEWTON,
            rtol=None,
            wall_s=wall,
            settle_time=None,
            steps=found.iterations,
            max_error=error(found.outputs) if exact else None,
            status="ok",
        )
    ]
    for solver in solvers:
        for tolerance in tolerances:
            rows.append(_run(model, Settings(solver=solver, tolerance=tolerance), end, repeats, error))
            if progress is not None:
                progress(f"{solver} {tolerance:.0e}")
    return rows


def _run(
    model: Model, settings: Settings, end: float, repeats: int, error: Callable[[dict[str, float]], float]
) -> Settled:
    """Simulate to the end, several times."""
    walls = []
    for _ in range(repeats):
        simulation = Simulation(model, settings)
        begin = time.perf_counter()
        status = simulation.advance(end)
        walls.append(time.perf_counter() - begin)
    outputs = dict(zip((v.name for v in simulation.variables), map(float, simulation.outputs()), strict=True))
    return Settled(
        solver=settings.solver,
        rtol=settings.tolerance,
        wall_s=statistics.median(walls),
        settle_time=end,
        steps=simulation.statistics.steps or None,
        max_error=error(outputs),
        status="ok" if status.ok else status.message,
    )


def as_text(rows: Sequence[Settled]) -> str:
    """Return the rows as a table for people, times also in those of Newton."""
    newton = next(row.wall_s for row in rows if row.solver == NEWTON)
    lines = [
        (
            row.solver,
            "-" if row.rtol is None else f"{row.rtol:.0e}",
            f"{1e3 * row.wall_s:.3g}",
            f"{row.wall_s / newton:.0f}",
            "-" if row.settle_time is None else f"{row.settle_time:.3g}",
            "-" if row.steps is None else str(row.steps),
            "-" if row.max_error is None else f"{row.max_error:.1e}",
            row.status.partition(". ")[0],
        )
        for row in rows
    ]
    header = ("method", "rtol", "time [ms]", "of Newton", "simulated [s]", "steps", "error [rad, m]", "outcome")
    return table(header, lines)
