"""Calling SUNDIALS IDA step by step and taking its results: what every stepper around it shares."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.ledger import BOOK, WORK, begin_work, report_at
from solvers.options import Options
from solvers.outcome import Code
from solvers.stepper import Stepper
from solvers.system import AnySystem, Array

from .quiet import IDA, silent

STANDSTILL = 1e-10  # relative to t and one over the rate: no step, and in OFTEN steps no progress
OFTEN = 5000
STOOD = 10  # returns of IDA without a step, of which one is meant
COUNTS = 5  # of a stepper: residuals, matrices K, residuals that were not finite, steps, steps taken back
RESIDUALS, MATRICES, BAD, STEPS, REFUSED = range(COUNTS)


class IDADriver(Stepper):
    """A stepper around IDA.

    A stepper gives ``_ida`` and ``_instant``, ``_begin``, ``_look_over`` and ``_take``, and counts residuals, Jacobians
    and residuals that were not finite in ``_counts``.
    """

    others: tuple[str, ...] = ("adams", "hybrid")

    _ida: IDA
    _instant: float  # s, of no account

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self._counts, self._book = np.zeros(COUNTS), records(1, BOOK)
        self._begun = np.zeros(1)  # how often IDA has been initialized
        self._pending = True  # IDA is to be initialized at the reported state
        self._passed = self._begun_at = self._t  # s, where IDA itself stands, and where its history begins
        self._taken, self._reach = 0.0, np.inf  # s, its last step, and how long the next one may be
        self._longest = np.inf  # s, of any step
        self._stops = 0  # times asked for at which steps are yet to end

    @abstractmethod
    def _begin(self) -> Code:
        """Initialize IDA at the reported state."""

    @abstractmethod
    def _look_over(self, t: float, y: Array, yp: Array) -> Code:
        """Accept IDA's step to y at t: note ``_passed``, and book it."""

    @abstractmethod
    def _take(self, t: float, y: Array) -> Code:
        """Make IDA's y at t the reported state."""

    def _stop(self, t: float) -> float | None:
        """Where IDA must stop on the way to t, s; none where it will not reach that.

        After a step it keeps the step size, doubles or shortens it; a stop it does not reach shortens it too.
        """
        reach, end = min(self._reach, self._longest), t if self._stops else np.inf
        if reach >= 2.0 * self._taken > 0.0 or np.isinf(reach):
            return t if self._stops else None
        return float(min(end, self._passed + (self._taken if reach >= self._taken > 0.0 else reach)))

    def _limit(self, longest: float) -> None:
        self._longest = longest if longest < self.options.max_step else np.inf  # which IDA holds to by itself

    def _resume(self) -> Code:
        """Begin anew where the last good step ended, after IDA could not go on."""
        return Code.COLLAPSED

    def _begun_here(self) -> None:
        """Note that IDA has been initialized at the reported state."""
        self._pending, self._passed, self._begun_at, self._taken = False, self._t, self._t, 0.0
        self._begun[0] += 1.0
        begin_work(self._book, self._ledger[WORK])

    def _advance(self, t: float) -> Code:
        if self._pending:
            code = self._begin()
            if code is not Code.OK:
                return code
        with silent():
            code = self._go(t)
        self._stops = max(0, self._stops - 1)
        if code not in (Code.OK, Code.MAX_STEPS):
            self._pending = True
        return code

    def _go(self, t: float) -> Code:
        """Step until ``t`` is passed, and interpolate. IDA must not be trusted to notice that it stands still."""
        taken, stood, bad, since = 0, 0, self._counts[BAD], self._passed
        while self._passed < t:
            if taken >= self.options.max_steps:
                return Code.MAX_STEPS
            before, stop = self._passed, self._stop(t)
            instant = max(self._instant, STANDSTILL * abs(before))
            if self._reach < instant:
                return Code.BRANCHES
            result = self._ida.step(max(t, stop) if stop else t, method="onestep", tstop=stop)
            stopped = Code.NOT_FINITE if self._counts[BAD] > bad else Code.COLLAPSED
            if result.status < 0:
                anew = stopped is Code.COLLAPSED and self._passed > self._begun_at
                code = self._resume() if anew else stopped
            elif float(result.t) <= before:  # it had interpolated, and tells where it stands first; or nothing moves t
                stood += 1
                code = Code.OK if stood <= STOOD else stopped
            else:
                taken, stood, self._taken = taken + 1, 0, float(result.t) - before
                code = self._look_over(float(result.t), result.y, result.yp)
                if taken % OFTEN == 0:
                    if self._passed - since <= instant:
                        return stopped
                    since = self._passed
            if code is not Code.OK:
                return code
        result = self._ida.step(t)
        code = self._take(float(result.t), result.y)
        if code is Code.OK:
            self._tell()
        return code

    def _tell(self) -> None:
        """Put what is booked at the reported time into the ledger."""
        report_at(self._book, self._t, self._ledger)

    def restart(self) -> None:
        """Initialize IDA anew at the reported state before the next step."""
        self._pending, self._reach = True, np.inf

    def _arrays(self) -> list[NDArray[Any]]:
        return [self._reported, self._q, self._v, self._counts, self._begun, self._ledger, self._book]

    def restore(self, data: bytes) -> None:
        """Take over a reported state; the history starts anew."""
        super().restore(data)
        self.restart()
        self._pending, self._stops = True, 0
