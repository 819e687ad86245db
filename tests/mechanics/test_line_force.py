"""The force between two points against virtual work, and against SciPy for a boom with a cylinder."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.errors import UserError

Array = NDArray[np.float64]
MASS, CENTER, INERTIA, GRAVITY = 80.0, 1.2, 30.0, 9.81  # of the boom: kg, m, kg m2 about its center; m/s2
FOOT, EYE = (0.5, -0.8), (0.9, 0.1)  # pins of the cylinder on the ground and on the boom, m


def boom(angle: float, force: Any = 0.0) -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0.0, -GRAVITY, 0.0))
    arm = m.body(
        "boom", m.ground, mb.Revolute(start=angle), mass=MASS, com=(CENTER, 0, 0), inertia=(0.0, INERTIA, INERTIA)
    )
    cylinder = m.force("cylinder", mb.LineForce(magnitude=force, at_a=(*FOOT, 0), at_b=(*EYE, 0)), m.ground, arm)
    m.output("angle", arm.angle())
    m.output("length", cylinder.length())
    m.output("rate", cylinder.length_rate())
    for axis in "xy":
        m.output(f"force.{axis}", cylinder.force(axis, on="b"))
        m.output(f"reaction.{axis}", cylinder.force(axis))
    return m


def length(angle: float) -> float:
    """Return the length of the cylinder, m."""
    c, s = np.cos(angle), np.sin(angle)
    return float(np.hypot(c * EYE[0] - s * EYE[1] - FOOT[0], s * EYE[0] + c * EYE[1] - FOOT[1]))


def lever(angle: float, h: float = 1e-5) -> float:
    """Return the derivative of the length by the angle, m."""
    return (length(angle + h) - length(angle - h)) / (2.0 * h)


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.2])
def test_virtual_work_gives_the_force_that_holds_a_boom(angle: float) -> None:
    force = MASS * GRAVITY * CENTER * np.cos(angle) / lever(angle)
    result = mb.simulate(boom(angle, force), 0.5, solver="adams", tolerance=1e-9)
    assert not result.failure
    assert not result.warning
    np.testing.assert_allclose(result["angle"], angle, atol=1e-7)
    np.testing.assert_allclose(result["length"], length(angle), rtol=1e-7)
    np.testing.assert_allclose(np.hypot(result["force.x"], result["force.y"]), force, rtol=1e-12)
    np.testing.assert_array_equal(result["force.y"], -result["reaction.y"])
    assert result["force.y"][0] > 0.0  # a positive force pushes the boom up


def test_a_boom_moves_as_by_scipy_under_a_force_that_is_an_input() -> None:
    given = mb.Input(name="force", unit="N", description="Force of the cylinder")
    result = mb.simulate(
        boom(0.4, given), 2.0, inputs={"force": "1800 + 500 * sin(4 * t)"}, solver="adams", tolerance=1e-10
    )
    assert not result.warning

    def rates(t: float, y: Array) -> list[float]:
        moment = (1800.0 + 500.0 * np.sin(4.0 * t)) * lever(y[0]) - MASS * GRAVITY * CENTER * np.cos(y[0])
        return [y[1], moment / (INERTIA + MASS * CENTER**2)]

    exact = solve_ivp(rates, (0.0, 2.0), [0.4, 0.0], "DOP853", result.t, rtol=1e-11, atol=1e-12).y
    assert np.ptp(exact[0]) > 0.3
    np.testing.assert_allclose(result["angle"], exact[0], atol=1e-7)
    np.testing.assert_allclose(result["rate"], [lever(q) * v for q, v in exact.T], atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_generalized_force_between_two_bodies_is_that_of_virtual_work(seed: int) -> None:
    """Of two bodies in space: the inertia forces of the accelerations do the work that the force does."""
    rng = np.random.default_rng(seed)
    at_a, at_b, arm = rng.normal(size=(3, 3))
    q, force = rng.uniform(-1.5, 1.5, 4), rng.normal()
    m = mb.Mechanism()
    first = m.body("first", m.ground, mb.Universal(axis="x", second="z"), mass=2.0, inertia=(0.3, 0.4, 0.5))
    slide = m.body("slide", first, mb.Translational(axis="y", at=arm), mass=0.5, inertia=(0.1, 0.1, 0.1))
    second = m.body("second", slide, mb.Revolute(axis="x"), mass=1.0, com=(0, 0, 0.2), inertia=(0.2, 0.3, 0.1))
    m.force("f", mb.LineForce(magnitude=force, at_a=at_a, at_b=at_b), first, second)

    def distance(q: Array) -> float:
        turned = Rotation.from_euler("XZ", q[:2])
        inner = arm + np.array((0.0, q[2], 0.0)) + Rotation.from_euler("X", q[3]).apply(at_b)
        return float(np.linalg.norm(turned.apply(inner) - turned.apply(at_a)))

    h = 1e-5
    slope = np.array([(distance(q + h * e) - distance(q - h * e)) / (2.0 * h) for e in np.eye(4)])
    system = CompiledMechanism(m).system
    terms = system.allocate_terms()
    system.fill(0.0, q, np.zeros(4), terms)
    np.testing.assert_allclose(terms.h, -force * slope, atol=1e-8)


def test_points_that_coincide_exert_nothing_and_are_reported() -> None:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("push", mb.LineForce(magnitude=3.0), m.ground, body)
    m.output("x", body.coordinate())
    found = mb.simulate(m, 0.1, solver="adams")
    assert any(
        "the ends of force 'push' coincide at the start: its force has no direction" in t
        for t in map(str, found.diagnostics)
    )
    np.testing.assert_array_equal(found["x"], 0.0)


def test_only_forces_along_a_line_have_a_length() -> None:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Translational(axis="x"), mass=1.0)
    handle = m.force("push", mb.JointForce(1.0), body)
    with pytest.raises(UserError, match="which has no length; allowed: Damper, DistanceStop"):
        handle.length()
