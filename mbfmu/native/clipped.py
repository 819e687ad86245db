"""Units of coordinates that follow parameters up to a bound, or from one on: min(a, b) or max(a, b) of two products."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError
from solvers.system import Array

from .monomials import FIT_TOLERANCE, Fit, products

if TYPE_CHECKING:
    from .parameter_dependence import ParameterDependence

POWER_ROOT = 4  # powers are multiples of a quarter
POWER_STEP_RATIO = 0.99  # of the value of a parameter, for its power about a point
POWER_TOLERANCE = 1e-8  # off a whole number

Read = Callable[[Mapping[str, float]], Array]


class Clipped(NamedTuple):
    """Numbers that are the largest of two products, to the power 1 / root; the smallest where that is negative."""

    fits: tuple[Fit, ...]
    root: int

    def values(self, x: Array) -> Array:
        """Return the numbers (points, k) at x (points, variables)."""
        largest: Array = np.max([fit.values(x)[0] for fit in self.fits], axis=0)
        return largest ** (1.0 / self.root)


def fit_clipped(
    read: Read, center: dict[str, float], points: list[dict[str, float]], names: list[str], columns: NDArray[np.int64]
) -> list[Clipped] | None:
    """Return what columns are about a center and at the first of the points where that fails; None: no products.

    They follow the parameters ``names`` and no others.
    """
    x = np.array([list(point.values()) for point in points])
    y = np.array([read(point)[columns] for point in points])
    inner = _products(read, center, names, columns)
    if inner is None or np.any(y <= 0.0):
        return None
    found = []
    for exponents in np.unique(inner[0], axis=0):
        own = np.flatnonzero(np.all(inner[0] == exponents, axis=1))
        first = Fit(columns[own], exponents[np.newaxis], inner[1][np.newaxis, own])
        wanted = first.values(x)[0] ** (1.0 / POWER_ROOT)
        off = np.any(np.abs(wanted - y[:, own]) > FIT_TOLERANCE * y[:, own], axis=1)
        k = int(np.argmax(off))
        outer = _products(read, points[k], names, columns[own])
        if outer is None or np.any(outer[0] != outer[0][0]):
            return None
        sign = -1 if off[k] and y[k, own[0]] < wanted[k, 0] else 1
        both = ((exponents, inner[1][own]), (outer[0][0], outer[1]))
        fits = tuple(Fit(columns[own], sign * e[np.newaxis], c[np.newaxis] ** sign) for e, c in both)
        found.append(Clipped(fits, sign * POWER_ROOT))
    return found


def _products(
    read: Read, point: dict[str, float], names: list[str], columns: NDArray[np.int64]
) -> tuple[Array, Array] | None:
    """Return powers (k, variables) and coefficients (k,) of the columns, to the power ROOT, about a point."""
    y = read(point)[columns]
    powers = np.zeros((len(point), len(columns)))
    with np.errstate(all="ignore"):
        for k, (name, x) in enumerate(point.items()):
            if name in names:
                powers[k] = (
                    POWER_ROOT
                    * np.log(read(point | {name: POWER_STEP_RATIO * x})[columns] / y)
                    / np.log(POWER_STEP_RATIO)
                )
    exponents = np.round(powers)
    if not np.all(np.abs(powers - exponents) < POWER_TOLERANCE):
        return None
    scale = np.array([products(np.array([list(point.values())]), e[np.newaxis])[0, 0] for e in exponents.T])
    return exponents.T, y**POWER_ROOT / scale


def fit_all_clipped(search: ParameterDependence, points: list[dict[str, float]]) -> bool:
    """Fit what follows parameters up to a bound; false where that froze them."""
    columns = np.array(sorted(search.bounded), np.int64)
    started = set(search.reader.columns("q", "v", "world").tolist())
    names = [n for n in search.settable if search.powers[n].keys() - started]  # a start has no say in a unit
    search.clipped, found = [], None
    moving = [n for n in names if search.powers[n].keys() & search.bounded]
    if not moving:
        return True
    with suppress(UserError):
        found = fit_clipped(search.reader.read, search.at_center(), points, names, columns)
    if found is None:
        search.fix(blame_for_units(search) or moving, search.describe_no_sum(columns))
        return False
    search.clipped = found
    return True


def blame_for_units(search: ParameterDependence) -> list[str]:
    """Return the parameters that change both lengths that stay as they are and units with a bound."""
    moved = ((n, search.powers[n].keys()) for n in search.settable)
    return [n for n, columns in moved if columns & search.bounded and columns & search.constant_scales]
