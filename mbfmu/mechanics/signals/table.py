"""A signal through points: measured motions and loads."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from mbfmu.mechanics.curve import curve, rows
from mbfmu.mechanics.kind import Site
from solvers.compiled.kernel import kernel

from .base import InUse, Signal


@kernel
def evaluate(signal: Any, t: float, arrays: Any) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    x, dx, ddx, _ = curve(arrays.numbers, signal.first, signal.count, t)
    return x, dx, ddx


@dataclass(frozen=True)
class Table(Signal):
    """A curve through points; beyond both ends it goes on as a straight line.

    Of a spring it is the force over the stretch, see ``JointSpring`` and ``Spring``.

    Parameters
    ----------
    x
        Where the points are, ascending: s, or of a spring m or rad.
    y
        Values there.
    kind
        ``spline``: twice differentiable, without curvature at its ends. ``monotone``: never beyond the points beside
        it, ``akima``: hardly ever; both with jumps of the second derivative. ``linear``: straight from point to point,
        which no joint can follow.
    """

    x: Any
    y: Any
    kind: str = "spline"

    record = np.dtype(
        [
            ("first", np.int64),  # row of numbers
            ("count", np.int64),  # of rows
            ("slope", np.float64),  # the steepest, 1/s
            ("interval", np.float64),  # the shortest, s
        ],
        align=True,
    )
    evaluate = evaluate

    def fill(self, record: Any, site: Site) -> None:
        """Write the points."""
        table = rows("a table", self.x, self.y, self.kind)
        record["first"], record["count"] = site.numbers(table), len(table)
        record["slope"], record["interval"] = np.abs(table[:, 2]).max(), np.diff(table[:, 0]).min()

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether its rate has no jumps."""
        return self.kind != "linear" or np.size(self.x) == 2

    def __hash__(self) -> int:
        """Arrays are told apart by themselves."""
        return id(self)

    def pace(self, own: InUse, size: float) -> float:
        """Return ``size`` by the steepest slope."""
        slope = float(own.record["slope"])
        return size / slope if slope else 0.0

    def longest_step(self, own: InUse, t: float) -> tuple[float, float]:
        """Return the shortest interval between points, until the last."""
        begin, end = np.min(self.x), np.max(self.x)
        shortest = float(own.record["interval"])
        if t >= end or not float(own.record["slope"]):
            return inf, inf
        return (max(0.5 * (begin - t), shortest), float(begin)) if t < begin else (shortest, float(end))
