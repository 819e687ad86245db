"""Random mechanisms whose motion SciPy integrates from equations written by hand, in other coordinates if possible.

Each draw gives a mechanism, the times of its outputs, and the exact outputs as a function of the start: an error of the
start, of one tolerance, grows in the exact motion too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from mbfmu.mechanics import (
    Harmonic,
    JointForce,
    JointSpring,
    JointStop,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    Translational,
    rod,
)

G = 9.81
Array = Any


class Draw(NamedTuple):
    """A mechanism and its exact motion."""

    mechanism: Mechanism
    end: float  # s
    start: Array  # state in the equations by hand
    scale: Array  # what an error of one tolerance is there
    rates: Callable[[float, Array], Any]
    seen: Callable[[Array], Array]  # outputs (k, outputs) from states (components, k)
    sizes: Array  # (outputs,) what errors of the outputs are measured in
    longest: float = np.inf  # s, step of SciPy

    def exact(self, times: Array, shift: float = 0.0) -> Array:
        """Outputs (k, outputs) of the motion that starts off by ``shift`` times the scale."""
        start = self.start + shift * self.scale
        span, step = (0.0, times[-1]), self.longest
        found = solve_ivp(self.rates, span, start, "DOP853", t_eval=times, rtol=1e-12, atol=1e-13, max_step=step)
        return self.seen(found.y)


def pendulum(rng: Any) -> Draw:
    """A rod of any size, damped or not, with a constant torque or none."""
    length, mass = 10.0 ** rng.uniform(-3, 3), 10.0 ** rng.uniform(-3, 3)
    pace, inertia = np.sqrt(G / length), mass * length**2 / 3.0
    damping = rng.choice([0.0, 0.1]) * inertia * pace
    torque = rng.choice([0.0, 0.4]) * inertia * pace**2
    angle, rate = rng.uniform(-3.0, 3.0), rng.uniform(-2.0, 2.0) * pace
    m = Mechanism(gravity=(0.0, -G, 0.0))
    bar = m.body("bar", m.ground, Revolute(start=angle, rate=rate, fixed=True), **rod(mass=mass, length=length))
    m.force("oil", JointSpring(damping=damping), bar)
    m.force("motor", JointForce(magnitude=torque), bar)
    m.output("angle", bar.angle())
    m.output("rate", bar.rate())

    def rates(_: float, y: Array) -> list[float]:
        return [y[1], (torque - damping * y[1] - 0.5 * mass * G * length * np.cos(y[0])) / inertia]

    scale = np.array([1.0, pace])
    return Draw(m, 5.0 / pace, np.array([angle, rate]), scale, rates, np.transpose, scale)


def double_pendulum(rng: Any) -> Draw:
    """Two rods with a spring and a damper between them; by hand in absolute angles."""
    a, b = rng.uniform(0.5, 1.5, 2)
    m1, m2 = rng.uniform(0.3, 3.0, 2)
    stiffness, damping = rng.choice([0.0, 5.0, 50.0]), rng.choice([0.0, 0.1])
    start = np.array([*rng.uniform(-1.0, 1.0, 2) - np.pi / 2.0, *rng.uniform(-1.0, 1.0, 2)])
    m = Mechanism(gravity=(0.0, -G, 0.0))
    upper = m.body("a", m.ground, Revolute(start=start[0], rate=start[2], fixed=True), **rod(mass=m1, length=a))
    bend, bend_rate = start[1] - start[0], start[3] - start[2]
    joint = Revolute(at=(a, 0.0, 0.0), start=bend, rate=bend_rate, fixed=True)
    lower = m.body("b", upper, joint, **rod(mass=m2, length=b))
    m.force("spring", JointSpring(stiffness=stiffness, damping=damping), lower)
    for name, sensor in (("a", upper.angle()), ("b", lower.angle()), ("a'", upper.rate()), ("b'", lower.rate())):
        m.output(name, sensor)

    def rates(_: float, y: Array) -> Array:
        p, q, u, w = y
        mixed = 0.5 * m2 * a * b
        M = np.array([[(m1 / 3.0 + m2) * a * a, mixed * np.cos(p - q)], [mixed * np.cos(p - q), m2 * b * b / 3.0]])
        tie = -stiffness * (q - p) - damping * (w - u)
        force = [
            -mixed * np.sin(p - q) * w * w - (0.5 * m1 + m2) * G * a * np.cos(p) - tie,
            mixed * np.sin(p - q) * u * u - 0.5 * m2 * G * b * np.cos(q) + tie,
        ]
        return np.concatenate((y[2:], np.linalg.solve(M, force)))

    def seen(y: Array) -> Array:
        return np.array([y[0], y[1] - y[0], y[2], y[3] - y[2]]).T

    scale = np.array([1.0, 1.0, 4.0, 4.0])
    return Draw(m, 2.0, start, scale, rates, seen, scale)


def shaken(rng: Any) -> Draw:
    """A rod on a support that a drive shakes sideways."""
    amplitude, frequency = rng.uniform(0.02, 0.2), rng.uniform(0.5, 2.0)
    angle, omega = rng.uniform(-1.0, 1.0) - np.pi / 2.0, 2.0 * np.pi * frequency
    m = Mechanism(gravity=(0.0, -G, 0.0))
    drive = Harmonic(amplitude=amplitude, frequency=frequency)
    cart = m.body("cart", m.ground, Translational(axis="x", drive=drive), mass=2.0, inertia=(0.1, 0.1, 0.1))
    bar = m.body("bar", cart, Revolute(start=angle, fixed=True), **rod(mass=1.0, length=1.0))
    m.output("angle", bar.angle())
    m.output("rate", bar.rate())

    def rates(t: float, y: Array) -> list[float]:
        pull = -amplitude * omega**2 * np.sin(omega * t)
        return [y[1], 1.5 * (pull * np.sin(y[0]) - G * np.cos(y[0]))]

    scale = np.array([1.0, 4.0])
    return Draw(m, 3.0, np.array([angle, 0.0]), scale, rates, np.transpose, scale)


def stopped(rng: Any) -> Draw:
    """A mass on a spring that meets a damped stop again and again."""
    stiffness, stop = rng.uniform(5.0, 50.0), 10.0 ** rng.uniform(3.0, 5.0)
    loss, upper, rate = rng.choice([0.0, 0.2, 1.0]), rng.uniform(0.0, 0.3), rng.uniform(1.0, 4.0)
    m = Mechanism()
    slide = Translational(axis="x", rate=rate, fixed=True)
    block = m.body("block", m.ground, slide, mass=1.0, inertia=(0.1, 0.1, 0.1))
    m.force("spring", JointSpring(stiffness=stiffness), block)
    m.force("stop", JointStop(upper=upper, stiffness=stop, damping=loss), block)
    m.output("place", block.position("x"))
    m.output("speed", block.velocity("x"))

    def rates(_: float, y: Array) -> list[float]:
        push = stop * max(0.0, y[0] - upper) * max(0.0, 1.0 + loss * y[1])
        return [y[1], -stiffness * y[0] - push]

    scale = np.array([1.0, np.sqrt(stop)])
    return Draw(m, 2.0, np.array([0.0, rate]), scale, rates, np.transpose, scale, longest=2e-3)


def loop(rng: Any) -> Draw:
    """A parallelogram of bars, which passes its singular configurations; by hand in the angle of its crank."""
    crank, coupler = rng.uniform(0.3, 1.2), rng.uniform(1.5, 3.0)
    m1, m2, m3 = rng.uniform(0.5, 2.0, 3)
    angle, rate = rng.uniform(0.3, 2.8), rng.uniform(0.5, 2.0)
    m = Mechanism(gravity=(0.0, -G, 0.0))
    one = m.body("a", m.ground, Revolute(start=angle, rate=rate, fixed=True), **rod(mass=m1, length=crank))
    joint = Revolute(at=(crank, 0.0, 0.0), start=-angle, rate=-rate)
    two = m.body("b", one, joint, **rod(mass=m2, length=coupler))
    joint = Revolute(at=(coupler, 0.0, 0.0), start=angle, rate=rate)
    three = m.body("c", two, joint, **rod(mass=m3, length=-crank))
    m.cut("pivot", RevoluteCutJoint(at_a=(-crank, 0.0, 0.0), at_b=(coupler, 0.0, 0.0)), three, m.ground)
    m.output("angle", one.angle())
    m.output("rate", one.rate())
    inertia, weight = ((m1 + m3) / 3.0 + m2) * crank**2, ((m1 + m3) / 2.0 + m2) * crank * G

    def rates(_: float, y: Array) -> list[float]:
        return [y[1], -weight * np.cos(y[0]) / inertia]

    scale = np.array([1.0, 4.0])
    return Draw(m, 2.0, np.array([angle, rate]), scale, rates, np.transpose, scale)


def top(rng: Any) -> Draw:
    """A heavy body on a ball joint; by hand as a rotation matrix and Euler's equations about the joint."""
    com, spin, mass = 0.2 * rng.normal(size=3), rng.uniform(-3.0, 3.0, 3), rng.uniform(0.5, 2.0)
    own = rng.uniform(0.02, 0.03, 3)
    m = Mechanism(gravity=(0.0, -G, 0.0))
    joint = Spherical(rate=tuple(spin), fixed=True)
    body = m.body("top", m.ground, joint, mass=mass, com=tuple(com), inertia=tuple(own))
    for axis in "xyz":
        m.output(axis, body.position(axis, point=tuple(com)))
    I = np.diag(own) + mass * (com @ com * np.eye(3) - np.outer(com, com))

    def rates(_: float, y: Array) -> Array:
        R, w = y[:9].reshape(3, 3), y[9:]
        cross = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        torque = np.cross(com, R.T @ np.array([0.0, -G * mass, 0.0]))
        return np.concatenate(((R @ cross).ravel(), np.linalg.solve(I, torque - np.cross(w, I @ w))))

    def seen(y: Array) -> Array:
        return np.einsum("ijk,j->ki", y[:9].reshape(3, 3, -1), com)

    scale = np.concatenate((np.zeros(9), np.full(3, 3.0)))
    return Draw(m, 1.5, np.concatenate((np.eye(3).ravel(), spin)), scale, rates, seen, np.ones(3))


FAMILIES = (pendulum, double_pendulum, shaken, stopped, loop, top)
