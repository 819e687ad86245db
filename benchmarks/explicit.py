"""``adams`` on the small models against Runge-Kutta on their motions by hand: ``python benchmarks/explicit.py``.

Ten seconds, compile time apart, medians of CPU time, the two sides of a ratio measured in turn. Adams takes the loosest
tolerance that reaches the error, Runge-Kutta the fewest equal steps that reach Adams' own error. The error is the
largest of the first coordinate at 1001 times. ``run`` is the integration alone, ``with outputs`` records all outputs of
the model at the 1001 times; the floor writes one number at each.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from floor import INTEGRATORS, start
from numpy.typing import NDArray
from timing import median_times

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.modeling import Model
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.text_table import format_table

END = 10.0
INTERVALS = 1000
TIMES = np.linspace(0.0, END, INTERVALS + 1)
ERRORS = (1e-6, 1e-9)  # rad
MODELS = {"fourbar": FourBar(), "governor": Governor(gravity=0.0), "pendulum": SwingPendulum()}
REQUIRED = {  # largest ratio, and of which column
    ("fourbar", 1e-6): ("run", 20),
    ("governor", 1e-6): ("with outputs", 15),
    ("governor", 1e-9): ("with outputs", 15),
    ("pendulum", 1e-6): ("with outputs", 10),
    ("pendulum", 1e-9): ("with outputs", 10),
}

Vector = NDArray[np.float64]


class Swing:
    """A simulation that restarts at every call."""

    def __init__(self, model: Model, solver: str, tolerance: float) -> None:
        self.simulation = Simulation(model, Settings(solver=solver, tolerance=tolerance))
        self.tolerance = tolerance
        self._fresh = self.simulation.stepper.save()
        self._values = np.zeros((INTERVALS, len(self.simulation.variables)))

    def run(self) -> None:
        """Go to the end without a stop."""
        self.simulation.stepper.restore(self._fresh)
        assert self.simulation.advance(END).ok

    def with_outputs(self) -> None:
        """Record all outputs at every time."""
        self.simulation.stepper.restore(self._fresh)
        assert self.simulation.record(TIMES[1:], self._values) == INTERVALS

    def error(self, exact: Vector) -> float:
        """Return the largest error of the first coordinate, rad."""
        self.simulation.stepper.restore(self._fresh)
        return float(np.abs(self.simulation.stepper.sample(TIMES[1:]).q[:, 0] - exact[1:]).max())


def exact_motion(model: Model) -> Vector:
    """Return the first coordinate at every time."""
    motion = model.exact(TIMES)
    assert motion is not None
    return next(iter(motion.values()))


def loosest(model: Model, solver: str, error: float, exact: Vector) -> tuple[Swing, float]:
    """Return the run of the loosest tolerance (ten a decade) whose error is at most ``error``, and its error."""
    for tolerance in 10.0 ** np.arange(-4.0, -12.0, -0.1):
        swing = Swing(model, solver, float(tolerance))
        own = swing.error(exact)
        if own <= error:
            return swing, own
    raise RuntimeError(f"{solver} does not reach {error}")


def floor_at(model: Model, error: float, exact: Vector) -> tuple[Callable[[], object], float]:
    """Return Runge-Kutta with the fewest steps that reach ``error``, and its error; outputs count as steps' ends."""
    y, p = start(model)
    out = np.zeros(INTERVALS)
    integrate = INTEGRATORS[model.name]
    for steps in sorted({round(1.05**k) for k in range(200)}):
        run = partial(integrate, y, p, END / INTERVALS, INTERVALS, steps, out)
        run()
        own = float(np.abs(out - exact[1:]).max())
        if own <= error:
            return run, own
    raise RuntimeError(f"Runge-Kutta does not reach {error}")


def main() -> None:
    """Print the table."""
    lines = []
    for name, model in MODELS.items():
        exact = exact_motion(model)
        for error in ERRORS:
            swing, own = loosest(model, "adams", error, exact)
            floor, own_floor = floor_at(model, own, exact)
            alone, outputs, base = median_times(swing.run, swing.with_outputs, floor)
            column, most = REQUIRED.get((name, error), ("", 0))
            lines.append(
                (
                    name,
                    f"{error:.0e}",
                    f"{swing.tolerance:.1e}",
                    f"{own:.1e}",
                    f"{own_floor:.1e}",
                    str(swing.simulation.statistics.steps),
                    f"{1e3 * alone:.2f}",
                    f"{1e3 * outputs:.2f}",
                    f"{1e3 * base:.3f}",
                    f"{alone / base:.1f}",
                    f"{outputs / base:.1f}",
                    f"{column} at most {most}" if column else "",
                )
            )
    header = ("model", "error", "rtol", "adams", "floor", "steps", "run [ms]", "with outputs [ms]", "floor [ms]")
    print(format_table((*header, "ratio", "ratio with outputs", "required"), lines))


if __name__ == "__main__":
    main()
