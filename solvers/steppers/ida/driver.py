"""Calling SUNDIALS IDA and taking its results: what every stepper around it shares."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import unpin
from solvers.energy_account import ENERGY_ACCOUNT, WORK, fill_account_row_at, restart_work
from solvers.options import Options, Statistics
from solvers.outcome import Code
from solvers.stepper import Stepper
from solvers.system import AnySystem, Array

from .binding import BoundIDA
from .loop import COURSE, ERROR_TEST_FAILURES, N_COUNTERS, REJECTED_STEPS, RESIDUALS, STEP_REJECTED, STEPS
from .sundials import DirectIDA


class IDADriver(Stepper):
    """A stepper around IDA.

    A stepper gives ``_ida`` and ``_begin`` and ``_take``, and counts residuals, Jacobians and residuals that were not
    finite in ``_counts``; what looks over IDA's steps notes in ``_course`` that they are passed, and books them.
    """

    fallback_solvers: tuple[str, ...] = ("radau", "adams", "hybrid")

    _ida: DirectIDA | BoundIDA
    _scales: Any  # solvers.energy_account.EnergyScales, held

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._counts, self._book, self._course = np.zeros(N_COUNTERS), records(1, ENERGY_ACCOUNT), records(1, COURSE)
        self._begun = np.zeros(1)  # how often IDA has been initialized
        self._failed_before = 0.0  # steps of too large an error until then
        self._pending = True  # IDA is to be initialized at the reported state
        c = self._c = self._course[0]
        c["passed"] = c["begun"] = self._t
        c["reach"] = c["longest"] = np.inf
        self._most = min(self.options.max_steps, np.iinfo(np.int64).max)
        self._check_at: float = np.inf  # steps since construction at which ``_check`` is called
        self._check: Callable[[], float] = lambda: np.inf
        c["most"], c["energy_check"] = self._most, int(self.options.energy_check)

    @abstractmethod
    def _begin(self) -> Code:
        """Initialize IDA at the reported state."""

    @abstractmethod
    def _take(self, t: float, y: Array) -> Code:
        """Make IDA's y at t the reported state."""

    def _limit(self, longest: float) -> None:
        self._c["longest"] = longest if longest < self.options.max_step else np.inf  # which IDA holds to by itself

    def check_steps(self, at: float, check: Callable[[], float]) -> None:
        """Call ``check`` once ``at`` steps have been taken; it returns at how many it is to be called again.

        It is called between two steps, and must not change the stepper.
        """
        self._check_at, self._check = at, check

    def _until_check(self) -> int:
        """Return how many steps of this call may be taken until the next check is due."""
        left = max(0.0, self._check_at - float(self._counts[STEPS]))
        return int(min(self._most, self._c["count"] + left))

    def _resume(self) -> Code:
        """Restart at the end of the last good step, after IDA could not continue."""
        return Code.COLLAPSED

    def _begin_with(self, y: Array, slopes: Array) -> None:
        """Initialize IDA at the reported state, where its unknowns and their derivatives are these (N,)."""
        self._count_failures()
        self._failed_before = self._counts[ERROR_TEST_FAILURES]
        self._ida.begin(self._t, y, slopes)
        c = self._c
        self._pending, c["passed"], c["begun"], c["taken"] = False, self._t, self._t, 0.0
        c["works"] = int(self._works())
        self._begun[0] += 1.0
        restart_work(self._book, self._energy_account[WORK])

    @abstractmethod
    def _works(self) -> bool:
        """Whether there is power to be booked."""

    def _count_failures(self) -> None:
        """Count the steps whose error was too large: IDA resets this counter at a restart."""
        if not self._pending:
            self._counts[ERROR_TEST_FAILURES] = self._failed_before + self._ida.told().rejected

    def _advance(self, t: float) -> Code:
        if self._pending:
            code = self._begin()
            if code is not Code.OK:
                return code
        code = self._go(t)
        self._c["stops"] = max(0, self._c["stops"] - 1)
        if code not in (Code.OK, Code.MAX_STEPS):
            self._pending = True
        return code

    def _go(self, t: float) -> Code:
        """Step until ``t`` is passed, and interpolate."""
        c = self._c
        c["count"] = 0
        while True:
            c["most"] = self._until_check()
            told = self._ida.go(t) if c["passed"] < t else Code.OK
            if told == Code.MAX_STEPS and c["count"] < self._most:
                self._check_at = self._check()
                continue
            if not (told == STEP_REJECTED or (told == Code.COLLAPSED and c["passed"] > c["begun"])):
                code = Code(told)
                break
            code = self._resume()
            if code is not Code.OK:
                return code
        if code is Code.OK:
            y = self._ida.interpolate(t)
            code = self._take(t, y) if np.isfinite(y).all() else Code.NOT_FINITE
        if code is Code.OK:
            self._tell()
        return code

    def _tell(self) -> None:
        """Fill the energy account of the reported time."""
        fill_account_row_at(self._book, self._t, self._energy_account)

    def restart(self) -> None:
        """Reinitialize IDA at the reported state before the next step."""
        self._pending, self._c["reach"] = True, np.inf

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        self._count_failures()
        seen = unpin(self._scales).bound_results
        return [self.clock, self._q, self._v, self._counts, self._begun, self._energy_account, self._book, seen]

    def restore(self, data: bytes) -> None:
        """Set a reported state; the history restarts."""
        super().restore(data)
        self.restart()
        self._failed_before, self._c["stops"] = self._counts[ERROR_TEST_FAILURES], 0

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far, order and length of IDA's last step."""
        self._count_failures()
        told, refused = self._ida.told(), int(self._counts[REJECTED_STEPS])
        return Statistics(
            steps=int(self._counts[STEPS]),
            rejected=int(self._counts[ERROR_TEST_FAILURES]) + refused,
            refused=refused,
            rate_growth=self._growth()[0],
            rate_growth_at=self._growth()[1],
            rhs_evals=self._evaluations(),
            restarts=max(0, int(self._begun[0]) - 1),
            order=told.order,
            step_size=told.step_size,
        )

    def _growth(self) -> tuple[float, float]:
        """Return the largest rate growth so far and its time (s), see :mod:`solvers.inertia`."""
        return 0.0, 0.0

    def _evaluations(self) -> int:
        """Return how often the equations were evaluated."""
        return int(self._counts[RESIDUALS])
