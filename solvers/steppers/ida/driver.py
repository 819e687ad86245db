"""Calling SUNDIALS IDA and taking its results: what every stepper around it shares."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.template import substitute
from solvers.compiled.tuple_pointer import unpin
from solvers.energy_account import ENERGY_ACCOUNT, WORK, fill_account_row_at
from solvers.options import Options, Statistics
from solvers.outcome import CODES, Code
from solvers.stepper import Stepper
from solvers.system import AnySystem, Array

from . import loop
from .binding import BoundIDA
from .loop import (
    EARLIER_FAILURES,
    ERROR_TEST_FAILURES,
    N_COUNTERS,
    PROGRESS,
    REJECTED_STEPS,
    RESIDUALS,
    STARTS,
    STEPS,
    count_failures,
    record_start,
)
from .sundials import DirectIDA


class IDADriver(Stepper):
    """A stepper around IDA.

    A subclass provides ``_ida``, ``_begin`` and ``_report_unknowns``, and counts residuals, Jacobians and residuals
    that were not finite in ``_counts``. The function that accepts IDA's steps records the time reached in
    ``_progress_array``, and the energy.
    """

    fallback_solvers: tuple[str, ...] = ("radau", "adams", "hybrid")

    _ida: DirectIDA | BoundIDA
    _scales: Any  # solvers.energy_account.EnergyScales, held

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._check_at: float = np.inf  # steps since construction at which ``_check`` is called
        self._check: Callable[[], float] = lambda: np.inf
        self._set_records(np.zeros(N_COUNTERS), records(1, ENERGY_ACCOUNT), records(1, PROGRESS))

    def _set_records(self, counts: Array, energy_record: NDArray[Any], progress: NDArray[Any]) -> None:
        """Use these records, and begin them at the reported state."""
        self._counts, self._energy_record, self._progress_array = counts, energy_record, progress
        self._progress, self._progress_fields = progress[0], progress.view(np.recarray)
        self._progress["t_reached"] = self._progress["t_begun"] = self._t
        self._progress["max_next_step"] = self._progress["max_step"] = np.inf
        self._progress["max_steps"], self._progress["is_pending"] = self.max_steps, 1
        self._progress["energy_check"] = int(self.options.energy_check)

    @abstractmethod
    def _begin(self) -> Code:
        """Initialize IDA at the reported state."""

    @abstractmethod
    def _report_unknowns(self, t: float, y: Array) -> Code:
        """Make IDA's y at t the reported state; Code.NOT_FINITE if it is not finite."""

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`."""
        self._progress["max_step"] = (
            longest if longest < self.options.max_step else np.inf
        )  # which IDA holds to by itself

    def check_steps(self, at: float, check: Callable[[], float]) -> None:
        """Call ``check`` once ``at`` steps have been taken; it returns at how many it is to be called again.

        It is called between two steps, and must not change the stepper.
        """
        self._check_at, self._check = at, check

    def _steps_until_check(self) -> int:
        """Return how many steps of this call may be taken until the next check is due."""
        left = max(0.0, self._check_at - float(self._counts[STEPS]))
        return int(min(self.max_steps, self._progress["steps"] + left))

    def _resume(self) -> Code:
        """Restart at the end of the last good step, after IDA could not continue."""
        return Code.COLLAPSED

    def _begin_with(self, y: Array, slopes: Array) -> None:
        """Initialize IDA at the reported state, where its unknowns and their derivatives are these (N,)."""
        self._count_failures()
        self._progress["works"] = int(self._has_work())
        self._ida.begin(self._t, y, slopes)
        work_done = self._energy_account[WORK]
        record_start(self._progress_array, self._counts, self._energy_record, self._t, work_done)

    @abstractmethod
    def _has_work(self) -> bool:
        """Whether some force does work that is to be recorded."""

    def _count_failures(self) -> None:
        """Count the steps whose error was too large: IDA resets this counter at a restart."""
        count_failures(self._progress_array, self._counts, float(self._ida.statistics().rejected))

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        return CODES[_advance(self, self._progress_fields, t)]

    def _may_take_more(self) -> bool:
        """Whether more steps may follow; if a check is due it is made."""
        if self._progress["steps"] >= self.max_steps:
            return False
        self._check_at = self._check()
        return True

    @property
    def has_dense_output(self) -> bool:
        """As :attr:`solvers.stepper.Stepper.has_dense_output`."""
        return True

    @property
    def own_time(self) -> float:
        """As :attr:`solvers.stepper.Stepper.own_time`."""
        return float(self._t if self._progress["is_pending"] else self._progress["t_reached"])

    def _report(self, t: float) -> Code:
        """Make the motion at t the reported state."""
        code = self._report_unknowns(t, self._ida.interpolate(t))
        if code is Code.OK:
            self._report_energy()
        return code

    def _report_energy(self) -> None:
        """Write the energy account at the reported time."""
        fill_account_row_at(self._energy_record, self._t, self._energy_account)

    def restart(self) -> None:
        """Reinitialize IDA at the reported state before the next step."""
        self._progress["is_pending"], self._progress["max_next_step"] = 1, np.inf

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        self._count_failures()
        seen = unpin(self._scales).bound_results
        return [
            self.clock,
            self._q,
            self._v,
            self._counts,
            self._energy_account,
            self._energy_record,
            seen,
        ]

    def restore(self, data: bytes) -> None:
        """Set a reported state; the history restarts."""
        super().restore(data)
        self.restart()
        self._counts[EARLIER_FAILURES], self._progress["truncated_steps"] = self._counts[ERROR_TEST_FAILURES], 0

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far, order and length of IDA's last step."""
        self._count_failures()
        counted, refused = self._ida.statistics(), int(self._counts[REJECTED_STEPS])
        return Statistics(
            steps=int(self._counts[STEPS]),
            rejected=int(self._counts[ERROR_TEST_FAILURES]) + refused,
            refused=refused,
            rate_growth=self._growth()[0],
            rate_growth_at=self._growth()[1],
            rhs_evals=self._evaluations(),
            restarts=max(0, int(self._counts[STARTS]) - 1),
            order=counted.order,
            step_size=counted.step_size,
        )

    def _growth(self) -> tuple[float, float]:
        """Return the largest rate growth so far and its time (s), see :mod:`solvers.inertia`."""
        return 0.0, 0.0

    def _evaluations(self) -> int:
        """Return how often the equations were evaluated."""
        return int(self._counts[RESIDUALS])


STEPPER_HOOKS = {
    "begin": lambda stepper: stepper._begin(),
    "steps_allowed": lambda stepper: stepper._steps_until_check(),
    "may_take_more": lambda stepper: stepper._may_take_more(),
    "take_steps": lambda stepper, t: stepper._ida.step_until(t),
    "resume": lambda stepper: stepper._resume(),
    "report": lambda stepper, t: stepper._report(t),
}
_advance_history = substitute(loop.advance_history, __name__, STEPPER_HOOKS)
_advance = substitute(loop.advance, __name__, {**STEPPER_HOOKS, "advance_history": _advance_history})
