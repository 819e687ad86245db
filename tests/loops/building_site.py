"""Where random mechanisms are built: links, dyads and cut joints, with the pose of every body where it starts."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import atan2, cos, pi, sin
from typing import Any

import numpy as np
from mechanisms import Case, Scale
from tree import Pose, child

from mbfmu.mechanics import (
    Harmonic,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    RunUp,
    SphericalCutJoint,
    Translational,
)

Generator = np.random.Generator
LASTS = 6.0  # of a run, by what gravity takes for a length


def random_rotation(rng: Generator) -> Any:
    """A uniformly random rotation."""
    a, b, c, d = (p := rng.normal(size=4)) / np.linalg.norm(p)
    return np.array(
        (
            (1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)),
            (2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)),
            (2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)),
        )
    )


def random_plane(rng: Generator) -> Any:
    """Axes of a plane, now and then the global ones in some order."""
    if rng.random() < 0.65:
        return random_rotation(rng)
    return np.roll(np.eye(3), int(rng.integers(3)), axis=1)


@dataclass
class Site:
    """A mechanism being built, with the pose of every body where it starts."""

    rng: Generator
    scale: Scale
    axes: Any = field(default_factory=lambda: np.eye(3))  # of the plane, in the base
    mechanism: Mechanism = field(init=False)
    poses: list[Pose] = field(init=False)
    angles: dict[int, float] = field(default_factory=dict)  # of planar bodies in their plane

    def __post_init__(self) -> None:
        """Begin with a gravity of random direction, mostly in the plane, sometimes none."""
        pull = self.axes @ (self.rng.normal(size=3) * (1.0, 1.0, 0.2))
        pull *= 0.0 if self.rng.random() < 0.15 else self.scale.gravity / np.linalg.norm(pull)
        self.mechanism = Mechanism(gravity=pull)
        zero = np.zeros(3)
        self.poses = [Pose(np.eye(3), zero, zero, zero)]
        self.base = self.mechanism.ground

    @property
    def size(self) -> float:
        """A random length, m."""
        return self.scale.lengths * float(np.exp(self.rng.uniform(-1.2, 0.7)))

    @property
    def rate(self) -> float:
        """A random rate, 1/s."""
        return 3.0 * float(self.rng.normal()) / self.scale.times

    def add(self, parent: Any, joint: Any, **mass: Any) -> Any:
        """Hang a body on another and note where it is."""
        body = self.mechanism.body(f"b{len(self.poses)}", parent, joint, **mass)
        start = joint.rest() if joint.start is None else np.atleast_1d(joint.start)
        if joint.drive is not None:
            start = np.array([_drive_start(joint.drive)])
        self.poses.append(child(joint, self.poses[parent.index], start, np.zeros(joint.nv)))
        return body

    def mass(self, length: float) -> dict[str, Any]:
        """A body around a rod along x: unlike mass, its center off the middle."""
        mass = self.scale.masses * float(np.exp(self.rng.uniform(-1.5, 1.5)))
        points = self.rng.normal(size=(5, 3)) * np.abs(length) * (0.3, 0.15, 0.1)
        inertia = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points) * mass / 5.0
        com = length * np.array((0.5, 0.15, 0.1)) * self.rng.uniform((0.5, -1.0, -1.0), 1.0)
        return {"mass": mass, "com": com, "inertia": inertia}

    def drive(self, start: float) -> Any:
        """A drive that begins at ``start``."""
        w = self.rate
        kind = self.rng.integers(3)
        if kind == 0:
            return Polynomial((start, w))
        if kind == 1:
            return RunUp(speed=w, duration=self.scale.times * float(self.rng.uniform(0.5, 2.0)), start=start)
        phase = float(self.rng.uniform(-pi, pi))
        size = float(self.rng.uniform(0.2, 1.0))
        return Harmonic(amplitude=size, frequency=abs(w) / (2 * pi), phase=phase, mean=start - size * sin(phase))

    def cut(self, kind: Any, a: Any, b: Any, at: Any, axes: Any = None, **options: Any) -> None:
        """Tie bodies a and b at a global point, the cut frames along the same global axes."""
        A, B = self.poses[a.index], self.poses[b.index]
        options |= {"at_a": A.R.T @ (at - A.o), "at_b": B.R.T @ (at - B.o)}
        if axes is not None:
            options |= {"rotation_a": A.R.T @ axes, "rotation_b": B.R.T @ axes}
        self.mechanism.cut(f"c{len(self.mechanism.cuts)}", kind(**options), a, b)

    def case(self, exact: Any = None) -> Case:
        """What has been built."""
        self.mechanism.output("energy", self.mechanism.energy)
        return Case(self.mechanism, exact, LASTS * self.scale.times / 9.81**0.5)

    # -- in the plane ----------------------------------------------------------------------------------------------

    def on_base(self, x: float, y: float) -> dict[str, Any]:
        """Placement of a joint of the base at a point of the plane."""
        return {"at": self.axes @ (x, y, 0.0), "rotation": self.axes}

    def link(self, parent: Any, at: tuple[float, float], angle: float, length: float, **options: Any) -> Any:
        """A link on a hinge at a point of its parent, at an angle in the plane."""
        before = self.angles.get(parent.index, 0.0)
        place = self.on_base(*at) if parent is self.base else {"at": (*at, 0.0)}
        if options.pop("driven", False):
            options = {"drive": self.drive(angle - before)}
        else:
            options["start"] = angle - before
        body = self.add(parent, Revolute(**place, **options), **self.mass(length))
        self.angles[body.index] = angle
        return body

    def spot(self, body: Any, x: float, y: float) -> Any:
        """Global position of a point of a body, or of the plane on the base."""
        pose = self.poses[body.index]
        p = self.axes @ (x, y, 0.0) if body is self.base else np.array((x, y, 0.0))
        return pose.o + pose.R @ p

    def seen(self, body: Any, x: float, y: float) -> Any:
        """The same in coordinates of the plane."""
        base = self.poses[self.base.index]
        return (self.axes.T @ base.R.T @ (self.spot(body, x, y) - base.o))[:2]

    def hinge(self, a: Any, b: Any, at: Any) -> None:
        """Tie two bodies by a cut joint across the plane, of one kind or another."""
        normal = self.poses[self.base.index].R @ self.axes
        if self.rng.random() < 0.7:
            self.cut(RevoluteCutJoint, a, b, at, normal)
        else:
            self.cut(SphericalCutJoint, a, b, at)

    def dyad(self, a: Any, at: tuple[float, float], b: Any, bt: tuple[float, float]) -> list[Any]:
        """Two bodies between a point of a and one of b: a loop more, mobility as before."""
        start, end = self.seen(a, *at), self.seen(b, *bt)
        way = end - start
        far = float(np.hypot(*way))
        along = float(np.arctan2(way[1], way[0]))
        if self.rng.random() < 0.25:
            guide = self.link(a, at, along, 0.5 * far)
            joint = Translational(axis="x", start=far)
            slide = self.add(guide, joint, **self.mass(-0.3 * far))
            self.angles[slide.index] = along
            self.hinge(slide, b, self.spot(b, *bt))
            return [guide]
        side = float(self.rng.choice((-1.0, 1.0))) * float(self.rng.uniform(0.4, 1.2))
        knee = start + (float(self.rng.uniform(0.1, 0.9)) * way + side * np.array((-way[1], way[0])))
        first, second = knee - start, end - knee
        near = self.link(a, at, atan2(*first[::-1]), float(np.hypot(*first)))
        length = float(np.hypot(*second))
        far_link = self.link(near, (float(np.hypot(*first)), 0.0), atan2(*second[::-1]), length)
        self.hinge(far_link, b, self.spot(b, *bt))
        return [near, far_link]

    def more(self, movers: list[Any], count: int) -> None:
        """``count`` more loops: dyads between bodies that move and others or the base."""
        L = self.scale.lengths
        for _ in range(count):
            a = movers[int(self.rng.integers(len(movers)))]
            others = [self.base, *(x for x in movers if x is not a)]
            b = others[int(self.rng.integers(len(others)))]
            at, bt = (tuple(L * self.rng.uniform((0.2, -0.3), (1.0, 0.3))) for _ in range(2))
            if b is self.base:
                bt = tuple(self.seen(a, *at) + L * self.rng.uniform(0.7, 1.5) * _direction(self.rng))
            movers += self.dyad(a, at, b, bt)


def _drive_start(drive: Any) -> float:
    """Value of a drive of :meth:`Site.drive` at time zero."""
    if isinstance(drive, Harmonic):
        return drive.mean + drive.amplitude * sin(drive.phase)
    return float(drive.start if isinstance(drive, RunUp) else drive.c[0])


def _direction(rng: Generator) -> Any:
    angle = rng.uniform(-pi, pi)
    return np.array((cos(angle), sin(angle)))
