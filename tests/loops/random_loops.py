"""Random mechanisms with closed loops, drawn by a seed; each can move by construction, and is closed where it starts.

Five families:

``beside``    a four-bar or slider-crank that misses a singular configuration by 1e-9 ... 1e-2 of its size; 0-2 others
``planar``    a crank or a double pendulum with one to four loops, bodies and sizes unlike
``parallel``  equal parallel cranks on a coupler, all but two redundant; exact, through singular configurations or not
``spatial``   one to three loops of revolute, spherical, translational and free joints, some with a redundant equation
``driven``    planar or spatial ones on a base that a drive turns or shifts, or with a driven crank

Most planar ones lie in any plane, so that equations out of it are redundant; a third in a plane of global axes, where
these equations are zero until a drive turns them. Lengths and masses are scaled by 1e-3 ... 1e3, times by 0.1 ... 10.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, pi, sin
from typing import Any

import numpy as np
from building_site import Generator, Site, random_plane, random_rotation
from hypothesis import strategies as st
from mechanisms import Case, Scale, swinging

from mbfmu.mechanics import (
    DistanceCutJoint,
    Floating,
    Harmonic,
    JointSpring,
    PlanarCutJoint,
    PlaneCutJoint,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Spring,
    Translational,
    WeldCutJoint,
    rod,
)

FAMILIES = {"beside": 0.3, "planar": 0.25, "parallel": 0.1, "spatial": 0.2, "driven": 0.15}


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
        By how much of its size it misses a singular configuration; None: not built to.
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
    normal = RevoluteCutJoint(at_a=(-c * L, 0.0, 0.0), at_b=pivot, rotation_b=site.axes)
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
    site.mechanism.cut("fold", RevoluteCutJoint(at_a=(rod_length * L, 0.0, 0.0)), link, slider)
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
        kind = RevoluteCutJoint if rng.random() < 0.5 else SphericalCutJoint
        m.cut(f"pin{i}", kind(at_a=(l, 0.0, 0.0), at_b=(*foot, 0.0)), crank, coupler)
    bars = float(masses[:n].sum())
    J, weight = (bars / 3.0 + masses[n]) * l * l, (0.5 * bars + masses[n]) * pull * l

    def embed(a: Any, b: Any) -> tuple[Any, Any]:
        signs = np.r_[1.0, -1.0, np.ones(n - 1)]
        return np.outer(a + down + 0.5 * pi, signs), np.outer(b, signs)

    exact = swinging(J, weight, (swing - 0.5 * pi, speed), embed)  # of a pendulum the weight pulls to -pi/2
    case = site.case(exact)
    return case._replace(stop_time=5.0 * case.stop_time), None  # the exact motion costs nothing


# Joints of a chain and the cut joints that close it: more degrees of freedom than rows.
CHAINS: tuple[tuple[tuple[Any, ...], tuple[Any, ...]], ...] = (
    ((Revolute, Spherical), (DistanceCutJoint,)),
    ((Revolute, Revolute), (PlaneCutJoint,)),
    ((Revolute, Revolute), (DistanceCutJoint,)),
    ((Spherical, Revolute), (SphericalCutJoint,)),
    ((Revolute, Spherical, Revolute), (SphericalCutJoint,)),
    ((Revolute, Spherical, Spherical), (RevoluteCutJoint,)),
    ((Revolute, Spherical, Spherical), (WeldCutJoint,)),
    ((Floating,), (SphericalCutJoint, SphericalCutJoint)),  # a hinge of two balls: one row redundant
    ((Floating,), (DistanceCutJoint, DistanceCutJoint, DistanceCutJoint)),
    ((Floating,), (PlanarCutJoint, DistanceCutJoint)),
    ((Revolute, Revolute, Revolute, Revolute), (SphericalCutJoint,)),
    ((Translational, Spherical), (SphericalCutJoint,)),
    ((Revolute, Spherical, Translational), (SphericalCutJoint,)),
    ((Revolute, Floating), (SphericalCutJoint, SphericalCutJoint, DistanceCutJoint)),
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
    if kind is not DistanceCutJoint:
        site.cut(kind, a, b, at, random_rotation(rng))
        return
    A, B = pose, site.poses[b.index]
    way = rng.normal(size=3)
    length = site.size
    there = at + length * way / np.linalg.norm(way)
    cut = DistanceCutJoint(at_a=A.R.T @ (at - A.o), at_b=B.R.T @ (there - B.o), length=length)
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
