"""Planar linkages: row of four-bars, slider-crank with links of equal length, Andrews' squeezing mechanism."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, pi, radians, sin
from typing import Any

import numpy as np

from mbfmu.mechanics import JointForce, Mechanism, Revolute, RevoluteCutJoint, Spring, Translational, rod

from .case import UNSCALED, Case, Scale, columns, swinging, turning, vertical, with_energy


def n_four_bar(
    loops: int = 2, *, grounded: bool = False, longer: Mapping[int, float] | None = None, scale: Scale = UNSCALED
) -> Case:
    """Return N four-bars in a row, links 1 m and 1 kg, top at 1 m/s (benchmark A02 of the IFToMM library).

    When all links are horizontal, all loops are singular. The tree is a serial chain with a cut joint at the foot of
    each column or, if ``grounded``, columns on the ground with a cut joint at the end of each coupler. ``longer`` maps
    the number of a coupler to the length that is added to it, in lengths; its loop misses the singular configuration
    by this length.
    """
    l, mass, angle, speed = scale.lengths, scale.masses, 0.5 * pi, -1.0 / scale.times
    m = vertical(scale)
    upright = m.body("column0", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=mass, length=l))
    top, signs = (l, 0.0, 0.0), [1.0]
    for i in range(1, loops + 1):
        reach = l * (1.0 + (longer or {}).get(i, 0.0))
        pin, foot, end = Revolute(at=top, start=-angle, rate=-speed), (i * l, 0.0, 0.0), (reach, 0.0, 0.0)
        coupler = m.body(f"coupler{i}", upright, pin, **rod(mass=mass, length=reach))
        if grounded:
            hinge = Revolute(at=foot, start=angle, rate=speed)
            upright = m.body(f"column{i}", m.ground, hinge, **rod(mass=mass, length=l))
            m.cut(f"pin{i}", RevoluteCutJoint(at_a=end, at_b=top), coupler, upright)
        else:
            hinge = Revolute(at=end, start=angle, rate=speed)
            upright = m.body(f"column{i}", coupler, hinge, **rod(mass=mass, length=-l))
            m.cut(f"pivot{i}", RevoluteCutJoint(at_a=(-l, 0.0, 0.0), at_b=foot), upright, m.ground)
            top = (0.0, 0.0, 0.0)
        signs += [-1.0, 1.0]
    inertia, weight = ((loops + 1) / 3.0 + loops) * mass * l * l, (0.5 * (loops + 1) + loops) * mass * scale.gravity * l
    exact = None if longer else swinging(inertia, weight, (angle, speed), columns(*signs))
    return Case(with_energy(m), exact, 10.0 * scale.times)


def slider_crank(eps: float = 0.0, *, start: float = 20.0, rate: float = 6.0, scale: Scale = UNSCALED) -> Case:
    """Return a crank of length r with a rod of length r + eps; with equal lengths it passes a singular configuration.

    ``start`` of the crank in degrees, ``rate`` in rad/s. The exact motion is that of equal lengths.
    """
    r, L = scale.lengths, (1.0 + eps) * scale.lengths
    crank, link, slider = np.array((1.0, 0.5, 0.8)) * scale.masses
    angle, speed = radians(start), rate / scale.times
    lean = -np.arcsin(sin(angle) * r / L)
    lean = lean if cos(angle) >= 0.0 else -pi - lean
    m = vertical(scale)
    first = m.body("crank", m.ground, Revolute(start=angle, rate=speed, fixed=True), **rod(mass=crank, length=r))
    pin = Revolute(at=(r, 0.0, 0.0), start=lean - angle, rate=-2.0 * speed)
    second = m.body("rod", first, pin, **rod(mass=link, length=L))
    block = m.body("slider", m.ground, Translational(axis="x", start=r * cos(angle) + L * cos(lean)), mass=slider)
    m.cut("pin", RevoluteCutJoint(at_a=(L, 0.0, 0.0)), second, block)

    def inertia(a: float) -> tuple[float, float]:
        moving = 2.0 * link * r * r + 4.0 * slider * r * r
        fixed = (crank / 3.0 + link / 12.0 + 0.25 * link) * r * r
        return fixed + moving * sin(a) ** 2, moving * sin(2.0 * a)

    def slope(a: float) -> float:
        return float(0.5 * (crank + link) * scale.gravity * r * cos(a))

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        q = np.column_stack((a, -2.0 * a, 2.0 * r * np.cos(a)))
        return q, np.column_stack((b, -2.0 * b, -2.0 * r * np.sin(a) * b))

    exact = turning(inertia, slope, (angle, speed), embed) if eps == 0.0 else None
    return Case(with_energy(m), exact, 3.0 * scale.times)


# Angles of Andrews' squeezing mechanism after 0.03 s (IVP test set), rad: K1 to K7 in the order of the bodies below
SQUEEZER_END = (
    15.81077119629904,
    -15.75637105984298,
    0.04082224013073101,
    0.5244099658805304,
    -0.5347301163226948,
    1.048080741042263,
    0.5347301163226948,
)


def squeezer(*, scale: Scale = UNSCALED) -> Case:
    """Return Andrews' squeezing mechanism: seven bodies, three loops, a spring, a constant torque (IVP test set)."""
    L, ms = scale.lengths, scale.masses
    m = Mechanism()

    def body(name: str, on: Any, at: Any, start: float, mass: float, inertia: float, com: Any) -> Any:
        joint = Revolute(at=(at[0] * L, at[1] * L, 0.0), start=start, fixed=name == "K1")
        J = inertia * ms * L * L
        return m.body(name, on, joint, mass=mass * ms, com=(com[0] * L, com[1] * L, 0.0), inertia=(J / 2, J / 2, J))

    A, B = (-0.06934, -0.00227), (-0.03635, 0.03273)
    phi = 0.222668390165885884674473185609
    k1 = body("K1", m.ground, (0.0, 0.0), -0.0617138900142764496358948458001, 0.04325, 2.194e-6, (0.00092, 0.0))
    k2 = body("K2", k1, (0.007, 0.0), 0.0, 0.00365, 4.410e-7, (-0.0115, 0.0))
    k3 = body("K3", m.ground, B, 0.455279819163070380255912382449, 0.02373, 5.255e-6, (0.01043, -0.01874))
    k5 = body("K5", m.ground, A, 0.487364979543842550225598953530, 0.07050, 1.169e-5, (0.02308, 0.00916))
    k4 = body("K4", k5, (0.04, 0.0), phi, 0.00706, 5.667e-7, (0.0, -(0.02 - 0.01421)))
    k7 = body("K7", m.ground, A, 1.23054744454982119249735015568, 0.05498, 1.912e-5, (-0.00449, -0.01228))
    k6 = body("K6", k7, (0.0, -0.04), -phi, 0.00706, 5.667e-7, (0.02 - 0.01421, 0.0))
    tip = (-0.028 * L, 0.0, 0.0)
    for name, link, at in (("P3", k3, (0.0, -0.035)), ("P4", k4, (0.0, -0.02)), ("P6", k6, (0.02, 0.0))):
        m.cut(name, RevoluteCutJoint(at_a=(at[0] * L, at[1] * L, 0.0), at_b=tip), link, k2)
    m.force("motor", JointForce(magnitude=0.033 * scale.torque), k1)
    spring = Spring(
        stiffness=4530.0 * ms / scale.times**2,
        free=0.07785 * L,
        at_a=(0.02 * L, -0.018 * L, 0.0),
        at_b=(0.014 * L, 0.072 * L, 0.0),
    )
    m.force("spring", spring, k3, m.ground)
    return Case(with_energy(m), None, 0.03 * scale.times)
