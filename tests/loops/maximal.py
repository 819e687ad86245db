"""Rigid bodies in maximal coordinates: every joint and every cut joint is a constraint between two free bodies.

Equations are written in terms of marks. A mark is a point or a direction that is fixed in a body or moved in it by a
drive. With its global components X every equation has one of these forms, a Phi of at most second degree in the X:

    meet    X_b - X_a = 0                     two points coincide
    across  X_i . X_j = 0                     two directions stay perpendicular
    slide   X_e . (X_q - X_p) = 0             a point stays in a plane
    apart   (|X_q - X_p|^2 - L^2) / 2 L = 0   two points keep their distance
    angle   phi_b - phi_a - angle(t) = 0      in the plane only

Differentiating gives  J v = nu  and  J v' = gamma. All numbers are in units of the mechanism, see :func:`tree.units`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from ties import Tie, ties
from tree import Known, NotCovered, Pose, Units, joint_axes, known

from mbfmu.mechanics import JointForce, JointSpring, Mechanism, PointForce, Spring, Torque, Translational
from mbfmu.mechanics.axes import unit_axis


class Rows(NamedTuple):
    """The constraints at a state: Phi = 0, J v = nu, J v' = gamma."""

    Phi: Any
    J: Any
    nu: Any
    gamma: Any


def dot(a: Any, b: Any) -> Any:
    return np.add.reduce(a * b, axis=1)


class Maximal:
    """What the formulations in the plane and in space share: marks, rows on them, forces on them.

    Attributes
    ----------
    n
        Velocity coordinates: ``per`` a body.
    m
        Rows.
    M
        Mass matrix (n, n), constant.
    """

    dim: int
    per: int  # velocity coordinates a body

    def __init__(self, mechanism: Mechanism, unit: Units, t0: float, poses: list[Pose]) -> None:
        self.mechanism, self.unit, self.poses0 = mechanism, unit, poses
        self.count = len(mechanism.bodies) - 1
        self.n = self.per * self.count
        self._marks: list[tuple[int, Any, float]] = []  # body, components in it, 1 of a point and 0 of a direction
        self._moving: list[tuple[int, Any, Known]] = []  # mark, and (value, slope, curve) as functions of a drive
        self._lists: dict[str, list[Any]] = {"meet": [], "across": [], "slide": [], "apart": [], "angle": []}
        for tie in ties(mechanism):
            self._tie(tie)
        self._read_forces()
        self._freeze()
        self.M = self._inertia()

    # -- reading ---------------------------------------------------------------------------------------------------

    def _point(self, body: int, p: Any) -> int:
        """A new mark at a point of a body, SI units, the body's frame."""
        p = np.asarray(p, float) - self.mechanism.bodies[body].com
        self._marks.append((body, self._local(body, p / self.unit.length), 1.0))
        return len(self._marks) - 1

    def _direction(self, body: int, e: Any) -> int:
        """A new mark along a direction of a body."""
        self._marks.append((body, self._local(body, np.asarray(e, float)), 0.0))
        return len(self._marks) - 1

    def _tie(self, tie: Tie) -> None:
        match tie.kind:
            case "meet":
                a, b = self._point(tie.a, tie.pa), self._point(tie.b, tie.pb)
                self._lists["meet"] += [(a, b, k) for k in range(self.dim)]
                if tie.drive is not None:
                    self._shift(a, tie)
            case "slide" | "guide":
                e, at = tie.pa
                for normal in self._normals(tie.a, e) if tie.kind == "guide" else self._in_plane(tie.a, e):
                    points = self._point(tie.a, at), self._point(tie.b, tie.pb)
                    self._lists["slide"].append((self._direction(tie.a, normal), *points))
            case "apart":
                points = self._point(tie.a, tie.pa), self._point(tie.b, tie.pb)
                self._lists["apart"].append((*points, tie.length / self.unit.length))
            case "hinge":
                self._hinge(tie)
            case "lock":
                self._lock(tie)

    def _shift(self, mark: int, tie: Tie) -> None:
        """Let a drive move a point along an axis of its body."""
        start, axis = self._marks[mark][1], self._local(tie.a, tie.axis / self.unit.length)
        T, drive = self.unit.time, tie.drive
        assert drive is not None

        def place(t: float) -> tuple[Any, Any, Any]:
            s, rate, second = drive(t * T)
            return start + s * axis, rate * T * axis, second * T * T * axis

        self._moving.append((mark, place, drive))

    def _read_forces(self) -> None:
        L, m, T = self.unit
        self._springs, self._joints, self._loads, self._torques = [], [], [], []
        for name, force, a, b in self.mechanism.forces:
            match force:
                case Spring():
                    marks = self._point(a.index, force.at_a), self._point(b.index, force.at_b)
                    numbers = force.stiffness * T * T / m, force.damping * T / m, force.free / L
                    self._springs.append((*marks, *numbers))
                case JointSpring() | JointForce():
                    self._joints.append(self._on_joint(force, a))
                case PointForce():
                    axis = self._global(unit_axis(force.axis, "axis") * T * T / (m * L))
                    self._loads.append((self._point(a.index, force.at_a), axis, known(force.magnitude)))
                case Torque():
                    axis = unit_axis(force.axis, "axis") * T * T / (m * L * L)
                    self._torques.append((a.index, axis, known(force.magnitude)))
                case _:
                    raise NotCovered(f"force {name!r}: {force!r}")

    def _on_joint(self, force: Any, body: Any) -> tuple[Any, ...]:
        """Body, marks of a translational joint or None, and the law: generalized force of (t, s, rate of s)."""
        L, m, T = self.unit
        slides = isinstance(body.joint, Translational)
        size = L if slides else 1.0
        in_unit = T * T / (m * L * L) * size
        if isinstance(force, JointForce):
            signal = known(force.magnitude)

            def law(t: float, s: float, rate: float) -> float:
                return signal(t * T)[0] * in_unit

            stored = None
        else:

            def law(t: float, s: float, rate: float) -> float:
                return -in_unit * (force.stiffness * (s * size - force.free) + force.damping * rate * size / T)

            def stored(s: float) -> float:
                return 0.5 * force.stiffness * (s * size - force.free) ** 2

        marks = None
        if slides:
            joint, a = body.joint, body.parent
            e = self._direction(a, joint_axes(joint) @ joint.direction)
            marks = e, self._point(a, joint.at), self._point(body.index, np.zeros(3))
        return body, marks, law, stored

    def _freeze(self) -> None:
        """Turn lists into index arrays."""
        d, per = self.dim, self.per
        self.body = np.array([k[0] for k in self._marks], int)
        self.local = np.array([k[1] for k in self._marks], float).reshape(-1, d)
        self.point = np.array([k[2] for k in self._marks], float)[:, None]
        self.slope, self.curve = np.zeros_like(self.local), np.zeros_like(self.local)
        lists = self._lists
        self._meet = np.array(lists["meet"], int).reshape(-1, 3)
        self._across = np.array(lists["across"], int).reshape(-1, 2)
        self._slide = np.array(lists["slide"], int).reshape(-1, 3)
        self._apart = np.array([k[:2] for k in lists["apart"]], int).reshape(-1, 2)
        self._length = np.array([k[2] for k in lists["apart"]], float)
        self._columns_of = self._meet.T, self._across.T, self._slide.T, self._apart.T
        sizes = [len(k) for k in (self._meet, self._across, self._slide, self._apart, lists["angle"])]
        ends = np.cumsum([0, *sizes])
        self._at = [slice(a, b) for a, b in pairwise(ends)]
        self.m = int(ends[-1])
        rows = [np.arange(s.start, s.stop) for s in self._at]
        a, b, k = self._meet.T
        (i, j), (e, p, q), (u, w) = self._across.T, self._slide.T, self._apart.T
        self._entry_row = np.concatenate((rows[0], rows[0], rows[1], rows[1], *(rows[2],) * 3, *(rows[3],) * 2))
        self._entry_mark = np.concatenate((a, b, i, j, e, p, q, u, w))
        parts = np.cumsum([0, *(len(x) for x in (a, b, i, j, e, p, q, u, w))])
        self._part = [slice(x, y) for x, y in pairwise(parts)]
        self._F = np.zeros((len(self._entry_mark), d))
        self._F[self._part[0]] = -np.eye(d)[k]
        self._F[self._part[1]] = np.eye(d)[k]
        body = self.body[self._entry_mark]
        column = per * (body[:, None] - 1) + np.arange(per)
        flat = self._entry_row[:, None] * self.n + column
        self._flat = np.where(body[:, None] > 0, flat, self.m * self.n).ravel()  # ground: after the last one, unused
        self._entry_body = body
        self._entry_local, self._entry_point = self.local[self._entry_mark], self.point[self._entry_mark]
        self._J_angle = np.zeros((sizes[4], self.n))
        for row, (a_, b_, _) in enumerate(lists["angle"]):
            for sign, k_ in ((-1.0, a_), (1.0, b_)):
                if k_ > 0:
                    self._J_angle[row, per * k_ - 1] += sign

    # -- evaluating ------------------------------------------------------------------------------------------------

    def rows(self, t: float, x: Any, v: Any) -> Rows:
        """The constraints at time t."""
        for mark, place, _ in self._moving:
            self.local[mark], self.slope[mark], self.curve[mark] = place(t)
        if self._moving:
            self._entry_local = self.local[self._entry_mark]
        X, Xd, Xb, drift = self._kinematics(x, v)
        (a, b, k), (i, j), (e, p, q), (u, w) = self._columns_of
        Phi, nu, gamma = np.empty(self.m), np.zeros(self.m), np.empty(self.m)
        meet, perp, slide, apart, angle = self._at
        F, part = self._F, self._part
        Phi[meet] = X[b, k] - X[a, k]
        gamma[meet] = Xb[a, k] - Xb[b, k]
        if len(i):
            F[part[2]], F[part[3]] = X[j], X[i]
            Phi[perp] = dot(X[i], X[j])
            gamma[perp] = -dot(Xb[i], X[j]) - dot(X[i], Xb[j]) - 2.0 * dot(Xd[i], Xd[j])
        if len(e):
            d, dd = X[q] - X[p], Xd[q] - Xd[p]
            F[part[4]], F[part[5]], F[part[6]] = d, -X[e], X[e]
            Phi[slide] = dot(X[e], d)
            gamma[slide] = -dot(Xb[e], d) - dot(X[e], Xb[q] - Xb[p]) - 2.0 * dot(Xd[e], dd)
        if len(u):
            d, dd, L = X[w] - X[u], Xd[w] - Xd[u], self._length
            F[part[7]], F[part[8]] = -d / L[:, None], d / L[:, None]
            Phi[apart] = 0.5 * (dot(d, d) / L - L)
            gamma[apart] = -(dot(d, Xb[w] - Xb[u]) + dot(dd, dd)) / L
        if self._moving:
            moved = dot(F, drift[self._entry_mark])
            nu -= np.bincount(self._entry_row, moved, self.m)
        J = np.bincount(self._flat, self._columns(F).ravel(), self.m * self.n + 1)[:-1].reshape(self.m, self.n)
        if angle.stop > angle.start:
            self._angle_rows(t, x, J, Phi, nu, gamma)
        self._seen = X, Xd
        return Rows(Phi, J, nu, gamma)

    def _angle_rows(self, t: float, x: Any, J: Any, Phi: Any, nu: Any, gamma: Any) -> None:
        T, angle = self.unit.time, self._at[4]
        J[angle] = self._J_angle
        for row, (_, _, law) in enumerate(self._lists["angle"], angle.start):
            s, rate, second = law(t * T)
            Phi[row] = J[row] @ x - s
            nu[row], gamma[row] = rate * T, second * T * T

    def forces(self, t: float, x: Any, v: Any) -> Any:
        """Generalized forces (n,) of gravity, springs, joints, loads and of the bodies' own turning.

        To be called after :meth:`rows` of the same state.
        """
        f = self._own_forces(x, v)
        X, Xd = self._seen
        for a, b, stiffness, damping, free in self._springs:
            d, dd = X[b] - X[a], Xd[b] - Xd[a]
            length = float(np.sqrt(d @ d))
            push = (stiffness * (length - free) + damping * float(d @ dd) / length) / length * d
            self._push(f, a, push)
            self._push(f, b, -push)
        for body, marks, law, _ in self._joints:
            if marks is None:
                s, rate = self._hinge_state(body, x, v)
                self._twist(f, body, law(t, s, rate))
            else:
                e, p, q = marks
                d, dd = X[q] - X[p], Xd[q] - Xd[p]
                push = law(t, float(X[e] @ d), float(X[e] @ dd + Xd[e] @ d))
                for mark, way in ((e, d), (q, X[e]), (p, -X[e])):
                    self._push(f, mark, push * way)
        for mark, axis, signal in self._loads:
            self._push(f, mark, signal(t * self.unit.time)[0] * axis)
        for body, axis, signal in self._torques:
            self._torque(f, body, x, signal(t * self.unit.time)[0] * axis)
        return f

    def energy(self, t: float, x: Any, v: Any) -> float:
        """Kinetic energy and that of gravity and springs, J."""
        X, _, _, _ = self._kinematics(x, v)
        L, m, T = self.unit
        stored = 0.0
        for a, b, stiffness, _, free in self._springs:
            stored += 0.5 * stiffness * (float(np.linalg.norm(X[b] - X[a])) - free) ** 2
        lifted = 0.0
        for body, pose in zip(self.mechanism.bodies[1:], self.poses(x, v)[1:], strict=True):
            lifted -= body.mass * float(self.mechanism.gravity @ (pose.o + pose.R @ body.com))
        for body, marks, _, stored_at in self._joints:
            if stored_at is not None:
                s = self._hinge_state(body, x, v)[0]
                if marks is not None:
                    e, p, q = marks
                    s = float(X[e] @ (X[q] - X[p]))
                lifted += stored_at(s)
        return float(0.5 * v @ self.M @ v + stored) * m * L * L / T**2 + lifted

    def _push(self, f: Any, mark: int, push: Any) -> None:
        """Add the force on a mark."""
        body = int(self.body[mark])
        if body > 0:
            here = slice(self.per * (body - 1), self.per * body)
            f[here] += self._wrench(mark, push)

    # -- what plane and space do differently -----------------------------------------------------------------------

    def _local(self, body: int, p: Any) -> Any:
        raise NotImplementedError

    def _global(self, p: Any) -> Any:
        raise NotImplementedError

    def _in_plane(self, body: int, e: Any) -> tuple[Any, ...]:
        """The direction itself, nothing where it leaves the plane."""
        raise NotImplementedError

    def _normals(self, body: int, axis: Any) -> tuple[Any, ...]:
        """Directions across the axis of a slider."""
        raise NotImplementedError

    def _hinge(self, tie: Tie) -> None:
        raise NotImplementedError

    def _lock(self, tie: Tie) -> None:
        raise NotImplementedError

    def _inertia(self) -> Any:
        raise NotImplementedError

    def _kinematics(self, x: Any, v: Any) -> tuple[Any, Any, Any, Any]:
        """X, X' and what X'' and X' are without v' and v, of every mark; stays valid for _columns and _wrench."""
        raise NotImplementedError

    def _columns(self, F: Any) -> Any:
        """F dX of every entry by the velocity coordinates of its body."""
        raise NotImplementedError

    def _wrench(self, mark: int, push: Any) -> Any:
        raise NotImplementedError

    def _own_forces(self, x: Any, v: Any) -> Any:
        raise NotImplementedError

    def _hinge_state(self, body: Any, x: Any, v: Any) -> tuple[float, float]:
        raise NotImplementedError

    def _twist(self, f: Any, body: Any, torque: float) -> None:
        raise NotImplementedError

    def _torque(self, f: Any, body: int, x: Any, torque: Any) -> None:
        raise NotImplementedError

    def start(self) -> tuple[Any, Any]:
        """Positions and velocities of the poses given."""
        raise NotImplementedError

    def rate(self, x: Any, v: Any) -> Any:
        """x'."""
        raise NotImplementedError

    def move(self, x: Any, d: Any) -> Any:
        """Positions after a small displacement (n,)."""
        raise NotImplementedError

    def poses(self, x: Any, v: Any) -> list[Pose]:
        """Poses, SI units."""
        raise NotImplementedError

    def remember(self, x: Any, v: Any) -> None:
        """Take note of an accepted state: angles are counted on from there."""
