"""The floor of every speed claim: compiled classical Runge-Kutta on each model's motion derived by hand.

One model, one slope; the parameters ``p`` are a tuple in the order its slope reads them.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, sin, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.modeling import Model
from solvers.compiled.kernel import kernel

State = tuple[float, ...]
Floor = Callable[[State, Any, float, int, int, NDArray[np.float64]], None]


@kernel
def fourbar(y: Any, p: Any) -> Any:
    """The pendulum that a parallelogram is."""
    (acceleration,) = p
    return y[1], acceleration * cos(y[0])


@kernel
def governor(y: Any, p: Any) -> Any:
    """:meth:`Governor.minimal`."""
    phi, rate = y
    a, b, length, m, mc, inertia, stiffness, free, speed, gravity = p
    c, s = cos(phi), sin(phi)
    root = sqrt(length * length - a * c * a * c)
    first = a * c + a * a * c * s / root
    second = -a * s + a * a * (c * c - s * s) / root - (a * a * c * s) * (a * a * c * s) / (root * root * root)
    force = -stiffness * (a * s + root - free) * first - 2.0 * m * speed * speed * b * b * c * s
    force += gravity * (2.0 * m * b * c + mc * first)
    return rate, (force - mc * first * second * rate * rate) / (2.0 * (m * b * b + inertia) + mc * first * first)


@kernel
def pendulum(y: Any, p: Any) -> Any:
    """:meth:`SwingPendulum.minimal`."""
    theta, d, swing, slide = y
    w, length, m, swing_stiffness, slider_stiffness, free = p
    c, s = cos(theta), sin(theta)
    return (
        swing,
        slide,
        -2.0 * slide * (swing + w) / d - w * w * length * s / d - swing_stiffness * theta / (m * d * d),
        d * (swing + w) * (swing + w) + w * w * length * c - slider_stiffness / m * (d - free),
    )


@kernel
def along2(y: Any, h: float, k: Any) -> Any:
    """Y + h k of two numbers."""
    return y[0] + h * k[0], y[1] + h * k[1]


@kernel
def along4(y: Any, h: float, k: Any) -> Any:
    """Y + h k of four numbers."""
    return y[0] + h * k[0], y[1] + h * k[1], y[2] + h * k[2], y[3] + h * k[3]


def rk4(slope: Callable[..., Any], along: Callable[..., Any]) -> Floor:
    """Return the integrator of one motion: ``out[i]`` = y[0] at (i + 1) intervals, equal steps in each."""

    @kernel
    def integrate(y: Any, p: Any, interval: float, count: int, steps: int, out: Any) -> None:
        h = interval / steps
        for i in range(count):
            for _ in range(steps):
                k1 = slope(y, p)
                k2 = slope(along(y, 0.5 * h, k1), p)
                k3 = slope(along(y, 0.5 * h, k2), p)
                k4 = slope(along(y, h, k3), p)
                y = along(along(along(along(y, h / 6.0, k1), h / 3.0, k2), h / 3.0, k3), h / 6.0, k4)
            out[i] = y[0]

    return integrate


INTEGRATORS: dict[str, Floor] = {
    "fourbar": rk4(fourbar, along2),
    "governor": rk4(governor, along2),
    "pendulum": rk4(pendulum, along4),
}


def start(model: Model) -> tuple[State, State]:
    """Return the first state and the parameters of a model's motion."""
    match model:
        case FourBar(crank_length=l, gravity=g):
            bars, m = model.crank_mass + model.rocker_mass, model.coupler_mass
            return (model.start_angle, model.start_rate), (-g / l * (0.5 * bars + m) / (bars / 3.0 + m),)
        case Governor(rod_position=a, arm_length=b, rod_length=l, ball_mass=m, collar_mass=mc):
            p = (a, b, l, m, mc, model.ball_inertia, model.stiffness, model.free_length, model.spindle_speed)
            return (model.start_angle, 0.0), (*p, model.gravity)
        case SwingPendulum(drive_speed=w, crank_length=l, slider_mass=m):
            p = (w, l, m, model.swing_stiffness, model.slider_stiffness, model.free_length)
            return (model.start_angle, model.start_distance, 0.0, 0.0), p
    raise TypeError(f"no motion derived by hand for {model.name!r}")
