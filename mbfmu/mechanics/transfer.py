"""Transfer functions as matrices of a linear block."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.numbers import array_of, is_whole, positive
from mbfmu.util.errors import UserError

Matrix = NDArray[np.float64]
MAX_DELAY_ORDER = 10  # of a Pade approximation: coefficients of higher orders lose digits


def coefficients(what: str, given: Any) -> Matrix:
    """Check the coefficients of a polynomial, the highest power first; return them without zeros in front."""
    values = array_of(what, given)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise UserError(f"{what} is {given!r}; allowed: finite coefficients, that of the highest power of s first")
    return np.trim_zeros(values, "f") if values.any() else np.zeros(1)


def matrix(what: str, given: Any, shape: tuple[int, int]) -> Matrix:
    """Check a matrix of finite numbers."""
    found = array_of(what, given)
    if found.shape != shape or not np.isfinite(found).all():
        raise UserError(f"{what} has the shape {found.shape}; allowed: finite numbers of the shape {shape}")
    return found


def realize(what: str, numerator: Any, denominator: Any) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Return A, B, C, D of a transfer function of ``what``; UserError if it is not proper.

    The states are v and its derivatives (controllable canonical form), where v is the input divided by the denominator.
    Time is scaled by the geometric mean of the poles that are not zero, and the states so that the largest entry of C
    is 1: their size is that of the output.
    """
    top = coefficients(f"numerator of {what}", numerator)[::-1]
    given = array_of(f"denominator of {what}", denominator)
    bottom = coefficients(f"denominator of {what}", denominator)[::-1]
    if not given[0]:
        raise UserError(
            f"denominator of {what} is {denominator!r}, whose first coefficient is zero; leave out zeros in front of "
            "the highest power"
        )
    n = len(bottom) - 1
    if len(top) - 1 > n:
        raise UserError(
            f"{what} has a numerator of degree {len(top) - 1} and a denominator of degree {n}; allowed: a proper "
            "transfer function, whose numerator has at most the degree of the denominator. To differentiate, use a "
            "sensor of a rate, or add a pole"
        )
    low = int(np.flatnonzero(bottom)[0])
    scale = abs(bottom[low] / bottom[n]) ** (1.0 / (n - low)) if low < n else 1.0  # rad/s
    powers = scale ** np.arange(n + 1.0)
    b = np.zeros(n + 1)
    b[: len(top)] = top * powers[: len(top)] / (bottom[n] * powers[n])
    a = bottom * powers / (bottom[n] * powers[n])
    A = scale * np.eye(n, k=1)
    B = np.zeros((n, 1))
    C = (b[:n] - b[n] * a[:n])[None, :]
    if n:
        size = np.abs(C).max() or 1.0
        A[n - 1] = -scale * a[:n]
        B[n - 1], C = scale * size, C / size
    return A, B, C, b[n:][None, :]


def steady_states(what: str, A: Matrix, B: Matrix, inputs: Sequence[float]) -> Matrix:
    """Return the states in which constant inputs leave them; UserError if there are none."""
    load = B @ np.asarray(inputs, float)
    if not load.any():
        return np.zeros(len(A))
    found = np.linalg.lstsq(A, -load, rcond=None)[0]
    if np.abs(A @ found + load).max() > 1e-9 * np.abs(load).max():
        raise UserError(
            f"start_input of {what} is {list(inputs)}, which the block integrates, so that it has no steady state; "
            "allowed: zero. Leave out start_input"
        )
    return np.asarray(found)


def pade_delay(delay: float, order: int) -> tuple[list[float], list[float]]:
    """Return numerator and denominator of the Pade approximation of a delay, for :meth:`.Mechanism.transfer_function`.

    The gain is 1 at all frequencies. The phase is that of the delay up to about w = ``order`` / ``delay``, rad/s. The
    response to a step starts with oscillations, since the approximation is no delay: use a high order only for signals
    that are smooth over the delay. :meth:`.Mechanism.delay` is a delay without this approximation.

    Parameters
    ----------
    delay
        Delay, s.
    order
        Number of states, 1 to 10.

    Returns
    -------
    tuple
        Coefficients of the numerator and of the denominator, those of the highest power of s first.

    Raises
    ------
    UserError
        The delay is not positive, or the order is not a whole number from 1 to 10.
    """
    positive("delay", delay)
    if not is_whole(order) or not 1 <= order <= MAX_DELAY_ORDER:
        raise UserError(f"order of a delay is {order!r}; allowed: a whole number from 1 to {MAX_DELAY_ORDER}")
    terms = [factorial(2 * order - k) * comb(order, k) / factorial(2 * order) * delay**k for k in range(order, -1, -1)]
    signs = [(-1.0) ** k for k in range(order, -1, -1)]
    return [sign * term for sign, term in zip(signs, terms, strict=True)], terms
