"""First guesses of positions, which closing the loops corrects: near is enough."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError
from solvers.system import Array

from .monomials import Fit, products

GUESS_TOLERANCE = 0.02  # error, of the largest there is
RANGE_FACTORS = (1.18, 1.1, 1.05)  # by what parts of its value a parameter may change, largest first
# ... and in place of it by what, for every one of these parts, where it is zero: 0.27, 0.15, 0.075
RANGE_ABOUT_ZERO = 1.5
GUESS_DEGREE = 3
GUESS_VALIDATION_POINTS = 10  # random points that are not used in a fit, in addition to all corners
MAX_GUESS_PARAMETERS = 4  # parameters

Box = dict[str, tuple[float, float]]


def fit_guesses(
    read: Callable[[Mapping[str, float]], Array],
    values: Mapping[str, tuple[float, float, float]],
    columns: NDArray[np.int64],
    random: np.random.Generator,
) -> tuple[Fit, Box] | None:
    """Return a polynomial for each column in the parameters, and the widest box in which it is near; None: in none.

    ``read`` gives the numbers for some values, ``values`` of every parameter its value and least and largest allowed.
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
        if np.all(np.abs(terms @ c - y) <= GUESS_TOLERANCE * np.abs(y).max(axis=0)):
            return Fit(columns, exponents, c / scale[:, np.newaxis]), box
    return None


def _range(value: float, least: float, most: float, part: float) -> tuple[float, float]:
    """Return the range about a value, within what is allowed."""
    about = RANGE_ABOUT_ZERO * (part - 1.0)
    low, high = sorted((value / part, value * part)) if value else (-about, about)
    return max(low, least), min(high, most)
