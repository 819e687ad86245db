"""Equations of motion of trees of rigid bodies in absolute coordinates, with Lagrange multipliers for every joint.

A state y contains, one quantity after the other, for n bodies the centers of mass (3 n), unit quaternions with the
scalar first (4 n), velocities (3 n) and angular velocities in ground axes (3 n), then the joint coordinates and the
bristles. Every joint has six rows: relative velocities of its child along and about three axes. A row is free (its
rate is that of a joint coordinate), constrained, driven or held; forces on coordinates act through the same rows:

    M a = f + G^T (Q + lambda),    G a + b = 0 for constrained and held rows,  q'' of the drive for driven ones

No recursion and no part of mbfmu is used.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

REVOLUTE, PRISMATIC, UNIVERSAL, SPHERICAL = range(4)
FREE, CONSTRAINED, DRIVEN, HELD = range(4)  # rows
BRISTLE, SET_VALUED = range(2)  # laws of friction
NO_BODY = -1  # the ground
ROWS = 6  # of a joint: three translations, three rotations
CREEP_LIMIT, DAMPING_RATIO = 0.9, 0.7  # of the bristle


class Tree(NamedTuple):
    """Arrays of a mechanism of n bodies; joint j connects body j with its parent."""

    gravity: Any  # (3,)
    mass: Any  # (n,)
    com: Any  # (n, 3)
    inertia: Any  # (n, 3, 3), about the center of mass
    parent: Any  # (n,)
    kind: Any  # (n,)
    at: Any  # (n, 3)
    frame: Any  # (n, 3, 3)
    axes: Any  # (n, 3, 3): rows are the axis and two normals to it, in the joint frame
    drive: Any  # (n, 4): mean, amplitude, angular frequency, phase
    free: Any  # (f,): rows that have a coordinate
    elastic: Any  # (6 n, 3): stiffness, damping, unloaded coordinate
    pushed: Any  # (6 n, 3): amplitude, angular frequency, phase of a force
    stops: Any  # (6 n, 4): lower, upper, stiffness, damping
    spring_ends: Any  # (s, 2): bodies
    spring_points: Any  # (s, 2, 3)
    springs: Any  # (s, 3): stiffness, damping, unloaded length
    rubbed: Any  # (r,): rows with friction
    ball: Any  # (r,): whether the friction is that of a ball joint; three rows each
    friction: Any  # (r, 6): coulomb, static, stribeck, viscous, deflection, inertia that the bristle moves
    pulse: Any  # (r, 3): amplitude, angular frequency, phase of the normal force


def cross(a: Any, b: Any) -> Any:
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


def rotation(p: Any) -> Any:
    """Rotation matrix of a quaternion of any length."""
    w, x, y, z = p / np.sqrt(np.sum(p * p))
    R = np.empty((3, 3))
    R[0] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    R[1] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    R[2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    return R


def kinematics(y: Any, tree: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Return rotations (n, 3, 3), G (6 n, 6 n), the terms b (6 n) of its derivative, G v (6 n), and M^-1 (6 n, 6 n).

    Velocities and forces of body k are at 6 k: three of the center of mass, three of the rotation.
    """
    n = len(tree.mass)
    x, p = y[: 3 * n].reshape(n, 3), y[3 * n : 7 * n].reshape(n, 4)
    v, w = y[7 * n : 10 * n].reshape(n, 3), y[10 * n : 13 * n].reshape(n, 3)
    R, inverse = np.empty((n, 3, 3)), np.zeros((6 * n, 6 * n))
    G, b, rate = np.zeros((6 * n, 6 * n)), np.zeros(6 * n), np.zeros(6 * n)
    zero = np.zeros(3)
    d, turn = np.empty((6, 3)), np.empty((3, 3))
    for k in range(n):
        R[k] = rotation(p[k])
        inverse[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = np.eye(3) / tree.mass[k]
        inverse[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = R[k] @ np.linalg.inv(tree.inertia[k]) @ R[k].T
    for k in range(n):
        a = tree.parent[k]
        Ra, xa, va, wa = np.eye(3), zero, zero, zero
        if a >= 0:
            Ra, xa, va, wa = R[a], x[a], v[a], w[a]
        F = Ra @ tree.frame[k]
        origin = x[k] - R[k] @ tree.com[k]
        to_a, to_b = origin - xa, origin - x[k]
        for i in range(3):
            d[i] = F @ tree.axes[k, i]
            d[3 + i] = d[i]
            turn[i] = cross(wa, d[i])
        if tree.kind[k] == UNIVERSAL:
            d[4] = R[k] @ tree.axes[k, 1]
            d[5] = cross(d[3], d[4])
            turn[1] = cross(w[k], d[4])
            turn[2] = cross(turn[0], d[4]) + cross(d[3], turn[1])
        elif tree.kind[k] == SPHERICAL:
            for i in range(3):
                d[3 + i] = R[k][:, i]
                turn[i] = cross(w[k], d[3 + i])
        slip = v[k] + cross(w[k], to_b) - va - cross(wa, to_a)
        spin = w[k] - wa
        turned = cross(w[k], cross(w[k], to_b)) - cross(wa, cross(wa, to_a)) - 2.0 * cross(wa, slip)
        for i in range(3):
            r, s = 6 * k + i, 6 * k + 3 + i
            G[r, 6 * k : 6 * k + 3], G[r, 6 * k + 3 : 6 * k + 6] = d[i], cross(to_b, d[i])
            G[s, 6 * k + 3 : 6 * k + 6] = d[3 + i]
            if a >= 0:
                G[r, 6 * a : 6 * a + 3], G[r, 6 * a + 3 : 6 * a + 6] = -d[i], -cross(to_a, d[i])
                G[s, 6 * a + 3 : 6 * a + 6] = -d[3 + i]
            b[r], b[s] = np.sum(d[i] * turned), np.sum(turn[i] * spin)
            rate[r], rate[s] = np.sum(d[i] * slip), np.sum(d[3 + i] * spin)
    return R, G, b, rate, inverse


def yielding(u: float) -> float:
    """Part of the slip that does not deflect a bristle (Dupont, Hayward, Armstrong and Altpeter 2002)."""
    s = min(max((u - CREEP_LIMIT) / (1.0 - CREEP_LIMIT), 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def rub(parameters: Any, normal: float, v: Any, z: Any) -> tuple[Any, Any]:
    """Friction on the coordinates and z' of a bristle whose slip v and state z are vectors of any dimension."""
    coulomb, static, stribeck, viscous, deflection, inertia = parameters
    speed, length = np.sqrt(np.sum(v * v)), np.sqrt(np.sum(z * z))
    ratio = 1.0 + (static / coulomb - 1.0) * np.exp(-((speed / stribeck) ** 2))
    part = yielding(length / ratio) if np.sum(v * z) > 0.0 else 0.0
    rate = (v - part * speed / ratio * z) / deflection
    if normal <= 0.0:
        return -viscous * v, rate
    time = 2.0 * DAMPING_RATIO * np.sqrt(inertia * deflection / (coulomb * normal))
    damping = time / (1.0 + (time * speed / deflection) ** 2)
    return -coulomb * normal * (z + damping * rate) - viscous * v, rate


def evaluate(t: float, y: Any, tree: Any, modes: Any, loads: Any, grips: Any, signs: Any, law: int) -> tuple[Any, Any]:
    """Return y' and the forces (6 n) that hold or constrain rows.

    modes (6 n) of the rows, loads (6 n) and grips (r,): constant parts of the forces and the normal forces; signs
    (r,): directions of sliding of set-valued friction.
    """
    n, f = len(tree.mass), len(tree.free)
    R, G, b, rate, inverse = kinematics(y, tree)
    q = np.zeros(6 * n)
    q[tree.free] = y[13 * n : 13 * n + f]
    z, z_rate = y[13 * n + f :], np.zeros(len(tree.rubbed))
    Q = loads - tree.elastic[:, 0] * (q - tree.elastic[:, 2]) - tree.elastic[:, 1] * rate
    Q += tree.pushed[:, 0] * np.sin(tree.pushed[:, 1] * t + tree.pushed[:, 2])
    for r in tree.free:
        lower, upper, stiffness, damping = tree.stops[r]
        if q[r] < lower:
            Q[r] += stiffness * (lower - q[r]) * max(1.0 - damping * rate[r], 0.0)
        elif q[r] > upper:
            Q[r] -= stiffness * (q[r] - upper) * max(1.0 + damping * rate[r], 0.0)
    i = 0
    while i < len(tree.rubbed):
        count = 3 if tree.ball[i] else 1
        r, j = tree.rubbed[i], i + count
        normal = max(grips[i] + tree.pulse[i, 0] * np.sin(tree.pulse[i, 1] * t + tree.pulse[i, 2]), 0.0)
        if law == BRISTLE:
            force, z_rate[i:j] = rub(tree.friction[i], normal, rate[r : r + count], z[i:j])
            Q[r : r + count] += force
        elif signs[i] != 0.0:
            coulomb, static, stribeck, viscous = tree.friction[i, :4]
            decayed = coulomb + (static - coulomb) * np.exp(-((rate[r] / stribeck) ** 2))
            Q[r] -= signs[i] * normal * decayed + viscous * rate[r]
        i = j
    force = G.T @ Q
    for k in range(n):
        w = y[10 * n + 3 * k : 10 * n + 3 * k + 3]
        force[6 * k : 6 * k + 3] += tree.mass[k] * tree.gravity
        force[6 * k + 3 : 6 * k + 6] -= cross(w, R[k] @ (tree.inertia[k] @ (R[k].T @ w)))
    for k in range(len(tree.springs)):
        points, speeds, arms = np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3))
        for side in range(2):
            body = tree.spring_ends[k, side]
            points[side] = tree.spring_points[k, side]
            if body >= 0:
                arms[side] = R[body] @ (tree.spring_points[k, side] - tree.com[body])
                points[side] = y[3 * body : 3 * body + 3] + arms[side]
                w = y[10 * n + 3 * body : 10 * n + 3 * body + 3]
                speeds[side] = y[7 * n + 3 * body : 7 * n + 3 * body + 3] + cross(w, arms[side])
        line = points[1] - points[0]
        length = np.sqrt(np.sum(line * line))
        # the damper of a spring acts along the relative velocity of its ends
        pull = tree.springs[k, 0] * (length - tree.springs[k, 2]) * line / length
        pull += tree.springs[k, 1] * np.sum((speeds[1] - speeds[0]) * line) / length * line / length
        for side, way in ((0, 1.0), (1, -1.0)):
            body = tree.spring_ends[k, side]
            if body >= 0:
                force[6 * body : 6 * body + 3] += way * pull
                force[6 * body + 3 : 6 * body + 6] += way * cross(arms[side], pull)
    held = np.flatnonzero(modes)
    right = -b.copy()
    for r in held:
        if modes[r] == DRIVEN:
            _, amplitude, frequency, phase = tree.drive[r // 6]
            right[r] -= amplitude * frequency * frequency * np.sin(frequency * t + phase)
    C = G[held]
    moved = inverse @ C.T
    multipliers = np.linalg.solve(C @ moved, right[held] - C @ (inverse @ force))
    acceleration = inverse @ force + moved @ multipliers
    out, holding = np.empty(len(y)), np.zeros(6 * n)
    holding[held] = multipliers
    out[: 3 * n] = y[7 * n : 10 * n]
    for k in range(n):
        p, w = y[3 * n + 4 * k : 3 * n + 4 * k + 4], y[10 * n + 3 * k : 10 * n + 3 * k + 3]
        out[3 * n + 4 * k] = -0.5 * np.sum(p[1:] * w)
        out[3 * n + 4 * k + 1 : 3 * n + 4 * k + 4] = 0.5 * (p[0] * w + cross(w, p[1:]))
        out[7 * n + 3 * k : 7 * n + 3 * k + 3] = acceleration[6 * k : 6 * k + 3]
        out[10 * n + 3 * k : 10 * n + 3 * k + 3] = acceleration[6 * k + 3 : 6 * k + 6]
    out[13 * n : 13 * n + f], out[13 * n + f :] = rate[tree.free], z_rate
    return out, holding


def compile_equations() -> None:
    """Replace the functions of this module by machine code, which takes a minute the first time."""
    from numba import njit

    for function in (cross, rotation, kinematics, yielding, rub, evaluate):
        globals()[function.__name__] = njit(cache=True)(function)
