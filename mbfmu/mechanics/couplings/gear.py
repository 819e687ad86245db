"""A constant ratio of two coordinates: q_a = ratio q_b + offset."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.numbers import finite, is_finite
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8

from .base import Coupling

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays


class GearRecord(Record):
    """Parameters of :class:`Gear`."""

    ratio: f8
    offset: f8


@kernel
def evaluate(gear: GearRecord, x: float, arrays: Arrays) -> Any:
    """See :mod:`.base`."""
    return gear.ratio * x + gear.offset, gear.ratio + 0.0 * x, 0.0 * x


@dataclass(frozen=True, kw_only=True)
class Gear(Coupling):
    """Gear, belt, chain drive, or rack and pinion: first coordinate = ``ratio`` * second + ``offset``.

    It holds positions, as Modelica's IdealGear does: unless both are fixed, assembly moves the joints whose starts do
    not fit, and a rotation by whole teeth is given by ``offset``. It is not determined from the start positions.

    Parameters
    ----------
    ratio
        Transmission ratio: -(teeth of the second) / (teeth of the first) for two external gears about parallel axes,
        for an internal gear, a belt
        or a chain without the sign; for a rack on a pinion the pitch radius, m/rad, for a pinion on a rack its inverse.
    offset
        First coordinate if the second is zero, rad or m.
    """

    record = GearRecord
    evaluate = evaluate

    ratio: float
    offset: float = 0.0

    def check(self, what: str) -> None:
        """Refuse what is no ratio."""
        if np.ndim(self.ratio) or not is_finite(self.ratio) or self.ratio == 0.0:
            raise UserError(f"ratio of {what} is {self.ratio!r}; allowed: a finite number other than zero")
        finite(f"offset of {what}", self.offset)

    def steepness(self) -> float:
        """Return the ratio without its sign."""
        return abs(self.ratio)
