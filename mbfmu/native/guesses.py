"""First guesses of positions, which closing the loops corrects: near is enough if they close to the same positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError
from solvers.system import Array

from .monomials import Fit, products

if TYPE_CHECKING:
    from .parameter_dependence import ParameterDependence

GUESS_TOLERANCE = 0.02  # error, of the largest there is
RANGE_FACTORS = (2.0, 1.5, 1.18, 1.1, 1.05)  # by what parts of its value a parameter may change, largest first
# ... and in place of it by what, for every one of these parts, where it is zero: 0.27, 0.15, 0.075 for the last three
RANGE_ABOUT_ZERO = 1.5
GUESS_DEGREE = 3
GUESS_VALIDATION_POINTS = 10  # random points that are not used in a fit, in addition to all corners
MAX_GUESS_PARAMETERS = 6  # parameters
MAX_CLOSED_CORNERS = 16  # corners of a range at which loops are closed
CLOSED_ALIKE = 1e-9  # difference of closed positions, in units of the coordinates

Box = dict[str, tuple[float, float]]


def fit_guesses(
    read: Callable[[Mapping[str, float]], Array],
    values: Mapping[str, tuple[float, float, float]],
    columns: NDArray[np.int64],
    random: np.random.Generator,
    close_alike: Callable[[dict[str, float], Array], bool],
) -> tuple[Fit, Box] | None:
    """Return a polynomial for each column in the parameters, and the widest box in which it is near; None: in none.

    ``read`` gives the numbers for some values, ``values`` of every parameter its value and least and largest allowed.
    ``close_alike`` compares closed positions from the values of the polynomials and from the exact ones.
    """
    exponents = np.array(
        [e for e in product(range(GUESS_DEGREE + 1), repeat=len(values)) if sum(e) <= GUESS_DEGREE], float
    )
    for part in RANGE_FACTORS if len(values) <= MAX_GUESS_PARAMETERS else ():
        box = {name: _range(*own, part) for name, own in values.items()}
        low, high = np.array(list(box.values())).T
        fitted = 2 * len(exponents)
        x = np.vstack(
            (random.uniform(low, high, (fitted + GUESS_VALIDATION_POINTS, len(box))), list(product(*box.values())))
        )
        try:
            y = np.array([read(dict(zip(box, map(float, point), strict=True)))[columns] for point in x])
        except UserError:
            continue
        scale = np.prod(np.maximum(np.abs(low), np.abs(high)) ** exponents, axis=1)
        terms = products(x, exponents) / scale
        c = np.linalg.lstsq(terms[:fitted], y[:fitted], rcond=None)[0]
        near, points = terms @ c, [dict(zip(box, map(float, point), strict=True)) for point in x]
        tried = range(fitted, min(len(x), fitted + GUESS_VALIDATION_POINTS + MAX_CLOSED_CORNERS))
        if np.all(np.abs(near - y) <= GUESS_TOLERANCE * np.abs(y).max(axis=0)) and all(
            close_alike(points[k], near[k]) for k in tried
        ):
            return Fit(columns, exponents, c / scale[:, np.newaxis]), box
    return None


def _range(value: float, least: float, most: float, part: float) -> tuple[float, float]:
    """Return the range about a value, within what is allowed."""
    about = RANGE_ABOUT_ZERO * (part - 1.0)
    low, high = sorted((value / part, value * part)) if value else (-about, about)
    return max(low, least), min(high, most)


def fit_all_guesses(search: ParameterDependence) -> bool:
    """Fit the first guesses of a search that are no sums, in a range that is narrow enough.

    If there is none, curves are to represent them; then the result is false.
    """
    columns = np.array(sorted(search.guessed), np.int64)
    names = [n for n in search.settable if any(i in search.powers[n] for i in columns)]
    if not names:
        return True
    own = {n: (float(getattr(search.model, n)), *search.limits(n)) for n in names}
    found = None
    if not any(n in search.discrete for n in names):
        found = fit_guesses(search.reader.read, own, columns, search.random, _Closing(search, columns).alike)
    if found is None:
        search.guessed.clear()
        for n in names:
            search.curved[n] |= search.powers[n].keys() & set(columns.tolist())
        return False
    guess, box = found
    exponents = np.zeros((len(guess.exponents), len(search.settable)))
    exponents[:, [search.settable.index(n) for n in names]] = guess.exponents
    search.fits.append(guess._replace(exponents=exponents))
    for name, ends in box.items():
        search.narrow(name, ends)
    return True


class _Closing:
    """Comparison of closed positions from exact and from near start positions, which are numbers of a search."""

    def __init__(self, search: ParameterDependence, columns: NDArray[np.int64]) -> None:
        self._model, self._places = search.model, columns - search.reader.columns("q")[0]

    def alike(self, values: dict[str, float], near: Array) -> bool:
        """Return whether loops close to the same positions from ``near`` values of the columns."""
        compiled = self._model.with_values(values).compile()
        assembly, q = compiled.assembly, compiled.assembly.start_positions()
        held, given = assembly.held(), assembly.given()
        try:
            exact = assembly.close(0.0, q, held, given)
            q[self._places] = near
            difference = assembly.close(0.0, q, held, given) - exact
        except UserError:
            return False
        return bool(np.all(np.abs(difference) <= CLOSED_ALIKE * compiled.system.size))
