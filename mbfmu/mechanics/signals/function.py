"""A signal that a user writes as a Python function of time, or as an expression."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mbfmu.errors import UserError
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.law import law_of
from mbfmu.mechanics.numbers import is_finite
from solvers.compiled.kernel import kept_nowhere

from .base import InUse, Signal

TRIED, AGREE = 64, 1e-6  # times, within ten of ``time``, at which differences over two steps must agree so well
FIRST, SECOND = 1e-3, 3e-3  # steps of the differences for rate and second derivative, in units of ``time``


@cache
def kernel_of_value(law: Any) -> Any:
    """Return the kernel of a signal whose derivatives nobody asks for."""

    def evaluate(signal: Any, t: float, arrays: Any) -> Any:
        x = law(t)
        return x, 0.0 * x, 0.0 * x

    return kept_nowhere(evaluate)


@cache
def kernel_of_motion(law: Any) -> Any:
    """Return the kernel of a signal with its derivatives, by differences of sixth order."""

    def evaluate(signal: Any, t: float, arrays: Any) -> Any:
        x, h, k = law(t), FIRST * signal.pace.real, SECOND * signal.pace.real
        rate = 45.0 * (law(t + h) - law(t - h)) - 9.0 * (law(t + 2.0 * h) - law(t - 2.0 * h))
        rate += law(t + 3.0 * h) - law(t - 3.0 * h)
        second = 270.0 * (law(t + k) + law(t - k)) - 27.0 * (law(t + 2.0 * k) + law(t - 2.0 * k))
        second += 2.0 * (law(t + 3.0 * k) + law(t - 3.0 * k)) - 490.0 * x
        return x, rate / (60.0 * h), second / (180.0 * k * k)

    return kept_nowhere(evaluate)


@dataclass(frozen=True)
class Function(Signal):
    """A function of time, ``lambda t: ...`` or ``"sin(2*pi*t)"``; wherever a signal may stand it may stand as it is.

    Parameters
    ----------
    law
        Takes the time in s.
    differentiate
        It drives a joint: its derivatives are taken by differences. It must be smooth then.
    time
        Time in which it changes noticeably, s: no step is longer than a third of it, and differences are taken over
        some thousandths of it.
    what
        What messages call it.
    """

    law: Any
    differentiate: bool = False
    time: float = 1.0
    what: str = "function of time"

    record = np.dtype([("pace", np.float64)], align=True)

    def __post_init__(self) -> None:
        """Compile it."""
        if not (is_finite(self.time) and self.time > 0.0):
            raise UserError(f"time in which {self.what} changes is {self.time!r} s; allowed: greater than zero")
        law = law_of(self.what, self.law, ("t",))
        if self.differentiate and not self._resolved(law):
            raise UserError(
                f"{self.what} changes faster than differences over thousandths of {self.time:g} s can tell; "
                "say Function(..., time=...) with the time in which it changes, s, or give a signal"
            )
        object.__setattr__(self, "evaluate", (kernel_of_motion if self.differentiate else kernel_of_value)(law))

    def _resolved(self, law: Any) -> bool:
        """Whether its second derivative, which a drive needs, is the same over a smaller step."""
        found = []
        for t in np.random.default_rng(0).uniform(0.0, 10.0 * self.time, TRIED):
            x, seconds = law(t), []
            for k in (SECOND * self.time, 0.25 * SECOND * self.time):
                f = [law(t + n * k) + law(t - n * k) for n in (1, 2, 3)]
                seconds.append((270.0 * f[0] - 27.0 * f[1] + 2.0 * f[2] - 490.0 * x) / (180.0 * k * k))
            found.append((abs(seconds[0] - seconds[1]), abs(seconds[1]), abs(x)))
        off, second, size = np.max(found, axis=0)
        return not off > AGREE * (second + 1e-2 * size / self.time**2)  # the last is what rounding leaves

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether it has derivatives."""
        return self.differentiate

    def fill(self, record: Any, site: Site) -> None:
        """Write how fast it changes."""
        record["pace"] = self.time

    def pace(self, own: InUse, size: float) -> float:
        """Return what was told."""
        return self.time

    def longest_step(self, own: InUse, t: float) -> tuple[float, float]:
        """Return a third of its pace."""
        return self.time / 3.0, np.inf
