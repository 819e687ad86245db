"""Maximal coordinates in a plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from maximal import Maximal, dot
from ties import Tie, across
from tree import Pose, Units, joint_axes, near_angle, turning

from mbfmu.mechanics import Mechanism


class Planar(Maximal):
    """Bodies in a plane: x, y of the center of mass and an angle each."""

    dim, per = 2, 3

    def __init__(self, mechanism: Mechanism, unit: Units, t0: float, poses: list[Pose], normal: Any) -> None:
        self.normal = normal
        self._frames = [self._frame(pose.R.T @ normal) for pose in poses]
        E1, E2 = self._frames[0]
        self._phi0 = [
            float(np.arctan2(E2 @ pose.R @ b, E1 @ pose.R @ b))
            for pose, (b, _) in zip(poses, self._frames, strict=True)
        ]
        self._t0 = t0
        self._hinges: dict[int, tuple[float, float]] = {}
        super().__init__(mechanism, unit, t0, poses)

    @staticmethod
    def _frame(normal: Any) -> tuple[Any, Any]:
        """In-plane axes of a body, exact where the normal is a coordinate axis."""
        k = int(np.argmax(np.abs(normal)))
        if abs(abs(normal[k]) - 1.0) < 1e-14:
            normal = np.sign(normal[k]) * np.eye(3)[k]
        return across(normal / np.linalg.norm(normal))

    def _local(self, body: int, p: Any) -> Any:
        b1, b2 = self._frames[body]
        return np.array((b1 @ p, b2 @ p))

    def _global(self, p: Any) -> Any:
        return self._local(0, p)

    def _in_plane(self, body: int, e: Any) -> tuple[Any, ...]:
        return (e,) if np.linalg.norm(self._local(body, e)) > 0.5 else ()

    def _normals(self, body: int, axis: Any) -> tuple[Any, ...]:
        return (np.cross(np.cross(*self._frames[body]), axis),)

    def _hinge(self, tie: Tie) -> None:
        """Nothing: all bodies turn about one normal."""

    def _lock(self, tie: Tie) -> None:
        (a1, a2), (b1, _) = self._frames[tie.a], self._frames[tie.b]
        along = tie.pa @ tie.pb.T @ b1
        offset = float(np.arctan2(along @ a2, along @ a1))
        start = self._phi0[tie.b] - self._phi0[tie.a]
        if tie.drive is None:
            offset = near_angle(offset, start)
            self._lists["angle"].append((tie.a, tie.b, lambda t: (offset, 0.0, 0.0)))
            return
        drive, sign = tie.drive, float(np.sign(tie.axis @ np.cross(a1, a2)))
        s0 = drive(self._t0)[0]
        offset = near_angle(offset + sign * s0, start) - sign * s0
        self._lists["angle"].append((tie.a, tie.b, lambda t: _affine(offset, sign, drive(t))))

    def _inertia(self) -> Any:
        L, m, _ = self.unit
        diagonal = np.empty((self.count, 3))
        for k, body in enumerate(self.mechanism.bodies[1:]):
            b1, b2 = self._frames[body.index]
            n = np.cross(b1, b2)
            diagonal[k] = body.mass / m, body.mass / m, float(n @ body.inertia @ n) / (m * L * L)
        g = self._global(self.mechanism.gravity) * self.unit.time**2 / L
        self._weight = np.zeros((self.count, 3))
        self._weight[:, :2] = diagonal[:, :2] * g
        return np.diag(diagonal.ravel())

    def _kinematics(self, x: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        r, u = np.zeros((self.count + 1, 3)), np.zeros((self.count + 1, 3))
        r[1:], u[1:] = x.reshape(-1, 3), v.reshape(-1, 3)
        r[0, 2] = self._phi0[0]
        c, s, w = np.cos(r[:, 2])[self.body], np.sin(r[:, 2])[self.body], u[self.body, 2]
        turned = _rotate(c, s, self.local)
        swept = np.empty_like(turned)
        swept[:, 0], swept[:, 1] = -turned[:, 1], turned[:, 0]
        X = turned + self.point * r[self.body, :2]
        Xd = w[:, None] * swept + self.point * u[self.body, :2]
        Xb, drift = -(w * w)[:, None] * turned, self.slope
        if self._moving:
            drift, second = _rotate(c, s, self.slope), _rotate(c, s, self.curve)
            Xd = Xd + drift
            Xb = Xb + second + 2.0 * w[:, None] * np.stack((-drift[:, 1], drift[:, 0]), axis=1)
        self._swept = swept
        return X, Xd, Xb, drift

    def _columns(self, F: Any) -> Any:
        out = np.empty((len(F), 3))
        out[:, :2] = F * self._entry_point
        out[:, 2] = dot(F, self._swept[self._entry_mark])
        return out

    def _wrench(self, mark: int, push: Any) -> Any:
        return np.r_[push * self.point[mark], push @ self._swept[mark]]

    def _own_forces(self, x: Any, v: Any) -> Any:
        return self._weight.ravel().copy()

    def _hinge_at(self, body: Any) -> tuple[float, float]:
        """Sign and offset of a hinge: its angle is sign (phi_b - phi_a) - offset."""
        if body.index not in self._hinges:
            (a1, a2), (b1, b2) = self._frames[body.parent], self._frames[body.index]
            sign = float(np.sign(body.joint.direction @ np.cross(b1, b2)))
            along = joint_axes(body.joint) @ b1
            rest = sign * float(np.arctan2(along @ a2, along @ a1))
            start = sign * (self._phi0[body.index] - self._phi0[body.parent])
            given = 0.0 if body.joint.start is None else float(np.squeeze(body.joint.start))
            self._hinges[body.index] = sign, start - near_angle(start - rest, given)
        return self._hinges[body.index]

    def _hinge_state(self, body: Any, x: Any, v: Any) -> tuple[float, float]:
        a, b = body.parent, body.index
        sign, offset = self._hinge_at(body)
        phi, w = (x[3 * a - 1], v[3 * a - 1]) if a > 0 else (self._phi0[0], 0.0)
        return sign * (x[3 * b - 1] - phi) - offset, sign * (v[3 * b - 1] - w)

    def _twist(self, f: Any, body: Any, torque: float) -> None:
        torque *= self._hinge_at(body)[0]
        f[3 * body.index - 1] += torque
        if body.parent > 0:
            f[3 * body.parent - 1] -= torque

    def _torque(self, f: Any, body: int, x: Any, torque: Any) -> None:
        f[3 * body - 1] += torque @ self.normal

    def start(self) -> tuple[Any, Any]:
        L, _, T = self.unit
        x, v = np.empty((self.count, 3)), np.empty((self.count, 3))
        for k, body in enumerate(self.mechanism.bodies[1:]):
            pose = self.poses0[body.index]
            arm = pose.R @ body.com
            x[k, :2], x[k, 2] = self._global(pose.o + arm) / L, self._phi0[body.index]
            v[k, :2] = self._global(pose.vo + np.cross(pose.w, arm)) * T / L
            v[k, 2] = pose.w @ self.normal * T
        return x.ravel(), v.ravel()

    def rate(self, x: Any, v: Any) -> Any:
        return v

    def move(self, x: Any, d: Any) -> Any:
        return x + d

    def poses(self, x: Any, v: Any) -> list[Pose]:
        L, _, T = self.unit
        E1, E2 = self._frames[0]
        found = [self.poses0[0]]
        for body, (px, py, phi), (vx, vy, w) in zip(
            self.mechanism.bodies[1:], x.reshape(-1, 3), v.reshape(-1, 3), strict=True
        ):
            start = self.poses0[body.index]
            R = turning(self.normal, phi - self._phi0[body.index]) @ start.R
            arm, spin = R @ body.com, self.normal * w / T
            height = self.normal * float(self.normal @ (start.o + start.R @ body.com))
            o = (px * E1 + py * E2) * L + height - arm
            found.append(Pose(R, o, spin, (vx * E1 + vy * E2) * L / T - np.cross(spin, arm)))
        return found


def _rotate(c: Any, s: Any, p: Any) -> Any:
    out = np.empty_like(p)
    out[:, 0] = c * p[:, 0] - s * p[:, 1]
    out[:, 1] = s * p[:, 0] + c * p[:, 1]
    return out


def _affine(offset: float, sign: float, values: tuple[float, float, float]) -> tuple[float, float, float]:
    return offset + sign * values[0], sign * values[1], sign * values[2]
