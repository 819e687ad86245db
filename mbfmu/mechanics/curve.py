"""Piecewise cubics through points that a user gives: tables of signals and of springs.

A row of ``Arrays.numbers`` is an interval: where it begins, the four coefficients from there on, lowest first, and the
integral from the first point to there. The last row is the end, with its value and slope. Beyond both ends the curve
goes on as a straight line.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator, PPoly

from mbfmu.errors import UserError
from solvers.compiled.kernel import kernel

from .numbers import array_of

ROW = 6  # numbers of an interval
KINDS = ("spline", "monotone", "akima", "linear")


@kernel
def curve(numbers: Any, first: int, count: int, x: Any) -> Any:
    """Value of a curve of ``count`` rows from ``first`` on, its two derivatives, and its integral from the first point
    on; analytic in x but for the points.
    """
    low, high = 0, count - 1
    while high - low > 1:
        middle = (low + high) // 2
        if x.real < numbers[first + ROW * middle].real:
            high = middle
        else:
            low = middle
    if x.real >= numbers[first + ROW * (count - 1)].real:
        low = count - 1
    at = first + ROW * low
    s, c0, c1, c2, c3 = x - numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3], numbers[at + 4]
    if low == 0 and s.real < 0.0:
        c2, c3 = 0.0 * c2, 0.0 * c3
    return (
        c0 + s * (c1 + s * (c2 + s * c3)),
        c1 + s * (2.0 * c2 + s * 3.0 * c3),
        2.0 * c2 + s * 6.0 * c3,
        numbers[at + 5] + s * (c0 + s * (c1 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0))),
    )


def rows(what: str, x: Any, y: Any, kind: str) -> NDArray[np.float64]:
    """Return the rows (points, 6) of a curve through points; UserError for what is none."""
    xs, ys = array_of(f"x of {what}", x), array_of(f"y of {what}", y)
    if xs.ndim != 1 or xs.shape != ys.shape or len(xs) < 2:
        raise UserError(f"{what} has {xs.shape} and {ys.shape} numbers; allowed: as many x as y, at least two")
    if not np.isfinite([xs, ys]).all() or np.any(np.diff(xs) <= 0.0):
        raise UserError(f"x of {what} is {x!r}; allowed: finite numbers, each greater than the one before")
    if kind not in KINDS:
        raise UserError(f"kind of {what} is {kind!r}; allowed: {', '.join(map(repr, KINDS))}")
    if len(xs) == 2 or kind == "linear":
        c = np.zeros((4, len(xs) - 1))
        c[2], c[3] = np.diff(ys) / np.diff(xs), ys[:-1]
        found = PPoly(c, xs)
    elif kind == "spline":
        found = CubicSpline(xs, ys, bc_type="natural")
    elif kind == "monotone":
        found = PchipInterpolator(xs, ys)
    else:
        found = Akima1DInterpolator(xs, ys)
    table = np.zeros((len(xs), ROW))
    table[:, 0], table[:-1, 1:5] = xs, found.c[::-1].T
    width = xs[-1] - xs[-2]
    c0, c1, c2, c3 = table[-2, 1:5]
    table[-1, 1:3] = c0 + width * (c1 + width * (c2 + width * c3)), c1 + width * (2.0 * c2 + 3.0 * width * c3)
    table[:, 5] = [found.antiderivative()(x) for x in xs]
    return table
