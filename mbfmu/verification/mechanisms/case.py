"""Mechanisms of any size, and motions of one degree of freedom by SciPy."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import cos, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from mbfmu.mechanics import Mechanism

G = 9.81  # m/s^2
ExactMotion = Callable[..., tuple[Any, Any]]  # (times (k,), nudge=0.0) -> q (k, nq), v (k, n); see `turning`
PRECISION: dict[str, Any] = {"method": "DOP853", "rtol": 2.3e-14, "atol": 1e-15}
Array = NDArray[np.float64]


class Case(NamedTuple):
    """Mechanism, its exact motion (None: unknown), and the end of the motion, s."""

    mechanism: Mechanism
    exact: ExactMotion | None
    stop_time: float


class Scale(NamedTuple):
    """Factors by which lengths, masses and times are multiplied."""

    lengths: float = 1.0
    masses: float = 1.0
    times: float = 1.0

    @property
    def gravity(self) -> float:
        """Acceleration of gravity, m/s^2."""
        return G * self.lengths / self.times**2

    @property
    def torque(self) -> float:
        """Factor of energies and torques."""
        return self.masses * self.lengths**2 / self.times**2


UNSCALED = Scale()


def vertical(scale: Scale) -> Mechanism:
    """Return an empty mechanism with gravity along -y."""
    return Mechanism(gravity=(0.0, -scale.gravity, 0.0))


def with_energy(m: Mechanism) -> Mechanism:
    """Add the output ``energy``."""
    m.output("energy", m.energy, "kinetic and potential energy")
    return m


def columns(*factors: float) -> Callable[[Any, Any], tuple[Any, Any]]:
    """Return the function that embeds one angle as coordinates which are multiples of it."""
    return lambda a, b: (np.outer(a, factors), np.outer(b, factors))


def turning(
    inertia: Callable[[float], tuple[float, float]],
    slope: Callable[[float], float],
    start: tuple[float, float],
    embed: Callable[[Any, Any], tuple[Any, Any]],
    *,
    rate_size: float | None = None,
) -> ExactMotion:
    """Return the motion of one angle: m theta'' + m' theta'^2 / 2 + V' = 0.

    Parameters
    ----------
    inertia, slope
        Functions of the angle: (m, m'), and V'.
    start
        Angle, rad, and its rate, rad/s, at the first time.
    embed
        Returns the coordinates (k, nq) and velocities (k, n) for angles and rates (k,).
    rate_size
        Rate that gravity causes, 1/s; None: the largest for any angle.

    Returns
    -------
    Function of times (k,) and of a ``nudge``: a change of the angle (rad), and of the rate relative to the rate that
    gravity causes, with random signs at each of the times. It shows how errors grow.
    """
    if rate_size is None:
        rate_size = sqrt(max(abs(slope(a)) / inertia(a)[0] for a in np.linspace(0.0, 2.0 * pi, 64)))

    def right(_: float, y: Any) -> list[float]:
        m, dm = inertia(y[0])
        return [y[1], -(0.5 * dm * y[1] ** 2 + slope(y[0])) / m]

    def exact(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        y = followed(right, times, np.array(start), nudge * np.array((1.0, rate_size)))
        return embed(y[:, 0], y[:, 1])

    return exact


def followed(right: Any, times: Any, start: Any, nudge: Any) -> Array:
    """Return the solution (k, 2 n) at the times; with a nudge (2 n,) it is changed by that at each of them."""
    if not np.any(nudge):
        return np.asarray(solve_ivp(right, (float(times[0]), float(times[-1])), start, t_eval=times, **PRECISION).y.T)
    rows, rng = [start], np.random.default_rng(len(times))
    for span in pairwise(times):
        pushed = rows[-1] + nudge * rng.choice((-1.0, 1.0), len(start))
        rows.append(solve_ivp(right, span, pushed, **PRECISION).y[:, -1])
    return np.array(rows)


def swinging(inertia: float, weight: float, start: tuple[float, float], embed: Any) -> ExactMotion:
    """Return the motion of a pendulum: inertia theta'' = -weight cos theta."""
    return turning(lambda _: (inertia, 0.0), lambda a: weight * cos(a), start, embed)
