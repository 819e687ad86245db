"""Steady states that belong to a family: a motion changes no force, so that the Jacobian is singular at all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

import mbfmu as mb
from mbfmu.steady.sweep import sweep

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


def damped_cart(count: int, damping: float = 3.0) -> mb.Mechanism:
    """A cart that a damper slows down, with a pole that a motor turns, and pendulums: ``count`` coordinates."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    cart = m.body("cart", m.ground, mb.Translational(axis="x", rate=2.0), mass=1.0)
    m.force("damper", mb.JointForce(f"-{damping} * v"), cart)
    pole = m.body("pole", cart, mb.Revolute(start=-1.2), **mb.rod(mass=1.0, length=1.0))
    m.force("motor", mb.JointForce(mb.Input(name="torque", unit="N m")), pole)
    m.output("pole", pole.angle())
    for k in range(count - 2):
        m.body(f"pendulum{k}", m.ground, mb.Revolute(start=-1.3), **mb.rod(mass=1.0, length=1.0))
    return m


@pytest.mark.parametrize("count", [2, 61])
def test_a_rate_that_is_no_steady_state_is_set_to_zero(count: int) -> None:
    """A damper acts on a cyclic coordinate: its only steady rate is zero."""
    for start in (None, {"pole": -1.0}):
        found = mb.equilibrium(damped_cart(count), start)
        assert not np.any(found.v)
        assert found.outputs["pole"] == pytest.approx(-0.5 * np.pi, abs=1e-9)
        note = next(d.text for d in found.diagnostics if "'cart' (2)" in d.text)
        assert "no steady state was found with the start rates" in note


def test_a_rate_that_is_a_steady_state_is_kept() -> None:
    found = mb.equilibrium(damped_cart(2, damping=0.0))
    assert found.v[0] == 2.0
    assert found.diagnostics == ()


def test_a_force_on_a_damped_cart_is_refused_at_any_rate() -> None:
    """The message is that of the search with the start rates: 3 N s/m times 2 m/s, less 1 N."""
    m = damped_cart(2)
    m.force("engine", mb.JointForce(1.0), next(body for body in m.bodies if body.name == "cart"))
    with pytest.raises(mb.EquilibriumError, match="residual 5 N or N m at 'cart'"):
        mb.equilibrium(m)


@dataclass(frozen=True, kw_only=True)
class DampedCart(mb.Model):
    """The cart with a pole."""

    name = "damped_cart"
    damping: float = mb.parameter(3.0, unit="N s/m")

    def build(self) -> mb.Mechanism:
        return damped_cart(2, self.damping)


def test_sweeps_and_paths_follow_the_state_at_rest() -> None:
    """The torque T of the motor holds the pole at m g L / 2 cos(angle) = T."""
    branches = sweep(DampedCart(), "damping", [2.0, 4.0, 8.0], scattered=0)
    assert [branch.values for branch in branches] == [[2.0, 4.0, 8.0]]
    path = mb.equilibrium_path(DampedCart(), "torque", (0.0, 2.0))
    assert path.branches[0].states[-1].outputs["pole"] == pytest.approx(-np.arccos(2.0 / (0.5 * 9.81)), abs=1e-8)


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
