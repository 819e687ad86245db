"""Random mechanisms with closed loops, drawn by a seed; each can move by construction, and is closed where it starts.

Five families:

``beside``    a four-bar or slider-crank that misses a singular position by 1e-9 ... 1e-2 of its size; 0 to 2 more loops
``planar``    a crank or a double pendulum with one to four loops, bodies and sizes unlike
``parallel``  equal parallel cranks on a coupler, all but two redundant; exact, through singular positions or not
``spatial``   one to three loops of revolute, spherical, translational and free joints, some with a redundant row
``driven``    planar or spatial ones on a base that a drive turns or shifts, or with a driven crank

Most planar ones lie in any plane, so that the rows out of it are redundant; a third in one of the global axes, where
these rows are void, until a drive turns them. Lengths and masses are scaled by 1e-3 ... 1e3, times by 0.1 ... 10.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import atan2, cos, pi, sin
from typing import Any

import numpy as np
from hypothesis import strategies as st
from mechanisms import Case, Scale, swinging
from tree import Pose, child

from mbfmu.mechanics import (
    DistanceCut,
    Floating,
    Harmonic,
    JointSpring,
    Mechanism,
    PlanarCut,
    PlaneCut,
    Polynomial,
    Revolute,
    RevoluteCut,
    RunUp,
    Spherical,
    SphericalCut,
    Spring,
    Translational,
    WeldCut,
    rod,
)

Generator = np.random.Generator
FAMILIES = {"beside": 0.3, "planar": 0.25, "parallel": 0.1, "spatial": 0.2, "driven": 0.15}
LASTS = 6.0  # of a run, by what gravity takes for a length


@dataclass(frozen=True)
class Drawn:
    """A random mechanism.

    Attributes
    ----------
    family, seed
        ``draw(seed, family)`` draws it again.
    case
        The mechanism, its exact motion if known, how long to run it.
    gap
        By how much of its size it misses a singular position; None: not built to.
    scale
        Lengths, masses and times of it.
    """

    family: str
    seed: int
    case: Case
    gap: float | None
    scale: Scale

    def __str__(self) -> str:
        m = self.case.mechanism
        gap = "" if self.gap is None else f", gap {self.gap:+.1e}"
        return (
            f"draw({self.seed}, {self.family!r}): {len(m.bodies) - 1} bodies, {len(m.cuts)} cuts{gap}, scale "
            f"{self.scale.lengths:.1e} m {self.scale.masses:.1e} kg {self.scale.times:.1e} s"
        )


def draw(seed: int, family: str | None = None) -> Drawn:
    """Draw the mechanism of a seed, of any family or of a given one."""
    rng = np.random.default_rng(seed)
    first = str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    family = family or first
    scale = Scale(*(10.0 ** rng.uniform((-3.0, -3.0, -1.0), (3.0, 3.0, 1.0)))) if rng.random() < 0.7 else Scale()
    case, gap = _MAKERS[family](rng, scale)
    return Drawn(family, seed, case, gap, scale)


def loops() -> st.SearchStrategy[Drawn]:
    """The same for hypothesis; a smaller seed is not a simpler mechanism."""
    return st.integers(0, 2**32 - 1).map(draw)


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
        """A body around a rod along x: unlike mass, its centre off the middle."""
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
            self.cut(RevoluteCut, a, b, at, normal)
        else:
            self.cut(SphericalCut, a, b, at)

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


def _springs(site: Site) -> None:
    """Now and then a spring between two bodies, or in a joint."""
    rng, bodies = site.rng, site.mechanism.bodies
    stiffness = 10.0 * site.scale.masses / site.scale.times**2 * float(rng.uniform(0.3, 3.0))
    if rng.random() < 0.3:
        a = bodies[int(rng.integers(1, len(bodies)))]
        flat = (1.0, 1.0, 0.0) if site.angles else (1.0, 1.0, 1.0)
        far = site.poses[a.index].o + 3.0 * site.size * (site.axes @ (rng.normal(size=3) * flat))
        damping = float(rng.choice((0.0, 0.02))) * stiffness * site.scale.times
        site.mechanism.force(
            "spring", Spring(stiffness=stiffness, damping=damping, free=site.size, at_b=far), a, site.mechanism.ground
        )
    if rng.random() < 0.2:
        free = [b for b in bodies[1:] if b.joint.nv == 1 and b.joint.drive is None]
        if free:
            body = free[int(rng.integers(len(free)))]
            unit = site.scale.lengths**2 if isinstance(body.joint, Revolute) else 1.0
            start = 0.0 if body.joint.start is None else float(np.squeeze(body.joint.start))
            site.mechanism.force("joint", JointSpring(stiffness=stiffness * unit, free=start), body)


def _gap(rng: Generator) -> float:
    return float(rng.choice((-1.0, 1.0))) * 10.0 ** float(rng.uniform(-9.0, -2.0))


def _beside(rng: Generator, scale: Scale) -> tuple[Case, float | None]:
    site = Site(rng, scale, random_plane(rng))
    gap = _gap(rng)
    movers = _fold(site, gap) if rng.random() < 0.75 else _crank_and_slider(site, gap)
    site.more(movers, int(rng.choice(3, p=(0.7, 0.2, 0.1))))
    return site.case(), gap


def _fold(site: Site, gap: float) -> list[Any]:
    """A four-bar whose links nearly fold onto one line: a parallelogram, or lengths of which two sums are alike."""
    rng, L = site.rng, site.scale.lengths
    for _ in range(1000):
        a, b, c = np.exp(rng.uniform(-0.9, 0.7, 3))
        if rng.random() < 0.3:
            c, d = a, b
        else:
            signs = np.array(((1, 1, -1), (1, -1, 1), (-1, 1, 1)))[int(rng.integers(3))]
            d = float(signs @ (a, b, c))
        d += gap * max(a, b, c)
        angle = float(rng.uniform(-pi, pi))
        x, y = d - a * cos(angle), -a * sin(angle)
        reach = float(np.hypot(x, y))
        if d < 0.2 or not abs(b - c) + 0.05 < reach < b + c - 0.05:
            continue
        break
    way = float(rng.choice((-1.0, 1.0)))
    along = atan2(y, x) + way * float(np.arccos((b * b + reach * reach - c * c) / (2.0 * b * reach)))
    crank = site.link(site.base, (0.0, 0.0), angle, a * L, rate=site.rate, fixed=True)
    coupler = site.link(crank, (a * L, 0.0), along, b * L)
    rocker = site.link(coupler, (b * L, 0.0), atan2(b * sin(along) - y, b * cos(along) - x), -c * L)
    pivot = site.axes @ (d * L, 0.0, 0.0)  # not the point where the rocker happens to end: the gap is in the lengths
    normal = RevoluteCut(at_a=(-c * L, 0.0, 0.0), at_b=pivot, rotation_b=site.axes)
    site.mechanism.cut("fold", normal, rocker, site.base)
    return [crank, coupler]


def _crank_and_slider(site: Site, gap: float) -> list[Any]:
    """A slider-crank whose crank and rod nearly fold across the slider's way."""
    rng, L = site.rng, site.scale.lengths
    for _ in range(1000):
        r, rod_length = np.exp(rng.uniform(-0.9, 0.7, 2))
        if rng.random() < 0.4:
            rod_length = r
        offset = abs(rod_length - r) + gap * max(r, rod_length)
        angle = float(rng.uniform(-pi, pi))
        drop = (offset - r * sin(angle)) / rod_length
        if abs(drop) < 0.9:
            break
    lean = float(np.arcsin(drop))
    lean = lean if rng.random() < 0.5 else pi - lean
    crank = site.link(site.base, (0.0, 0.0), angle, r * L, rate=site.rate, fixed=True)
    link = site.link(crank, (r * L, 0.0), lean, rod_length * L)
    start = L * (r * cos(angle) + rod_length * cos(lean))
    joint = Translational(axis="x", start=start, **site.on_base(0.0, offset * L))
    slider = site.add(site.base, joint, **site.mass(0.3 * L))
    site.mechanism.cut("fold", RevoluteCut(at_a=(rod_length * L, 0.0, 0.0)), link, slider)
    return [crank, link]


def _planar(rng: Generator, scale: Scale, base: bool = False) -> tuple[Case, float | None]:
    site = Site(rng, scale, random_plane(rng))
    driven = base and rng.random() < 0.4
    if base and not driven:
        _moving_base(site)
    length = site.size
    first = site.link(site.base, (0.0, 0.0), float(rng.uniform(-pi, pi)), length, rate=site.rate, driven=driven)
    movers = [first]
    if driven or rng.random() < 0.4:
        angle = float(rng.uniform(-pi, pi))
        movers.append(site.link(first, (length, 0.0), angle, site.size, rate=site.rate))
    site.more(movers, int(rng.integers(1, 5)))
    _springs(site)
    return site.case(), None


def _parallel(rng: Generator, scale: Scale) -> tuple[Case, float | None]:
    """Two to five equal cranks on one coupler."""
    site = Site(rng, scale, random_plane(rng))
    m, n = site.mechanism, int(rng.integers(2, 6))
    g = site.axes.T @ m.gravity
    if np.linalg.norm(g[:2]) == 0.0:
        m.gravity[:] = site.axes @ (0.0, -scale.gravity, 0.0)
        g = site.axes.T @ m.gravity
    down, pull = atan2(g[1], g[0]), float(np.hypot(g[0], g[1]))
    l = site.size
    masses = scale.masses * np.exp(rng.uniform(-1.0, 1.0, n + 1))
    swing = float(rng.uniform(0.2, 2.5)) * float(rng.choice((-1.0, 1.0)))
    angle, speed = down + swing, 0.0
    rod_of = [rod(mass=masses[i], length=l) for i in range(n)]
    first = m.body("crank0", m.ground, Revolute(start=angle, fixed=True, **site.on_base(0.0, 0.0)), **rod_of[0])
    pin = Revolute(at=(l, 0.0, 0.0), start=-angle)
    inertia = masses[n] * l * l * np.array((0.1, 0.2, 0.25))
    coupler = m.body("coupler", first, pin, mass=masses[n], com=0.3 * l * rng.normal(size=3), inertia=inertia)
    for i in range(1, n):
        foot = (i * float(rng.uniform(0.5, 1.5)) * l, float(rng.choice((0.0, 1.0))) * float(rng.normal()) * l)
        joint = Revolute(start=angle, **site.on_base(*foot))
        crank = m.body(f"crank{i}", m.ground, joint, **rod_of[i])
        kind = RevoluteCut if rng.random() < 0.5 else SphericalCut
        m.cut(f"pin{i}", kind(at_a=(l, 0.0, 0.0), at_b=(*foot, 0.0)), crank, coupler)
    bars = float(masses[:n].sum())
    J, weight = (bars / 3.0 + masses[n]) * l * l, (0.5 * bars + masses[n]) * pull * l

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        signs = np.r_[1.0, -1.0, np.ones(n - 1)]
        return np.outer(a + down + 0.5 * pi, signs), np.outer(b, signs)

    exact = swinging(J, weight, (swing - 0.5 * pi, speed), embed)  # of a pendulum the weight pulls to -pi/2
    case = site.case(exact)
    return case._replace(stop_time=5.0 * case.stop_time), None  # the exact motion costs nothing


# Joints of a chain and the cut joints that close it: more freedoms than rows.
CHAINS: tuple[tuple[tuple[Any, ...], tuple[Any, ...]], ...] = (
    ((Revolute, Spherical), (DistanceCut,)),
    ((Revolute, Revolute), (PlaneCut,)),
    ((Revolute, Revolute), (DistanceCut,)),
    ((Spherical, Revolute), (SphericalCut,)),
    ((Revolute, Spherical, Revolute), (SphericalCut,)),
    ((Revolute, Spherical, Spherical), (RevoluteCut,)),
    ((Revolute, Spherical, Spherical), (WeldCut,)),
    ((Floating,), (SphericalCut, SphericalCut)),  # a hinge of two balls: one row redundant
    ((Floating,), (DistanceCut, DistanceCut, DistanceCut)),
    ((Floating,), (PlanarCut, DistanceCut)),
    ((Revolute, Revolute, Revolute, Revolute), (SphericalCut,)),
    ((Translational, Spherical), (SphericalCut,)),
    ((Revolute, Spherical, Translational), (SphericalCut,)),
    ((Revolute, Floating), (SphericalCut, SphericalCut, DistanceCut)),
)


def _spatial(rng: Generator, scale: Scale, base: bool = False) -> tuple[Case, float | None]:
    site = Site(rng, scale)
    if base:
        _moving_base(site)
    movers: list[Any] = []
    for _ in range(int(rng.choice((1, 2, 3), p=(0.6, 0.3, 0.1)))):
        joints, cuts = CHAINS[int(rng.integers(len(CHAINS)))]
        root = body = site.base if not movers or rng.random() < 0.5 else movers[int(rng.integers(len(movers)))]
        chain = []
        for kind in joints:
            body = site.add(body, _joint(site, kind), **site.mass(site.size))
            chain.append(body)
        others = [root] + [x for x in movers if rng.random() < 0.3]
        target = others[int(rng.integers(len(others)))]
        for kind in cuts:
            _close(site, kind, body, target)
        movers += chain
    _springs(site)
    return site.case(), None


def _joint(site: Site, kind: Any) -> Any:
    """A joint somewhere on its parent, in motion."""
    rng, size = site.rng, site.size
    options: dict[str, Any] = {"at": size * rng.normal(size=3) * 0.6, "rotation": random_rotation(rng)}
    rates = np.array([site.rate * (0.3 * site.scale.lengths if u == "m" else 1.0) for u in kind.units])
    if kind.nv == 1:
        options |= {"axis": tuple(rng.normal(size=3)), "rate": float(rates[0])}
    else:
        options["rate"] = rates
    return kind(**options)


def _close(site: Site, kind: Any, a: Any, b: Any) -> None:
    """Tie a to b where a is now."""
    rng, pose = site.rng, site.poses[a.index]
    at = pose.o + 0.8 * site.size * rng.normal(size=3)
    if kind is not DistanceCut:
        site.cut(kind, a, b, at, random_rotation(rng))
        return
    A, B = pose, site.poses[b.index]
    way = rng.normal(size=3)
    length = site.size
    there = at + length * way / np.linalg.norm(way)
    cut = DistanceCut(at_a=A.R.T @ (at - A.o), at_b=B.R.T @ (there - B.o), length=length)
    site.mechanism.cut(f"c{len(site.mechanism.cuts)}", cut, a, b)


def _moving_base(site: Site) -> None:
    """Put everything on a base that a drive turns about any axis, or shifts."""
    rng, axis = site.rng, tuple(site.rng.normal(size=3))
    start = float(rng.uniform(-pi, pi))
    if rng.random() < 0.5:
        axis, start = ("x", "y", "z")[int(rng.integers(3))], 0.0
    if rng.random() < 0.8:
        joint: Any = Revolute(axis=axis, drive=site.drive(start))
    else:
        size = site.scale.lengths
        shake = Harmonic(amplitude=0.3 * size, frequency=abs(site.rate) / (2 * pi), mean=0.0)
        joint = Translational(axis=axis, drive=shake)
    site.base = site.add(site.mechanism.ground, joint, **site.mass(site.size))


def _driven(rng: Generator, scale: Scale) -> tuple[Case, float | None]:
    return (_planar if rng.random() < 0.6 else _spatial)(rng, scale, base=True)


_MAKERS = {"beside": _beside, "planar": _planar, "parallel": _parallel, "spatial": _spatial, "driven": _driven}
