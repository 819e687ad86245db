"""Piecewise cubics through points that a user gives: tables of signals and of springs.

A row of ``Arrays.numbers`` is an interval: where it begins, the four coefficients from there on, lowest first, and the
integral from the first point to there. The last row is the end, with its value and slope. Beyond both ends the curve
continues as a straight line; the number of rows of a periodic curve is negative.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel

from .numbers import array_of

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

INTERVAL_SIZE = 6  # numbers of an interval
CURVE_KINDS = ("spline", "monotone", "akima", "linear")
END_CONDITIONS = {"linear": "natural", "hold": "clamped", "periodic": "periodic"}  # end conditions of a spline


@kernel
def curve(numbers: Reals, first: int, count: int, x: float) -> Any:
    """Value of a curve of ``count`` rows from ``first`` on, its two derivatives, and its integral from the first point
    on; analytic in x but for the points.
    """
    turns = 0.0
    if count < 0:
        count = -count
        begin, period = numbers[first].real, numbers[first + INTERVAL_SIZE * (count - 1)].real - numbers[first].real
        turns = np.floor((x.real - begin) / period)
        x = x - turns * period
    low, high = 0, count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if x.real < numbers[first + INTERVAL_SIZE * middle].real:
            high = middle
        else:
            low = middle
    end = first + INTERVAL_SIZE * (count - 1)
    if x.real >= numbers[end].real:
        low = count - 1
    at = first + INTERVAL_SIZE * low
    s, c0, c1, c2, c3 = x - numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3], numbers[at + 4]
    if low == 0 and s.real < 0.0:
        c2, c3 = 0.0 * c2, 0.0 * c3
    return (
        c0 + s * (c1 + s * (c2 + s * c3)),
        c1 + s * (2.0 * c2 + s * 3.0 * c3),
        2.0 * c2 + s * 6.0 * c3,
        numbers[at + 5] + s * (c0 + s * (c1 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0))) + turns * numbers[end + 5],
    )


@kernel
def next_point(numbers: Reals, first: int, count: int, x: float) -> float:
    """The first point of a curve after x, in which its polynomial changes; infinite after the last one."""
    turned, end = 0.0, np.inf
    if count < 0:
        count = -count
        begin, period = numbers[first].real, numbers[first + INTERVAL_SIZE * (count - 1)].real - numbers[first].real
        turned = period * np.floor((x - begin) / period)
        end = turned + period + numbers[first + INTERVAL_SIZE].real  # if rounding puts x at the end of its period
    low, high = -1, count
    while high - low > 1:
        middle = (low + high) // 2
        if x < turned + numbers[first + INTERVAL_SIZE * middle].real:
            high = middle
        else:
            low = middle
    return turned + numbers[first + INTERVAL_SIZE * high].real if high < count else end


def rows(what: str, x: Any, y: Any, kind: str, beyond: str = "linear") -> NDArray[np.float64]:
    """Return the rows (intervals + 1, 6) of a curve through points; UserError for what is none."""
    xs, ys = array_of(f"x of {what}", x), array_of(f"y of {what}", y)
    if xs.ndim != 1 or xs.shape != ys.shape or len(xs) < 2:
        raise UserError(f"{what} has {xs.shape} and {ys.shape} numbers; allowed: as many x as y, at least two")
    if not np.isfinite([xs, ys]).all() or np.any(np.diff(xs) <= 0.0):
        raise UserError(f"x of {what} is {x!r}; allowed: finite numbers, each greater than the one before")
    if kind not in CURVE_KINDS:
        raise UserError(f"kind of {what} is {kind!r}; allowed: {', '.join(map(repr, CURVE_KINDS))}")
    if beyond not in END_CONDITIONS:
        raise UserError(f"beyond of {what} is {beyond!r}; allowed: {', '.join(map(repr, END_CONDITIONS))}")
    if beyond == "periodic" and ys[0] != ys[-1]:
        raise UserError(
            f"{what} is periodic, but its first value is {ys[0]:g} and its last {ys[-1]:g}; allowed: equal values"
        )
    found = _pieces(xs, ys, kind, beyond)
    table = np.zeros((len(xs), INTERVAL_SIZE))
    table[:, 0], table[:-1, 1:5] = xs, found.c[::-1].T
    width = xs[-1] - xs[-2]
    c0, c1, c2, c3 = table[-2, 1:5]
    table[-1, 1:3] = c0 + width * (c1 + width * (c2 + width * c3)), c1 + width * (2.0 * c2 + 3.0 * width * c3)
    table[:, 5] = found.antiderivative()(xs)
    if beyond == "hold":  # an interval before the first point, whose slope is none; nor has the end any
        table[-1, 2] = 0.0
        return np.vstack(((xs[0] - width, ys[0], 0.0, 0.0, 0.0, -width * ys[0]), table))
    if beyond == "periodic":  # rounding may leave x at the end
        table[-1, 2:5] = table[0, 2:5]
    return table


def _pieces(xs: NDArray[np.float64], ys: NDArray[np.float64], kind: str, beyond: str) -> Any:
    """Return the polynomials of the intervals between the points."""
    if kind == "linear" or (len(xs) == 2 and beyond != "hold"):
        c = np.zeros((4, len(xs) - 1))
        c[2], c[3] = np.diff(ys) / np.diff(xs), ys[:-1]
        return scipy.interpolate.PPoly(c, xs)
    if kind == "spline":
        return scipy.interpolate.CubicSpline(xs, ys, bc_type=END_CONDITIONS[beyond])
    make = scipy.interpolate.PchipInterpolator if kind == "monotone" else scipy.interpolate.Akima1DInterpolator
    if beyond == "linear":
        return make(xs, ys)
    period, gap = xs[-1] - xs[0], np.diff(xs).min()
    if beyond == "periodic":
        before, after = (xs[:-1] - period, ys[:-1]), (xs[1:] + period, ys[1:])
    else:  # flat on both sides
        before, after = (
            (xs[0] - gap * np.array((2.0, 1.0)), ys[[0, 0]]),
            (xs[-1] + gap * np.array((1.0, 2.0)), ys[[-1, -1]]),
        )
    whole = make(*(np.concatenate(part) for part in zip(before, (xs, ys), after, strict=True)))
    first = len(before[0])
    return scipy.interpolate.PPoly(whole.c[:, first : first + len(xs) - 1], xs)
