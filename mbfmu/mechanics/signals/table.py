"""A signal through points: measured motions and loads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.curve import INTERVAL_SIZE, curve, next_point, rows
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .base import InUse, Signal
from .followed import next_finer

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays


STEP_LIMIT_SIZE = 3  # numbers of a row of step limits
EQUAL_WIDTH_RATIO = 0.9  # of the shortest to the longest interval, above which all steps have the same limit


class TableRecord(Record):
    """Parameters of :class:`Table`."""

    first: i8  # row of numbers
    count: i8  # of rows, negative: periodic
    slope: f8  # the steepest, 1/s
    limits: i8  # place of the step limits, STEP_LIMIT_SIZE numbers for each interval
    begin: f8  # the first point, s
    end: f8  # the last, s
    clock: f8  # 1, or 0: held at its value at t = 0


@kernel
def evaluate(signal: TableRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`."""
    clock = signal.clock.real
    x, dx, ddx, _ = curve(arrays.numbers, signal.first, signal.count, clock * t)
    return x, clock * dx, clock * ddx


@kernel
def longest_step(signal: TableRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. The interval between points, until the next point; before a shorter one half the way there."""
    numbers, count, period = arrays.numbers, signal.count, signal.end - signal.begin
    if signal.slope == 0.0 or (count > 0 and t >= signal.end):
        return np.inf, np.inf
    if count > 0 and t < signal.begin:
        own, following, until, finer = np.inf, np.inf, signal.begin, numbers[signal.limits].real
    else:
        turned = period * np.floor((t - signal.begin) / period) if count < 0 else 0.0
        low, high = 0, abs(count) - 1
        while high - low > 1:
            middle = (low + high) // 2
            if t < turned + numbers[signal.first + INTERVAL_SIZE * middle].real:
                high = middle
            else:
                low = middle
        at = signal.limits + STEP_LIMIT_SIZE * low
        own, until, finer = numbers[at].real, turned + numbers[at + 1].real, numbers[at + 2].real
        following = next_point(numbers, signal.first, count, t)
    if not until < np.inf:
        return own, following
    half = 0.5 * (until - t)
    return (min(own, half), min(following, t + half)) if half > finer else (finer, until)


def step_limits(table: Any, beyond: str) -> NDArray[np.float64]:
    """Return the longest step in each interval of a table, s, and begin and longest step of the next shorter interval.

    The rows (intervals, 3) contain infinite numbers if no interval is shorter. Intervals that are almost equal have the
    same longest step, so that rounding errors of the points do not change the steps.
    """
    points = table[1:, 0] if beyond == "hold" else table[:, 0]
    widths, begins = np.diff(points), points[:-1]
    if widths.min() >= EQUAL_WIDTH_RATIO * widths.max():
        widths = np.full_like(widths, widths.min())
    if beyond == "periodic":  # the next shorter interval may be in the next period
        begins, widths = np.append(begins, begins + points[-1] - points[0]), np.tile(widths, 2)
    limits = np.column_stack((widths, *next_finer(begins, widths)))[: len(points) - 1]
    return np.vstack((limits[:1], limits)) if beyond == "hold" else limits  # an interval before the first point


@dataclass(frozen=True)
class Table(Signal):
    """Curve through points.

    For a spring it is the force over the elongation, see ``JointSpring`` and ``Spring``; for a ``Cam`` one coordinate
    over the other.

    Parameters
    ----------
    x
        Abscissas, ascending: s, or m or rad for a spring or a cam.
    y
        Values at the points.
    kind
        ``spline``: twice differentiable, without curvature at its ends. ``monotone``: never beyond the points next to
        it, ``akima``: almost never beyond them; both with jumps of the second derivative. ``linear``: straight from
        point to point, which cannot drive a joint.
    beyond
        Continuation beyond both ends. ``linear``: as a straight line. ``hold``: with the value there; a spline or a
        monotone curve has zero slope at its ends. ``periodic``: repeated without limit in both directions; the
        last value must be the first, and a curve has no kink there.
    """

    x: Any
    y: Any
    kind: str = "spline"
    beyond: str = "linear"

    record = TableRecord
    evaluate, longest_step = evaluate, longest_step

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the points."""
        table = self.write("a table", record, site)
        widths = np.diff(table[:, 0])
        secants = np.diff(table[:, 1]) / widths  # of smooth curves that are flat at all points
        record["slope"] = max(np.abs(table[:, 2]).max(), np.abs(secants).max())
        record["limits"] = site.numbers(step_limits(table, self.beyond))
        record["begin"], record["end"], record["clock"] = np.min(self.x), np.max(self.x), 1.0

    def rows(self, what: str) -> Any:
        """Return the rows of the curve, see :mod:`mbfmu.mechanics.curve`; UserError for what is none."""
        return rows(what, self.x, self.y, self.kind, self.beyond)

    def write(self, what: str, record: Any, site: Attachment) -> Any:
        """Keep the rows for the kernels of a record with ``first`` and ``count``, and return them."""
        table = self.rows(what)
        record["first"] = site.numbers(table)
        record["count"] = -len(table) if self.beyond == "periodic" else len(table)
        return table

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether its rate has no jumps."""
        if self.beyond == "hold":
            return self.kind in ("spline", "monotone")
        return self.kind != "linear" or np.size(self.x) == 2

    def __hash__(self) -> int:
        """Arrays are compared by identity."""
        return id(self)

    def time_scale(self, own: InUse, size: float) -> float:
        """Return ``size`` by the steepest slope."""
        slope = float(own.record["slope"])
        return size / slope if slope else 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return that it is at rest, if it is held or has one value only."""
        return 0.0, not own.record["slope"] * own.record["clock"]

    def run_on(self, own: InUse) -> None:
        """Keep only the interval beyond the last point, if it is constant there."""
        count = int(own.record["count"].real)
        if count > 1 and not self.rows("a table")[-1, 2]:
            own.record["first"] += INTERVAL_SIZE * (count - 1)
            own.record["count"], own.record["slope"] = 1, 0.0

    def hold(self, own: InUse, value: float) -> None:
        """Evaluate it at t = 0 at all times."""
        own.record["clock"] = 0.0
