"""A signal through a Python function of time or points, as a piecewise Chebyshev series; see :mod:`.fitting`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .base import InUse, Signal
from .fitting import SERIES_DEGREE, Array, Pieces

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays
    from solvers.compiled.record import Reals

MAX_INTERVAL_STEP_RATIO = 0.25  # longest step, in intervals
ONE_STEP_DEGREE = 3  # degree up to which a step of one interval resolves a series
MIN_JUMP_STEP_RATIO = 1e-9  # longest step at a jump, to its time, or to the duration of the run if that is shorter
TERMS = SERIES_DEGREE + 1
# Noise of value, rate and acceleration, relative to the series; a smaller value is zero: scales of the motion are taken
# from what acts at the start, and must not be taken from rounding
NOISE_LEVELS = (1e-13, 1e-12, 1e-9)
# Begin, end, longest step, noise of the three; begin and longest step of the next interval with a shorter one
HEADER_SIZE = 8
PIECE_SIZE = HEADER_SIZE + 3 * TERMS  # ... and the series of the three


class FollowedRecord(Record):
    """Parameters of :class:`Followed`."""

    first: i8  # row of numbers
    count: i8  # of rows
    start: f8  # rate at the begin
    slope: f8  # the steepest, 1/s
    constant: i8  # 1: the rate never changes


@kernel
def find_piece(numbers: Reals, first: int, count: int, t: float) -> int:
    """Return where the row of the interval begins that t is in."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if t < numbers[first + PIECE_SIZE * middle].real:
            high = middle
        else:
            low = middle
    return first + PIECE_SIZE * low


@kernel
def clenshaw(numbers: Reals, at: int, z: float) -> Any:
    """Return the Chebyshev series from ``at`` on, at z from -1 to 1."""
    b, before = 0.0 * numbers[at], 0.0 * numbers[at]
    for k in range(TERMS - 1, 0, -1):
        b, before = numbers[at + k] + 2.0 * z * b - before, b
    return numbers[at] + z * b - before


@kernel
def without_noise(x: Any, noise: Any) -> Any:
    """Return x, or zero where it is noise."""
    return x if abs(x) > noise.real else 0.0 * x


@kernel
def evaluate(signal: FollowedRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`. Beyond both ends it continues with constant acceleration."""
    numbers = arrays.numbers
    at = find_piece(numbers, signal.first, signal.count, t)
    a, b = numbers[at].real, numbers[at + 1].real
    inside = min(max(t, a), b)
    z, late = (2.0 * inside - a - b) / (b - a), t - inside
    x, dx, ddx = (
        without_noise(clenshaw(numbers, at + HEADER_SIZE, z), numbers[at + 3]),
        without_noise(clenshaw(numbers, at + HEADER_SIZE + TERMS, z), numbers[at + 4]),
        without_noise(clenshaw(numbers, at + HEADER_SIZE + 2 * TERMS, z), numbers[at + 5]),
    )
    return x + late * (dx + 0.5 * late * ddx), dx + late * ddx, ddx


@kernel
def longest_step(signal: FollowedRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. Part of the interval, and before a shorter one half the way there."""
    numbers = arrays.numbers
    at = find_piece(numbers, signal.first, signal.count, t)
    own, until, finer = numbers[at + 2].real, numbers[at + 6].real, numbers[at + 7].real
    half, end = 0.5 * (until - t), max(numbers[at + 1].real, t + own)
    if not until < np.inf:
        return own, end if t < numbers[at + 1].real else np.inf
    return (min(own, half), min(end, t + half)) if half > finer else (finer, until)


def next_finer(begins: Array, steps: Array) -> tuple[Array, Array]:
    """Return begin and longest step of the next interval whose longest step is shorter, for each; else infinite."""
    at, finer, waiting = np.full(len(steps), np.inf), np.full(len(steps), np.inf), list[int]()
    for k in range(len(steps) - 1, -1, -1):
        while waiting and steps[waiting[-1]] >= 0.9 * steps[k]:
            waiting.pop()
        if waiting:
            at[k], finer[k] = begins[waiting[-1]], steps[waiting[-1]]
        waiting.append(k)
    return at, finer


@dataclass(frozen=True, kw_only=True)
class Followed(Signal):
    """What an input is given by for a whole run: a function of time, or points.

    Parameters
    ----------
    value, rate, acceleration
        The signal and its derivatives over the run.
    smooth
        Whether its rate has no jumps, so that a joint can follow it.
    """

    value: Pieces
    rate: Pieces
    acceleration: Pieces
    smooth: bool

    record = FollowedRecord
    evaluate, longest_step = evaluate, longest_step

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the intervals."""
        rates = self.rate.series
        record["first"] = site.numbers(self.rows())
        record["count"], record["start"] = len(rates), self.rate.at(self.rate.begins[:1])[0]
        record["slope"] = np.abs(rates).sum(axis=1).max()
        record["constant"] = not np.any(rates[:, 1:]) and np.all(rates[:, 0] == rates[0, 0])

    def rows(self) -> Array:
        """Return the rows (intervals, ROW) for kernels."""
        begins, ends, series = self.value
        degree = np.array([np.flatnonzero(row)[-1] if row.any() else 0 for row in series])
        times = np.maximum(np.abs(begins), np.abs(ends))
        widths, shortest = ends - begins, MIN_JUMP_STEP_RATIO * np.minimum(times, ends[-1] - begins[0])
        steps = np.maximum(np.where(degree > ONE_STEP_DEGREE, MAX_INTERVAL_STEP_RATIO, 1.0) * widths, shortest)
        # resolved by steps of any length
        constant = (degree == 0) | (degree.max() <= ONE_STEP_DEGREE) & (len(degree) == 1)
        steps[constant & (widths > shortest)] = np.inf
        parts = (series, self.rate.series, self.acceleration.series)
        noise = [share * np.abs(part).sum(axis=1) for share, part in zip(NOISE_LEVELS, parts, strict=True)]
        noise[0][:] = noise[0].max()
        return np.column_stack((begins, ends, steps, *noise, *next_finer(begins, steps), *parts))

    @property
    def drives(self) -> bool:  # type: ignore[override]
        """Whether its rate has no jumps."""
        return self.smooth

    def __hash__(self) -> int:
        """Arrays are compared by identity."""
        return id(self)

    def time_scale(self, own: InUse, size: float) -> float:
        """Return ``size`` by the steepest slope."""
        slope = float(own.record["slope"])
        return size / slope if slope else 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return the rate at the begin, and whether it never changes."""
        return float(own.record["start"]), bool(own.record["constant"])
