"""Calling SUNDIALS IDA and taking its results: what every stepper around it shares."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from numpy.typing import NDArray

from .kernel import kernel
from .ledger import report
from .outcome import Code
from .quiet import IDA
from .stepper import Stepper
from .system import Array

STEPS_A_CALL = 5000  # then progress is looked at
STANDSTILL = 1e-10  # relative to t or one over the rate: less progress in STEPS_A_CALL steps is a collapse
TOO_MUCH_WORK = -1  # IDA's status for STEPS_A_CALL steps taken
# Counts of a stepper: residuals, matrices K, residuals that were not finite, steps begun, latest time; where steps are
# looked over, steps and those taken back.
COUNTS = 7
RESIDUALS, MATRICES, BAD, BEGUN, LATEST, STEPS, REFUSED = range(COUNTS)


@kernel
def count(counts: Any, t: float) -> None:
    """Count a step as begun: IDA evaluates at a new time for each that it tries."""
    if t != counts[LATEST]:
        counts[LATEST] = t
        counts[BEGUN] += 1.0


@kernel
def reported(c: Any, work: float, row: Any) -> None:
    """Put what is booked into ``row``, W having moved to ``work``."""
    c[0].through += abs(work - row[0])
    report(c[0], work, row)


class IDADriver(Stepper):
    """A stepper around IDA.

    A stepper gives ``_ida``, ``_begin`` and ``_take``, and counts residuals, Jacobians and residuals that were not
    finite in ``_counts``.
    """

    others: tuple[str, ...] = ("adams", "hybrid")

    _ida: IDA
    _counts: Array  # (3,)
    _begun: Array  # (1,) how often IDA has been initialised
    _pending: bool  # IDA is to be initialised at the reported state
    _book: NDArray[Any]  # (1,) record of ledger.BOOK

    @abstractmethod
    def _begin(self) -> Code:
        """Initialise IDA at the reported state."""

    @abstractmethod
    def _take(self, t: float, y: Array) -> Code:
        """Make IDA's y at t the reported state."""

    def _advance(self, t: float) -> Code:
        if self._pending:
            code = self._begin()
            if code is not Code.OK:
                return code
        code = self._go(t)
        if code not in (Code.OK, Code.MAX_STEPS):
            self._pending = True
        return code

    def _go(self, t: float) -> Code:
        """Call IDA until ``t``; it must not be trusted to notice that it stands still."""
        taken, bad = 0, self._counts[BAD]
        while True:
            before = self._t
            result = self._ida.step(t)
            if result.status < 0 and result.status != TOO_MUCH_WORK:
                return Code.NOT_FINITE if self._counts[BAD] > bad else Code.COLLAPSED
            code = self._take(float(result.t), result.y)
            if code is not Code.OK:
                return code
            if result.status >= 0:
                return Code.OK
            taken += STEPS_A_CALL
            if self._t - before <= STANDSTILL * max(1.0, abs(self._t)):
                return Code.NOT_FINITE if self._counts[BAD] > bad else Code.COLLAPSED
            if taken >= self.options.max_steps:
                return Code.MAX_STEPS

    def restart(self) -> None:
        """Initialise IDA anew at the reported state before the next step."""
        self._pending = True

    def _arrays(self) -> list[NDArray[Any]]:
        return [self._reported, self._q, self._v, self._counts, self._begun, self._ledger, self._book]

    def restore(self, data: bytes) -> None:
        """Take over a reported state; the history starts anew."""
        super().restore(data)
        self._pending = True
