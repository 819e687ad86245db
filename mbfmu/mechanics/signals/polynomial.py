"""Polynomials in time, and the inputs that a host sets: polynomials about the last communication point.

The coefficients of an input during a run are described in :mod:`mbfmu.mechanics.arrays.support_motion` and
:mod:`mbfmu.mechanics.arrays.load_extrapolation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, is_finite
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Reals, Record, f8

from .base import InUse, Signal

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays


class PolynomialRecord(Record):
    """A polynomial of time."""

    t0: f8  # s
    c: Annotated[Reals, (4,)]  # c0 + c1 s + c2 s^2 + c3 s^3, s = t - t0


@kernel
def evaluate(signal: PolynomialRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    s, c = t - signal.t0, signal.c
    return (
        c[0] + s * (c[1] + s * (c[2] + s * c[3])),
        c[1] + s * (2.0 * c[2] + s * 3.0 * c[3]),
        2.0 * c[2] + s * 6.0 * c[3],
    )


@dataclass(frozen=True)
class Coefficients(Signal):
    """A polynomial, whoever gives its coefficients."""

    record = PolynomialRecord
    evaluate = evaluate

    def time_scale(self, own: InUse, size: float) -> float:
        """Return the shortest time in which one of its terms becomes ``size``."""
        c = [abs(float(x)) for x in own.record["c"]]
        return min(((size / x) ** (1.0 / k) for k, x in enumerate(c) if k and x), default=0.0)

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return c1, which is its speed where all higher ones are zero."""
        return float(own.record["c"][1]), not np.any(own.record["c"][2:])

    def hold(self, own: InUse, value: float) -> None:
        """Set c0 to the value and the others to zero."""
        own.record["c"] = (value, 0.0, 0.0, 0.0)

    def run_at(self, own: InUse, speed: float) -> None:
        """Set c1."""
        own.record["c"][1] = speed


@dataclass(frozen=True)
class Polynomial(Coefficients):
    """Polynomial of time: c0 + c1 t + c2 t^2 + c3 t^3, t in s.

    Parameters
    ----------
    c
        One to four coefficients, from the constant one; unit of the driven quantity per s^k.
    """

    c: Sequence[float]

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the coefficients."""
        if np.ndim(self.c) != 1 or not 1 <= len(self.c) <= 4 or not is_finite(self.c):
            raise UserError(f"polynomial coefficients are {self.c!r}; allowed: one to four finite numbers")
        record["c"][: len(self.c)] = self.c


@dataclass(frozen=True, kw_only=True)
class Input(Coefficients):
    """Input: a value that the importing tool sets between steps.

    A load is held, or continued with ``rate_name`` if the rate is given too. The input of a driven joint is its
    position at the time at which it is set. During the next step the joint moves to the position that is extrapolated
    to the end of this step, without a jump, see :mod:`mbfmu.mechanics.arrays.support_motion`.

    Parameters
    ----------
    name, unit, description
        Name, unit and description of the input variable of the FMU.
    rate_name
        Name of a second input, the time derivative; without it the rate is zero.
    acceleration_name
        Name of a third input, the second derivative, of the drive of a joint. With it the error of the force of the
        drive is O(h^2) at communication points at a distance h, without it O(h); without a rate it does not include
        inertia.
    start
        Value until the importing tool sets one, in ``unit``.

    Raises
    ------
    UserError
        The start is no finite number; there is an ``acceleration_name`` and no ``rate_name``.
    """

    name: str
    unit: str
    description: str = ""
    rate_name: str = ""
    acceleration_name: str = ""
    start: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a start that is no number, and an acceleration without a rate."""
        finite(f"start of input {self.name!r}", self.start)
        if self.acceleration_name and not self.rate_name:
            raise UserError(
                f"input {self.name!r} has the acceleration_name {self.acceleration_name!r} and no rate_name; give both"
            )

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the start value."""
        record["c"][0] = self.start

    def variables(self) -> list[tuple[str, str, str, float]]:
        """Return the value, and the rate and the acceleration if they have names."""
        own = [(self.name, self.unit, self.description, self.start)]
        if self.rate_name:
            own.append((self.rate_name, self.unit + "/s", f"rate of {self.name}", 0.0))
        if self.acceleration_name:
            own.append((self.acceleration_name, self.unit + "/s2", f"acceleration of {self.name}", 0.0))
        return own

    @property
    def force_error(self) -> str:
        """Message on the error of the force of a drive with this input at communication points; empty: none."""
        if self.acceleration_name:
            return ""
        if self.rate_name:
            return (
                f"force of the drive has an error of O(h) for a communication step size h ({self.name} "
                "without acceleration)"
            )
        return f"force of the drive without inertia ({self.name} without rate and acceleration)"


@dataclass(frozen=True, kw_only=True)
class SpeedInput(Coefficients):
    """Drive at a speed that the importing tool sets; the driven coordinate is its integral and is continuous.

    A new value sets the speed at once, by an impulse that also moves the bodies connected to the joint. Held between
    communication points, a speed that changes smoothly lags behind by half a step.

    Parameters
    ----------
    name, unit, description
        Name, unit and description of the input variable of the FMU; ``unit`` is rad/s or m/s.
    start
        Speed until the importing tool sets one, in ``unit``.
    """

    name: str
    unit: str
    description: str = ""
    start: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a start that is no number."""
        finite(f"start of input {self.name!r}", self.start)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the start value."""
        record["c"][1] = self.start

    def variables(self) -> list[tuple[str, str, str, float]]:
        """Return nothing for coefficient 0, which follows, and the speed for coefficient 1."""
        return [("", "", "", 0.0), (self.name, self.unit, self.description, self.start)]
