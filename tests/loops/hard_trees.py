"""Hard cases without loops, with motions that SciPy integrates from equations written by hand.

Every function returns a :class:`mechanisms.Case`. Sizes are chosen on both sides of 60 coordinates, above which solvers
use the tree's structure and no dense matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi, sin
from typing import Any

import numpy as np

from mbfmu.mechanics import JointStop, Mechanism, Polynomial, Revolute, Translational, rod
from mbfmu.verification.mechanisms.case import Case, G
from mbfmu.verification.mechanisms.trees import chain, integrated, light_cart, pendulum_among


def light_cart_among(count: int, ratio: float = 1e-6) -> Case:
    """:func:`light_cart` for 1.5 s next to rods at rest, ``count`` coordinates in all."""
    case = light_cart(ratio)
    for k in range(count - 2):
        case.mechanism.body(f"rod{k}", case.mechanism.ground, Revolute(start=-0.5 * pi), **rod(mass=1.0, length=1.0))

    def exact(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        q, v = case.exact(times, nudge)
        rest = np.full((len(q), count - 2), -0.5 * pi)
        return np.hstack((q, rest)), np.hstack((v, 0.0 * rest))

    return Case(case.mechanism, exact, 1.5)


def light_link(ratio: float = 1e-6, size: float = 1.0) -> Case:
    """Double pendulum with masses of ``ratio`` and 1 kg at the ends of two links of ``size`` and 0.7 ``size`` (m).

    det M is proportional to ratio + sin^2 of the angle between the links, which stretch and fold.
    """
    m = Mechanism(gravity=(0.0, -G, 0.0))
    no_inertia = (0.0, 0.0, 0.0)
    joint = Revolute(start=0.9, rate=0.0, fixed=True)
    first = m.body("first", m.ground, joint, mass=ratio, com=(0.0, -size, 0.0), inertia=no_inertia)
    joint = Revolute(at=(0.0, -size, 0.0), start=0.8, rate=0.0, fixed=True)
    m.body("second", first, joint, mass=1.0, com=(0.0, -0.7 * size, 0.0), inertia=no_inertia)
    lengths, masses = np.array((1.0, 0.7)), np.array(((1.0 + ratio, 1.0), (1.0, 1.0)))
    coupling, weight = masses * np.outer(lengths, lengths), masses[0] * lengths * G / size

    def acceleration(a: Any, b: Any) -> Any:
        lag = a[0] - a[1]
        right = -weight * np.sin(a) - coupling[0, 1] * sin(lag) * np.array((b[1] ** 2, -(b[0] ** 2)))
        c = coupling[0, 1] * cos(lag)
        det = (lengths[0] * lengths[1]) ** 2 * (ratio + sin(lag) ** 2)
        own = coupling[1, 1] * right[0] - c * right[1], coupling[0, 0] * right[1] - c * right[0]
        return np.array(own) / det

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        return np.diff(a, axis=1, prepend=0.0), np.diff(b, axis=1, prepend=0.0)

    return Case(m, integrated(acceleration, (0.9, 1.7), (0.0, 0.0), embed, None), 2.0 * size**0.5)


def light_gimbal(ratio: float = 1e-6, size: float = 1.0) -> Case:
    """Rotor of 1 kg m2 in a gimbal whose two rings have ``ratio`` kg m2, passing near gimbal lock.

    Axes are z, x, z; all inertias are isotropic. det M is proportional to 2 ratio + sin^2 of the middle angle.
    """
    m = Mechanism()
    inertia = size**2 * np.ones(3)
    outer = m.body("outer", m.ground, Revolute(axis="z", rate=0.01, fixed=True), mass=ratio, inertia=ratio * inertia)
    joint = Revolute(axis="x", start=1.0, rate=-1.0, fixed=True)
    inner = m.body("inner", outer, joint, mass=ratio, inertia=ratio * inertia)
    m.body("rotor", inner, Revolute(axis="z"), mass=1.0, inertia=inertia)

    def acceleration(q: Any, v: Any) -> Any:
        s, c, a = sin(q[1]), cos(q[1]), 1.0 + 2.0 * ratio
        outer, rotor = s * v[1] * v[2], s * v[0] * v[1]
        det = 2.0 * ratio + s * s
        return np.array(((outer - c * rotor) / det, -s * v[0] * v[2] / (1.0 + ratio), (a * rotor - c * outer) / det))

    return Case(m, integrated(acceleration, (0.0, 1.0, 0.0), (0.01, -1.0, 0.0), lambda q, v: (q, v), None), 3.0)


def turning_rods(count: int, speed: float = 5.0) -> Case:
    """Rods on hinges of a vertical spindle that is driven at constant speed (rad/s)."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    drive = Revolute(axis="y", drive=Polynomial((0.0, speed)))
    spindle = m.body("spindle", m.ground, drive, mass=1.0, inertia=(1.0, 1.0, 1.0))
    starts = -0.5 * pi + np.array((0.1, 0.3, 0.6, 1.0))
    chosen = np.arange(count) % len(starts)
    for k, which in enumerate(chosen):
        joint = Revolute(start=float(starts[which]), fixed=True)
        m.body(f"rod{k}", spindle, joint, mass=1.0, com=(0.5, 0.0, 0.0), inertia=(0.0, 1.0 / 12.0, 1.0 / 12.0))

    def acceleration(q: Any, _: Any) -> Any:
        return -(speed**2) * np.sin(q) * np.cos(q) - 1.5 * G * np.cos(q)

    exact = integrated(acceleration, starts, 0.0 * starts, lambda q, v: (q[:, chosen], v[:, chosen]), None)
    return Case(m, exact, 2.0)


def bouncing(stiffness: float = 1e4, damping: float = 0.1) -> Case:
    """A slider of 1 kg that falls 1 m onto a damped stop and bounces."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.body("slider", m.ground, Translational(axis="y", start=1.0), mass=1.0)
    m.force("stop", JointStop(lower=0.0, stiffness=stiffness, damping=damping), body)

    def acceleration(q: Any, v: Any) -> Any:
        depth = np.maximum(-q, 0.0)
        return -G + stiffness * depth * np.maximum(1.0 - damping * v, 0.0)

    def touches(_: float, y: Any) -> float:
        return float(y[0])

    touches.terminal = True  # type: ignore[attr-defined]
    return Case(m, integrated(acceleration, 1.0, 0.0, lambda q, v: (q, v), touches), 3.0)


def turning_pendulum_on_stops(stiffness: float = 1e5) -> Case:
    """A rod that swings between two stops without damping, 20 times in 4 s."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.body("rod", m.ground, Revolute(start=-0.5 * pi, rate=3.0), **rod(mass=1.0, length=1.0))
    lower, upper = -0.5 * pi - 0.3, -0.5 * pi + 0.3
    m.force("stop", JointStop(lower=lower, upper=upper, stiffness=stiffness), body)

    def acceleration(q: Any, _: Any) -> Any:
        torque = stiffness * (np.maximum(lower - q, 0.0) - np.maximum(q - upper, 0.0)) - 0.5 * G * np.cos(q)
        return 3.0 * torque

    def low(_: float, y: Any) -> float:
        return float(y[0] - lower)

    def high(_: float, y: Any) -> float:
        return float(y[0] - upper)

    low.terminal = high.terminal = True  # type: ignore[attr-defined]
    return Case(m, integrated(acceleration, -0.5 * pi, 3.0, lambda q, v: (q, v), (low, high)), 4.0)


TREES: dict[str, Callable[[], Case]] = {
    "cart of 1e-6 kg, pole of 1 kg": light_cart,
    "cart of 1e-4 kg, pole of 1 kg": lambda: light_cart(1e-4),
    "double pendulum, first mass 1e-6 kg": light_link,
    "rotor in light rings, near gimbal lock": light_gimbal,
    **{f"pendulum among {n} coordinates": lambda n=n: pendulum_among(n) for n in (59, 61, 131)},  # type: ignore[misc]
    **{f"chain of {n} links": lambda n=n: chain(n) for n in (59, 61)},  # type: ignore[misc]
    **{f"{n} rods on a turning spindle": lambda n=n: turning_rods(n) for n in (1, 59, 61, 131)},  # type: ignore[misc]
    "slider on a damped stop": bouncing,
    "rod between stops": turning_pendulum_on_stops,
}
