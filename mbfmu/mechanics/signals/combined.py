"""Sums and products of signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.dispatch import signal as signal_at
from mbfmu.mechanics.kind import Attachment
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, i8

from .base import InUse, Signal

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays


class SignalPairRecord(Record):
    """Numbers of two signals."""

    a: i8
    b: i8


@kernel
def total(signal: SignalPairRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    x, dx, ddx = signal_at(signal.a, t, arrays)
    y, dy, ddy = signal_at(signal.b, t, arrays)
    return x + y, dx + dy, ddx + ddy


@kernel
def product(signal: SignalPairRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    x, dx, ddx = signal_at(signal.a, t, arrays)
    y, dy, ddy = signal_at(signal.b, t, arrays)
    return x * y, dx * y + x * dy, ddx * y + 2.0 * dx * dy + x * ddy


@dataclass(frozen=True, init=False)
class Combined(Signal):
    """Base class of sums and products.

    Parameters
    ----------
    *parts
        Two or more signals or numbers.
    """

    record = SignalPairRecord

    parts: tuple[Any, ...]

    def __init__(self, *parts: Any) -> None:
        if len(parts) < 2:
            raise UserError(f"{type(self).__name__} has {len(parts)} parts; allowed: two signals or numbers, or more")
        object.__setattr__(self, "parts", parts)

    def fill(self, record: Any, site: Attachment) -> None:
        """Number the first, and what the others come to."""
        first, *others = self.parts
        name = type(self).__name__.lower()
        record["a"] = site.signal(first, f"first part of a {name}")
        record["b"] = site.signal(others[0] if len(others) == 1 else type(self)(*others), f"other part of a {name}")

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether all parts can; what a host sets jumps, and only as a drive itself it is made a motion."""
        return all(part.drives and not part.variables() for part in self.parts if isinstance(part, Signal))

    def time_scale(self, own: InUse, size: float) -> float:
        """Return that of the faster part."""
        return min(filter(None, (part.time_scale(size) for part in self.operands(own))), default=0.0)

    def run_on(self, own: InUse) -> None:
        """Let the parts do so."""
        for part in self.operands(own):
            part.signal.run_on(part)

    def operands(self, own: InUse) -> list[InUse]:
        """Return both."""
        return [own.part(k) for k in "ab"]


class Sum(Combined):
    """Sum of signals."""

    evaluate = total

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return the sum of the speeds, if all are constant."""
        (a, steady_a), (b, steady_b) = (part.steady() for part in self.operands(own))
        return a + b, steady_a and steady_b

    def moving(self, own: InUse) -> list[InUse]:
        """Return those of the parts."""
        return [leaf for part in self.operands(own) for leaf in part.signal.moving(part)]


class Product(Combined):
    """Product of signals."""

    evaluate = product

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return zero, constant where all parts are at rest."""
        return 0.0, all(part.is_constant for part in self.operands(own))
