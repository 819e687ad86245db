"""Rigid bodies in maximal coordinates: every joint and every cut joint is a constraint between two free bodies.

Rows are written on marks. A mark is a point or a direction fixed in a body (or moving in it as a drive says); with X
its global components every row is of one of these forms, a Phi of at most second degree in the X:

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
from tree import (
    Known,
    NotCovered,
    Pose,
    Units,
    angle_about,
    cut_axes,
    joint_axes,
    known,
    matrix_of,
    near_angle,
    quaternion_of,
    turning,
)

from mbfmu.mechanics import (
    DistanceCut,
    Floating,
    JointForce,
    JointSpring,
    Mechanism,
    PlanarCut,
    PlaneCut,
    PointForce,
    Revolute,
    RevoluteCut,
    Spherical,
    SphericalCut,
    Spring,
    Torque,
    Translational,
    Weld,
    WeldCut,
)
from mbfmu.mechanics.joints.base import unit_axis


class Rows(NamedTuple):
    """The constraints at a state: Phi = 0, J v = nu, J v' = gamma."""

    Phi: Any
    J: Any
    nu: Any
    gamma: Any


class Tie(NamedTuple):
    """One constraint between bodies a and b; what p, r, length are depends on the kind."""

    kind: str
    a: int
    b: int
    pa: Any = None
    pb: Any = None
    axis: Any = None  # of a drive, in body a
    drive: Known | None = None
    length: float = 0.0


def ties(mechanism: Mechanism) -> list[Tie]:
    """Every joint and cut joint as ties: meet, hinge (axes parallel), lock (axes equal), slide, guide, apart."""
    found = []
    for body in mechanism.bodies[1:]:
        found += _of_joint(body.joint, body.parent, body.index)
    return found + cut_ties(mechanism)


def cut_ties(mechanism: Mechanism) -> list[Tie]:
    """Those of the cut joints."""
    return [tie for c in mechanism.cuts for tie in _of_cut(c.cut, c.a.index, c.b.index)]


def _of_joint(joint: Any, a: int, b: int) -> list[Tie]:
    at, F, zero = np.asarray(joint.at, float), joint_axes(joint), np.zeros(3)
    meet, lock = Tie("meet", a, b, at, zero), Tie("lock", a, b, F, np.eye(3))
    if isinstance(joint, Weld):
        return [meet, lock]
    if isinstance(joint, Spherical):
        return [meet]
    if isinstance(joint, Floating):
        return []
    axis = F @ joint.direction
    drive = None if joint.drive is None else known(joint.drive)
    if isinstance(joint, Revolute):
        if drive is None:
            return [meet, Tie("hinge", a, b, axis, joint.direction)]
        return [meet, lock._replace(axis=axis, drive=drive)]
    if isinstance(joint, Translational):
        if drive is not None:
            return [meet._replace(axis=axis, drive=drive), lock]
        return [lock, Tie("guide", a, b, (axis, at), zero)]
    raise NotCovered(f"joint {joint!r}")


def _of_cut(cut: Any, a: int, b: int) -> list[Tie]:
    at_a, at_b = np.asarray(cut.at_a, float), np.asarray(cut.at_b, float)
    Ra, Rb = cut_axes(cut.rotation_a), cut_axes(cut.rotation_b)
    meet, hinge = Tie("meet", a, b, at_a, at_b), Tie("hinge", a, b, Ra[:, 2], Rb[:, 2])
    slide = Tie("slide", a, b, (Ra[:, 2], at_a), at_b)
    match cut:
        case DistanceCut():
            return [Tie("apart", a, b, at_a, at_b, length=cut.length)]
        case SphericalCut():
            return [meet]
        case RevoluteCut():
            return [meet, hinge]
        case WeldCut():
            return [meet, Tie("lock", a, b, Ra, Rb)]
        case PlaneCut():
            return [slide]
        case PlanarCut():
            return [slide, hinge]
    raise NotCovered(f"cut {cut!r}")


def across(axis: Any) -> tuple[Any, Any]:
    """Two unit vectors that make a right-handed frame with a unit axis; exact where the axis is a coordinate axis."""
    e = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    e /= np.linalg.norm(e)
    return e, np.cross(axis, e)


def cross(a: Any, b: Any) -> Any:
    """Cross products of rows; numpy's is slow on small arrays."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


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
                    axis = self._global(unit_axis(force.axis) * T * T / (m * L))
                    self._loads.append((self._point(a.index, force.at_a), axis, known(force.magnitude)))
                case Torque():
                    axis = unit_axis(force.axis) * T * T / (m * L * L)
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
        self._flat = np.where(body[:, None] > 0, flat, self.m * self.n).ravel()  # the ground's go into a spare place
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
            Phi[perp] = _dot(X[i], X[j])
            gamma[perp] = -_dot(Xb[i], X[j]) - _dot(X[i], Xb[j]) - 2.0 * _dot(Xd[i], Xd[j])
        if len(e):
            d, dd = X[q] - X[p], Xd[q] - Xd[p]
            F[part[4]], F[part[5]], F[part[6]] = d, -X[e], X[e]
            Phi[slide] = _dot(X[e], d)
            gamma[slide] = -_dot(Xb[e], d) - _dot(X[e], Xb[q] - Xb[p]) - 2.0 * _dot(Xd[e], dd)
        if len(u):
            d, dd, L = X[w] - X[u], Xd[w] - Xd[u], self._length
            F[part[7]], F[part[8]] = -d / L[:, None], d / L[:, None]
            Phi[apart] = 0.5 * (_dot(d, d) / L - L)
            gamma[apart] = -(_dot(d, Xb[w] - Xb[u]) + _dot(dd, dd)) / L
        if self._moving:
            moved = _dot(F, drift[self._entry_mark])
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


def _dot(a: Any, b: Any) -> Any:
    return np.add.reduce(a * b, axis=1)


class Planar(Maximal):
    """Bodies in a plane: x, y of the centre of mass and an angle each."""

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
        out[:, 2] = _dot(F, self._swept[self._entry_mark])
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


class Spatial(Maximal):
    """Bodies in space: centre of mass and unit quaternion; velocity, and angular velocity in the body's axes."""

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
        p /= np.sqrt(_dot(p, p))[:, None]
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
        out[:, 3] = -0.5 * _dot(p, w)
        out[:, 4:] = 0.5 * (s[:, None] * w + cross(p, w))
        return out.ravel()

    def move(self, x: Any, d: Any) -> Any:
        out, step = x.reshape(-1, 7).copy(), d.reshape(-1, 6)
        out[:, :3] += step[:, :3]
        s, p, w = x.reshape(-1, 7)[:, 3], x.reshape(-1, 7)[:, 4:], 0.5 * step[:, 3:]
        out[:, 3] = s - _dot(p, w)
        out[:, 4:] = p + s[:, None] * w + cross(p, w)
        out[:, 3:] /= np.sqrt(_dot(out[:, 3:], out[:, 3:]))[:, None]
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


def normal_of(mechanism: Mechanism, poses: list[Pose]) -> Any:
    """Normal of the plane all bodies move in, from their poses; None where there is none."""
    axes = [poses[b.index].R @ b.joint.direction for b in mechanism.bodies[1:] if isinstance(b.joint, Revolute)]
    if not axes:
        return None
    n = axes[0]
    k = int(np.argmax(np.abs(n)))
    n = np.sign(n[k]) * n
    if abs(n[k] - 1.0) < 1e-14:
        n = np.eye(3)[k]
    found = True
    for body in mechanism.bodies[1:]:
        joint = body.joint
        if isinstance(joint, Revolute):
            found &= np.linalg.norm(np.cross(n, poses[body.index].R @ joint.direction)) < 1e-11
        elif isinstance(joint, Translational):
            found &= abs(n @ poses[body.index].R @ joint.direction) < 1e-11
        else:
            found &= isinstance(joint, Weld)
    for tie in ties(mechanism):
        if tie.kind == "hinge":
            found &= np.linalg.norm(np.cross(n, poses[tie.a].R @ tie.pa)) < 1e-11
        elif tie.kind == "slide":
            along = abs(n @ poses[tie.a].R @ tie.pa[0])
            found &= min(along, abs(along - 1.0)) < 1e-11
        elif tie.kind == "apart":
            found &= _level(n, poses, tie.a, tie.pa, tie.b, tie.pb)
    for _, force, a, b in mechanism.forces:
        if isinstance(force, Spring):
            found &= _level(n, poses, a.index, force.at_a, b.index, force.at_b)
    return n if found else None


def _level(n: Any, poses: list[Pose], a: int, pa: Any, b: int, pb: Any) -> bool:
    """Whether two points lie in one plane across n."""
    way = poses[b].o + poses[b].R @ np.asarray(pb) - poses[a].o - poses[a].R @ np.asarray(pa)
    return abs(float(n @ way)) < 1e-11 * max(1e-30, float(np.linalg.norm(pa)), float(np.linalg.norm(pb)))


def formulate(mechanism: Mechanism, unit: Units, t0: float, poses: list[Pose]) -> Maximal:
    """The mechanism in the plane if it moves in one, else in space."""
    normal = normal_of(mechanism, poses)
    if normal is None:
        return Spatial(mechanism, unit, t0, poses)
    return Planar(mechanism, unit, t0, poses, normal)
