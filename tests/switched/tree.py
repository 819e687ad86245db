"""A drawn mechanism as arrays of :mod:`absolute`, and its state at the start."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from . import absolute
from .absolute import CONSTRAINED, DRIVEN, FREE, ROWS, Tree
from .drawn import FREEDOM, GROUND, KINDS, PRISMATIC, REVOLUTE, SPHERICAL, Drawn, Sensor

FIRST = {PRISMATIC: 0, REVOLUTE: 3, "universal": 3, SPHERICAL: 3}  # row of the first coordinate


def row_of(d: Drawn, part: int, coordinate: int = 0) -> int:
    """Row of a coordinate."""
    return ROWS * part + FIRST[d.parts[part].kind] + coordinate


def arrays(d: Drawn) -> Tree:
    """Return the arrays; the inertias that the bristles move follow in :func:`with_inertias`."""
    n, parts = len(d.parts), d.parts
    free = [row_of(d, k, c) for k, p in enumerate(parts) for c in range(FREEDOM[p.kind])]
    drive, elastic, pushed = np.zeros((n, 4)), np.zeros((ROWS * n, 3)), np.zeros((ROWS * n, 3))
    stops = np.tile((-np.inf, np.inf, 0.0, 0.0), (ROWS * n, 1))
    for k, p in enumerate(parts):
        r = row_of(d, k)
        if p.drive:
            drive[k] = p.drive.mean, p.drive.amplitude, p.drive.frequency, p.drive.phase
        if p.elastic:
            elastic[r] = p.elastic
        if p.load:
            pushed[r] = p.load.amplitude, p.load.frequency, p.load.phase
        if p.limits:
            stops[r] = p.limits
    rubbed: list[int] = []
    ball, friction, pulse = list[bool](), list[Any](), list[Any]()
    for f in d.frictions:
        is_ball = parts[f.part].kind == SPHERICAL
        for c in range(3) if is_ball else [f.coordinate]:
            rubbed.append(row_of(d, f.part, c))
            ball.append(is_ball)
            friction.append((f.coulomb, f.static, f.stribeck, f.viscous, f.deflection, 0.0))
            pulse.append((f.normal.amplitude, f.normal.frequency, f.normal.phase))
    return Tree(
        gravity=np.array(d.gravity),
        mass=np.array([p.mass for p in parts]),
        com=np.array([p.com for p in parts]),
        inertia=np.array([p.inertia for p in parts]),
        parent=np.array([p.parent for p in parts]),
        kind=np.array([KINDS.index(p.kind) for p in parts]),
        at=np.array([p.at for p in parts]),
        frame=np.array([p.frame for p in parts]),
        axes=np.array([p.axes for p in parts]),
        drive=drive,
        free=np.array(free),
        elastic=elastic,
        pushed=pushed,
        stops=stops,
        spring_ends=np.array([line.ends for line in d.lines], dtype=np.int64).reshape(-1, 2),
        spring_points=np.array([line.points for line in d.lines]).reshape(-1, 2, 3),
        springs=np.array([(s.stiffness, s.damping, s.free) for s in d.lines]).reshape(-1, 3),
        rubbed=np.array(rubbed, dtype=np.int64),
        ball=np.array(ball, dtype=np.bool_),
        friction=np.array(friction).reshape(-1, 6),
        pulse=np.array(pulse).reshape(-1, 3),
    )


def row_modes(d: Drawn) -> Any:
    """Mode (6 n) of each row when nothing is held."""
    modes = np.full(ROWS * len(d.parts), CONSTRAINED)
    for k, p in enumerate(d.parts):
        first = row_of(d, k)
        modes[first : first + FREEDOM[p.kind]] = DRIVEN if p.drive else FREE
    return modes


def start_state(d: Drawn, rubbed: int) -> Any:
    """Return y at the start: the bodies are placed one after the other along the tree."""
    n = len(d.parts)
    R, o, v, w, x = (np.zeros((n, 3)) for _ in range(5))
    turns: list[Rotation] = []
    q: list[float] = []
    quaternions = np.zeros((n, 4))
    none = np.zeros(3)
    for k, p in enumerate(d.parts):
        turn = Rotation.identity() if p.parent == GROUND else turns[p.parent]
        at_parent = [none] * 3 if p.parent == GROUND else [o[p.parent], v[p.parent], w[p.parent]]
        start, rate = p.start, p.rate
        if p.drive:
            phase = p.drive.phase
            start = [p.drive.mean + p.drive.amplitude * np.sin(phase)]
            rate = [p.drive.amplitude * p.drive.frequency * np.cos(phase)]
        F = turn * Rotation.from_matrix(p.frame)
        n_, m_ = F.apply(p.axes[0]), F.apply(p.axes[1])
        origin = at_parent[0] + turn.apply(p.at)
        spin = none
        if p.kind == PRISMATIC:
            turned, shift, slide = F, start[0] * n_, rate[0] * n_
        else:
            shift = slide = none
            if p.kind == REVOLUTE:
                turned, spin = Rotation.from_rotvec(start[0] * n_) * F, rate[0] * n_
            elif p.kind == SPHERICAL:
                turned = F * Rotation.from_quat(p.start, scalar_first=True)
                spin = turned.apply(rate)
            else:
                first = Rotation.from_rotvec(start[0] * n_)
                second = first.apply(m_)
                turned = Rotation.from_rotvec(start[1] * second) * first * F
                spin = rate[0] * n_ + rate[1] * second
        turns.append(turned)
        quaternions[k] = turned.as_quat(scalar_first=True)
        o[k] = origin + shift
        w[k] = at_parent[2] + spin
        v[k] = at_parent[1] + np.cross(at_parent[2], o[k] - at_parent[0]) + slide
        arm = turned.apply(p.com)
        x[k], R[k] = o[k] + arm, v[k] + np.cross(w[k], arm)  # R: velocities of the centers of mass
        q.extend([0.0] * 3 if p.kind == SPHERICAL else [float(s) for s in start])
    return np.concatenate((x.ravel(), quaternions.ravel(), R.ravel(), w.ravel(), q, np.zeros(rubbed)))


def with_inertias(d: Drawn, tree: Tree, y: Any) -> Tree:
    """Enter 1 / (g M^-1 g) of each row with friction, for the motions that all constraints allow."""
    _, G, _, _, inverse = absolute.kinematics(y, tree)
    C = G[row_modes(d) != FREE]
    moved = inverse @ C.T
    admitted = inverse - moved @ np.linalg.solve(C @ moved, moved.T)
    inertias = np.array([1.0 / (G[r] @ admitted @ G[r]) for r in tree.rubbed])
    first = 0
    while first < len(inertias):
        count = 3 if tree.ball[first] else 1
        tree.friction[first : first + count, 5] = inertias[first : first + count].mean()
        first += count
    return tree


def measured(d: Drawn, tree: Tree, y: Any, s: Sensor, known: Any = None) -> tuple[float, float, Any]:
    """Return a quantity, its rate, and the row (6 n) whose product with the velocities is the rate of a position.

    The rate of a sensor of rates is not returned: zero.
    """
    n = len(d.parts)
    R, G, _, rate, _ = known or absolute.kinematics(y, tree)
    if s.kind != "position":
        r = row_of(d, s.part)
        place = 13 * n + int(np.flatnonzero(tree.free == r)[0])
        return (float(y[place]), float(rate[r]), G[r]) if s.kind == "coordinate" else (float(rate[r]), 0.0, G[r])
    k = s.part
    arm = R[k] @ (s.point - tree.com[k])
    row = np.zeros(ROWS * n)
    row[6 * k : 6 * k + 3] = np.eye(3)[s.axis]
    row[6 * k + 3 : 6 * k + 6] = absolute.cross(arm, np.eye(3)[s.axis])
    velocity = np.column_stack((y[7 * n : 10 * n].reshape(n, 3), y[10 * n : 13 * n].reshape(n, 3))).ravel()
    return float(y[3 * k + s.axis] + arm[s.axis]), float(row @ velocity), row


def outputs(d: Drawn, tree: Tree, y: Any) -> Any:
    """Coordinates of joints, and for ball joints the center of mass."""
    n, found, place = len(d.parts), list[float](), 13 * len(d.parts)
    for k, p in enumerate(d.parts):
        freedom = FREEDOM[p.kind]
        found.extend(y[3 * k : 3 * k + 3] if p.kind == SPHERICAL else y[place : place + freedom])
        place += freedom
    assert n
    return np.array(found)


def finish(d: Drawn) -> Drawn:
    """Shift the values of events, which are drawn relative to the start."""
    tree = arrays(d)
    y = start_state(d, len(tree.rubbed))
    for event in d.events:
        if event.sensor and event.sensor.kind != "rate":
            event.value += measured(d, tree, y, event.sensor)[0]
    return d
