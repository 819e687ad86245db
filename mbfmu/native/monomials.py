"""Sums of products of powers, fitted to numbers that follow some variables."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.system import Array

FIT_TOLERANCE = 3e-13  # error of a fit, relative to the sum of its terms without their signs
NEGLIGIBLE_TERM_RATIO = 1e-11  # of the largest term: a term that is rounding
MAX_TERMS = 32  # terms of a sum

CONSTANT_POWERS = (0.0,)
SINGLE_POWERS = [(0.5 * k,) for k in (2, 4, 6, 8, -2, -4, -6, 1, -1, 3, -3, 5)]
SUM_POWERS: list[tuple[int, ...]] = [(0, 1), (0, 2), (0, -1), (0, 3), (1, 2), (0, -2), (1, 3), (1, -1), (2, 4), (0, 4)]
SUM_POWERS += [(2, 3), (0, 1, 2), (1, 2, 3), (0, 2, 4), (0, 1, 2, 3), (0, 1, 2, 3, 4)]

Powers = tuple[float, ...]


class Fit(NamedTuple):
    """Sums of the same products of powers: y = coefficients . prod(x ** exponents)."""

    columns: NDArray[np.int64]  # (k,) numbers that have them
    exponents: Array  # (terms, variables)
    coefficients: Array  # (terms, k)

    def values(self, x: Array) -> tuple[Array, Array]:
        """Return the sums (points, k) at x (points, variables), and those of the terms without their signs."""
        with np.errstate(all="ignore"):
            terms = products(x, self.exponents)
            return terms @ self.coefficients, np.abs(terms) @ np.abs(self.coefficients)


def products(x: Array, exponents: Array) -> Array:
    """Return the products of powers (points, terms)."""
    return np.asarray(np.prod(x[:, np.newaxis, :] ** exponents, axis=2))


def single(u: Array, y: Array) -> list[Powers | None]:
    """Return the power that every column of y (points, k) has in u (points,), u[0] = 1; None where it is not one.

    Of a column that u leaves alone it is the power zero.
    """
    found: list[Powers | None] = [None] * y.shape[1]
    left = np.arange(y.shape[1])
    for powers in (CONSTANT_POWERS, *SINGLE_POWERS):
        wanted = y[0, left] * u[:, np.newaxis] ** powers[0]
        tolerance = FIT_TOLERANCE * np.abs(wanted) if powers != CONSTANT_POWERS else 0.0
        done = np.all(np.abs(y[:, left] - wanted) <= tolerance, axis=0)
        for i in left[done]:
            found[i] = powers
        left = left[~done]
    return found


def sums(u: Array, y: Array) -> list[Powers | None]:
    """Return the powers of u (points,) whose sum every column of y (points, k) is; None where it is none."""
    found: list[Powers | None] = [None] * y.shape[1]
    left = np.arange(y.shape[1])
    for powers in SUM_POWERS:
        terms = u[:, np.newaxis] ** np.array(powers, float)
        c = np.linalg.lstsq(terms, y[:, left], rcond=None)[0]
        done = np.all(np.abs(terms @ c - y[:, left]) <= FIT_TOLERANCE * (np.abs(terms) @ np.abs(c)), axis=0)
        for i in left[done]:
            found[i] = tuple(map(float, powers))
        left = left[~done]
    return found


def joint_exponents(powers: tuple[Powers, ...]) -> Array:
    """Return the exponents (terms, variables) of all products of the powers of each variable."""
    return np.array(list(product(*powers)))


def fit_sums(columns: NDArray[np.int64], exponents: Array, x: Array, center: Array, y: Array) -> list[Fit]:
    """Return the sums that columns (points, k) of y are, terms that are rounding left out, coefficients snapped.

    Whether they do is for the caller to see. ``x`` (points, variables) is about ``center`` (variables,).
    """
    if not len(columns):
        return []
    terms, scale = products(x / center, exponents), np.prod(center**exponents, axis=1)
    c = np.linalg.lstsq(terms, y, rcond=None)[0]
    kept = np.abs(c) > NEGLIGIBLE_TERM_RATIO * np.abs(c).max(axis=0, initial=0.0)
    fits = []
    for pattern in np.unique(kept, axis=1).T:
        own = np.flatnonzero(np.all(kept == pattern[:, np.newaxis], axis=0))
        if not pattern.any():  # zero as long as what is frozen stays as it is
            fits.append(Fit(columns[own], exponents[:0], np.zeros((0, len(own)))))
            continue
        again = np.linalg.lstsq(terms[:, pattern], y[:, own], rcond=None)[0] / scale[pattern, np.newaxis]
        snapped = np.array([[snap(value) for value in row] for row in again]).reshape(again.shape)
        fits.append(Fit(columns[own], exponents[pattern], snapped))
    return fits


def snap(value: float) -> float:
    """Return the fraction of small numbers that a value is but for rounding, or the value."""
    if not 1e-6 < abs(value) < 1e12:
        return float(value)
    near = float(Fraction(float(value)).limit_denominator(2000))
    return near if abs(near - value) <= 1e-13 * abs(value) else float(value)
