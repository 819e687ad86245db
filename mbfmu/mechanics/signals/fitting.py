"""Piecewise Chebyshev approximation of a Python function of time, with controlled error.

A Python function cannot be called from a kernel, so it is approximated over the whole run before the run begins. An
interval is halved until the last coefficients of its Chebyshev series are at rounding level (Trefethen, *Approximation
Theory and Approximation Practice*, 2013, chapter 3). The nodes are Gauss points, in the interior of the interval, and
the series is compared with the function at the output times too, so that nothing is missed that the outputs resolve.

A jump, or a kink, is enclosed by intervals that become shorter towards it.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

Array = NDArray[np.float64]

SERIES_DEGREE = 15  # of the series on one interval
FIRST_INTERVALS = 32  # equal intervals that the halving begins with
RESOLUTION_TOLERANCE = 1e-13  # last coefficients relative to the largest value, below which an interval is accepted
NEGLIGIBLE_RATIO = 4e-15  # coefficients relative to the largest value that are rounding
IMPULSE_TOLERANCE = 1e-14  # ... of a load: error times duration relative to largest value times duration of the run
MIN_GAIN_RATIO = 0.25  # of last coefficients after and before halving; above it the function has noise or a kink
TIME_ROUNDING = 8.0 * np.finfo(float).eps  # of the time at which the function is called
MIN_INTERVAL_RATIO = 1e-13  # width of an interval relative to the run; what is not resolved there is a jump
MAX_JUMPS, MAX_ADJACENT_JUMPS, MAX_INTERVALS = 500, 8, 100_000
CHECK_TOLERANCE = 1e-11  # deviation at output times relative to the largest value
JUMP_WIDTH, JUMP_CHANGE = 1e-9, 1e-4  # interval relative to the run, and relative change over it: a jump

_COUNT = SERIES_DEGREE + 1
_ANGLES = (np.arange(_COUNT) + 0.5) * np.pi / _COUNT
NODES = -np.cos(_ANGLES)
_TO_SERIES = 2.0 / _COUNT * np.cos(np.outer(np.arange(_COUNT), _ANGLES)) * (-1.0) ** np.arange(_COUNT)[:, np.newaxis]
_TO_SERIES[0] *= 0.5


class UnresolvedError(Exception):
    """A function that is too rough to be approximated; the text gives the reason and the time."""


class Pieces(NamedTuple):
    """A piecewise Chebyshev series."""

    begins: Array  # (k,) s
    ends: Array  # (k,) s
    series: Array  # (k, DEGREE + 1)

    @property
    def half_widths(self) -> Array:
        """Half of the width of each interval (k, 1), s."""
        found: Array = 0.5 * (self.ends - self.begins)[:, np.newaxis]
        return found

    @staticmethod
    def of_cubics(points: Array, c: Array) -> Pieces:
        """Return cubics between points (k + 1,); their coefficients (4, k) begin with that of the third power."""
        begins, ends = points[:-1], points[1:]
        s = 0.5 * (ends - begins)[:, np.newaxis] * (1.0 + NODES)
        c3, c2, c1, c0 = (part[:, np.newaxis] for part in c)
        series = (c0 + s * (c1 + s * (c2 + s * c3))) @ _TO_SERIES.T
        series[:, 4:] = 0.0
        return Pieces(begins, ends, series)

    def derivative(self) -> Pieces:
        """Return the derivative by time."""
        slopes = np.zeros_like(self.series)
        slopes[:, :-1] = chebyshev.chebder(self.series, axis=1)
        return self._replace(series=slopes / self.half_widths)

    def integral(self, start: float) -> Pieces:
        """Return the integral over time that begins with ``start``; its highest coefficient, at rounding level, is left
        out.
        """
        found = chebyshev.chebint(self.series, lbnd=-1, axis=1)[:, :_COUNT] * self.half_widths
        gains = chebyshev.chebval(1.0, found.T)
        found[:, 0] += start + np.concatenate(([0.0], np.cumsum(gains)[:-1]))
        return self._replace(series=found)

    def joined_derivative(self) -> Pieces:
        """Return the derivative with equal values where intervals meet, and zero at the begin of a motion from rest.

        The differences are errors of the approximation. In the rate of a drive they would be jumps of velocities,
        which a gear multiplies by its ratio, and across which an integrator of velocities cannot step. Every interval
        takes half of the difference at its ends, and less linearly towards its other end.
        """
        found = self.derivative()
        first, last = (np.asarray(chebyshev.chebval(z, found.series.T), float) for z in (-1.0, 1.0))
        half = 0.5 * (first[1:] - last[:-1])
        error = RESOLUTION_TOLERANCE * np.abs(self.series).sum(axis=1).max() * SERIES_DEGREE**2 / self.half_widths[0, 0]
        at_begin = np.append(-first[0] if abs(first[0]) <= error else 0.0, -half)
        at_end = np.append(half, 0.0)
        found.series[:, 0] += 0.5 * (at_end + at_begin)
        found.series[:, 1] += 0.5 * (at_end - at_begin)
        return found

    def at(self, times: Array) -> Array:
        """Return the values at ``times`` within the intervals."""
        k = np.clip(np.searchsorted(self.begins, times, side="right") - 1, 0, len(self.begins) - 1)
        z = (2.0 * times - self.begins[k] - self.ends[k]) / (self.ends[k] - self.begins[k])
        return np.asarray(chebyshev.chebval(z, self.series[k].T, tensor=False), float)


class _Fit:
    """One approximation on its way."""

    def __init__(self, function: Callable[[float], float], begin: float, end: float, marks: Array) -> None:
        self.function, self.begin, self.end = function, begin, end
        self.marks, self.at_marks = marks, np.array([function(float(t)) for t in marks])
        self.scale = float(np.abs(self.at_marks).max(initial=0.0))

    def series(self, a: float, b: float) -> Array:
        """Return the series of the function from a to b, s."""
        values = np.array([self.function(float(t)) for t in 0.5 * (a + b) + 0.5 * (b - a) * NODES])
        self.scale = max(self.scale, float(np.abs(values).max()))
        found: Array = _TO_SERIES @ values
        return found

    def noise(self, a: float, b: float, series: Array) -> float:
        """Return by how much rounding of the time changes the function between a and b."""
        slope = float(np.arange(_COUNT) @ np.abs(series)) / (0.5 * (b - a))
        return TIME_ROUNDING * max(abs(a), abs(b)) * slope

    def agrees(self, a: float, b: float, series: Array, allowed: float) -> bool:
        """Whether the series agrees with the function at the output times between a and b, and next to a and b, where
        a jump between the end and the outermost node changes none of the values at the nodes.
        """
        k = slice(np.searchsorted(self.marks, a, side="right"), np.searchsorted(self.marks, b, side="left"))
        inset = TIME_ROUNDING * max(abs(a), abs(b))
        next_to = [a + inset, b - inset] if 4.0 * inset < b - a else []
        times = np.append(self.marks[k], next_to)
        values = np.append(self.at_marks[k], [self.function(float(t)) for t in next_to])
        off = np.abs(chebyshev.chebval((2.0 * times - a - b) / (b - a), series) - values)
        return bool(off.max(initial=0.0) <= allowed)


def fit(
    function: Callable[[float], float], begin: float, end: float, marks: Array, loose: float, *, smooth: bool
) -> Pieces:
    """Return the approximation of a function from ``begin`` to ``end``, s.

    Parameters
    ----------
    function
        Returns a finite number at any time in between.
    begin, end
        The interval, s.
    marks
        Times (k,), ascending, at which it must agree with the function too: outputs, points of a table.
    loose
        Error relative to the largest value that is allowed where halving an interval does not make it smaller.
    smooth
        Neither jumps, kinks nor noise are allowed.

    Raises
    ------
    UnresolvedError
        The function has noise, too many jumps, or it is to be ``smooth`` and is not.
    """
    own = _Fit(function, begin, end, marks)
    span = end - begin
    edges = np.linspace(begin, end, FIRST_INTERVALS + 1)
    waiting = [(a, b, own.series(a, b), np.inf) for a, b in pairwise(edges)][::-1]
    found: list[tuple[float, float, Array]] = []
    jumps, adjacent, last = 0, 0, -np.inf
    while waiting:
        a, b, series, before = waiting.pop()
        width, tail, noise = b - a, float(np.abs(series[-3:]).max()), own.noise(a, b, series)
        fine = tail <= RESOLUTION_TOLERANCE * own.scale + noise
        if not smooth:
            fine = fine or tail * width <= IMPULSE_TOLERANCE * own.scale * span
            fine = fine or (tail > MIN_GAIN_RATIO * before and tail <= loose * own.scale)
        agreed = (
            CHECK_TOLERANCE * own.scale + noise
            if smooth
            else max(CHECK_TOLERANCE, loose) * own.scale + noise + 10.0 * tail
        )
        if fine and own.agrees(a, b, series, agreed):
            kept = np.where(np.abs(series) > NEGLIGIBLE_RATIO * own.scale, series, 0.0)
            found.append((a, b, kept))
        elif width <= max(MIN_INTERVAL_RATIO * span, 4.0 * np.finfo(float).eps * max(abs(a), abs(b))):
            jumps, adjacent = jumps + 1, adjacent + 1 if a == last else 0
            last = b
            if smooth or jumps > MAX_JUMPS or adjacent > MAX_ADJACENT_JUMPS:
                kind = "it jumps" if smooth or adjacent <= MAX_ADJACENT_JUMPS else "it changes like noise"
                more = f", and more than {MAX_JUMPS} times in all" if jumps > MAX_JUMPS else ""
                raise UnresolvedError(f"{kind} at t = {a:.9g} s{more}")
            ends = chebyshev.chebval(np.array([NODES[0], NODES[-1]]), series)
            line = np.zeros(_COUNT)
            line[:2] = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
            found.append((a, b, line))
        else:
            middle = 0.5 * (a + b)
            waiting += [(x, y, own.series(x, y), tail) for x, y in ((middle, b), (a, middle))]
            if len(found) + len(waiting) > MAX_INTERVALS:
                raise UnresolvedError(f"it needs more than {MAX_INTERVALS} intervals, at t = {a:.9g} s")
    if not smooth:
        found = _enclose_jumps(found, 4.0 * max(CHECK_TOLERANCE, loose) * own.scale, MIN_INTERVAL_RATIO * span)
    return Pieces(*(np.array(part) for part in zip(*found, strict=True)))


def _enclose_jumps(found: list[tuple[float, float, Array]], allowed: float, least: float) -> list[Any]:
    """Return the intervals with a short one, of at least ``least`` (s), where two long ones differ by more than
    ``allowed``.

    A jump exactly between two intervals has no short intervals from halving, which make the steps of solvers short.
    """
    result = found[:1]
    for a, b, series in found[1:]:
        begin, end, before = result[-1]
        ends, width = chebyshev.chebval(1.0, before), max(least, 4.0 * np.finfo(float).eps * abs(a))
        change = chebyshev.chebval(-1.0, series) - ends
        if abs(change) > allowed and min(end - begin, b - a) > 4.0 * width:
            line = np.zeros(_COUNT)
            line[:2] = ends + 0.5 * change, 0.5 * change
            result[-1:] = [(begin, a - width, before), (a - width, a, line)]
        result.append((a, b, series))
    return result


def find_jump(pieces: Pieces) -> float | None:
    """Return the first time, s, at which it jumps, between two intervals or within a very short one; None: nowhere."""
    width, span = pieces.ends - pieces.begins, pieces.ends[-1] - pieces.begins[0]
    first, last = (np.asarray(chebyshev.chebval(z, pieces.series.T), float) for z in (-1.0, 1.0))
    wide = width > JUMP_WIDTH * span
    scale = np.abs(pieces.series[wide]).sum(axis=1).max(initial=0.0)
    within = ~wide & (np.abs(last - first) > JUMP_CHANGE * scale)
    between = np.append(np.abs(first[1:] - last[:-1]) > JUMP_CHANGE * scale, False)
    times = np.where(within, pieces.begins, pieces.ends)[within | between]
    return float(times[0]) if len(times) else None
