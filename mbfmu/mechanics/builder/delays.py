"""Delays: y(t) = u(t - T), by polynomials through samples of u.

Two sampled blocks make a delay. The first one is a shift register: it samples the source at the multiples of h = T / N
and keeps the last N samples. The second one evaluates, at the multiples of H = p h, the polynomial of degree p through
the p + 1 samples from t - T to t - T + H. Its states are the values w_i = y^(i) H^i / i! of the output and of its
scaled derivatives; until the next evaluation w_i' = (i + 1) w_(i+1) / H, so that w_0 = y follows the polynomial.

The polynomials of successive intervals H have a common value where they meet, so that the output is continuous. The
error is at most h^(p+1) max|u^(p+1)| max|s (s - 1) ... (s - p)| / (p + 1)!, with s from 0 to p. An interval contains
samples of that interval only: a jump of a derivative of u at a multiple of H causes no error.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.numbers import is_whole, positive
from mbfmu.util.errors import UserError

from .sampled import Sampled, SampledHandle

MAX_DEGREE, MAX_SAMPLES = 5, 1000  # of the polynomials; kept in the shift register


class Delays(Sampled):
    """Base of :class:`.Mechanism`: delays."""

    def delay(
        self,
        name: str,
        source: Any,
        *,
        delay: float,
        samples: int = 30,
        degree: int = 3,
        start: float = 0.0,
        nominal: float = 1.0,
        unit: str = "1",
    ) -> SampledHandle:
        """Add a pure delay: y(t) = u(t - T), with the input u and the output y.

        The source is sampled at the multiples of T / ``samples``, s. The output follows polynomials through the
        samples, without jumps.

        Parameters
        ----------
        name
            Unique name among the blocks.
        source
            Input u.
        delay
            Delay T, s.
        samples
            Number N of samples within the delay, a multiple of ``degree``, at least twice as large.
        degree
            Degree p of the polynomials, 1 to 5: the error of a smooth signal is proportional to N^-(p+1). 1: lines, for
            signals with jumps, where polynomials of higher degrees overshoot.
        start
            Input before the start of the run. It is not used if the run starts in the steady state.
        nominal, unit
            As for :meth:`lag`.

        Returns
        -------
        SampledHandle
            Handle of the block. Its states are the output ``y1`` and its scaled derivatives ``y2``, ...; the samples
            are the states of a second block NAME.history.

        Raises
        ------
        UserError
            As for :meth:`lag`; or the delay is not positive, or the numbers of samples or the degree are not allowed.
        """
        what = f"block {name!r}"
        T = positive(f"delay of {what}", delay)
        if not is_whole(degree) or not 1 <= degree <= MAX_DEGREE:
            raise UserError(f"degree of {what} is {degree!r}; allowed: a whole number from 1 to {MAX_DEGREE}")
        if not is_whole(samples) or samples % degree or not 2 * degree <= samples <= MAX_SAMPLES:
            raise UserError(
                f"samples of {what} is {samples!r}; allowed: a multiple of its degree {degree} from {2 * degree} to "
                f"{MAX_SAMPLES}"
            )
        self._new_name("block", name, [acting.name for acting in self.blocks])
        N, p, h = int(samples), int(degree), T / int(samples)
        shift, first = np.eye(N, k=-1), np.eye(N, 1)
        before: dict[str, Any] = {"quantum": 0.0, "start": [start] * N, "start_output": [], "nominal": nominal}
        none = np.zeros((0, N)), np.zeros((0, 1))
        history = self._sampled(f"{name}.history", [source], h, shift, first, *none, **before, units=[])
        # Both blocks sample at once: the register holds the samples before this time, the newest one first
        window = [history.states[N - 1 - j] for j in range(p + 1)]
        powers = np.vander(np.arange(p + 1) / p, increasing=True)
        coefficients = np.linalg.inv(powers)
        flow = np.diag(np.arange(1.0, p + 1), 1) / (p * h)
        output: dict[str, Any] = {"quantum": 0.0, "start_output": [start, *[0.0] * p], "nominal": nominal}
        empty = np.zeros((0, 0)), np.zeros((0, p + 1)), np.zeros((p + 1, 0))
        made = self._sampled(name, window, p * h, *empty, coefficients, **output, units=[unit] * (p + 1), rates=flow)
        made.held = 1
        return made
