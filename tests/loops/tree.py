"""What the public builder holds, read for a formulation of our own: poses, coordinates, signals, natural units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, sin
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics import (
    Floating,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    RunUp,
    SpeedInput,
    Spherical,
    Spring,
    Translational,
    Weld,
)

Known = Callable[[float], tuple[float, float, float]]  # value, first and second derivative at a time
JOINTS = (Weld, Revolute, Translational, Spherical, Floating)


class NotCovered(NotImplementedError):
    """The mechanism has something this reference does not know."""


def known(signal: Any) -> Known:
    """Value and two derivatives of a signal."""
    match signal:
        case Harmonic(amplitude=a, frequency=f, phase=phase, mean=mean):
            w = 2.0 * np.pi * f
            return lambda t: (
                mean + a * sin(w * t + phase),
                a * w * cos(w * t + phase),
                -a * w * w * sin(w * t + phase),
            )
        case RunUp(speed=speed, duration=T, start=start):
            return lambda t: _run_up(t, speed, T, start)
        case Polynomial(c=c):
            p = np.polynomial.Polynomial(np.asarray(c, float))
            d, dd = p.deriv(), p.deriv(2)
            return lambda t: (float(p(t)), float(d(t)), float(dd(t)))
        case Input(start=start):
            return lambda t: (start, 0.0, 0.0)
        case SpeedInput(start=start):
            return lambda t: (start * t, start, 0.0)
        case int() | float():
            return lambda t: (float(signal), 0.0, 0.0)
    raise NotCovered(f"signal {signal!r}")


def _run_up(t: float, speed: float, T: float, start: float) -> tuple[float, float, float]:
    """Speed (x - sin 2 pi x / 2 pi) until x = t / T = 1, constant after; integrated and differentiated."""
    x, turn = min(max(t / T, 0.0), 1.0), 2.0 * np.pi
    value = start + speed * T * (0.5 * x * x + (cos(turn * x) - 1.0) / turn**2 + max(t / T - 1.0, 0.0))
    return value, speed * (x - sin(turn * x) / turn), speed / T * (1.0 - cos(turn * x))


class Units(NamedTuple):
    """A length (m), a mass (kg) and a time (s) of the mechanism itself."""

    length: float
    mass: float
    time: float


def units(mechanism: Mechanism, v: Any) -> Units:
    """Return the mechanism's largest length and mass and its shortest obvious time; ``v`` is a start velocity."""
    bodies, cuts = mechanism.bodies[1:], mechanism.cuts
    points = [p for b in bodies for p in (b.joint.at, b.com)] + [p for c in cuts for p in (c.cut.at_a, c.cut.at_b)]
    points += [p for _, f, _, _ in mechanism.forces if isinstance(f, Spring) for p in (f.at_a, f.at_b)]
    sizes = [float(np.linalg.norm(p)) for p in points] + [float(getattr(c.cut, "length", 0.0)) for c in cuts]
    length = max(sizes, default=0.0) or 1.0
    mass = max([b.mass for b in bodies] + [float(np.trace(b.inertia)) / length**2 for b in bodies]) or 1.0
    rates = [float(np.linalg.norm(mechanism.gravity)) / length]
    rates += [f.stiffness / mass for _, f, _, _ in mechanism.forces if isinstance(f, Spring)]
    rates += [f.stiffness / (mass * length**2) for _, f, _, _ in mechanism.forces if isinstance(f, JointSpring)]
    for _, f, _, _ in mechanism.forces:
        if isinstance(f, JointForce):
            rates.append(abs(known(f.magnitude)(0.0)[0]) / (mass * length**2))
    speeds = _angular(mechanism, v, length) + [
        abs(known(b.joint.drive)(t)[1]) / (length if isinstance(b.joint, Translational) else 1.0)
        for b in bodies
        if b.joint.drive is not None
        for t in (0.0, _late(b.joint.drive))
    ]
    fastest = max([r**0.5 for r in rates] + speeds)
    return Units(length, mass, 1.0 / fastest if fastest > 0.0 else 1.0)


def _late(drive: Any) -> float:
    """A second time at which a drive's rate is looked at: where a run-up ends, a quarter of a period."""
    return float(getattr(drive, "duration", 0.25 / getattr(drive, "frequency", 1.0)))


def _angular(mechanism: Mechanism, v: Any, length: float) -> list[float]:
    """Start velocities by their size, those of displacements over ``length``."""
    found, k = [0.0], 0
    for body in mechanism.bodies[1:]:
        joint = body.joint
        if joint.drive is None:
            for unit in joint.units:
                found.append(abs(float(v[k])) / (length if unit == "m" else 1.0))
                k += 1
    return found


@dataclass
class Pose:
    """Where a body is: axes R and origin o in global axes; angular velocity w and velocity of the origin, global."""

    R: Any
    o: Any
    w: Any
    vo: Any


def joint_axes(joint: Any) -> Any:
    """Axes of the joint frame in the parent's."""
    return np.eye(3) if joint.rotation is None else np.asarray(joint.rotation, float)


def turning(axis: Any, angle: float) -> Any:
    """Rotation matrix about a unit axis."""
    K = skew(axis)
    return np.eye(3) + sin(angle) * K + (1.0 - cos(angle)) * (K @ K)


def skew(a: Any) -> Any:
    """Matrix of the cross product by a."""
    return np.array(((0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)))


def matrix_of(p: Any) -> Any:
    """Rotation matrix of a unit quaternion, scalar first."""
    s, u = p[0], np.asarray(p[1:], float)
    return (s * s - u @ u) * np.eye(3) + 2.0 * np.outer(u, u) + 2.0 * s * skew(u)


def quaternion_of(R: Any) -> Any:
    """Unit quaternion, scalar first, of a rotation matrix: the column of largest norm of 4 p p^T."""
    t = np.trace(R)
    P = np.empty((4, 4))
    P[0, 0] = 1.0 + t
    P[1:, 1:] = R + R.T + (1.0 - t) * np.eye(3)
    P[0, 1:] = P[1:, 0] = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    p = P[:, int(np.argmax(np.diag(P)))]
    return p / np.linalg.norm(p)


def forward(mechanism: Mechanism, t: float, q: Any, v: Any) -> list[Pose]:
    """Poses of all bodies, the ground first, from free positions q and velocities v in the compiled mechanism's
    order.
    """
    zero = np.zeros(3)
    poses = [Pose(np.eye(3), zero, zero, zero)]
    iq = iv = 0
    for body in mechanism.bodies[1:]:
        joint, up = body.joint, poses[body.parent]
        if type(joint) not in JOINTS:
            raise NotCovered(f"joint {joint!r}")
        if joint.drive is not None:
            value, rate, _ = known(joint.drive)(t)
            qj, vj = np.array([value]), np.array([rate])
        else:
            qj, vj = np.asarray(q[iq : iq + joint.nq], float), np.asarray(v[iv : iv + joint.nv], float)
            iq, iv = iq + joint.nq, iv + joint.nv
        poses.append(child(joint, up, qj, vj))
    return poses


def child(joint: Any, up: Pose, q: Any, v: Any) -> Pose:
    """Pose of the child of a joint."""
    F = up.R @ joint_axes(joint)
    shift, rate, turn, spin = np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3)  # spin in the child's axes
    if isinstance(joint, Revolute):
        turn, spin = turning(joint.direction, q[0]), joint.direction * v[0]
    elif isinstance(joint, Translational):
        shift, rate = joint.direction * q[0], joint.direction * v[0]
    elif isinstance(joint, Spherical):
        turn, spin = matrix_of(q / np.linalg.norm(q)), v
    elif isinstance(joint, Floating):
        shift, rate = q[:3], v[:3]
        turn, spin = matrix_of(q[3:] / np.linalg.norm(q[3:])), v[3:]
    R = F @ turn
    arm = up.R @ np.asarray(joint.at, float) + F @ shift
    return Pose(R, up.o + arm, up.w + R @ spin, up.vo + np.cross(up.w, arm) + F @ rate)


def backward(mechanism: Mechanism, poses: list[Pose], near: Any) -> tuple[Any, Any]:
    """Free positions and velocities of poses; angles and quaternions on the side of ``near``, free positions."""
    q, v = [], []
    iq = 0
    for body in mechanism.bodies[1:]:
        joint = body.joint
        if joint.drive is None:
            qj, vj = _relative(joint, poses[body.parent], poses[body.index], near[iq : iq + joint.nq])
            iq += joint.nq
            q.append(qj)
            v.append(vj)
    return np.concatenate([np.zeros(0), *q]), np.concatenate([np.zeros(0), *v])


def _relative(joint: Any, up: Pose, here: Pose, near: Any) -> tuple[Any, Any]:
    """Coordinates and velocities of one joint."""
    F = up.R @ joint_axes(joint)
    T = F.T @ here.R
    spin = here.R.T @ (here.w - up.w)
    if isinstance(joint, Revolute):
        return np.array([near_angle(angle_about(joint.direction, T), near[0])]), np.array([joint.direction @ spin])
    arm = here.o - up.o - up.R @ np.asarray(joint.at, float)
    rate = F.T @ (here.vo - up.vo - np.cross(up.w, here.o - up.o))
    if isinstance(joint, Translational):
        return np.array([joint.direction @ (F.T @ arm)]), np.array([joint.direction @ rate])
    if isinstance(joint, Weld):
        return np.zeros(0), np.zeros(0)
    p = quaternion_of(T)
    p = p if p @ near[-4:] >= 0.0 else -p
    if isinstance(joint, Spherical):
        return p, spin
    return np.concatenate((F.T @ arm, p)), np.concatenate((rate, spin))


def angle_about(axis: Any, T: Any) -> float:
    """Angle of a rotation T about a unit axis, within (-pi, pi]."""
    n = np.asarray(axis, float)
    across = np.eye(3)[int(np.argmin(np.abs(n)))]
    e = np.cross(n, across)
    e /= np.linalg.norm(e)
    return float(np.arctan2(np.cross(n, e) @ T @ e, e @ T @ e))


def near_angle(angle: float, near: float) -> float:
    """The angle, by whole turns as near as possible to another."""
    return angle + 2.0 * np.pi * round((near - angle) / (2.0 * np.pi))


def sizes(mechanism: Mechanism, unit: Units) -> tuple[Any, Any]:
    """What errors of free positions (nq,) and velocities (n,) are measured in."""
    q, v = [np.zeros(0)], [np.zeros(0)]
    for body in mechanism.bodies[1:]:
        if body.joint.drive is None:
            scale = np.array([unit.length if u == "m" else 1.0 for u in body.joint.units])
            v.append(scale / unit.time)
            q.append(scale if body.joint.nq == body.joint.nv else np.r_[scale[: body.joint.nq - 4], np.ones(4)])
    return np.concatenate(q), np.concatenate(v)
