"""A signal that a user writes as a Python function of time, or as an expression."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import law
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import positive
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Record, f8

from .base import InUse, Signal

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

FUNCTION_CHECK_RANGE = 10.0  # units of ``time`` from zero on, in which it is tried


class FunctionRecord(Record):
    """Parameters of :class:`Function`."""

    time_scale: f8
    clock: f8


@kernel
def longest_step(signal: FunctionRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. A third of its time scale."""
    return signal.time_scale / 3.0, np.inf


@cache
def kernel_of_value(function: Any) -> Any:
    """Return the kernel of a signal whose derivatives nobody asks for."""

    def evaluate(signal: Any, t: float, arrays: Arrays) -> Any:
        x = function(signal.clock.real * t)
        return x, 0.0 * x, 0.0 * x

    return jit_uncached(evaluate)


@cache
def kernel_of_motion(function: Any) -> Any:
    """Return the kernel of a signal with its derivatives, by differences."""
    derivatives = law.derivatives

    def evaluate(signal: Any, t: float, arrays: Arrays) -> Any:
        x, dx, ddx = derivatives(function, signal.clock.real * t, signal.time_scale.real)
        return x, signal.clock * dx, signal.clock * ddx

    return jit_uncached(evaluate)


@dataclass(frozen=True)
class Function(Signal):
    """A function of time, ``lambda t: ...`` or ``"sin(2*pi*t)"``; it may be given directly instead of a signal.

    Parameters
    ----------
    law
        Function of the time in s, or expression in t.
    differentiate
        Whether it drives a joint. Its derivatives are then computed by differences, and it must be smooth.
    time
        Time in which it changes noticeably, s: no step is longer than a third of it, and differences are taken over
        some thousandths of it.
    what
        Name in messages.
    """

    law: Any
    differentiate: bool = False
    time: float = 1.0
    what: str = "function of time"

    record = FunctionRecord
    longest_step = longest_step

    def __post_init__(self) -> None:
        """Compile it."""
        positive(f"time in which {self.what} changes", self.time)
        function = law.law_of(self.what, self.law, ("t",))
        if self.differentiate and not law.resolved(function, (0.0, FUNCTION_CHECK_RANGE * self.time), self.time):
            raise UserError(
                f"{self.what} changes faster than differences over thousandths of {self.time:g} s resolve; use "
                "Function(..., time=...) with the time in which it changes, s, or give a signal"
            )
        object.__setattr__(self, "evaluate", (kernel_of_motion if self.differentiate else kernel_of_value)(function))

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether it has derivatives."""
        return self.differentiate

    def fill(self, record: Any, site: Attachment) -> None:
        """Write how fast it changes."""
        record["time_scale"], record["clock"] = self.time, 1.0

    def time_scale(self, own: InUse, size: float) -> float:
        """Return the given value."""
        return self.time

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return that it is at rest, if it is held or an expression without t."""
        without_time = isinstance(self.law, str) and "t" not in law.names_in(self.law)
        return 0.0, without_time or not own.record["clock"]

    def hold(self, own: InUse, value: float) -> None:
        """Evaluate it at t = 0 at all times."""
        own.record["clock"] = 0.0
