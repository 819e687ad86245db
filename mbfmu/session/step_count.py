"""Whether ``ida`` takes far more steps on a large tree than another solver would: found during the run, by trying.

BDF follows fast undamped motions whether or not they matter to the result, and how many steps that takes is not known
before the run. If many steps have been taken, the number for the whole run is extrapolated. If that is large too,
the other solvers go on from the state that the run has reached, on a copy of the mechanism, and their evaluations for
a second of motion are compared. The run itself is not changed.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from solvers.options import Options
from solvers.stepper import Stepper
from solvers.steppers.ida.tree import TreeIDAStepper

from .solver_selection import EVALUATION_WEIGHTS, IMPLICIT_TRIAL_STEPS, State, suits_esdirk, try_solver

FIRST_CHECK_STEPS = 2000  # steps after which the pace is checked first
NEXT_CHECK_FACTOR = 4  # steps at the next check, in units of those at the last one
MIN_EXPECTED_STEPS = 20_000  # steps of a whole run, below which no other solver is tried
MIN_STEPS_UNKNOWN_END = 8000  # steps after which other solvers are tried if the end of the run is not known
MIN_COST_RATIO = 4.0  # ratio of the costs from which on another solver is reported
MAX_EXPLICIT_TRIAL_STEPS = 1500  # of a trial of an explicit solver, which must meet its limit of stability
# ends of a trial's parts, in what ``ida`` has done since a check
TRIAL_TIME_FACTORS = tuple(2.0**k for k in range(-10, 4))
NO_FURTHER_CHECK = np.iinfo(np.int64).max


class LastCheck(NamedTuple):
    """What the run had done at the last check."""

    t: float  # s
    steps: int
    evaluations: int


class StepCountCheck:
    """Checks of the number of steps of one run.

    Parameters
    ----------
    copy
        Returns a compiled mechanism of the same mechanism, with inputs as they are now.
    options
        Those of the run.
    report
        Receives the note.

    Attributes
    ----------
    end
        End of the run, s; None: not known.
    """

    def __init__(
        self, copy: Callable[[], CompiledMechanism], options: Options, report: Callable[[Diagnostic], None]
    ) -> None:
        self._copy, self._options, self._report = copy, options, report
        self.end: float | None = None

    def attach(self, stepper: Stepper) -> None:
        """Let ``stepper`` call the check if it is ``ida`` on a large tree, without friction that sticks.

        Where joints stick after the start, the steps at the start say nothing about those of the run.
        """
        if isinstance(stepper, TreeIDAStepper) and not stepper.system.stick_reason:
            self._last = LastCheck(stepper.t, 0, 0)
            stepper.check_steps(FIRST_CHECK_STEPS, lambda: self._check(stepper))

    def _check(self, stepper: TreeIDAStepper) -> int:
        """Return the number of steps at which to check again; report another solver if it is far cheaper."""
        done, state, last = stepper.statistics, stepper.internal_state, self._last
        self._last, took = LastCheck(state[0], done.steps, done.rhs_evals), state[0] - last.t
        if not took > 0.0 or done.steps <= last.steps:  # restored to an earlier state
            return done.steps + FIRST_CHECK_STEPS
        expected = inf if done.steps >= MIN_STEPS_UNKNOWN_END else 0.0
        if self.end is not None:
            expected = done.steps + (done.steps - last.steps) / took * (self.end - state[0])
        if expected < MIN_EXPECTED_STEPS:
            return NEXT_CHECK_FACTOR * done.steps
        cost = EVALUATION_WEIGHTS["ida"] * (done.rhs_evals - last.evaluations) / took
        costs = {name: least for name, least in self._costs(state, took).items() if MIN_COST_RATIO * least <= cost}
        if not costs:
            return NEXT_CHECK_FACTOR * done.steps
        whole = f" and will take about {expected:.1g} for the whole run" if self.end is not None else ""
        names = sorted(costs, key=costs.__getitem__)
        factors = " and ".join(f"{name!r} needed {cost / costs[name]:.2g} times" for name in names)
        remedy = (
            f"In a trial from this time {factors} less computation for the same motion: fast undamped oscillations "
            f"limit the step size of 'ida'. Use the solver {' or '.join(map(repr, names))}"
        )
        text = f"'ida' has taken {done.steps} steps until t = {state[0]:.4g} s{whole}"
        self._report(Diagnostic.note("slow-solver", text, remedy, subject="ida", time=state[0]))
        return NO_FURTHER_CHECK

    def _costs(self, state: State, took: float) -> dict[str, float]:
        """Return what other solvers need for a second of motion from ``state``, in weighed evaluations, 1/s.

        Evaluations of implicit solvers are weighed as in :mod:`mbfmu.session.solver_selection`.
        ``esdirk`` is not tried where `ida` needs less for an error.
        """
        try:
            compiled = self._copy()
        except UserError:
            return {}
        names = {} if compiled.system.nonsmooth_reason else {"adams": MAX_EXPLICIT_TRIAL_STEPS}
        if suits_esdirk(compiled, self._options.absolute):
            names["esdirk"] = IMPLICIT_TRIAL_STEPS
        times = [took * part for part in TRIAL_TIME_FACTORS]
        return {
            name: EVALUATION_WEIGHTS.get(name, 1.0)
            * try_solver(compiled, name, state, self._options, times, steps).cost
            for name, steps in names.items()
        }
