"""A coordinate as a function of another: q_a = f(q_b)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics import law
from mbfmu.mechanics.curve import curve
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.signals import Signal, Table
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Record, f8, i8

from .base import Coupling

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

CAM_CHECK_RANGE = 5.0  # units of ``width`` to either side of zero, in which a function is tried


class CamRecord(Record):
    """Parameters of :class:`Cam`."""

    first: i8
    count: i8
    width: f8


@kernel
def evaluate(cam: CamRecord, x: float, arrays: Arrays) -> Any:
    """See :mod:`.base`."""
    value, slope, bend, _ = curve(arrays.numbers, cam.first, cam.count, x)
    return value, slope, bend


@cache
def kernel_of(f: Any) -> Any:
    """Return ``evaluate`` of a function f(q)."""
    derivatives = law.derivatives

    def evaluate(cam: Any, x: Any, arrays: Arrays) -> Any:
        return derivatives(f, x, cam.width.real)

    return jit_uncached(evaluate)


@dataclass(frozen=True)
class Cam(Coupling):
    """Cam and follower, or another law: first coordinate = law(second coordinate).

    Parameters
    ----------
    law
        ``Table`` of the first coordinate over the second, which must be smooth (``beyond="periodic"`` for a cam that
        rotates without limit); a function ``lambda q: ...`` or an expression ``"0.01 * cos(3 * q)"``, compiled and
        differentiated by differences.
    width
        For a function: change of the second coordinate, rad or m, over which it changes noticeably; None: 1 rad. It is
        required if the second coordinate is a displacement.
    """

    law: Any
    width: float | None = None

    record = CamRecord
    evaluate = evaluate

    def __post_init__(self) -> None:
        """Compile a function."""
        if not isinstance(self.law, Table):
            if isinstance(self.law, Signal) or not (callable(self.law) or isinstance(self.law, str)):
                raise UserError(f"law of a cam is {self.law!r}; allowed: a Table, a function or an expression of q")
            object.__setattr__(self, "evaluate", kernel_of(self._function()))

    def _function(self) -> Any:
        return law.law_of("law of a cam", self.law, ("q",))

    def check(self, what: str) -> None:
        """Refuse what no joint can follow."""
        if self.width is not None:
            positive(f"width of {what}", self.width)
        if isinstance(self.law, Table):
            self.law.rows(f"law of {what}")
            if not self.law.drives:
                raise UserError(f"law of {what} is {self.law!r}; its slope jumps, and no joint can follow that")
        elif not law.resolved(self._function(), self._width * CAM_CHECK_RANGE * np.array((-1.0, 1.0)), self._width):
            raise UserError(
                f"law of {what} changes faster than differences over thousandths of {self._width:g} resolve; use "
                "Cam(..., width=...) with the change of its coordinate, rad or m, over which it changes"
            )

    def check_unit(self, what: str, unit: str) -> None:
        """Refuse a function of a displacement that does not say over what it changes."""
        if unit == "m" and self.width is None and not isinstance(self.law, Table):
            raise UserError(
                f"law of {what} is a function of a displacement; use Cam(..., width=...) with the displacement, m, "
                "over which it changes"
            )

    @property
    def _width(self) -> float:
        return 1.0 if self.width is None else float(self.width)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the table, or how fast the function changes."""
        record["width"] = self._width
        if isinstance(self.law, Table):
            self.law.write(f"law of {site.name}", record, site)

    def steepness(self) -> float:
        """Return the steepest slope at the points of a table, or at some of a function."""
        if isinstance(self.law, Table):
            return float(np.abs(self.law.rows("law of a cam")[:, 2]).max())
        points = self._width * np.linspace(-CAM_CHECK_RANGE, CAM_CHECK_RANGE, 41)
        return float(np.abs([law.derivatives(self._function(), x, self._width)[1] for x in points]).max())
