"""Steady states that belong to a family: a motion changes no force, so that the Jacobian is singular at all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import mbfmu as mb

DISTANCE = {2: 2.0, 3: 3.0**0.5, 4: (8.0 / 3.0) ** 0.5}  # of points on the unit sphere that repel each other


def repulsion(x: float) -> float:
    """Return the force of a spring that repels, N."""
    return -1.0 / x


def points_on_a_sphere(count: int, seed: int, radius: float, places: ArrayLike | None = None) -> mb.Mechanism:
    """Point masses at ``places`` on a sphere, by default random, each with a massless rod to its center."""
    m = mb.Mechanism()
    directions = np.asarray(np.random.default_rng(seed).normal(size=(count, 3)) if places is None else places, float)
    bodies = list[Any]()
    for i, place in enumerate(radius * directions / np.linalg.norm(directions, axis=1)[:, np.newaxis]):
        body = m.ground
        for axis, start in zip("xyz", place, strict=True):
            joint = mb.Translational(axis=axis, start=float(start), fixed=True)
            body = m.body(f"{axis}{i}", body, joint, mass=1.0 if axis == "z" else 0.0)
        m.cut(f"rod{i}", mb.DistanceCutJoint(length=radius), m.ground, body)
        for j, other in enumerate(bodies):
            m.force(f"force{i}.{j}", mb.Spring(stiffness=repulsion, free=0.0), body, other)
            m.output(f"d{i}{j}", m.distance(body, other))
        bodies.append(body)
    return m


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("count", DISTANCE)
def test_points_that_repel_each_other_form_a_regular_figure(count: int, radius: float) -> None:
    for seed in range(4):
        found = mb.equilibrium(points_on_a_sphere(count, seed, radius))
        np.testing.assert_allclose(list(found.outputs.values()), DISTANCE[count] * radius, rtol=1e-8)
        assert found.stability == "neutral"
        directions = 2 if count == 2 else 3  # rotation about the line through two points moves neither
        assert [d.text for d in found.diagnostics] == [
            f"neutral family: {directions} directions in which nothing changes"
        ]


def chain_and_wheel(count: int, scale: float, where: str) -> mb.Mechanism:
    """A hanging chain of ``count`` - 1 hinges, bent at the start, and a wheel that turns freely."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    wheel = mb.cylinder(mass=1.0, radius=scale, length=scale, axis="z")
    if where == "ground":
        m.body("wheel", m.ground, mb.Revolute(), **wheel)
    body, links = m.ground, count - 1
    for k in range(links):
        joint = mb.Revolute(at=(scale / links if k else 0.0, 0.0, 0.0), start=1.2 / links if k else -1.2)
        body = m.body(f"link{k}", body, joint, **mb.rod(mass=1.0 / links, length=scale / links))
    m.output("x", body.position("x"))
    m.output("y", body.position("y"))
    if where == "tip":
        m.body("wheel", body, mb.Revolute(at=(scale / links, 0.0, 0.0)), **wheel)
    return m


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("where", ["ground", "tip"])
@pytest.mark.parametrize("count", [59, 61, 131])
def test_a_wheel_that_turns_freely_does_not_matter(count: int, where: str, scale: float) -> None:
    found = mb.equilibrium(chain_and_wheel(count, scale, where))
    links = count - 1
    assert abs(found.outputs["x"]) < 1e-8 * scale
    assert found.outputs["y"] == pytest.approx(-scale * (links - 1) / links, rel=1e-9)
    assert found.stability == "neutral"


@pytest.mark.parametrize("count", [40, 80])
def test_a_force_that_nothing_balances_is_refused(count: int) -> None:
    m = chain_and_wheel(count, 1.0, "ground")
    sled = m.body("sled", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("push", mb.JointForce(1e-3), sled)
    with pytest.raises(mb.EquilibriumError, match="no equilibrium was found"):
        mb.equilibrium(m)


def test_a_saddle_in_a_family_is_unstable() -> None:
    """Four points in a square on a great circle are balanced, but the tetrahedron has a lower potential."""
    m = points_on_a_sphere(4, 0, 1.0, places=[(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)])
    found = mb.equilibrium(m)
    assert found.outputs["d10"] == pytest.approx(2.0**0.5, rel=1e-12)
    assert found.stability == "unstable"
    assert [d.text for d in found.diagnostics] == ["neutral family: 3 directions in which nothing changes"]


def wheel_and_governor(count: int, length: float, speed: float) -> mb.Mechanism:
    """A rod on a free spindle at ``speed`` (rad/s), a wheel at twice that, and pendulums: ``count`` coordinates."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    spindle = m.body("spindle", m.ground, mb.Revolute(axis="y", rate=speed), mass=1.0, inertia=(0.1, 0.1, 0.1))
    m.body("wheel", m.ground, mb.Revolute(axis="z", rate=2.0 * speed), mass=1.0, inertia=(0.1, 0.1, 0.2))
    arm = m.body("arm", spindle, mb.Revolute(axis="z", start=-0.7), **mb.rod(mass=2.0, length=length))
    m.output("arm", arm.angle())
    for k in range(count - 3):
        m.body(f"pendulum{k}", m.ground, mb.Revolute(start=-1.3), **mb.rod(mass=1.0, length=length))
    return m


@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("count", [59, 61, 131])
def test_cyclic_coordinates_keep_their_rates(count: int, length: float) -> None:
    """The arm stands where the moments of weight and centrifugal force are equal: sin(angle) = -3 g / (2 L w^2)."""
    speed = (3.0 * 9.81 / length) ** 0.5
    found = mb.equilibrium(wheel_and_governor(count, length, speed))
    assert found.v[:2] == pytest.approx([speed, 2.0 * speed], rel=1e-14)
    assert not np.any(found.v[2:])
    assert found.outputs["arm"] == pytest.approx(-np.pi / 6.0, abs=1e-9)
    assert found.diagnostics == ()
    assert found.iterations < 30  # without continuation


@pytest.mark.parametrize("count", [59, 61])
def test_a_torque_on_a_free_wheel_is_refused(count: int) -> None:
    m = chain_and_wheel(count, 1.0, "ground")
    wheel = next(body for body in m.bodies if body.name == "wheel")
    m.force("motor", mb.JointForce(1e-3), wheel)
    with pytest.raises(mb.EquilibriumError, match="no equilibrium was found"):
        mb.equilibrium(m)


@pytest.mark.parametrize("stiffness", [1e2, 1e5, 1e8, 1e10])
@pytest.mark.parametrize("others", [0, 60])
def test_a_small_force_in_parallel_with_a_stiff_spring_is_refused(stiffness: float, others: int) -> None:
    m = mb.Mechanism()
    sled = m.body("sled", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("push", mb.JointForce(0.01), sled)
    for k in range(1 + others):
        held = m.body(f"held{k}", m.ground, mb.Translational(axis="y"), mass=1.0)
        m.force(f"spring{k}", mb.JointSpring(stiffness=stiffness), held)
    with pytest.raises(mb.EquilibriumError, match="no equilibrium was found"):
        mb.equilibrium(m)
