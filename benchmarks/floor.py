"""The floor of every speed claim: compiled fixed-step RK4 on the hand-derived pendulum of the four-bar."""

from __future__ import annotations

import math

from solvers.kernel import kernel


@kernel
def rk4(theta: float, rate: float, weight: float, inertia: float, t: float, steps: int) -> float:
    """Return theta(t) of inertia theta'' = -weight cos theta after ``steps`` equal classical Runge-Kutta steps."""
    h = t / steps
    c = -weight / inertia
    for _ in range(steps):
        k1, l1 = rate, c * math.cos(theta)
        k2, l2 = rate + 0.5 * h * l1, c * math.cos(theta + 0.5 * h * k1)
        k3, l3 = rate + 0.5 * h * l2, c * math.cos(theta + 0.5 * h * k2)
        k4, l4 = rate + h * l3, c * math.cos(theta + h * k3)
        theta += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        rate += h / 6.0 * (l1 + 2.0 * l2 + 2.0 * l3 + l4)
    return theta
