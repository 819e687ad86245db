"""Pendulum, light cart, forced oscillator, geared shafts: few coordinates, mostly closed forms."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj, ellipkinc

from mbfmu.mechanics import (
    Bounce,
    Gear,
    Harmonic,
    JointDamper,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    Translational,
)
from mbfmu.verification.mechanisms.case import G
from mbfmu.verification.mechanisms.trees import chain, light_cart, pendulum_among
from mbfmu.verification.problem import Exact, Motion
from mbfmu.verification.references import Pushed, closed_form

from .sources import IFTOMM

Array = NDArray[np.float64]


def pendulum() -> Mechanism:
    """Return a point mass of 1 kg at 1 m from a hinge, horizontal at the start."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    bob = m.body("bob", m.ground, Revolute(), mass=1.0, com=(1.0, 0.0, 0.0))
    for axis in "xy":
        m.output(axis, bob.position(axis, (1.0, 0.0, 0.0)), f"Coordinate {axis} of the point mass")
    m.output("energy", m.energy, "Total energy")
    return m


def pendulum_exact() -> Exact:
    """Return sin(theta / 2) = k sn(w t + u), with the angle theta from the lowest position."""

    def solution(start: Array, times: Array) -> Array:
        theta, rate = start
        w = sqrt(G)
        s, c = np.sin(0.5 * theta), 0.5 * rate / w
        k2 = s * s + c * c
        u = ellipkinc(np.arctan2(s, c), k2)
        half = np.arcsin(sqrt(k2) * ellipj(w * times + u, k2)[0])
        return np.column_stack((np.sin(2.0 * half), -np.cos(2.0 * half)))

    return closed_form(solution, (0.5 * pi, 0.0), (1.0, sqrt(G)), 10.0)


def cart() -> Mechanism:
    """Return the pole on the light cart."""
    m = light_cart(1e-4).mechanism
    m.output("angle", m.bodies[2].angle(), "Angle of the pole from the vertical")
    return m


def cart_exact() -> Pushed:
    """Return the motion by Lagrange's equations."""
    motion = light_cart(1e-4).exact
    assert motion is not None
    return Pushed(motion, lambda q, _: q[:, 1:], 1e-10)


DROP, RESTITUTION = 1.0, 0.8  # m, -


def bouncing_ball() -> Mechanism:
    """Return a ball that falls onto a rigid stop."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    ball = m.body("ball", m.ground, Translational(axis="y", start=DROP), mass=1.0)
    m.event("floor", ball.coordinate(), crosses=0.0, direction="down", then=Bounce(restitution=RESTITUTION))
    m.output("height", ball.coordinate(), "Height of the ball")
    return m


def bouncing_ball_exact() -> Exact:
    """Return parabolas between impacts, at each of which the velocity is reversed and multiplied by the restitution."""

    def solution(start: Array, times: Array) -> Array:
        height, velocity = start
        begin, values = 0.0, np.empty(len(times))
        while begin <= times[-1]:
            later = times >= begin
            t = times[later] - begin
            values[later] = height + velocity * t - 0.5 * G * t * t
            impact = sqrt(velocity**2 + 2.0 * G * height)
            begin += (velocity + impact) / G
            height, velocity = 0.0, RESTITUTION * impact
        return values[:, None]

    return closed_form(solution, (DROP, 0.0), (1.0, sqrt(G)), 10.0)


def first_rod(m: Mechanism) -> Mechanism:
    """Return a mechanism with the angle of its first body as an output."""
    m.output("angle", m.bodies[1].angle(), "Angle of the first rod")
    return m


def among_exact() -> Pushed:
    """Return the motion of one rod by the equation of a pendulum."""
    motion = pendulum_among(61).exact
    assert motion is not None
    return Pushed(motion, lambda q, _: q[:, :1], 1e-10)


def chain_exact() -> Pushed:
    """Return the motion of a chain by Lagrange's equations in absolute angles."""
    motion = chain(61).exact
    assert motion is not None
    return Pushed(motion, lambda q, _: q[:, :1], 1e-10)


OSCILLATOR_MASS, DAMPING, STIFFNESS, FORCE, FREQUENCY = 2.0, 1.5, 300.0, 40.0, 1.1  # kg, N s/m, N/m, N, Hz


def oscillator() -> Mechanism:
    """Return a slider on a spring and a damper with a harmonic force."""
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.1), mass=OSCILLATOR_MASS)
    m.force("spring", JointSpring(stiffness=STIFFNESS, damping=DAMPING), slider)
    m.force("force", JointForce(magnitude=Harmonic(amplitude=FORCE, frequency=FREQUENCY)), slider)
    m.output("x", slider.coordinate(), "Displacement of the slider")
    return m


def oscillator_exact() -> Exact:
    """Return the particular solution plus the decaying oscillation."""

    def solution(start: Array, times: Array) -> Array:
        w = 2.0 * pi * FREQUENCY
        forced = FORCE / (STIFFNESS - OSCILLATOR_MASS * w * w + 1j * w * DAMPING)
        root = -0.5 * DAMPING / OSCILLATOR_MASS + 1j * sqrt(
            STIFFNESS / OSCILLATOR_MASS - (0.5 * DAMPING / OSCILLATOR_MASS) ** 2
        )
        x, v = start[0] - forced.imag, start[1] - (1j * w * forced).imag
        amplitude = x - 1j * (v - root.real * x) / root.imag
        free = (amplitude * np.exp(root * times)).real
        return np.asarray(free + (forced * np.exp(1j * w * times)).imag)[:, None]

    return closed_form(solution, (0.1, 0.0), (0.5, 5.0), 1.0)


WHEEL, PINION, RATIO, TORQUE, LOSS = 2.0, 0.05, -3.0, 5.0, 0.02  # kg m^2, kg m^2, -, N m, N m s/rad


def gears() -> Mechanism:
    """Return a wheel with a torque that drives a pinion with a damper."""
    m = Mechanism()
    wheel = m.body("wheel", m.ground, Revolute(), inertia=(WHEEL,) * 3)
    pinion = m.body("pinion", m.ground, Revolute(at=(1.0, 0.0, 0.0)), inertia=(PINION,) * 3)
    m.couple("mesh", Gear(ratio=RATIO), pinion, wheel)
    m.force("torque", JointForce(magnitude=TORQUE), wheel)
    m.force("loss", JointDamper(damping=LOSS), pinion)
    m.output("pinion", pinion.angle(), "Angle of the pinion")
    m.output("wheel", wheel.angle(), "Angle of the wheel")
    return m


def gears_exact() -> Exact:
    """Return the solution of (Jw + r^2 Jp) w' = T - r^2 c w."""
    inertia, loss = WHEEL + RATIO**2 * PINION, RATIO**2 * LOSS

    def solution(start: Array, times: Array) -> Array:
        decay = -np.expm1(-loss / inertia * times)
        angle = start[0] + TORQUE / loss * times + (start[1] - TORQUE / loss) * inertia / loss * decay
        return np.column_stack((RATIO * angle, angle))

    return closed_form(solution, (0.0, 0.0), (1.0, 5.0), 100.0)


PENDULUM_PROBLEMS = (
    Motion(
        name="A01 pendulum",
        description="Point mass of 1 kg on a massless rod of 1 m, released horizontally, 10 s.",
        sources=(IFTOMM,),
        quantity="Coordinates x and y of the point mass",
        unit="m",
        derivation="closed form (Jacobi elliptic functions)",
        build=pendulum,
        outputs=("x", "y"),
        exact=pendulum_exact,
        stop_time=10.0,
    ),
    Motion(
        name="cart-pole",
        description="Pole with 1 kg at 1 m on a cart of 1e-4 kg, released horizontally, 10 s. The mass matrix is "
        "nearly singular at each passage (proposed to the IFToMM library).",
        quantity="Angle of the pole",
        unit="rad",
        derivation="SciPy DOP853 on Lagrange's equations",
        build=cart,
        outputs=("angle",),
        exact=cart_exact,
        stop_time=10.0,
    ),
    Motion(
        name="forced oscillator",
        description="Slider of 2 kg with a spring of 300 N/m, a damper of 1.5 N s/m and a force of 40 N at 1.1 Hz, "
        "from 0.1 m, 10 s.",
        quantity="Displacement",
        unit="m",
        derivation="closed form",
        build=oscillator,
        outputs=("x",),
        exact=oscillator_exact,
        stop_time=10.0,
    ),
    Motion(
        name="geared shafts",
        description="Wheel of 2 kg m2 with a torque of 5 N m drives a pinion of 0.05 kg m2 with a damper of 0.02 N m "
        "s/rad by a gear of ratio -3, 10 s.",
        quantity="Angles of pinion and wheel",
        unit="rad",
        derivation="closed form",
        build=gears,
        outputs=("pinion", "wheel"),
        exact=gears_exact,
        stop_time=10.0,
    ),
    Motion(
        name="large tree",
        description="One swinging rod of 1 m and sixty rods at rest, 2 s. Solvers use the structure of trees with more "
        "than 60 coordinates.",
        quantity="Angle of the swinging rod",
        unit="rad",
        derivation="SciPy DOP853 on the equation of a pendulum",
        build=lambda: first_rod(pendulum_among(61).mechanism),
        outputs=("angle",),
        exact=among_exact,
        stop_time=2.0,
    ),
    Motion(
        name="hanging chain",
        description="Chain of 61 rods, 1 m and 1 kg in total, released straight at 0.5 rad from the vertical, 1 s.",
        quantity="Angle of the first rod",
        unit="rad",
        derivation="SciPy DOP853 on Lagrange's equations in absolute angles",
        build=lambda: first_rod(chain(61).mechanism),
        outputs=("angle",),
        exact=chain_exact,
        stop_time=1.0,
        is_quick=False,
    ),
    Motion(
        name="bouncing ball",
        description="Ball that falls 1 m onto a rigid stop with a restitution of 0.8, 2 s with three impacts.",
        quantity="Height",
        unit="m",
        derivation="closed form",
        build=bouncing_ball,
        outputs=("height",),
        exact=bouncing_ball_exact,
        stop_time=2.0,
    ),
)
