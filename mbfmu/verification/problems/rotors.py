"""Gyroscopic motion: free body, heavy symmetric top, gyrostat."""

from __future__ import annotations

from math import cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj, ellipkinc

from mbfmu.mechanics import Mechanism, Revolute, Spherical
from mbfmu.verification.mechanisms.case import G
from mbfmu.verification.problem import Exact, Motion
from mbfmu.verification.references import closed_form, integrated

from .sources import LANDAU

Array = NDArray[np.float64]
INERTIA = np.array((1.0, 2.0, 3.0))  # kg m^2
SPIN = np.array((0.02, 5.0, 0.02))  # rad/s


def free_body() -> Mechanism:
    """Return a body that spins about its axis of intermediate inertia."""
    m = Mechanism()
    body = m.body("body", m.ground, Spherical(rate=tuple(SPIN)), mass=1.0, inertia=tuple(INERTIA))
    for axis in "xyz":
        m.output(axis, body.angular_velocity(axis, "body"), f"Angular velocity about the body axis {axis}")
    m.output("energy", m.energy, "Kinetic energy")
    return m


def free_body_exact() -> Exact:
    """Return the solution of Euler's equations for L^2 > 2 T I2 and positive angular velocities."""
    A, B, C = INERTIA

    def solution(start: Array, times: Array) -> Array:
        twice_energy, momentum = INERTIA @ start**2, np.sum((INERTIA * start) ** 2)
        high, low = twice_energy * C - momentum, momentum - twice_energy * A
        a = np.array((sqrt(high / (A * (C - A))), sqrt(high / (B * (C - B))), sqrt(low / (C * (C - A)))))
        rate_size, k2 = sqrt((C - B) * low / (A * B * C)), (B - A) * high / ((C - B) * low)
        u = ellipkinc(np.arctan2(start[1] / a[1], start[0] / a[0]), k2)
        sn, cn, dn, _ = ellipj(rate_size * times + u, k2)
        return np.asarray(a * np.column_stack((cn, sn, dn)))

    return closed_form(solution, SPIN, np.full(3, SPIN.max()), 1e3)


TOP_MASS, TOP_ARM, ACROSS, ALONG = 1.2, 0.3, 0.2, 0.05  # kg, m, kg m^2 about the fixed point
LEAN, TOP_SPIN = 0.6, 60.0  # rad, rad/s


def heavy_top() -> Mechanism:
    """Return a symmetric top with a fixed point, released with its spin only; gravity along -z."""
    m = Mechanism(gravity=(0.0, 0.0, -G))
    across = ACROSS - TOP_MASS * TOP_ARM**2
    joint = Spherical(start=(cos(0.5 * LEAN), sin(0.5 * LEAN), 0.0, 0.0), rate=(0.0, 0.0, TOP_SPIN))
    top = m.body("top", m.ground, joint, mass=TOP_MASS, com=(0.0, 0.0, TOP_ARM), inertia=(across, across, ALONG))
    m.output("u", top.direction("z", "z"), "Cosine of the angle between the axis and the vertical")
    m.output("energy", m.energy, "Total energy")
    return m


def heavy_top_exact() -> Exact:
    """Return u = u1 + (u2 - u1) sn^2(p t + w) with the roots u1 < u2 < u3 of u'^2 = f(u), u = cos theta."""

    def solution(start: Array, times: Array) -> Array:
        lean, lean_rate, precession, spin = start
        s, c = np.sin(lean), np.cos(lean)
        a, beta = ALONG * spin / ACROSS, 2.0 * TOP_MASS * G * TOP_ARM / ACROSS
        b, alpha = precession * s * s + a * c, lean_rate**2 + (precession * s) ** 2 + beta * c
        roots = np.roots((beta, -(alpha + a * a), 2.0 * a * b - beta, alpha - b * b))
        u1, u2, u3 = np.sort(roots.real)
        rate_size, k2 = 0.5 * sqrt(beta * (u3 - u1)), (u2 - u1) / (u3 - u1)
        part = (c - u1) / (u2 - u1)
        both = -s * lean_rate / ((u2 - u1) * rate_size * sqrt(1.0 - k2 * part))
        phase = ellipkinc(0.5 * np.arctan2(both, 1.0 - 2.0 * part), k2)
        sn = ellipj(rate_size * times + phase, k2)[0]
        return np.asarray(u1 + (u2 - u1) * sn**2)[:, None]

    return closed_form(solution, (LEAN, 0.0, 0.0, TOP_SPIN), (1.0, TOP_SPIN, TOP_SPIN, TOP_SPIN), 1e3)


CARRIER, ROTOR = np.array((2.0, 3.0, 4.0)), np.array((0.4, 0.4, 0.6))  # kg m^2
CARRIER_RATE, ROTOR_RATE = (0.5, 1.0, 0.8), 12.0  # rad/s


def gyrostat() -> Mechanism:
    """Return a free body with a symmetric rotor that spins without friction about its z axis."""
    m = Mechanism()
    carrier = m.body("carrier", m.ground, Spherical(rate=CARRIER_RATE), mass=1.0, inertia=tuple(CARRIER))
    m.body("rotor", carrier, Revolute(rate=ROTOR_RATE), mass=1.0, inertia=tuple(ROTOR))
    for axis in "xyz":
        m.output(axis, carrier.angular_velocity(axis, "body"), f"Angular velocity about the body axis {axis}")
    return m


def gyrostat_exact() -> Exact:
    """Return the motion of L' = L x w with L = J w + h e_z and a constant momentum h of the rotor about its axis."""
    J = CARRIER + np.array((ROTOR[0], ROTOR[1], 0.0))

    def right(_: float, y: Array) -> Array:
        w, h = y[:3], ROTOR[2] * (y[2] + y[3])
        rate = np.cross(J * w + (0.0, 0.0, h), w) / J
        return np.append(rate, -rate[2])

    start = (*CARRIER_RATE, ROTOR_RATE)
    return integrated(right, start, np.full(4, ROTOR_RATE), lambda _, y: tuple(y[:3]), 10.0)


ROTOR_PROBLEMS = (
    Motion(
        name="Euler top",
        description="Free body with moments of inertia of 1, 2 and 3 kg m2 and angular velocities of 0.02, 5 and 0.02 "
        "rad/s, 20 s. It turns over periodically (Dzhanibekov effect).",
        sources=(LANDAU,),
        quantity="Angular velocities in body axes",
        unit="rad/s",
        derivation="closed form (Jacobi elliptic functions)",
        build=free_body,
        outputs=("x", "y", "z"),
        exact=free_body_exact,
        stop_time=20.0,
    ),
    Motion(
        name="heavy top",
        description="Symmetric top of 1.2 kg with its center of mass 0.3 m above the fixed point, moments of inertia "
        "of 0.2 and 0.05 kg m2 about this point, 60 rad/s about an axis at 0.6 rad to the vertical, 5 s.",
        sources=(LANDAU,),
        quantity="Cosine of the nutation angle",
        unit="1",
        derivation="closed form (Jacobi elliptic functions)",
        build=heavy_top,
        outputs=("u",),
        exact=heavy_top_exact,
        stop_time=5.0,
    ),
    Motion(
        name="gyrostat",
        description="Free carrier with moments of inertia of 2, 3 and 4 kg m2 and a rotor of 0.4, 0.4 and 0.6 kg m2 "
        "that turns at 12 rad/s in it without friction, 10 s.",
        quantity="Angular velocities of the carrier in body axes",
        unit="rad/s",
        derivation="SciPy DOP853 on Euler's equations with internal momentum",
        build=gyrostat,
        outputs=("x", "y", "z"),
        exact=gyrostat_exact,
        stop_time=10.0,
    ),
)
