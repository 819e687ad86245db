"""Linearized motion of what supports carry whose speed, or whose position, is an input."""

from typing import Any

import numpy as np
import pytest
from scipy import signal

import mbfmu as mb

K, C, MASS, LENGTH, G = 100.0, 3.0, 2.0, 0.7, 9.81


def carried(drive: Any, others: int = 0) -> mb.Mechanism:
    """A mass on ground, joined to a driven base by a spring-damper."""
    m = mb.Mechanism()
    base = m.body("base", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    mass = m.body("mass", m.ground, mb.Translational(axis="x", at=(1, 0, 0)), mass=MASS)
    m.force("spring", mb.Spring(stiffness=K, damping=C, free=1.0), base, mass)
    m.output("base", base.coordinate())
    m.output("mass", mass.coordinate())
    m.output("force", base.effort())
    return m


def cart(drive: Any) -> mb.Mechanism:
    """A pendulum on a driven cart."""
    m = mb.Mechanism(gravity=(0, -G, 0))
    base = m.body("base", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    bob = m.body("bob", base, mb.Revolute(start=0.0), mass=MASS, com=(0.0, -LENGTH, 0.0))
    m.output("angle", bob.angle())
    return m


SPEED = mb.SpeedInput(name="v", unit="m/s")


def test_the_position_of_a_joint_driven_at_a_speed_is_a_state() -> None:
    space = mb.linearize(carried(SPEED))
    assert space.states == ("mass", "der(mass)", "base")
    k, c = K / MASS, C / MASS
    np.testing.assert_allclose(space.A, [[0, 1, 0], [-k, -c, k], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(space.B, [[0], [c], [1]], atol=1e-12)
    np.testing.assert_allclose(space.C, [[0, 0, 1], [1, 0, 0], [-K, -C, K]], atol=1e-12)
    np.testing.assert_allclose(space.D, [[0], [0], [C]], atol=1e-12)
    (note,) = map(str, space.diagnostics)  # the force that accelerates the base
    assert "input 'v' moves a support and its acceleration is not an input" in note


def test_it_is_the_motion_of_the_simulation() -> None:
    """The base moves by 0.5 m in 5 s."""
    run = mb.simulate(carried(SPEED), 5.0, interval=0.01, solver="adams", tolerance=1e-9, inputs={"v": 0.1})
    space = mb.linearize(carried(SPEED))
    _, found, _ = signal.lsim(space.to_scipy(), np.full_like(run.t, 0.1), run.t)
    assert found[-1, 0] == pytest.approx(0.5)
    np.testing.assert_allclose(found[:, 1], run["mass"], atol=1e-7)
    np.testing.assert_allclose(found[1:, 2], run["force"][1:], atol=1e-5)


def test_the_driven_position_is_no_mode() -> None:
    """Nor is it where nothing depends on it."""
    assert mb.equilibrium(carried(SPEED)).stability == "stable"
    assert len(mb.modes(carried(SPEED))) == 1
    m = cart(SPEED)
    assert mb.linearize(m).states == ("bob", "der(bob)")
    assert any("acceleration is not an input" in d.text for d in mb.linearize(m).diagnostics)


def test_the_acceleration_of_a_cart_is_an_input_where_it_has_a_name() -> None:
    """phi'' = -(g phi + x'') / l."""
    space = mb.linearize(cart(mb.Input(name="x", unit="m", rate_name="v", acceleration_name="a")))
    assert space.inputs == ("x", "v", "a")
    np.testing.assert_allclose(space.B, [[0, 0, 0], [0, 0, -1.0 / LENGTH]], atol=1e-12)
    assert space.A[1, 0] == pytest.approx(-G / LENGTH)
    assert not space.diagnostics
    for names, left_out in (({}, ["rate", "acceleration"]), ({"rate_name": "v"}, ["acceleration"])):
        notes = mb.linearize(carried(mb.Input(name="x", unit="m", **names))).diagnostics
        assert all(f"its {what} is not an input" in note.text for what, note in zip(left_out, notes, strict=True))
