"""Numbers that follow parameters along curves: polynomials in a range, verified to nearly all digits.

Polynomials represent what sums of products of powers do not, such as sines, roots of sums and quotients, if they are
smooth. Numbers that follow whole numbers or Booleans are interpolated at all their values.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from math import comb
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError
from solvers.system import Array

from .monomials import CONSTANT_POWERS, FIT_TOLERANCE, NEGLIGIBLE_TERM_RATIO, Powers, joint_exponents, products

if TYPE_CHECKING:
    from .parameter_dependence import ParameterDependence

CURVE_TOLERANCE = 1e-12  # error of a curve, relative to the largest value of the number in the range
BOUND_FACTOR = 4.0 * CURVE_TOLERANCE / FIT_TOLERANCE
NEGLIGIBLE_CURVE_TERM = 1e-3 * NEGLIGIBLE_TERM_RATIO  # of the largest term
# degrees and ranges that are tried by the number of parameters of curves; ranges as factors of the value
CURVES: dict[int, tuple[tuple[int, float], ...]] = {
    0: ((0, 1.0),),
    1: ((24, 2.0), (16, 1.5), (16, 1.2), (8, 1.05)),
    2: ((16, 1.5), (12, 1.2), (8, 1.05)),
    3: ((12, 1.2), (10, 1.1), (8, 1.05)),
    4: ((8, 1.05),),
}
RANGE_ABOUT_ZERO = 1.5  # half of the range about zero by the excess of the factor over one
SAMPLES_PER_TERM, VALIDATION_SAMPLES = 1.2, 24
MAX_SAMPLED_NUMBERS = 20_000_000  # numbers of all mechanisms that are built for a curve
MAX_CURVE_TERMS = 200_000  # terms of all curves of an FMU


class Shifted(NamedTuple):
    """A parameter minus an offset."""

    name: str
    offset: float


@dataclass(frozen=True)
class Curve:
    """Numbers that are sums of products of powers of variables, which are parameters or shifted parameters.

    Attributes
    ----------
    columns
        Numbers (k,) that have them.
    variables
        Names of parameters, and shifted parameters.
    exponents, coefficients
        (terms, variables) and (terms, k).
    """

    columns: NDArray[np.int64]
    variables: tuple[str | Shifted, ...]
    exponents: Array
    coefficients: Array

    def values(self, known: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the numbers (k,) for values of all parameters, and bounds of their magnitude: the error of the curves
        is less than ``FIT_TOLERANCE`` of the bounds.
        """
        x = np.array([[value_of(variable, known) for variable in self.variables]])
        terms = products(x, self.exponents)[0]
        return terms @ self.coefficients, BOUND_FACTOR * (np.abs(terms) @ np.abs(self.coefficients))


def value_of(variable: str | Shifted, known: Mapping[str, float]) -> float:
    """Return the value of a variable for values of all parameters."""
    return known[variable] if isinstance(variable, str) else known[variable.name] - variable.offset


def fit_all_curves(search: ParameterDependence) -> bool:
    """Find curves for all numbers of a search that need them; false where that fixed parameters."""
    search.curves = []
    groups = [_Together(search, names) for names in _groups(search)]
    return all(group.has_range() for group in groups) and all(group.fit() for group in groups)


def _groups(search: ParameterDependence) -> list[list[str]]:
    """Return the parameters of curves, those that move a number together in one list."""
    groups: list[tuple[list[str], set[int]]] = []
    for name in search.settable:
        columns = set(search.curved.get(name, ()))
        if not columns:
            continue
        names = [name]
        for other in [own for own in groups if own[1] & columns]:
            groups.remove(other)
            names, columns = other[0] + names, columns | other[1]
        groups.append((names, columns))
    return [names for names, _ in groups]


class _Together:
    """Parameters that move numbers along curves together."""

    def __init__(self, search: ParameterDependence, names: list[str]) -> None:
        self._search, self._names = search, names
        self._smooth = [n for n in names if n not in search.discrete]
        self._columns = sorted(set().union(*(search.curved[n] for n in names)))
        self._values = {n: float(getattr(search.model, n)) for n in search.settable}

    def has_range(self) -> bool:
        """Whether each parameter alone leads to curves in a range; false: parameters were fixed.

        This takes few mechanisms. Where it fails, curves that were found before would have to be found again.
        """
        search = self._search
        if len(self._smooth) > max(CURVES):
            most = max(self._smooth, key=lambda name: len(search.curved[name]))
            search.fix([most], search.describe_no_sum(search.curved[most]))
            return False
        if next(self._ranges(), None) is None:
            search.fix(self._names, search.describe_no_sum(self._columns))
            return False
        return True

    def fit(self) -> bool:
        """Add the curves of their numbers to the search; false where that fixed parameters."""
        search = self._search
        for degree, box in self._ranges():
            found = self._fit_within(box, self._exponents(degree))
            terms = sum(np.count_nonzero(curve.coefficients) for curve in [*search.curves, *(found or ())])
            if found is not None and terms <= MAX_CURVE_TERMS:
                search.curves += found
                for name, ends in box.items():
                    search.narrow(name, ends)
                return True
        search.fix(self._names, search.describe_no_sum(self._columns))
        return False

    def _ranges(self) -> Iterator[tuple[int, dict[str, tuple[float, float]]]]:
        """Yield degrees, and ranges in which polynomials represent the numbers as functions of each parameter alone."""
        for degree, factor in CURVES[len(self._smooth)]:
            box = {n: self._range(n, factor) for n in self._smooth}
            if len(box) < 2 or all(self._is_curve(name, ends, degree) for name, ends in box.items()):
                yield degree, box

    def _range(self, name: str, factor: float) -> tuple[float, float]:
        value, (least, most) = self._values[name], self._search.limits(name)
        about = RANGE_ABOUT_ZERO * (factor - 1.0)
        low, high = sorted((value / factor, value * factor)) if value else (-about, about)
        return max(low, least), min(high, most)

    def _is_curve(self, name: str, ends: tuple[float, float], degree: int) -> bool:
        """Return whether polynomials of a degree represent the numbers as functions of one parameter alone."""
        u = np.cos(np.pi * (np.arange(2.0 * degree) + 0.5) / (2.0 * degree))
        x = 0.5 * (ends[0] + ends[1]) + 0.5 * (ends[1] - ends[0]) * u
        try:
            rows = [self._search.reader.read(self._values | {name: float(own)})[self._columns] for own in x]
        except UserError:
            return False
        y, fitted = np.array(rows), np.arange(len(x)) % 3 != 1
        terms = u[:, np.newaxis] ** np.arange(degree + 1.0)
        c = np.linalg.lstsq(terms[fitted], y[fitted], rcond=None)[0]
        return bool(np.all(np.abs(terms @ c - y) <= CURVE_TOLERANCE * np.abs(y).max(axis=0)))

    def _exponents(self, degree: int) -> Array:
        """Return exponents up to a total degree in the smooth parameters, and to those of interpolation in others."""
        smooth = [e for e in product(range(degree + 1), repeat=len(self._smooth)) if sum(e) <= degree]
        assert len(smooth) == comb(degree + len(self._smooth), degree)
        others = [range(len(self._search.discrete[n])) for n in self._names if n not in self._smooth]
        return np.array([(*e, *more) for e in smooth for more in product(*others)], float)

    def _fit_within(self, box: dict[str, tuple[float, float]], exponents: Array) -> list[Curve] | None:
        """Return curves of all numbers in a range; None if they do not represent the numbers, or it is refused."""
        search, kinds = self._search, self._kinds()
        most = max(len(joint_exponents(kind)) if kind else 1 for kind in kinds)
        fitted = int(SAMPLES_PER_TERM * len(exponents) * most) + VALIDATION_SAMPLES
        if (fitted + VALIDATION_SAMPLES) * len(search.reader.places) > MAX_SAMPLED_NUMBERS:
            return None
        try:
            points = [self._point(box, k, k < fitted) for k in range(fitted + VALIDATION_SAMPLES)]
            points += [self._values | dict(zip(box, corner, strict=True)) for corner in product(*box.values())]
            rows = np.array([search.reader.read(point)[self._columns] for point in points])
        except UserError:
            return None
        curves = [self._fit_kind(kind, own, box, exponents, points, rows, fitted) for kind, own in kinds.items()]
        return None if None in curves else [curve for curve in curves if curve is not None]

    def _kinds(self) -> dict[tuple[Powers, ...], list[int]]:
        """Return the places of columns that have the same powers of all other parameters, by these powers."""
        found: dict[tuple[Powers, ...], list[int]] = {}
        for k, i in enumerate(self._columns):
            others = (self._search.powers[n].get(i, CONSTANT_POWERS) for n in self._others())
            found.setdefault(tuple(others), []).append(k)
        return found

    def _others(self) -> list[str]:
        return [n for n in self._search.settable if n not in self._names]

    def _point(self, box: dict[str, tuple[float, float]], number: int, dense_at_ends: bool) -> dict[str, float]:
        """Return values of all parameters at random, those of curves within their range, whole numbers in turn."""
        search, random = self._search, self._search.random
        point = search.random_point()
        for name in (n for n in self._names if n not in box):
            number, k = divmod(number, len(search.discrete[name]))
            point[name] = float(search.discrete[name][k])
        for name, (low, high) in box.items():
            u = np.cos(np.pi * random.random()) if dense_at_ends else random.uniform(-1.0, 1.0)
            point[name] = float(0.5 * (low + high) + 0.5 * (high - low) * u)
        return point

    def _fit_kind(
        self,
        kind: tuple[Powers, ...],
        own: list[int],
        box: dict[str, tuple[float, float]],
        exponents: Array,
        points: list[dict[str, float]],
        rows: Array,
        fitted: int,
    ) -> Curve | None:
        """Return the curves of columns with the same powers of other parameters; None if they do not represent them."""
        others, names = self._others(), [*self._smooth, *(n for n in self._names if n not in self._smooth)]
        low, high = np.array([box.get(n, self._search.ends[n]) for n in names]).T
        offsets, scales = 0.5 * (low + high), np.where(low < high, 0.5 * (high - low), 1.0)
        powers = joint_exponents(kind) if kind else np.zeros((1, 0))
        u = (_vectors(points, names) - offsets) / scales
        center = np.array([self._search.center[n] or 1.0 for n in others])
        curved, straight = products(u, exponents), products(_vectors(points, others) / center, powers)
        terms = (curved[:, :, np.newaxis] * straight[:, np.newaxis, :]).reshape(len(points), -1)
        y = rows[:, own]
        c = np.linalg.lstsq(terms[:fitted], y[:fitted], rcond=None)[0]
        if not np.all(np.abs(terms @ c - y) <= CURVE_TOLERANCE * np.abs(y).max(axis=0)):
            return None
        c[np.abs(c) < NEGLIGIBLE_CURVE_TERM * np.abs(c).max(axis=0)] = 0.0
        both = np.array([(*e, *p) for e in exponents for p in powers])
        c /= np.prod(np.concatenate([scales, center]) ** both, axis=1)[:, np.newaxis]
        kept = np.any(c != 0.0, axis=1)
        shifted = (Shifted(n, o) if o else n for n, o in zip(names, offsets.tolist(), strict=True))
        columns = np.array(self._columns, np.int64)[own]
        return Curve(columns, (*shifted, *others), both[kept], np.asarray(c[kept], float))


def _vectors(points: list[dict[str, float]], names: Iterable[str]) -> Array:
    """Return values of parameters (points, names)."""
    wanted = list(names)
    return np.array([[point[n] for n in wanted] for point in points], float).reshape(len(points), len(wanted))
