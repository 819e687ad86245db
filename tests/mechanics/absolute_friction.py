"""Accelerations of mechanisms with joint friction in absolute coordinates, by constraint forces: an independent
reference for friction in proportion to reactions.

Unknowns are the accelerations of all bodies at their origins and one multiplier for each constraint. Friction acts on
both bodies of a joint, in proportion to the loads that its multipliers exert on the bearings, and is found by SciPy.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation

Array = Any
DAMPING_RATIO, BETA = 0.7, 0.9  # of the bristle, Dupont et al. 2002


@dataclass
class Friction:
    """Bearings and bristle of one coordinate, or of several that slide together."""

    mu: float
    z: Array  # (1,), (2,) or (3,)
    deflection: float
    inertia: float
    radius: float = 0.0
    thrust_radius: float = 0.0
    length: float = np.inf
    width: float = np.inf
    preload: float = 0.0
    on: str = "b"
    arms: Array = None  # slip per unit of each coordinate that slides together with others; None: it does alone

    def force(self, normal: float, v: Array) -> Array:
        """Friction against the slip v, as long as z, under a normal force, N or N m."""
        coulomb, speed = self.mu * normal, np.linalg.norm(v)
        if coulomb <= 0.0:
            return 0.0 * v
        yielding = 0.0
        if v @ self.z > 0.0:
            s = np.clip((np.linalg.norm(self.z) - BETA) / (1.0 - BETA), 0.0, 1.0)
            yielding = s * s * (3.0 - 2.0 * s)
        rate = (v - yielding * speed * self.z) / self.deflection
        tau = 2.0 * DAMPING_RATIO * np.sqrt(self.inertia * self.deflection / coulomb)
        return coulomb * (self.z + tau * rate / (1.0 + (tau * speed / self.deflection) ** 2))


@dataclass
class Link:
    """A body and the joint that carries it: "R", "P", "C" (angle, displacement), "H" (screw), "U" (two angles), "S"
    (unit quaternion, scalar first, and the angular velocity in the axes of the body) or "L" (displacements along
    ``second`` and ``axis`` x ``second``, and the angle about ``axis``).
    """

    parent: int  # 0: the ground
    kind: str
    s: Array
    R: Array
    axis: Array
    mass: float
    com: Array
    inertia: Array
    q: Array
    v: Array
    rise: float = 0.0
    friction: dict[int, Friction] = field(
        default_factory=dict
    )  # by coordinate; of several that slide together the same
    second: Array = None  # axis, of "U" and "L"


@dataclass
class Ball:
    """A spherical joint that closes a loop between points of two bodies."""

    a: int
    b: int
    at_a: Array
    at_b: Array


N_ROWS = {"R": 5, "P": 5, "C": 4, "H": 5, "U": 4, "S": 3, "L": 3}  # constraints of a joint


def turned(q: Array, v: Array) -> Array:
    """Matrix of a unit quaternion, scalar first, after a rotation v about axes of the body."""
    return Rotation.from_quat(np.roll(q, -1)).as_matrix() @ Rotation.from_rotvec(v).as_matrix()


class Absolute:
    """The equations of motion of links, the first of which is body 1."""

    def __init__(self, links: list[Link], balls: list[Ball], gravity: Array) -> None:
        self.links, self.balls, self.gravity = links, balls, np.asarray(gravity)
        self.own = [(i, c) for i, link in enumerate(links, 1) for c in sorted(link.friction)]
        self.r, self.A, self.Y, self.axes = self.place(0.0)
        self.assemble()

    def place(self, dt: float) -> Any:
        """Positions, axes, velocities of all bodies, ground first, and the axes of all coordinates (columns), after dt
        at constant joint rates.
        """
        r, A, Y, axes = [np.zeros(3)], [np.eye(3)], [np.zeros(6)], [np.zeros(3)]
        for link in self.links:
            p, v = link.parent, link.v
            if link.kind in "USL":
                R, d, u = A[p] @ link.R, A[p] @ link.s, np.zeros(3)
                if link.kind == "L":
                    plane = R @ np.array([link.second, np.cross(link.axis, link.second)]).T
                    n, q = R @ link.axis, link.q + dt * v
                    d, u = d + plane @ q[:2], plane @ v[:2]
                    B = R @ Rotation.from_rotvec(q[2] * link.axis).as_matrix()
                    S, spin = np.column_stack((plane, n)), v[2] * n
                elif link.kind == "S":
                    B = S = R @ turned(link.q, dt * v)
                    spin = S @ v
                else:
                    first, second = (
                        Rotation.from_rotvec((q + dt * rate) * axis).as_matrix()
                        for q, rate, axis in zip(link.q, v, (link.axis, link.second), strict=True)
                    )
                    B, S = R @ first @ second, R @ np.array([link.axis, first @ link.second]).T
                    spin = S @ v
                r.append(r[p] + d)
                A.append(B)
                Y.append(np.concatenate((Y[p][:3] + np.cross(Y[p][3:], d) + u, Y[p][3:] + spin)))
                axes.append(S)
                continue
            q = link.q + dt * link.v
            turn = {"R": q[0], "P": 0.0, "C": q[0], "H": q[0]}[link.kind]
            spin = {"R": v[0], "P": 0.0, "C": v[0], "H": v[0]}[link.kind]
            way = {"R": 0.0, "P": q[0], "C": q[-1], "H": link.rise * q[0]}[link.kind]
            speed = {"R": 0.0, "P": v[0], "C": v[-1], "H": link.rise * v[0]}[link.kind]
            axis = A[p] @ link.R @ link.axis
            r.append(r[p] + A[p] @ link.s + way * axis)
            A.append(A[p] @ link.R @ Rotation.from_rotvec(turn * link.axis).as_matrix())
            w = Y[p][3:] + spin * axis
            Y.append(np.concatenate((Y[p][:3] + np.cross(Y[p][3:], r[-1] - r[p]) + speed * axis, w)))
            axes.append(axis)
        return r, A, Y, axes

    def constraints(self, dt: float) -> Array:
        """Velocity constraints G (rows, 6 bodies), after dt."""
        r, A, _, axes = self.place(dt)
        rows = []

        def row(i: int, p: int, force: Array, moment: Array) -> None:
            g = np.zeros(6 * (len(self.links) + 1))
            g[6 * i : 6 * i + 6] += np.concatenate((force, moment))
            arm = r[i] - r[p]
            g[6 * p : 6 * p + 6] -= np.concatenate((force, moment + np.cross(arm, force)))
            rows.append(g[6:])

        zero = np.zeros(3)
        for i, link in enumerate(self.links, 1):
            p, a = link.parent, axes[i]
            if link.kind == "L":
                row(i, p, a[:, 2], zero)
                row(i, p, zero, a[:, 0])
                row(i, p, zero, a[:, 1])
                continue
            if link.kind in "US":
                for e in np.eye(3):
                    row(i, p, e, zero)
                if link.kind == "U":
                    row(i, p, zero, np.cross(a[:, 0], a[:, 1]))
                continue
            across = (A[p] @ link.R @ np.linalg.svd(link.axis[None])[2][1:].T).T
            for e in across:
                row(i, p, zero, e)
                row(i, p, e, zero)
            if link.kind == "P":
                row(i, p, zero, a)
            elif link.kind == "R":
                row(i, p, a, zero)
            elif link.kind == "H":
                row(i, p, a, -link.rise * a)
        for ball in self.balls:
            for e in np.eye(3):
                g = np.zeros(6 * (len(self.links) + 1))
                pa, pb = A[ball.a] @ ball.at_a, A[ball.b] @ ball.at_b
                g[6 * ball.b : 6 * ball.b + 6] += np.concatenate((e, np.cross(pb, e)))
                g[6 * ball.a : 6 * ball.a + 6] -= np.concatenate((e, np.cross(pa, e)))
                rows.append(g[6:])
        return np.array(rows)

    def assemble(self) -> None:
        """Invert the matrix of the equations of motion with constraints, and fill the right-hand side."""
        n, step = 6 * len(self.links), 1e-4
        M, Q = np.zeros((n, n)), np.zeros(n)
        for i, link in enumerate(self.links, 1):
            c, w = self.A[i] @ link.com, self.Y[i][3:]
            Jc, k = self.A[i] @ link.inertia @ self.A[i].T, 6 * (i - 1)
            C = np.array([[0, -c[2], c[1]], [c[2], 0, -c[0]], [-c[1], c[0], 0]])
            M[k : k + 3, k : k + 3] = link.mass * np.eye(3)
            M[k : k + 3, k + 3 : k + 6] = -link.mass * C
            M[k + 3 : k + 6, k : k + 3] = link.mass * C
            M[k + 3 : k + 6, k + 3 : k + 6] = Jc - link.mass * C @ C
            bias = link.mass * (np.cross(w, np.cross(w, c)) - self.gravity)
            Q[k : k + 3] -= bias
            Q[k + 3 : k + 6] -= np.cross(c, bias) + np.cross(w, Jc @ w)
        self.G = G = self.constraints(0.0)
        near = [self.constraints(part * step) for part in (-2.0, -1.0, 1.0, 2.0)]
        rate = (near[0] - 8.0 * near[1] + 8.0 * near[2] - near[3]) / (12.0 * step)
        self.inverse = np.linalg.inv(np.block([[M, G.T], [G, np.zeros((len(G), len(G)))]]))
        self.right = np.concatenate((Q, -rate @ np.concatenate(self.Y[1:])))

    def accelerations(self, x: Array) -> Array:
        """Joint accelerations under the friction forces x, in the order of joints and coordinates; and multipliers."""
        b = self.right.copy()
        for (i, c), value in zip(self.own, x, strict=True):
            self.add_friction(i, c, value, b)
        found, n = self.inverse @ b, 6 * len(self.links)
        self.mu, self.x = -found[n:], x
        return self.joint_accelerations(np.concatenate((np.zeros(6), found[:n])).reshape(-1, 6))

    def gap(self, x: Array, part: float = 1.0) -> Array:
        """Friction forces less a part of those by the reactions under them."""
        self.accelerations(x)
        return np.array([x[k] - part * self.friction_of(i, c) for k, (i, c) in enumerate(self.own)])

    def follow_friction(self) -> Array | None:
        """Friction forces that a growing coefficient of friction leads to; None: SciPy finds none."""
        x = np.zeros(len(self.own))
        for part in np.linspace(0.05, 1.0, 20):
            x = root(self.gap, x, (part,), tol=1e-13).x
            if not np.abs(self.gap(x, part)).max() <= 1e-9 * np.abs(x).max():
                return None
        return x

    def add_friction(self, i: int, coordinate: int, value: float, b: Array) -> None:
        """Add a friction force against a positive velocity to the right-hand side."""
        link, a = self.links[i - 1], self.axes[i]
        force, moment = np.zeros(3), np.zeros(3)
        if link.kind == "H":  # along the thread; value is the torque about the axis that does the same work
            r = link.friction[0].radius
            lead = np.arctan2(link.rise, r)
            along = value * np.cos(lead) / r
            force, moment = -along * np.sin(lead) * a, -along * np.cos(lead) * r * a
        elif link.kind == "L" and coordinate < 2:
            force = -value * a[:, coordinate]
        elif link.kind in "USL":
            moment = -value * a[:, coordinate]
        elif link.kind == "P" or coordinate == 1:
            force = -value * a
        else:
            moment = -value * a
        k, p = 6 * (i - 1), 6 * (link.parent - 1)
        b[k : k + 3] += force
        b[k + 3 : k + 6] += moment
        if link.parent:
            b[p : p + 3] -= force
            b[p + 3 : p + 6] -= moment + np.cross(self.r[i] - self.r[link.parent], force)

    def friction_of(self, i: int, coordinate: int) -> float:
        """Friction force by the multipliers of joint i."""
        link, a, f = self.links[i - 1], self.axes[i], self.links[i - 1].friction[coordinate]
        first = sum(N_ROWS[one.kind] for one in self.links[: i - 1])
        rows = slice(first, first + N_ROWS[link.kind])
        wrench = self.mu[rows] @ self.G[rows, 6 * (i - 1) : 6 * i]
        F, M = wrench[:3], wrench[3:]
        if link.kind == "S":
            return float(f.force(f.radius * (np.linalg.norm(F) + f.preload), link.v)[coordinate])
        if link.kind == "L":
            return self.shared_friction(f, abs(F @ self.axes[i][:, 2]) + f.preload, link.v, coordinate)
        if link.kind == "U":  # the massless cross transmits the other friction, too
            a = self.axes[i][:, coordinate]
            M = M - self.x[self.own.index((i, 1 - coordinate))] * self.axes[i][:, 1 - coordinate]
        if link.kind == "H":
            lead = np.arctan2(link.rise, f.radius)
            flank = (F @ a) / np.cos(lead)  # the multiplier's axial force
            normal = abs(flank) * f.radius / np.cos(lead) + f.radius * f.preload
            return float(f.force(normal, link.v)[0])
        center = self.r[i] if f.on == "b" else self.r[link.parent] + self.A[link.parent] @ link.s
        M = M - np.cross(center - self.r[i], F)
        radial, couple = F - (F @ a) * a, np.cross(M, a) / f.length
        sides = np.linalg.norm(radial / 2 + couple) + np.linalg.norm(radial / 2 - couple) + f.preload
        if link.kind == "P":
            sides += 2.0 * abs(M @ a) / f.width
        elif f.arms is not None:
            return self.shared_friction(f, sides, link.v, coordinate)
        elif coordinate == 0:
            sides = f.radius * sides + f.thrust_radius * abs(F @ a)
        elif link.kind == "U":
            sides = f.radius * sides + f.thrust_radius * abs(F @ a)
        return float(f.force(sides, link.v[coordinate : coordinate + 1])[0])

    @staticmethod
    def shared_friction(f: Friction, normal: float, v: Array, coordinate: int) -> float:
        """Force on a coordinate that slides together with others."""
        return float(f.arms[coordinate] * f.force(normal, f.arms * v[: len(f.arms)])[coordinate])

    def joint_accelerations(self, a: Array) -> Array:
        """Joint accelerations by those of the bodies (bodies + 1, 6)."""
        found = []
        for i, link in enumerate(self.links, 1):
            p, axis = link.parent, self.axes[i]
            d, w = self.r[i] - self.r[p], self.Y[p][3:]
            if link.kind == "L":
                u = axis[:, :2] @ link.v[:2]
                way = a[i][:3] - a[p][:3] - np.cross(a[p][3:], d) - np.cross(w, np.cross(w, d)) - 2.0 * np.cross(w, u)
                found += [*(axis[:, :2].T @ way), axis[:, 2] @ (a[i][3:] - a[p][3:])]
                continue
            if link.kind in "US":
                slip, relative = self.Y[i][3:] - w, a[i][3:] - a[p][3:]
                if link.kind == "S":
                    found += [*(axis.T @ (relative - np.cross(self.Y[i][3:], slip)))]
                else:
                    turn = link.v[0] * axis[:, 0]
                    bias = np.cross(w, turn) + np.cross(w + turn, link.v[1] * axis[:, 1])
                    found += [*(axis.T @ (relative - bias))]
                continue
            turn = axis @ (a[i][3:] - a[p][3:])
            way = axis @ (a[i][:3] - a[p][:3] - np.cross(a[p][3:], d) - np.cross(w, np.cross(w, d)))
            found += {"R": [turn], "P": [way], "C": [turn, way], "H": [turn]}[link.kind]
        return np.array(found)
