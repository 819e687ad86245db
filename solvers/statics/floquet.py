"""Linear systems with periodic coefficients, x' = A(t) x: characteristic exponents of the monodromy matrix (Floquet).

A is interpolated by a trigonometric polynomial. The monodromy matrix is the product of exponentials by the
Magnus expansion of order four on Gauss points (Iserles and Norsett 1999), which are exact for constant A however fast
its modes are. The number of steps is doubled, with an extrapolation, until the matrix no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi, sqrt
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from solvers.system import Array

from .matrices import MACHINE_EPSILON
from .spectrum import Spectrum, order_spectrum

MIN_SAMPLES, MAX_PERIOD_SAMPLES = 16, 4096  # of A in a period
# times off the samples, at which A is compared: multiples of this part
CHECK_TIMES, GOLDEN_RATIO = 8, 0.5 * (sqrt(5.0) - 1.0)
# of the coefficients of A: those at the highest frequencies, and those that are rounding
SMOOTHNESS_TOLERANCE, COEFFICIENT_NOISE_RATIO = 1e-10, 1e-13
MIN_MAGNUS_STEPS, MAX_MAGNUS_STEPS = 16, 16384
MIN_STEPS_PER_CYCLE = 4  # at least, of the highest harmonic of A
MONODROMY_TOLERANCE = 1e-10  # change of the monodromy matrix, relative, at which there are steps enough


def interpolate(A: Callable[[float], Array], period: float, cycles: float) -> tuple[Callable[[float], Array], int]:
    """Return a periodic function (k, k) of time by its samples, and its highest harmonic.

    Samples at equal distances do not show a harmonic that they meet at the same phase. So there are several in each of
    the ``cycles`` that drives turn in a period, and the function is compared at other times.

    Raises
    ------
    LinAlgError
        It is not smooth.
    """
    count = MIN_SAMPLES
    while count < MIN_STEPS_PER_CYCLE * cycles:
        count *= 2
    while count <= MAX_PERIOD_SAMPLES:
        samples = np.array([A(period * k / count) for k in range(count)])
        parts = np.fft.rfft(samples, axis=0) / count
        size = np.abs(parts).max(axis=(1, 2), initial=0.0)
        kept = np.flatnonzero(size > COEFFICIENT_NOISE_RATIO * size.max())
        weights = np.where(kept == 0, 1.0, 2.0)[:, np.newaxis, np.newaxis] * parts[kept]
        if size[count // 4 :].max() <= SMOOTHNESS_TOLERANCE * size.max():
            found = _TrigonometricPolynomial(kept, weights, period)
            times = [period * (k * GOLDEN_RATIO % 1.0) for k in range(1, CHECK_TIMES + 1)]
            if all(
                np.abs(A(t) - found(t)).max(initial=0.0) <= count * SMOOTHNESS_TOLERANCE * size.max() for t in times
            ):
                return found, int(kept.max(initial=0))
        count *= 2
    raise np.linalg.LinAlgError("the linearized motion changes too sharply within a period of the drives")


class _TrigonometricPolynomial:
    """A trigonometric polynomial with these harmonics (j,) and coefficients (j, k, k)."""

    def __init__(self, harmonics: NDArray[Any], weights: NDArray[np.complex128], period: float) -> None:
        self._rates, self._weights = 2j * pi * harmonics / period, weights

    def __call__(self, t: float) -> Array:
        return np.asarray(np.tensordot(np.exp(self._rates * t), self._weights, axes=1).real)


def monodromy_matrix(A: Callable[[float], Array], period: float, cycles: float) -> tuple[Array, float]:
    """Return the state after a period by that before, (k, k), and its error; LinAlgError where it does not converge."""
    smooth, harmonic = interpolate(A, period, cycles)
    steps = max(MIN_MAGNUS_STEPS, MIN_STEPS_PER_CYCLE * harmonic)
    rough, before = _product(smooth, period, steps), None
    while steps < MAX_MAGNUS_STEPS:
        steps *= 2
        fine = _product(smooth, period, steps)
        better = fine + (fine - rough) / 15.0
        size = float(np.linalg.norm(better, 2))
        if not np.isfinite(size):
            break
        if before is not None:
            error = float(np.linalg.norm(better - before, 2))
            if error <= MONODROMY_TOLERANCE * size:
                return better, error + MACHINE_EPSILON * steps * size
        rough, before = fine, better
    raise np.linalg.LinAlgError("the motion over a period of the drives is too fast to be followed")


def _product(A: Callable[[float], Array], period: float, steps: int) -> Array:
    """Return the product of the exponentials of a number of steps."""
    h, found = period / steps, np.eye(len(A(0.0)))
    for k in range(steps):
        first, second = (A((k + 0.5 + side * sqrt(3.0) / 6.0) * h) for side in (-1.0, 1.0))
        turned = sqrt(3.0) / 12.0 * h**2 * (second @ first - first @ second)
        found = scipy.linalg.expm(0.5 * h * (first + second) + turned) @ found
    return np.asarray(found)


def characteristic_exponents(A: Callable[[float], Array], period: float, cycles: float, basis: Array) -> Spectrum:
    """Return the characteristic exponents; those of their motions when the period begins.

    Parameters
    ----------
    A
        (2 f, 2 f) at a time, of changes and rates of f coordinates.
    period
        s, of A.
    cycles
        Turns of all drives in a period.
    basis
        (n, f) change of all coordinates by these.
    """
    Phi, error = monodromy_matrix(A, period, cycles)
    multipliers, left, right = scipy.linalg.eig(Phi, left=True)
    values, doubts = np.zeros(len(Phi), complex), np.zeros(len(Phi))
    for k, mu in enumerate(multipliers):
        along = abs(np.vdot(left[:, k], right[:, k]))
        off = 2.0 * error / (along + sqrt(along**2 + 4.0 * error))
        size = max(abs(mu), np.finfo(float).tiny)
        values[k], doubts[k] = np.log(complex(mu) or size) / period, np.log1p(off / size) / period
    values[np.abs(values) <= doubts] = 0.0
    upper = values.imag >= 0.0
    motions: NDArray[np.complex128] = basis @ right[: len(Phi) // 2, upper]
    return order_spectrum(values[upper], motions, doubts[upper])
