"""Friction in proportion to reactions: accelerations against constraint forces in absolute coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.loads.reaction_friction import ReactionFriction

from .absolute_friction import Absolute, Ball, Friction, Link

KINDS = ("R", "P", "C", "H", "U", "S", "L")
DEFLECTION = 1e-3
SCALES: dict[str, Any] = {  # of coordinates
    "P": lambda size: [size], "C": lambda size: [1.0, size], "U": lambda _: [1.0, 1.0], "S": lambda _: 3 * [1.0],
    "L": lambda size: [size, size, 1.0],
}  # fmt: skip
TOGETHER = {"S": mb.SphericalFriction, "C": mb.CylindricalFriction, "L": mb.PlanarFriction}


def random_link(rng: Any, parent: int, size: float, kind: str) -> Link:
    """A link with a random joint frame and inertia; lengths in ``size``."""
    axes = rng.normal(size=(3, 3))
    axis, scale = (
        rng.normal(size=3),
        np.array(SCALES.get(kind, lambda _: [1.0])(size)),
    )
    axis /= np.linalg.norm(axis)
    second = np.linalg.svd(axis[None])[2][1] if kind == "U" else np.eye(3)[0] - axis[0] * axis
    q = rng.normal(size=4) if kind == "S" else scale * rng.normal(size=len(scale))
    return Link(
        parent, kind, size * rng.normal(size=3), Rotation.random(random_state=rng).as_matrix(),
        axis, rng.uniform(0.5, 3.0), 0.4 * size * rng.normal(size=3),
        size**2 * (0.1 * axes @ axes.T + 2.0 * np.eye(3)), q / np.linalg.norm(q) if kind == "S" else q,
        scale * rng.normal(size=len(scale)), second=second / np.linalg.norm(second),
        rise=0.1 * size * rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 2.0) if kind == "H" else 0.0,
    )  # fmt: skip


def random_frictions(rng: Any, link: Link, size: float) -> dict[int, Friction]:
    """Random frictions of all coordinates of a joint."""
    if link.kind in "SL" or (link.kind == "C" and rng.random() < 0.5):
        arm = 0.1 * size * rng.uniform(0.3, 1.0)
        arms = {"S": np.ones(3), "C": np.array([arm, 1.0]), "L": np.array([1.0, 1.0, arm])}[link.kind]
        shared = random_friction(rng, link, 0, size, arms[:2] if link.kind == "L" and rng.random() < 0.5 else arms)
        return dict.fromkeys(range(len(shared.z)), shared)
    return {c: random_friction(rng, link, c, size) for c in range(len(link.v))}


def random_friction(rng: Any, link: Link, coordinate: int, size: float, arms: Any = None) -> Friction:
    """Random bearings that are weak enough for a solution."""
    own: dict[str, Any] = {"on": str(rng.choice(["a", "b"])), "preload": rng.choice([0.0, 2.0]), "arms": arms}
    angle = link.kind in "US" or (link.kind not in "PL" and coordinate == 0 and arms is None)
    if angle:
        own["radius"] = 0.1 * size * rng.uniform(0.3, 1.0)
    if link.kind in "RU":
        own["thrust_radius"] = 0.1 * size * rng.uniform(0.3, 1.0)
    if link.kind not in "HSL" and rng.random() < 0.7:
        own["length"] = size * rng.uniform(0.5, 2.0)
    if link.kind == "P" and rng.random() < 0.5:
        own["width"] = size * rng.uniform(0.5, 2.0)
    deflection = DEFLECTION if angle else DEFLECTION * size
    z = rng.choice([-0.8, -0.3, 0.0, 0.5, 0.95]) * np.ones(1)
    if arms is not None:
        way = rng.normal(size=len(arms))
        z = z[0] * (-1.0 if way @ (arms * link.v[: len(arms)]) < 0.0 else 1.0) * way / np.linalg.norm(way)
    return Friction(rng.uniform(0.02, 0.12), z, deflection, 0.0, **own)


def pair(rng: Any, size: float, kinds: tuple[str, ...], loop: bool) -> tuple[CompiledMechanism, Absolute]:
    """The same mechanism for mbfmu and in absolute coordinates, at its start."""
    gravity = 9.81 * size * rng.normal(size=3)
    parents = [k if loop else int(rng.integers(0, k + 1)) for k in range(len(kinds))]
    links = [random_link(rng, parent, size, kind) for parent, kind in zip(parents, kinds, strict=True)]
    for link in links[-3:]:
        link.friction = random_frictions(rng, link, size)
    balls = []
    reference = Absolute(links, balls, gravity)
    if loop:
        at_a = size * rng.normal(size=3)
        where = reference.A[-1].T @ (reference.A[1] @ at_a + reference.r[1] - reference.r[-1])
        balls.append(Ball(1, len(links), at_a, where))
        rates = np.concatenate([link.v for link in links])
        columns = []
        for k in range(len(rates)):
            for link, v in zip(links, np.split(np.eye(len(rates))[k], split(links)), strict=True):
                link.v = v
            columns.append(reference.constraints(0.0)[-3:] @ np.concatenate(reference.place(0.0)[2][1:]))
        J = np.array(columns).T
        rates -= np.linalg.pinv(J) @ J @ rates
        for link, v in zip(links, np.split(rates, split(links)), strict=True):
            link.v = v
    m = mb.Mechanism(gravity=tuple(gravity))
    bodies = [m.ground]
    for k, link in enumerate(links, 1):
        given: dict[str, Any] = {
            "axis": tuple(link.axis), "at": tuple(link.s), "rotation": link.R, "start": tuple(link.q),
            "rate": tuple(link.v), "nominal": 1.0,
        }  # fmt: skip
        if link.kind in "RPH":
            given |= {"start": link.q[0], "rate": link.v[0]}
        kinds = {"R": mb.Revolute, "P": mb.Translational, "C": mb.Cylindrical, "H": mb.Screw}
        joint: Any = {**kinds, "U": mb.Universal, "S": mb.Spherical, "L": mb.Planar}[link.kind]
        if link.kind == "U":
            given["second"] = tuple(link.second)
        if link.kind == "S":
            del given["axis"]
        if link.kind == "H":
            given["lead"] = 2.0 * np.pi * link.rise
        own_mass: dict[str, Any] = {"mass": link.mass, "com": tuple(link.com), "inertia": link.inertia}
        bodies.append(m.body(f"b{k}", bodies[link.parent], joint(**given), **own_mass))
        for c, own in link.friction.items():
            sizes = {name: getattr(own, name) for name in ("length", "width") if np.isfinite(getattr(own, name))}
            sizes |= {"radius": own.radius} if own.radius else {}
            bearings = mb.Reaction(thrust_radius=own.thrust_radius, preload=own.preload, on=own.on, **sizes)
            law: dict[str, Any] = {"coulomb": own.mu, "normal_force": bearings, "deflection": own.deflection}
            if own.arms is None:
                m.force(f"f{k}{c}", mb.JointFriction(coordinate=c, **law), bodies[k])
            elif c == 0:
                law |= {"C": {"radius": own.arms[0]}, "L": {"radius": [*own.arms, None][2]}}.get(link.kind, {})
                m.force(f"f{k}", TOGETHER[link.kind](**law), bodies[k])
    for k, ball in enumerate(balls):
        cut = mb.SphericalCutJoint(at_a=tuple(ball.at_a), at_b=tuple(ball.at_b))
        m.cut(f"c{k}", cut, bodies[ball.a], bodies[ball.b])
    return CompiledMechanism(m), Absolute(links, balls, gravity)


def split(links: list[Link]) -> Any:
    """Where the rates of the links after the first begin."""
    return np.cumsum([len(link.v) for link in links])[:-1]


def accelerations(compiled: CompiledMechanism, q: Any, v: Any) -> tuple[Any, Any]:
    """Accelerations and rates of states, and the multipliers, by the terms of the equations of motion."""
    system, terms = compiled.system, compiled.system.allocate_terms()
    system.fill(0.0, q, v, terms)
    K = np.block([[terms.M, terms.J.T], [terms.J, np.zeros((system.m, system.m))]])
    found = np.linalg.solve(K, np.concatenate((-terms.h, terms.gamma)))
    return found[: system.n], found[system.n :]


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("loop", [False, True])
def test_accelerations_and_friction_are_those_by_constraint_forces(size: float, loop: bool) -> None:
    """Random mechanisms of all joints that have such friction, with three to six frictions that depend on each other.
    Some jam: then there is no solution, and the friction is not a number.
    """
    rng, jams = np.random.default_rng(7), 0
    for _ in range(12):
        compiled, reference = pair(rng, size, tuple(rng.choice(KINDS, size=5 if loop else 4)), loop)
        frictions = list({id(own): own for link in reference.links for own in link.friction.values()}.values())
        for own, inertia in zip(frictions, compiled.records(ReactionFriction)["estimated_inertia"], strict=True):
            own.inertia = float(inertia)
        q = np.concatenate([link.q for link in reference.links])
        v = np.concatenate([link.v for link in reference.links] + [own.z for own in frictions])
        n = sum(len(link.v) for link in reference.links)
        bearings, units = compiled.data.state.bearings, compiled.system.size[:n]
        found, lam = accelerations(compiled, q, v)
        forces, followed = bearings["resistance"].copy(), reference.follow_friction()
        if np.isnan(forces).any():
            assert followed is None
            jams += 1
            continue
        largest = np.abs(forces).max()
        np.testing.assert_allclose(reference.gap(forces), 0.0, atol=1e-7 * largest)
        if followed is not None:
            np.testing.assert_allclose(forces, followed, atol=1e-7 * largest)
        scaled = reference.accelerations(forces) / units
        np.testing.assert_allclose(found[:n] / units, scaled, atol=1e-7 * np.abs(scaled).max())
        compiled.system.observe_all(np.zeros(1), q[None], v[None], found[None], lam[None], np.zeros((1, 0)))
        np.testing.assert_allclose(bearings["resistance"], forces, atol=1e-10 * largest)
    assert jams < 3
