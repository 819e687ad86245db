"""Spatial linkages that move although their constraint equations outnumber their degrees of freedom.

Each has one degree of freedom: all coordinates follow from one angle in closed form, and SciPy integrates the equation
of motion of this angle.
"""

from __future__ import annotations

from math import cos, pi, radians, sin
from typing import Any

import numpy as np

from mbfmu.mechanics import Mechanism, Revolute, RevoluteCutJoint, rod

from .case import UNSCALED, Case, ExactMotion, Scale, turning, with_energy

COMPLEX_DIFFERENCE_STEP = 1e-30  # of complex differences


def about_x(angle: float) -> Any:
    """Return the matrix of a rotation about x."""
    c, s = cos(angle), sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def bennett(*, start: float = 60.0, rate: float = 0.0, tilt: float = 17.0, scale: Scale = UNSCALED) -> Case:
    """Return Bennett's linkage: four links, the opposite ones equal, lengths proportional to the sines of the twists.

    Five constraint equations on three coordinates have the rank two.

    With t1 and t2 the angles of the first two hinges, tan(t1 / 2) tan(t2 / 2) = sin((b + a) / 2) / sin((b - a) / 2) for
    twists a and b; the third angle is -t1. ``start`` of t1 and ``tilt`` of the base (degrees), ``rate`` in rad/s.
    """
    twists = radians(40.0), radians(70.0)
    short = scale.lengths
    long = short * sin(twists[1]) / sin(twists[0])
    lengths, bends = np.array((short, long, short)), (twists[0], twists[1], twists[0])
    masses = np.array((1.0, 2.0, 0.7)) * scale.masses
    product = sin(0.5 * (twists[1] + twists[0])) / sin(0.5 * (twists[1] - twists[0]))
    base, angle, speed = about_x(radians(tilt)), radians(start), rate / scale.times

    def second(x: Any) -> Any:
        return 2.0 * np.arctan(product / np.tan(0.5 * x))

    def lever(x: Any) -> Any:
        return -np.sin(second(x)) / np.sin(x)

    m = Mechanism(gravity=(0.0, -scale.gravity, 0.0))
    body, frame, at = m.ground, base, (0.0, 0.0, 0.0)
    starts, rates = (angle, float(second(angle)), -angle), (speed, float(lever(angle)) * speed, -speed)
    inertias = np.outer(masses * lengths**2 / 12.0, (0.01, 1.0, 1.0))
    for k in range(3):
        joint = Revolute(at=at, rotation=frame, start=starts[k], rate=rates[k], fixed=k == 0)
        com = (0.5 * lengths[k], 0.0, 0.0)
        body = m.body(f"link{k + 1}", body, joint, mass=masses[k], com=com, inertia=inertias[k])
        frame, at = about_x(bends[k]), (float(lengths[k]), 0.0, 0.0)
    back = base @ about_x(-twists[1])
    foot = back @ np.array((-long, 0.0, 0.0))
    m.cut("hinge", RevoluteCutJoint(at_a=at, at_b=foot, rotation_a=frame, rotation_b=back), body, m.ground)
    m.output("energy", m.energy, "kinetic and potential energy")

    def at_unit_rate(x: complex) -> tuple[complex, complex]:
        """Twice the kinetic energy where t1 turns at 1 rad/s, and the potential energy."""
        R, o, v, w = base.astype(complex), np.zeros(3, complex), np.zeros(3, complex), np.zeros(3, complex)
        kinetic = potential = 0.0j
        for k, (turn, rate_size) in enumerate(((x, 1.0), (second(x), lever(x)), (-x, -1.0))):
            c, s = np.cos(turn), np.sin(turn)
            w = w + R[:, 2] * rate_size
            R = R @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            com, own = 0.5 * lengths[k] * R[:, 0], R.T @ w
            moved = v + np.cross(w, com)
            kinetic += masses[k] * (moved @ moved) + own @ (inertias[k] * own)
            potential += masses[k] * scale.gravity * (o + com)[1]
            v, o, R = v + 2.0 * np.cross(w, com), o + 2.0 * com, R @ about_x(bends[k])
        return kinetic, potential

    def inertia(x: float) -> tuple[float, float]:
        value = at_unit_rate(x + 1j * COMPLEX_DIFFERENCE_STEP)[0]
        return value.real, value.imag / COMPLEX_DIFFERENCE_STEP

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        return np.column_stack((a, np.unwrap(second(a)), -a)), np.column_stack((b, lever(a) * b, -b))

    exact = turning(
        inertia,
        lambda x: at_unit_rate(x + 1j * COMPLEX_DIFFERENCE_STEP)[1].imag / COMPLEX_DIFFERENCE_STEP,
        (angle, speed),
        embed,
    )
    return Case(m, exact, 5.0 * scale.times)


def sarrus(*, start: float = 30.0, rate: float = 0.0, stop_time: float = 4.0, scale: Scale = UNSCALED) -> Case:
    """Return Sarrus' linkage: a plate that two folding legs in perpendicular planes guide straight up and down. Five
    constraint equations on five coordinates have the rank four.

    ``start`` (degrees) and ``rate`` (rad/s) of the lower link of a leg from the horizontal. At 0 the legs are folded
    flat, and each can turn by itself; at -90 degrees they are straight. Both are singular configurations.
    """
    l, aside, angle, speed = scale.lengths, 0.4 * scale.lengths, radians(start), rate / scale.times
    lower, upper, mass, upper2, lower2 = np.array((1.0, 0.7, 2.0, 0.5, 1.2)) * scale.masses

    def along_z(mass: float) -> dict[str, Any]:
        inertia = mass * l * l / 12.0
        return {"mass": mass, "com": (0.0, 0.0, 0.5 * l), "inertia": (inertia, inertia, 0.0)}

    def hinge(at: Any, turned: float, rate_size: float, **options: Any) -> Revolute:
        return Revolute(at=at, start=turned, rate=rate_size * speed, **options)

    m = Mechanism(gravity=(0.0, -scale.gravity, 0.0))
    other, end = {"axis": (-1.0, 0.0, 0.0)}, (l, 0.0, 0.0)
    first = m.body("lower1", m.ground, hinge((aside, 0.0, 0.0), angle, 1.0, fixed=True), **rod(mass=lower, length=l))
    second = m.body("upper1", first, hinge(end, pi - 2.0 * angle, -2.0), **rod(mass=upper, length=l))
    inertia_of_plate = (0.1 * mass * l * l,) * 3
    joint = hinge(end, angle - pi, 1.0)
    plate = m.body("plate", second, joint, mass=mass, com=(-aside, 0.0, 0.0), inertia=inertia_of_plate)
    third = m.body("upper2", plate, hinge((-aside, 0.0, aside), -angle, -1.0, **other), **along_z(upper2))
    fourth = m.body("lower2", third, hinge((0.0, 0.0, l), pi + 2.0 * angle, 2.0, **other), **along_z(lower2))
    frame = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    foot = RevoluteCutJoint(at_a=(0.0, 0.0, l), at_b=(0.0, 0.0, aside), rotation_a=frame, rotation_b=frame)
    m.cut("hinge", foot, fourth, m.ground)
    m.output("energy", m.energy, "kinetic and potential energy")
    lows, ups = lower + lower2, upper + upper2

    def inertia(x: float) -> tuple[float, float]:
        turned, lifted = (lows / 3.0 + ups / 3.0) * l * l, (2.0 * ups + 4.0 * mass) * l * l
        return turned + lifted * cos(x) ** 2, -lifted * sin(2.0 * x)

    def slope(x: float) -> float:
        return float(scale.gravity * l * cos(x) * (0.5 * lows + 1.5 * ups + 2.0 * mass))

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        q = np.column_stack((a, pi - 2.0 * a, a - pi, -a, pi + 2.0 * a))
        return q, np.outer(b, (1.0, -2.0, 1.0, -1.0, 2.0))

    exact: ExactMotion = turning(inertia, slope, (angle, speed), embed)
    return Case(m, exact, stop_time * scale.times)


def bricard(*, scale: Scale = UNSCALED, attitude: Any = None) -> Case:
    """Return Bricard's loop of six equal rods along edges of a cube (benchmark A04 of the IFToMM library).

    One of its five constraint equations is redundant. ``attitude`` is a rotation matrix of the whole mechanism.
    """
    R = np.eye(3) if attitude is None else np.asarray(attitude, float)
    l, mass = scale.lengths, scale.masses
    corners = l * np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]], float)
    rods = np.roll(corners, -1, axis=0) - corners
    m = Mechanism(gravity=R @ np.array((0.0, -scale.gravity, 0.0)))
    body = m.ground
    for i in range(5):
        axis = np.cross(rods[i - 1], rods[i]) / l**2
        first = {"rotation": R} if i == 0 else {"at": rods[i - 1]}
        inertia = mass / 12.0 * (l * l * np.eye(3) - np.outer(rods[i], rods[i]))
        body = m.body(
            f"rod{i}", body, Revolute(axis=tuple(axis), **first), mass=mass, com=0.5 * rods[i], inertia=inertia
        )
    hinge = np.cross(rods[4], rods[5]) / l**2
    frame = np.column_stack((rods[4] / l, np.cross(hinge, rods[4] / l), hinge))
    m.cut(
        "hinge",
        RevoluteCutJoint(at_a=rods[4], at_b=R @ corners[5], rotation_a=frame, rotation_b=R @ frame),
        body,
        m.ground,
    )
    return Case(with_energy(m), None, 5.0 * scale.times)
