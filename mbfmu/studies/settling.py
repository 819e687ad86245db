"""Two ways to a steady state: let the damped motion settle, or solve for it.

The paper's claim is that the second replaces the first; this measures what each costs and how near it comes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from mbfmu.modeling.model import Model
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.steady.equilibrium import build_problem, find_state
from mbfmu.studies.timing import CpuTimes, cpu_time, time_interleaved
from mbfmu.util.text_table import format_table, format_tolerance
from solvers.steppers import SOLVERS, drop_unlisted

SETTLED_RATIO = 1e-10  # of the first deviation, when the slowest mode has settled
NEWTON_METHOD = "newton"


@dataclass(frozen=True, kw_only=True)
class Settled:
    """The steady state as one method gives it.

    Attributes
    ----------
    solver, rtol
        ``newton`` and None for the solution of the equilibrium equations.
    cpu_s, spread
        Median CPU time of the method alone, without compilation and start, s; distance of the quartiles over it.
        Newton's is of the wall clock, too short for others to come between.
    settle_time
        Time simulated, s: till the slowest mode has decayed to 1e-10.
    steps
        Time steps, or Newton iterations; None if the solver does not report it.
    max_error
        Largest difference of an output from the closed form, or from Newton's where no closed form is known, rad or m.
    """

    solver: str
    rtol: float | None
    cpu_s: float
    spread: float
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
    solvers: Sequence[str] = drop_unlisted(SOLVERS),
    repeats: int = 5,
    progress: Callable[[str], None] | None = None,
) -> list[Settled]:
    """Let a model's motion settle with every solver at every tolerance; Newton's row comes first.

    ``model`` must be damped: :attr:`Model.settling` holds parameters that see to it.
    """
    balance = build_problem(model)
    found = find_state(balance)
    exact = None if model.replaced_inputs else model.exact_equilibrium()  # of the inputs at their start values
    decay = -max(mode.eigenvalue.real for mode in found.modes)
    end = float(-np.log(SETTLED_RATIO) / decay)

    def error(outputs: dict[str, float]) -> float:
        target = exact or found.outputs
        return max(abs(outputs[name] - target[name]) for name in target)

    settings = [Settings(solver=solver, tolerance=tolerance) for solver in solvers for tolerance in tolerances]
    runs = [_Run(model, own) for own in settings]
    newtons: list[Callable[[], float]] = [lambda: find_state(balance).solve_time]
    methods = newtons + [partial(run.settle, end) for run in runs]
    times = time_interleaved(methods, repeats, progress=progress)
    newton = Settled(
        solver=NEWTON_METHOD,
        rtol=None,
        cpu_s=times[0].median,
        spread=times[0].spread,
        settle_time=None,
        steps=found.iterations,
        max_error=error(found.outputs) if exact else None,
        status="ok",
    )
    return [newton, *(run.row(own, end, error) for run, own in zip(runs, times[1:], strict=True))]


class _Run:
    """A damped motion, simulated to its end several times."""

    def __init__(self, model: Model, settings: Settings) -> None:
        self.model, self.settings = model, settings

    def settle(self, end: float) -> float:
        """Simulate to the end; return the CPU time, s."""
        self.simulation = Simulation(self.model, self.settings)
        return cpu_time(lambda: self.simulation.advance(end))

    def row(self, spent: CpuTimes, end: float, error: Callable[[dict[str, float]], float]) -> Settled:
        """Measure the last run."""
        simulation = self.simulation
        outputs = dict(zip((v.name for v in simulation.variables), map(float, simulation.outputs()), strict=True))
        return Settled(
            solver=self.settings.solver,
            rtol=self.settings.tolerance,
            cpu_s=spent.median,
            spread=spent.spread,
            settle_time=end,
            steps=simulation.statistics.steps or None,
            max_error=error(outputs),
            status=simulation.failure or "ok",
        )


def as_text(rows: Sequence[Settled]) -> str:
    """Return the rows as a table for people, times also in those of Newton."""
    newton = next(row.cpu_s for row in rows if row.solver == NEWTON_METHOD)
    lines = [
        (
            row.solver,
            "-" if row.rtol is None else format_tolerance(row.rtol),
            f"{1e3 * row.cpu_s:.3g}",
            f"{100.0 * row.spread:.0f} %",
            f"{row.cpu_s / newton:.0f}",
            "-" if row.settle_time is None else f"{row.settle_time:.3g}",
            "-" if row.steps is None else str(row.steps),
            "-" if row.max_error is None else f"{row.max_error:.1e}",
            row.status.partition(". ")[0],
        )
        for row in rows
    ]
    header = (
        "method",
        "rtol",
        "CPU [ms]",
        "spread",
        "Newtons",
        "simulated [s]",
        "steps",
        "error [rad, m]",
        "outcome",
    )
    return format_table(header, lines)
