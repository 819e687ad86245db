"""Dry friction with stick between two points against closed forms: actuators that hold, breakaway, and oscillations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.errors import UserError

G = 9.81


def slider(
    force: Any, friction: mb.LineFriction, *, mass: float = 2.0, size: float = 1.0, **joint: Any
) -> mb.Mechanism:
    """A mass on a horizontal line; force and friction act between it and a point of the ground at the left."""
    m = mb.Mechanism()
    body = m.body("mass", m.ground, mb.Translational(axis="x", at=(size, 0, 0), nominal=size, **joint), mass=mass)
    if force is not None:
        m.force("force", force, m.ground, body)
    seal = m.force("seal", friction, m.ground, body)
    m.output("x", body.coordinate())
    m.output("friction", seal.force("x", on="b"))
    m.output("length", seal.length())
    return m


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_an_actuator_that_lifts_a_load_holds_it_when_the_force_stops(size: float) -> None:
    """Lengths times ``size``, times by its square root, the same accelerations: the same motion at three sizes."""
    mass, unit = 2.0, np.sqrt(size)
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    body = m.body("load", m.ground, mb.Translational(axis="z", at=(0, 0, size), nominal=size), mass=mass)
    push = mb.Step(height=-60.0, begin=0.3 * unit, duration=0.01 * unit)
    control = {"given": 60.0, "stop": push}
    m.force("oil", mb.LineForce(magnitude="given + stop", uses=control), m.ground, body)
    m.force("seal", mb.LineFriction(coulomb=30.0), m.ground, body)
    m.output("z", body.coordinate())
    result = mb.simulate(m, 5.0 * unit, interval=0.5 * unit, solver="radau", tolerance=1e-6)
    assert not result.warning
    z = result["z"] / size
    first = (60.0 - 30.0 - mass * G) / mass  # accelerations while the force acts, decreases, and is zero, m/s2
    rise = 0.5 * first * 0.3**2
    assert rise < z[-1] < rise + (first * 0.31) ** 2 / (2.0 * G) + 0.31 * 0.01 * first
    np.testing.assert_allclose(z[2:], z[2], atol=1e-7)  # it holds: 30 N are more than the weight


@pytest.mark.parametrize("static", [None, 7.0])
def test_the_force_at_which_it_breaks_away(static: float | None) -> None:
    given = {"coulomb": 5.0, "deflection": 1e-4, "static": static, "stribeck": 0.1 if static else None}
    ramp = mb.LineForce(magnitude="2 * t")
    result = mb.simulate(slider(ramp, mb.LineFriction(**given)), 4.0, interval=0.01, solver="radau", tolerance=1e-6)
    assert not result.warning
    largest = -result["friction"].min()
    assert largest == pytest.approx(static or 5.0, rel=5e-3)
    stuck = (result.t > 0.1) & (result.t < 0.89 * (static or 5.0) / 2.0)  # the bristle's vibration fades within 0.1 s
    np.testing.assert_allclose(result["friction"][stuck], -2.0 * result.t[stuck], atol=1e-4)
    assert np.abs(result["x"][stuck]).max() < 2e-4
    assert result["x"][-1] > 1e-2


def test_oscillations_lose_four_times_the_friction_over_the_stiffness_in_each_period() -> None:
    mass, k, friction, start = 2.0, 200.0, 3.0, 0.2
    spring = mb.LineForce(magnitude="200 * (1 - x)")
    m = slider(spring, mb.LineFriction(coulomb=friction, deflection=1e-6), mass=mass, start=start)
    half = np.pi * np.sqrt(mass / k)
    result = mb.simulate(m, 8.0 * half, interval=half, solver="radau", tolerance=1e-8)
    assert not result.warning
    lost = 2.0 * friction / k  # in half a period
    expected, sign, amplitude = [start], -1.0, start
    for _ in range(8):
        if amplitude > friction / k:  # it breaks away
            amplitude -= lost
            expected.append(sign * amplitude)
            sign = -sign
        else:
            expected.append(expected[-1])
    np.testing.assert_allclose(result["x"], expected, atol=1e-5)


def test_the_bristle_is_damped_by_the_mass_that_moves_along_the_line() -> None:
    """The reduced mass of two free masses, in any order; of a lever, its inertia over the arm squared."""
    m = mb.Mechanism()
    a = m.body("a", m.ground, mb.Translational(axis="x"), mass=2.0)
    b = m.body("b", m.ground, mb.Translational(axis="x", at=(1, 0, 0)), mass=3.0)
    lever = m.body("lever", m.ground, mb.Revolute(axis="z"), inertia=(3.0, 3.0, 5.0), mass=0.0)
    m.force("ab", mb.LineFriction(coulomb=1.0), a, b)
    m.force("gb", mb.LineFriction(coulomb=1.0), m.ground, b)
    m.force("lever", mb.LineFriction(coulomb=1.0, at_a=(2.0, 1.0, 0.0), at_b=(2.0, 0.0, 0.0)), m.ground, lever)
    found = [float(r["estimated_inertia"]) for r in CompiledMechanism(m).records(mb.LineFriction)]
    np.testing.assert_allclose(found, [6.0 / 5.0, 3.0, 5.0 / 4.0], rtol=1e-9)


def test_a_normal_force_may_be_a_law_of_the_length() -> None:
    """A wedge: the mass slides against friction mu c x from the length 1 m: v^2 / 2 = mu c (x^2 - 1) / (2 m)."""
    clamp = mb.LineFriction(coulomb=0.2, normal_force="c * x", uses={"c": 20.0}, deflection=1e-5)
    result = mb.simulate(slider(None, clamp, rate=1.5), 2.0, solver="radau", tolerance=1e-7)
    assert not result.warning
    assert result["length"][-1] == pytest.approx(np.sqrt(1.0 + 2.0 * 1.5**2 / 4.0), abs=1e-4)
    assert result["length"][-1] == result["x"][-1] + 1.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"coulomb": 0.0}, "coulomb of force 'seal' is 0.0"),
        ({"static": 2.0}, "stribeck of force 'seal' is not given"),
        ({"normal_force": mb.Reaction()}, "normal_force of a LineFriction is a Reaction"),
        ({"normal_force": "q + k", "uses": {"k": 1.0}}, "'q' is not known; allowed: t, x, v"),
    ],
)
def test_wrong_friction_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        slider(None, mb.LineFriction(**({"coulomb": 1.0} | wrong)))


def test_the_tolerance_is_that_of_the_nominal_value_of_the_coordinates() -> None:
    """Parts of 1 m at a distance of 1 km: the bristle of 1 mm is resolved at 1e-4, and by default it is 1e-5 m."""
    for deflection, said in ((1e-3, ()), (None, ("unresolved-friction",))):
        m = mb.Mechanism()
        body = m.body("mass", m.ground, mb.Translational(axis="x", at=(1e3, 0, 0), nominal=1.0), mass=2.0)
        friction = mb.LineFriction(coulomb=1.0, deflection=deflection, at_a=(999.0, 0, 0))
        m.force("seal", friction, m.ground, body)
        result = mb.simulate(m, 0.01, solver="radau", tolerance=1e-4)
        assert tuple(d.code for d in result.diagnostics) == said
    assert "deflection of force 'seal' is 1e-05" in result.diagnostics[0].text


@pytest.mark.parametrize("others", [0, 60])
def test_a_load_that_friction_holds_and_vibrates_about_its_place(others: int) -> None:
    """A mass on a slope: friction along a line that crosses the slope at 45 degrees holds it. The bristle has the
    stiffness mu / d along the line.
    """
    mass, friction, d = 2.0, 40.0, 1e-4
    m = mb.Mechanism(gravity=(0.5 * G, 0.0, -G))
    body = m.body("mass", m.ground, mb.Translational(axis="x"), mass=mass)
    m.force("seal", mb.LineFriction(coulomb=friction, deflection=d, at_a=(-1.0, 1.0, 0.0)), m.ground, body)
    for k in range(others):
        m.body(f"other{k}", m.ground, mb.Revolute(axis="y", start=1.1), **mb.rod(mass=1.0, length=1.0))
    found = mb.equilibrium(m)
    load = 0.5 * mass * G * np.sqrt(2.0)  # along the line
    assert load < 0.9 * friction
    assert found.states()["seal.bristle"] == pytest.approx(
        load / friction, rel=1e-4
    )  # the line turns by the deflection
    assert any("friction holds the start position" in d.text for d in found.diagnostics)
    frequencies = [shape.mode.natural_frequency for shape in mb.modes(m, count=200)]
    expected = np.sqrt(0.5 * friction / d / mass)
    assert min(abs(f / expected - 1.0) for f in frequencies) < 1e-3
    assert np.abs(mb.linearize(m).A - found.state_space.A).max() == 0.0
