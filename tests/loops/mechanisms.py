"""Mechanisms with closed loops, by name: singular ones with their exact motion, ones next to them, redundant ones.

Every function returns a :class:`Case`. Where all cranks of a linkage stay parallel its motion is that of a few angles;
``exact`` integrates their equation and gives the coordinates of the mechanism, through every singular configuration.
``scale`` makes the same mechanism of another size: what is returned moves alike, in its own lengths, masses and times.
"""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, radians, sin, sqrt
from typing import Any

import numpy as np

from mbfmu.mechanics import (
    Harmonic,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    SphericalCutJoint,
    Translational,
    rod,
)
from mbfmu.verification.mechanisms.case import (
    UNSCALED,
    Case,
    G,
    Scale,
    columns,
    followed,
    swinging,
    turning,
    vertical,
    with_energy,
)
from mbfmu.verification.mechanisms.case import ExactMotion as Exact
from mbfmu.verification.mechanisms.planar import SQUEEZER_END, n_four_bar, slider_crank, squeezer
from mbfmu.verification.mechanisms.spatial import bricard

__all__ = [
    "CASES", "GAPS", "SQUEEZER_END", "UNSCALED", "Case", "Exact", "G", "Scale", "bricard", "crane",
    "double_parallelogram", "four_bar", "grashof", "ladder", "n_four_bar", "parallelogram", "slider_crank", "squeezer",
    "swinging", "table", "three_cranks", "turning",
]  # fmt: skip


def four_bar(
    lengths: tuple[float, float, float, float],
    masses: tuple[float, float, float],
    start: float,
    rate: float,
    scale: Scale,
    guess: tuple[float, float] | None = None,
) -> Mechanism:
    """Crank, coupler, rocker, ground; ``start``, ``rate`` of the crank, ``guess``: coupler and rocker, absolute."""
    a, b, c, d = (x * scale.lengths for x in lengths)
    ma, mb, mc = (x * scale.masses for x in masses)
    along, up = guess or closed_above(lengths, start)
    m = vertical(scale)
    joint = Revolute(start=start, rate=rate / scale.times, fixed=True)
    crank = m.body("crank", m.ground, joint, **rod(mass=ma, length=a))
    pin = Revolute(at=(a, 0.0, 0.0), start=along - start)
    coupler = m.body("coupler", crank, pin, **rod(mass=mb, length=b))
    rocker = m.body("rocker", coupler, Revolute(at=(b, 0.0, 0.0), start=up - along), **rod(mass=mc, length=-c))
    m.cut("pivot", RevoluteCutJoint(at_a=(-c, 0.0, 0.0), at_b=(d, 0.0, 0.0)), rocker, m.ground)
    return with_energy(m)


def closed_above(lengths: tuple[float, float, float, float], crank: float) -> tuple[float, float]:
    """Absolute angles of coupler and rocker, with the pin of both to the left of the way from crank pin to pivot."""
    a, b, c, d = lengths
    x, y = d - a * cos(crank), -a * sin(crank)
    reach = x * x + y * y
    along = atan2(y, x) + np.arccos(np.clip((b * b + reach - c * c) / (2.0 * b * sqrt(reach)), -1.0, 1.0))
    return along, atan2(b * sin(along) - y, b * cos(along) - x)


def parallelogram(eps: float = 0.0, *, start: float = 10.0, scale: Scale = UNSCALED) -> Case:
    """The four-bar 1 / 3 / 1 + eps / 3 of the project, released at ``start`` degrees; exact where eps is zero."""
    angle, masses = radians(start), (8.019, 24.057, 8.019)
    m = four_bar((1.0, 3.0, 1.0 + eps, 3.0), masses, angle, 0.0, scale, (0.0, angle))
    bars = masses[0] + masses[2]
    inertia, weight = bars / 3.0 + masses[1], 0.5 * bars + masses[1]
    exact = swinging(inertia, weight * G / scale.times**2, (angle, 0.0), columns(1.0, -1.0, 1.0))
    return Case(m, exact if eps == 0.0 else None, 10.0 * scale.times)


def grashof(eps: float = 0.0, *, scale: Scale = UNSCALED) -> Case:
    """Crank 1, coupler 2.5, rocker 2, ground 3.5 + eps: folds flat at eps = 0, passes close to that at others."""
    m = four_bar((1.0, 2.5, 2.0, 3.5 + eps), (1.0, 0.5, 3.0), radians(120.0), 4.0, scale)
    return Case(m, None, 2.0 * scale.times)


def three_cranks(*, start: float = -20.0, rate: float = 0.0, eps: float = 0.0, scale: Scale = UNSCALED) -> Case:
    """Three equal parallel cranks on one coupler, one of them redundant; from -20 degrees they stay off the horizontal.

    ``start`` in degrees, ``rate`` in rad/s; ``eps`` lengthens all cranks and so changes nothing but the numbers.
    """
    l, w = (1.0 + eps) * scale.lengths, scale.lengths
    angle, speed = radians(start), rate / scale.times
    masses = np.array((1.0, 2.0, 0.7, 1.5)) * scale.masses  # crank 1, coupler, cranks 2 and 3
    m = vertical(scale)
    first = m.body("crank1", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=masses[0], length=l))
    pin = Revolute(at=(l, 0.0, 0.0), start=-angle, rate=-speed)
    coupler = m.body("coupler", first, pin, **rod(mass=masses[1], length=2.0 * w))
    for i in (2, 3):
        foot = ((i - 1.0) * w, 0.0, 0.0)
        crank = m.body(
            f"crank{i}", m.ground, Revolute(at=foot, start=angle, rate=speed), **rod(mass=masses[i], length=l)
        )
        m.cut(f"pin{i}", RevoluteCutJoint(at_a=(l, 0.0, 0.0), at_b=foot), crank, coupler)
    bars = masses[0] + masses[2] + masses[3]
    inertia, weight = (bars / 3.0 + masses[1]) * l * l, (0.5 * bars + masses[1]) * scale.gravity * l
    return Case(
        with_energy(m), swinging(inertia, weight, (angle, speed), columns(1.0, -1.0, 1.0, 1.0)), 10.0 * scale.times
    )


def table(*, start: float = -20.0, rate: float = 0.0, scale: Scale = UNSCALED) -> Case:
    """A table on four equal cranks, three of them by ball joints: six rows of rank four."""
    l, angle, speed = scale.lengths, radians(start), rate / scale.times
    masses = np.array((1.0, 4.0, 0.8, 1.2, 0.6)) * scale.masses  # crank 1, table, cranks 2 to 4
    feet = [(0.0, 0.0, 0.0), (1.5 * l, 0.0, 0.0), (0.0, 0.0, 0.8 * l), (1.5 * l, 0.0, 0.8 * l)]
    m = vertical(scale)
    first = m.body("crank1", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=masses[0], length=l))
    top = m.body(
        "table",
        first,
        Revolute(at=(l, 0.0, 0.0), start=-angle, rate=-speed),
        mass=masses[1],
        com=(0.7 * l, 0.1 * l, 0.4 * l),
        inertia=tuple(masses[1] * l * l * np.array((0.1, 0.3, 0.25))),
    )
    for i in (2, 3, 4):
        foot = feet[i - 1]
        crank = m.body(
            f"crank{i}", m.ground, Revolute(at=foot, start=angle, rate=speed), **rod(mass=masses[i], length=l)
        )
        m.cut(f"ball{i}", SphericalCutJoint(at_a=(l, 0.0, 0.0), at_b=foot), crank, top)
    bars = masses.sum() - masses[1]
    inertia, weight = (bars / 3.0 + masses[1]) * l * l, (0.5 * bars + masses[1]) * scale.gravity * l
    return Case(
        with_energy(m), swinging(inertia, weight, (angle, speed), columns(1.0, -1.0, 1.0, 1.0, 1.0)), 10.0 * scale.times
    )


def ladder(loops: int, *, start: Any = -60.0, rate: Any = 0.0, scale: Scale = UNSCALED) -> Case:
    """A rope ladder of parallelograms below each other, each storey with a different angle; all rungs stay level.

    ``start`` (degrees) and ``rate`` (rad/s) of the storeys, one number or one each.
    """
    l, side, rung = scale.lengths, 0.5 * scale.masses, 0.8 * scale.masses
    angles = radians(1.0) * np.broadcast_to(np.asarray(start, float), loops)
    rates = np.broadcast_to(np.asarray(rate, float), loops) / scale.times
    m = vertical(scale)
    above, corner = m.ground, (2.0 * l, 0.0, 0.0)
    for k in range(loops):
        angle, speed = angles[k], rates[k]
        left = m.body(f"left{k}", above, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=side, length=l))
        pin = Revolute(at=(l, 0.0, 0.0), start=-angle, rate=-speed)
        here = m.body(f"rung{k}", left, pin, **rod(mass=rung, length=2.0 * l))
        right = m.body(f"right{k}", here, Revolute(at=corner, start=angle, rate=speed), **rod(mass=side, length=-l))
        m.cut(f"pivot{k}", RevoluteCutJoint(at_a=(-l, 0.0, 0.0), at_b=corner), right, above)
        above = here

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        return tuple(np.stack((x, -x, x), axis=2).reshape(len(x), -1) for x in (a, b))  # type: ignore[return-value]

    exact = hanging(loops, l, 2.0 * side, rung, scale.gravity, (angles, rates), embed)
    return Case(with_energy(m), exact, 2.0 * scale.times)


def hanging(n: int, l: float, side: float, rung: float, g: float, start: Any, embed: Any) -> Exact:
    """Exact motion of n storeys of length l: M_ij = w_ij l^2 cos(a_i - a_j), as of a pendulum of n links.

    ``side``: mass of both sides of a storey, uniform rods; ``rung``: of its rung, which does not turn.
    """
    ends = np.tril(np.ones((n, n)))  # how the speed of link j moves the end of link k
    middles = ends - 0.5 * np.eye(n)
    w = l * l * (rung * ends.T @ ends + side * middles.T @ middles)
    own = side * l * l / 12.0 * np.eye(n)
    weight = g * l * (rung * ends + side * middles).sum(axis=0)

    def right(_: float, y: Any) -> Any:
        a, b = y[:n], y[n:]
        apart = a[:, None] - a
        return np.r_[b, np.linalg.solve(w * np.cos(apart) + own, -(w * np.sin(apart)) @ b**2 - weight * np.cos(a))]

    def exact(times: Any, nudge: float = 0.0) -> tuple[Any, Any]:
        off = nudge * np.r_[np.ones(n), np.full(n, sqrt(g / l))]
        y = followed(right, times, np.concatenate(start), off)
        return embed(y[:, :n], y[:, n:])

    return exact


def double_parallelogram(*, start: Any = (-60.0, -30.0), rate: Any = 0.0, scale: Scale = UNSCALED) -> Case:
    """Two parallelograms, the second one hung on the coupler of the first."""
    return ladder(2, start=start, rate=rate, scale=scale)._replace(stop_time=5.0 * scale.times)


SLEWING = ("constant", "run-up", "harmonic")


def crane(*, drive: str = "run-up", start: float = 0.0, axis: Any = "y", scale: Scale = UNSCALED) -> Case:
    """A planar loop on a base that slews: boom, cylinder, piston on a spring. ``start`` of the base in degrees.

    ``drive``: at constant speed, run up to 36 deg/s in 1 s, or harmonically; ``axis`` of the base.
    """
    L, ms, T, at = scale.lengths, scale.masses, scale.times, radians(start)
    laws = {
        "constant": Polynomial((at, radians(36.0) / T)),
        "run-up": RunUp(speed=radians(36.0) / T, duration=T, start=at),
        "harmonic": Harmonic(amplitude=1.0, frequency=0.3 / T, mean=at),
    }
    m = vertical(scale)
    base = m.body("base", m.ground, Revolute(axis=axis, drive=laws[drive]), mass=5 * ms, inertia=(ms * L * L,) * 3)
    boom = m.body("boom", base, Revolute(at=(0.0, L, 0.0), start=0.5, fixed=True), **rod(mass=2 * ms, length=3 * L))
    pin = np.array((1.2 * cos(0.5), 1.0 + 1.2 * sin(0.5)))  # of the piston on the boom
    foot = np.array((0.6, 0.2))
    length, lean = float(np.hypot(*(pin - foot))), float(np.arctan2(*(pin - foot)[::-1]))
    cylinder = m.body(
        "cylinder", base, Revolute(at=(0.6 * L, 0.2 * L, 0.0), start=lean), **rod(mass=0.5 * ms, length=0.6 * L)
    )
    piston = m.body(
        "piston", cylinder, Translational(axis="x", start=length * L), **rod(mass=0.3 * ms, length=-0.5 * L)
    )
    m.cut("pin", RevoluteCutJoint(at_b=(1.2 * L, 0.0, 0.0)), piston, boom)
    m.force("oil", JointSpring(stiffness=400.0 * ms / T**2, free=1.1 * length * L), piston)
    return Case(with_energy(m), None, 5.0 * T)


GAPS = tuple(s * 10.0**k for k in range(-9, -1) for s in (1.0, -1.0))  # 1e-9 ... 1e-2, both signs

CASES: dict[str, Callable[..., Case]] = {  # every one with ``scale``
    "parallelogram": parallelogram,
    "parallelogram + 1e-5": lambda **k: parallelogram(1e-5, **k),
    "grashof + 1e-2": lambda **k: grashof(1e-2, **k),
    "grashof + 1e-5": lambda **k: grashof(1e-5, **k),
    "grashof - 1e-5": lambda **k: grashof(-1e-5, **k),
    "three cranks": three_cranks,
    "three cranks, singular": lambda **k: three_cranks(start=10.0, **k),
    "table": table,
    "table, singular": lambda **k: table(start=10.0, **k),
    "double parallelogram": double_parallelogram,
    "double parallelogram, singular": lambda **k: double_parallelogram(start=(15.0, -50.0), **k),
    "slider-crank": slider_crank,
    "slider-crank + 1e-5": lambda **k: slider_crank(1e-5, **k),
    "slider-crank - 1e-5": lambda **k: slider_crank(-1e-5, **k),
    "bricard": bricard,
    "ladder of 5": lambda **k: ladder(5, **k),
    "ladder of 30": lambda **k: ladder(30, **k),
    "2 four-bars": n_four_bar,
    "10 four-bars": lambda **k: n_four_bar(10, **k),
    "squeezer": squeezer,
    "crane": crane,
    "crane, harmonic": lambda **k: crane(drive="harmonic", **k),
}
