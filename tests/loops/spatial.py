"""Maximal coordinates in space."""

from __future__ import annotations

from typing import Any

import numpy as np
from maximal import Maximal, dot
from ties import Tie, across
from tree import Known, Pose, Units, angle_about, joint_axes, matrix_of, near_angle, quaternion_of, turning

from mbfmu.mechanics import Mechanism


def cross(a: Any, b: Any) -> Any:
    """Cross products of rows; numpy's is slow on small arrays."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


class Spatial(Maximal):
    """Bodies in space: center of mass and unit quaternion; velocity, and angular velocity in the body's axes."""

    dim, per = 3, 6

    def __init__(self, mechanism: Mechanism, unit: Units, t0: float, poses: list[Pose]) -> None:
        self._angles: dict[int, float] = {}  # by body, of hinges that forces act on
        super().__init__(mechanism, unit, t0, poses)

    def _local(self, body: int, p: Any) -> Any:
        return np.asarray(p, float)

    def _global(self, p: Any) -> Any:
        return p

    def _in_plane(self, body: int, e: Any) -> tuple[Any, ...]:
        return (e,)

    def _normals(self, body: int, axis: Any) -> tuple[Any, ...]:
        return across(axis)

    def _hinge(self, tie: Tie) -> None:
        along = self._direction(tie.a, tie.pa)
        self._lists["across"] += [(along, self._direction(tie.b, e)) for e in across(tie.pb)]

    def _lock(self, tie: Tie) -> None:
        T = self.unit.time
        for k in range(3):
            mark = self._direction(tie.a, tie.pa[:, k])
            self._lists["across"].append((mark, self._direction(tie.b, tie.pb[:, (k + 1) % 3])))
            if tie.drive is not None:
                self._moving.append((mark, _Turned(tie.axis, tie.pa[:, k], tie.drive, T), tie.drive))

    def _inertia(self) -> Any:
        L, m, T = self.unit
        M = np.zeros((self.n, self.n))
        self._I = np.zeros((self.count, 3, 3))
        self._weight = np.zeros((self.count, 3))
        for k, body in enumerate(self.mechanism.bodies[1:]):
            self._I[k] = body.inertia / (m * L * L)
            self._weight[k] = body.mass / m * self.mechanism.gravity * T * T / L
            M[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = body.mass / m * np.eye(3)
            M[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = self._I[k]
        return M

    def _turned(self, x: Any) -> Any:
        """Rotation matrices (bodies, 3, 3), the ground's first."""
        p = np.empty((self.count + 1, 4))
        p[0] = 1.0, 0.0, 0.0, 0.0
        p[1:] = x.reshape(-1, 7)[:, 3:]
        p /= np.sqrt(dot(p, p))[:, None]
        w, a, b, c = p.T
        A = np.empty((self.count + 1, 3, 3))
        A[:, 0, 0], A[:, 0, 1], A[:, 0, 2] = 1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)
        A[:, 1, 0], A[:, 1, 1], A[:, 1, 2] = 2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)
        A[:, 2, 0], A[:, 2, 1], A[:, 2, 2] = 2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)
        return A

    def _kinematics(self, x: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        A = self._turned(x)
        r, u = np.zeros((self.count + 1, 3)), np.zeros((self.count + 1, 6))
        r[1:], u[1:] = x.reshape(-1, 7)[:, :3], v.reshape(-1, 6)
        body, p = self.body, self.local
        w = u[body, 3:]
        first = cross(w, p)
        both = np.empty((len(p), 3, 4))
        both[:, :, 0], both[:, :, 3] = p, self.slope
        both[:, :, 1] = first + self.slope
        both[:, :, 2] = cross(w, first + 2.0 * self.slope) + self.curve
        G = A[body] @ both
        self._A = A
        X = G[:, :, 0] + self.point * r[body]
        return X, G[:, :, 1] + self.point * u[body, :3], G[:, :, 2], G[:, :, 3]

    def _columns(self, F: Any) -> Any:
        out = np.empty((len(F), 6))
        out[:, :3] = F * self._entry_point
        turned = (F[:, None, :] @ self._A[self._entry_body])[:, 0]
        out[:, 3:] = cross(self._entry_local, turned)
        return out

    def _wrench(self, mark: int, push: Any) -> Any:
        turned = self._A[self.body[mark]].T @ push
        return np.r_[push * self.point[mark], np.cross(self.local[mark], turned)]

    def _own_forces(self, x: Any, v: Any) -> Any:
        f = np.empty((self.count, 6))
        w = v.reshape(-1, 6)[:, 3:]
        f[:, :3] = self._weight
        f[:, 3:] = -cross(w, np.einsum("kij,kj->ki", self._I, w))
        return f.ravel()

    def _hinge_state(self, body: Any, x: Any, v: Any) -> tuple[float, float]:
        A = self._turned(x)
        a, b, joint = body.parent, body.index, body.joint
        w = np.zeros((self.count + 1, 3))
        w[1:] = v.reshape(-1, 6)[:, 3:]
        angle = angle_about(joint.direction, joint_axes(joint).T @ A[a].T @ A[b])
        given = 0.0 if joint.start is None else float(np.squeeze(joint.start))
        rate = joint.direction @ (w[b] - A[b].T @ A[a] @ w[a])
        return near_angle(angle, self._angles.get(b, given)), float(rate)

    def _twist(self, f: Any, body: Any, torque: float) -> None:
        axis = body.joint.direction
        b, a = 6 * body.index, 6 * body.parent
        f[b - 3 : b] += torque * axis
        if body.parent > 0:
            f[a - 3 : a] -= torque * (joint_axes(body.joint) @ axis)

    def _torque(self, f: Any, body: int, x: Any, torque: Any) -> None:
        f[6 * body - 3 : 6 * body] += self._turned(x)[body].T @ torque

    def start(self) -> tuple[Any, Any]:
        L, _, T = self.unit
        x, v = np.empty((self.count, 7)), np.empty((self.count, 6))
        for k, body in enumerate(self.mechanism.bodies[1:]):
            pose = self.poses0[body.index]
            arm = pose.R @ body.com
            x[k, :3], x[k, 3:] = (pose.o + arm) / L, quaternion_of(pose.R)
            v[k, :3] = (pose.vo + np.cross(pose.w, arm)) * T / L
            v[k, 3:] = pose.R.T @ pose.w * T
        return x.ravel(), v.ravel()

    def rate(self, x: Any, v: Any) -> Any:
        out = np.empty((self.count, 7))
        u = v.reshape(-1, 6)
        out[:, :3] = u[:, :3]
        s, p, w = x.reshape(-1, 7)[:, 3], x.reshape(-1, 7)[:, 4:], u[:, 3:]
        out[:, 3] = -0.5 * dot(p, w)
        out[:, 4:] = 0.5 * (s[:, None] * w + cross(p, w))
        return out.ravel()

    def move(self, x: Any, d: Any) -> Any:
        out, step = x.reshape(-1, 7).copy(), d.reshape(-1, 6)
        out[:, :3] += step[:, :3]
        s, p, w = x.reshape(-1, 7)[:, 3], x.reshape(-1, 7)[:, 4:], 0.5 * step[:, 3:]
        out[:, 3] = s - dot(p, w)
        out[:, 4:] = p + s[:, None] * w + cross(p, w)
        out[:, 3:] /= np.sqrt(dot(out[:, 3:], out[:, 3:]))[:, None]
        return out.ravel()

    def poses(self, x: Any, v: Any) -> list[Pose]:
        L, _, T = self.unit
        found = [self.poses0[0]]
        for body, at, u in zip(self.mechanism.bodies[1:], x.reshape(-1, 7), v.reshape(-1, 6), strict=True):
            R = matrix_of(at[3:] / np.linalg.norm(at[3:]))
            w, arm = R @ u[3:] / T, R @ body.com
            found.append(Pose(R, at[:3] * L - arm, w, u[:3] * L / T - np.cross(w, arm)))
        return found

    def remember(self, x: Any, v: Any) -> None:
        for body, marks, _, _ in self._joints:
            if marks is None:
                self._angles[body.index] = self._hinge_state(body, x, v)[0]


class _Turned:
    """A direction that a drive turns about an axis of its body, with two derivatives."""

    def __init__(self, axis: Any, direction: Any, drive: Known, T: float) -> None:
        self.axis, self.direction, self.drive, self.T = axis, direction, drive, T

    def __call__(self, t: float) -> tuple[Any, Any, Any]:
        s, rate, second = self.drive(t * self.T)
        e = turning(self.axis, s) @ self.direction
        d = np.cross(self.axis, e)
        return e, rate * self.T * d, self.T**2 * (second * d + rate * rate * np.cross(self.axis, d))
