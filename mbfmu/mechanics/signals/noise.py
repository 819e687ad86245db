"""Noise with a given spectrum: a sum of cosines with random phases, and so a function of time.

    x(t) = mean + sum_k a_k cos(2 pi f_k t + p_k),    f_k = k / period,    a_k = (2 S(f_k) / period)^(1/2)

with the one-sided power spectral density S and phases p_k that are uniformly distributed (Shinozuka and Deodatis 1991,
Simulation of stochastic processes by spectral representation, doi:10.1115/1.3119501).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor, pi
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, is_finite, is_whole, not_negative, positive
from mbfmu.util.errors import UserError, short
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, f8, i8

from .base import InUse, Signal
from .harmonic import MAX_PERIOD_STEP_RATIO

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays

MAX_COSINES = 10_000  # every evaluation computes all
FREQUENCY_ROUNDING_RATIO = 1e-9  # relative, of a frequency that is a multiple of 1 / period


class NoiseRecord(Record):
    """Parameters of :class:`Noise`."""

    first: i8  # number of the real part of the first complex amplitude a_k exp(i p_k); the imaginary part follows
    lowest: i8  # k of the first cosine, and of the last
    highest: i8
    period: f8  # s
    middle: f8
    slope: f8  # root mean square of the rate, 1/s
    clock: f8  # 1, or 0: held at its value at t = 0


@kernel
def evaluate(signal: NoiseRecord, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """See :mod:`.base`. Horner's rule in exp(2 pi i t / period)."""
    turns = signal.clock.real * t / signal.period.real
    angle = 2.0 * pi * (turns - np.floor(turns))
    c, s, w1 = np.cos(angle), np.sin(angle), 2.0 * pi / signal.period
    zero = 0.0 * signal.middle
    xr, xi, vr, vi, ar, ai = zero, zero, zero, zero, zero, zero
    for k in range(signal.highest, -1, -1):
        xr, xi = xr * c - xi * s, xr * s + xi * c
        vr, vi = vr * c - vi * s, vr * s + vi * c
        ar, ai = ar * c - ai * s, ar * s + ai * c
        if k >= signal.lowest:
            at, w = signal.first + 2 * (k - signal.lowest), k * w1
            p, q = arrays.numbers[at], arrays.numbers[at + 1]
            xr, xi = xr + p, xi + q
            vr, vi = vr - w * q, vi + w * p
            ar, ai = ar - w * w * p, ai - w * w * q
    return signal.middle + xr, signal.clock * vr, signal.clock * ar


@kernel
def longest_step(signal: NoiseRecord, t: float, arrays: Arrays) -> tuple[float, float]:
    """See :mod:`.base`. Part of the shortest period."""
    if signal.clock.real == 0.0 or signal.slope.real == 0.0:
        return np.inf, np.inf
    return MAX_PERIOD_STEP_RATIO * signal.period.real / signal.highest, np.inf


@dataclass(frozen=True, kw_only=True)
class Noise(Signal):
    """Noise with a given power spectral density: a smooth function of time, the same in every run.

    It is a sum of cosines at the multiples of 1 / ``period`` from ``lowest`` to ``highest`` frequency, with random
    phases. Its mean square over a period is exactly the sum of S / ``period`` over these frequencies. With many cosines
    its values are nearly normally distributed.

    Parameters
    ----------
    density
        One-sided power spectral density S, in the square of the unit of the driven quantity per Hz: a number, or a
        function of the frequency in Hz, such as ``lambda f: 1e-4 / (1 + f**2)``, which is evaluated when the mechanism
        is compiled.
    lowest, highest
        Lowest and highest frequency, Hz.
    period
        Time after which the noise repeats itself, s: at least the duration of the run. There are
        (``highest`` - ``lowest``) ``period`` cosines, at most 10000, of which every evaluation computes all.
    seed
        Whole number from 0 on, from which the phases follow: noises with different seeds are independent.
    mean
        Mean value.

    Notes
    -----
    No step of a solver is longer than 0.3 / ``highest``.
    """

    record = NoiseRecord
    evaluate, longest_step = evaluate, longest_step

    density: float | Callable[[float], float]
    highest: float
    period: float
    lowest: float = 0.0
    seed: int = 0
    mean: float = 0.0

    def fill(self, record: Any, site: Attachment) -> None:
        """Check the parameters and write the cosines."""
        period, highest = positive("period of a Noise", self.period), positive("highest of a Noise", self.highest)
        lowest, mean = not_negative("lowest of a Noise", self.lowest), finite("mean of a Noise", self.mean)
        if not is_whole(self.seed) or self.seed < 0:
            raise UserError(f"seed of a Noise is {self.seed!r}; allowed: a whole number from 0 on")
        begin = max(1, ceil(lowest * period * (1.0 - FREQUENCY_ROUNDING_RATIO)))
        end = floor(min(highest * period * (1.0 + FREQUENCY_ROUNDING_RATIO), 1e15))
        if end < begin:
            raise UserError(
                f"lowest and highest of a Noise are {lowest!r} and {highest!r} Hz, without a multiple of "
                f"1 / period = {1.0 / period:g} Hz; allowed: lowest less than highest. Use a longer period"
            )
        if end - begin >= MAX_COSINES:
            raise UserError(
                f"a Noise up to {highest!r} Hz with a period of {period!r} s has {end - begin + 1} cosines; allowed: "
                f"at most {MAX_COSINES}. Use a shorter period or a smaller range of frequencies"
            )
        frequencies = np.arange(begin, end + 1) / period
        amplitudes = np.sqrt(2.0 * self._densities(frequencies) / period)
        phases = np.random.default_rng(self.seed).uniform(0.0, 2.0 * pi, len(frequencies))
        record["first"] = site.numbers(np.column_stack((amplitudes * np.cos(phases), amplitudes * np.sin(phases))))
        record["lowest"], record["highest"] = begin, end
        record["period"], record["middle"], record["clock"] = period, mean, 1.0
        record["slope"] = np.linalg.norm(2.0 * pi * frequencies * amplitudes) / np.sqrt(2.0)

    def _densities(self, frequencies: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the density at frequencies, Hz; UserError if it is not finite and not negative."""
        given = self.density
        if not callable(given):
            return np.full(len(frequencies), not_negative("density of a Noise", given))
        values = [given(float(f)) for f in frequencies]
        for f, value in zip(frequencies, values, strict=True):
            if np.ndim(value) or not is_finite(value) or value < 0.0:
                raise UserError(
                    f"density of a Noise is {short(value)} at {f:g} Hz; allowed: finite and not negative. Correct the "
                    "function, or the lowest and highest frequency"
                )
        return np.array(values, float)

    def time_scale(self, own: InUse, size: float) -> float:
        """Return ``size`` by the root mean square of the rate."""
        slope = float(own.record["slope"]) * float(own.record["clock"])
        return size / slope if slope else 0.0

    def steady(self, own: InUse) -> tuple[float, bool]:
        """Return that it is at rest, if it is held or zero."""
        return 0.0, not own.record["slope"] * own.record["clock"]

    def hold(self, own: InUse, value: float) -> None:
        """Evaluate it at t = 0 at all times."""
        own.record["clock"] = 0.0
