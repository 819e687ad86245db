"""Random mechanisms with friction, stops and events, described without mbfmu and without the reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

REVOLUTE, PRISMATIC, UNIVERSAL, SPHERICAL = KINDS = ("revolute", "prismatic", "universal", "spherical")
FREEDOM = {REVOLUTE: 1, PRISMATIC: 1, UNIVERSAL: 2, SPHERICAL: 3}
G = 9.81
GROUND = -1
BRISTLES, STIFF_BRISTLES = (-3.3, -2.3), (-6.5, -5.5)  # powers of ten of the deflection, in rad or lengths


@dataclass
class Wave:
    """mean + amplitude sin(frequency t + phase); frequency in rad/s."""

    mean: float = 0.0
    amplitude: float = 0.0
    frequency: float = 1.0
    phase: float = 0.0


@dataclass
class Part:
    """Body and the joint to its parent."""

    kind: str
    parent: int
    at: Any
    frame: Any  # (3, 3)
    axes: Any  # (3, 3): rows are the axis and two normals to it
    mass: float
    com: Any
    inertia: Any  # (3, 3)
    start: Any  # coordinates, or a quaternion
    rate: Any
    drive: Wave | None = None
    elastic: tuple[float, float, float] | None = None  # stiffness, damping, unloaded coordinate
    load: Wave | None = None  # its mean is an input
    limits: tuple[float, float, float, float] | None = None  # lower, upper, stiffness, damping


@dataclass
class Friction:
    """Dry friction on a coordinate, or in a ball joint."""

    part: int
    coordinate: int
    coulomb: float
    static: float
    stribeck: float
    viscous: float
    deflection: float
    normal: Wave  # its mean is an input if there is no amplitude


@dataclass
class Line:
    """Spring-damper between two points."""

    ends: tuple[int, int]
    points: Any  # (2, 3)
    stiffness: float
    damping: float
    free: float


@dataclass
class Sensor:
    """Coordinate or rate of a joint, or a position of a point along a ground axis."""

    kind: str
    part: int
    axis: int = 0
    point: Any = None


@dataclass
class Event:
    """Crossing of a value, or a time, and what happens."""

    name: str
    sensor: Sensor | None
    value: float  # or the time
    direction: int  # 1, -1, 0: both
    actions: list[tuple[Any, ...]]


@dataclass
class Drawn:
    """A random mechanism; length in m, time in s and force in N are its units."""

    seed: int
    length: float
    time: float
    force: float
    gravity: Any
    stop_time: float
    parts: list[Part] = field(default_factory=list)
    frictions: list[Friction] = field(default_factory=list)
    lines: list[Line] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    @property
    def has_bristles(self) -> bool:
        """Whether the reference has the elastic bristles of mbfmu; else its friction is set-valued."""
        return self.seed % 2 == 0

    def unit(self, part: int) -> float:
        """Unit of the coordinates of a joint: rad or the length."""
        return self.length if self.parts[part].kind == PRISMATIC else 1.0


def turned(rng: np.random.Generator) -> Any:
    """Random rotation matrix."""
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def normals(axis: Any) -> Any:
    """Return a unit vector and two normals to it, as rows."""
    n = axis / np.linalg.norm(axis)
    e = np.cross(n, np.eye(3)[np.argmin(abs(n))])
    e = e / np.linalg.norm(e)
    return np.array((n, e, np.cross(n, e)))


def draw(seed: int) -> Drawn:
    """Draw a mechanism of 1 to 8 joints."""
    rng = np.random.default_rng(seed)
    length, mass = (float(10.0 ** rng.uniform(-3.0, 3.0)) for _ in range(2))
    time = float(np.sqrt(length / G))
    planar = bool(rng.random() < 0.4)
    d = Drawn(seed, length, time, mass * G, np.array((0.0, -G, 0.0)), float(rng.uniform(3.0, 6.0)) * time)
    count = int(rng.choice(range(1, 9), p=[0.2, 0.2, 0.18, 0.14, 0.1, 0.07, 0.06, 0.05]))
    for k in range(count):
        d.parts.append(_part(d, k, planar, mass, rng))
    beyond = _carried(d)
    _frictions(d, beyond, rng)
    _forces(d, beyond, planar, rng)
    _events(d, beyond, planar, rng)
    return d


def _part(d: Drawn, k: int, planar: bool, mass: float, rng: np.random.Generator) -> Part:
    chain = k and rng.random() < 0.7
    parent = k - 1 if chain or not k else int(rng.integers(-1, k))
    kinds = (REVOLUTE, PRISMATIC) if planar else KINDS
    kind = str(rng.choice(kinds, p=[0.65, 0.35] if planar else [0.45, 0.25, 0.15, 0.15]))
    L, T = d.length, d.time
    if planar:
        angle = rng.uniform(-np.pi, np.pi)
        along = np.array((np.cos(angle), np.sin(angle), 0.0))
        axes = normals(np.array((0.0, 0.0, 1.0)) if kind == REVOLUTE else along)
        frame, flat = np.eye(3), np.array((1.0, 1.0, 0.0))
    else:
        axes, frame, flat = normals(rng.normal(size=3)), turned(rng), np.ones(3)
    at = flat * rng.normal(size=3) * 0.5 * L if k else np.zeros(3)
    com = flat * rng.normal(size=3)
    com = com / np.linalg.norm(com) * L * rng.uniform(0.2, 0.8)
    m = mass * float(10.0 ** rng.uniform(-0.7, 0.7))
    points = rng.normal(size=(5, 3)) * 0.4 * L
    inertia = m / 5.0 * sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points)
    if planar:
        inertia = np.diag(np.diag(inertia))
    freedom, unit = FREEDOM[kind], L if kind == PRISMATIC else 1.0
    start = rng.uniform(-1.0, 1.0, freedom) * (0.5 if kind == PRISMATIC else 2.0) * unit
    if kind == SPHERICAL:
        start = rng.normal(size=4)
        start = start / np.linalg.norm(start)
    rate = rng.normal(size=freedom) * unit / T * float(rng.choice([0.0, 0.7]))
    drive = None
    if FREEDOM[kind] == 1 and k == 0 and rng.random() < 0.12:
        drive = _wave(d, 0.3 * unit, rng)
    return Part(kind, parent, at, frame, axes, m, com, inertia, start, rate, drive)


def _wave(d: Drawn, amplitude: float, rng: np.random.Generator, mean: float = 0.0) -> Wave:
    return Wave(mean, amplitude, float(rng.uniform(0.7, 3.0)) / d.time, float(rng.uniform(-np.pi, np.pi)))


def _carried(d: Drawn) -> Any:
    """Mass (n,) of each body and those that it carries."""
    mass = np.array([p.mass for p in d.parts])
    for k in range(len(mass) - 1, 0, -1):
        if d.parts[k].parent >= 0:
            mass[d.parts[k].parent] += mass[k]
    return mass


def _frictions(d: Drawn, beyond: Any, rng: np.random.Generator) -> None:
    decades = BRISTLES if d.has_bristles else STIFF_BRISTLES
    for k, part in enumerate(d.parts):
        if part.drive or rng.random() < (0.15 if k else 0.0) or (part.kind == SPHERICAL and not d.has_bristles):
            continue
        coordinates = [0] if part.kind == SPHERICAL else range(FREEDOM[part.kind])
        for c in coordinates:
            unit = d.unit(k)
            size = float(beyond[k] * G * d.length / unit * 10.0 ** rng.uniform(-1.5, -0.2))
            scale = float(10.0 ** rng.uniform(-1.0, 1.0))  # of the normal force
            static = float(rng.choice([1.0, 1.0, rng.uniform(1.1, 1.6)]))
            normal = Wave(scale)
            if rng.random() < 0.15:
                normal = _wave(d, 0.6 * scale, rng, scale)
            d.frictions.append(
                Friction(
                    part=k,
                    coordinate=c,
                    coulomb=size / scale,
                    static=static * size / scale,
                    stribeck=float(rng.uniform(0.2, 0.8)) * unit / d.time,
                    viscous=float(rng.choice([0.0, 0.1])) * size * d.time / unit,
                    deflection=float(10.0 ** rng.uniform(*decades)) * unit,
                    normal=normal,
                )
            )


def _forces(d: Drawn, beyond: Any, planar: bool, rng: np.random.Generator) -> None:
    for k, part in enumerate(d.parts):
        if FREEDOM[part.kind] > 1 or part.drive:
            continue
        unit = d.unit(k)
        weight = float(beyond[k]) * G * d.length / unit  # generalized force of a coordinate
        if part.kind == PRISMATIC or rng.random() < 0.4:
            stiffness = weight / unit * float(10.0 ** rng.uniform(-0.3, 1.0))
            damping = float(rng.choice([0.0, 0.05])) * weight * d.time / unit
            part.elastic = stiffness, damping, float(rng.uniform(-0.5, 0.5)) * unit
        if rng.random() < 0.5:
            part.load = _wave(d, weight * float(rng.choice([0.0, 0.5, 1.0])), rng, weight * rng.uniform(-0.5, 0.5))
        if rng.random() < 0.2:
            low, high = (float(part.start[0] + s * rng.uniform(0.1, 0.8) * unit) for s in (-1.0, 1.0))
            part.limits = low, high, 300.0 * weight / unit, float(rng.uniform(0.0, 0.5)) * d.time / unit
    if rng.random() < 0.4:
        b = int(rng.integers(0, len(d.parts)))
        a = int(rng.integers(-1, b + 1))
        a = GROUND if a == b else a
        points = rng.normal(size=(2, 3)) * d.length
        points[0] *= 2.0
        if planar:
            points[:, 2] = (0.0, 0.3 * d.length)
        stiffness = float(beyond[b]) * G / d.length * float(rng.uniform(0.3, 3.0))
        d.lines.append(
            Line((a, b), points, stiffness, 0.05 * stiffness * d.time, float(rng.uniform(0.5, 1.5)) * d.length)
        )


def _sensor(d: Drawn, kinds: tuple[str, ...], planar: bool, rng: np.random.Generator) -> tuple[Sensor, float]:
    """Return a sensor and its unit."""
    kind, part = str(rng.choice(kinds)), int(rng.integers(0, len(d.parts)))
    if kind == "position" or FREEDOM[d.parts[part].kind] > 1 or d.parts[part].drive:
        axis = int(rng.integers(0, 2 if planar else 3))
        point = rng.normal(size=3) * d.length * (np.array((1.0, 1.0, 0.0)) if planar else 1.0)
        return Sensor("position", part, axis, point), d.length
    return Sensor(kind, part), d.unit(part) / (d.time if kind == "rate" else 1.0)


def _events(d: Drawn, beyond: Any, planar: bool, rng: np.random.Generator) -> None:
    """Draw up to two stops and up to three other events; their values are relative to the start."""
    for _ in range(int(rng.choice([0, 1, 2], p=[0.4, 0.4, 0.2]))):
        sensor, unit = _sensor(d, ("coordinate", "position"), planar, rng)
        side = int(rng.choice([-1, 1]))
        bounce = ("bounce", float(rng.uniform(0.3, 1.0)))
        d.events.append(
            Event(f"stop{len(d.events)}", sensor, side * float(rng.uniform(0.1, 0.8)) * unit, side, [bounce])
        )
    plain = [k for k, p in enumerate(d.parts) if FREEDOM[p.kind] == 1 and not p.drive]
    inputs = [k for k in plain if d.parts[k].load]
    grips = [i for i, f in enumerate(d.frictions) if not f.normal.amplitude]
    springs = [k for k in plain if d.parts[k].elastic]
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.2, 0.4, 0.25, 0.15]))):
        name, how = f"event{len(d.events)}", rng.random()
        actions: list[tuple[Any, ...]] = []
        choice = str(
            rng.choice(["load", "grip", "impulse", "lock", "stiffness", "end"], p=[0.25, 0.25, 0.2, 0.15, 0.12, 0.03])
        )
        if choice == "load" and inputs:
            k = int(rng.choice(inputs))
            actions = [("load", k, float(beyond[k]) * G * d.length / d.unit(k) * float(rng.uniform(-1.0, 1.0)))]
        elif choice == "grip" and grips:
            i = int(rng.choice(grips))
            actions = [("grip", i, d.frictions[i].normal.mean * float(rng.choice([0.0, 0.3, 2.0, 5.0])))]
        elif choice == "impulse" and plain:
            k = int(rng.choice(plain))
            part, unit = d.parts[k], d.unit(k)
            actions = [("impulse", k, part.mass * d.length**2 / unit / d.time * float(rng.uniform(-0.7, 0.7)))]
        elif choice == "lock" and plain:
            k = int(rng.choice(plain))
            begin = float(rng.uniform(0.1, 0.5)) * d.stop_time
            if not any(a[0] == "lock" for e in d.events for a in e.actions):
                d.events.append(Event(name, None, begin, 0, [("lock", k)]))
                end = begin + float(rng.uniform(0.1, 0.4)) * d.stop_time
                d.events.append(Event(f"{name}.release", None, end, 0, [("release", k)]))
            continue
        elif choice == "stiffness" and springs:
            actions = [("stiffness", float(rng.uniform(0.3, 3.0)))]
        elif choice == "end":
            actions = [("end",)]
        if not actions:
            continue
        if how < 0.2:
            d.events.append(Event(name, None, float(rng.uniform(0.1, 0.9)) * d.stop_time, 0, actions))
        else:
            sensor, unit = _sensor(d, ("coordinate", "position", "rate"), planar, rng)
            value = float(rng.uniform(-0.6, 0.6)) * unit
            d.events.append(Event(name, sensor, value, int(rng.choice([-1, 0, 1])), actions))
