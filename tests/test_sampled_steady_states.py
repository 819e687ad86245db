"""Steady states of models with digital controllers, and their stability by the map from one sample to the next."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import mbfmu as mb
from mbfmu.util.errors import UserError

MASS, LENGTH, G, TARGET, FRICTION = 2.0, 0.5, 9.81, 0.4, 0.3  # kg, m, m/s^2, rad, N m s
P, D, INTEGRAL = 40.0, 3.0, 60.0  # N m, N m s and N m/s per rad: gains of the controller
INERTIA, WEIGHT = MASS * LENGTH**2, MASS * G * LENGTH


def servo(period: float, *others: float, scale: float = 1.0, quantum: float = 0.0) -> mb.Mechanism:
    """Return an arm on which a digital PID controller acts, whose inputs are the angle and its rate.

    Blocks with ``others`` as periods hold the angle and act on nothing. ``scale`` multiplies the length of the arm at
    the same motion; the torques are those of the larger arm.
    """
    m = mb.Mechanism(gravity=(0.0, -G * scale, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=TARGET), mass=MASS, com=(LENGTH * scale, 0.0, 0.0))
    torque = scale**2
    m.force("friction", mb.JointDamper(damping=FRICTION * torque), arm)
    step = INTEGRAL * period * torque
    control = m.sampled_system(
        "control", [TARGET, arm.angle(), arm.rate()], period=period, A=[[1.0]], B=[[step, -step, 0.0]],
        C=[[1.0]], D=[[P * torque, -P * torque, -D * torque]], units=["N.m"], nominal=10.0 * torque,
    )  # fmt: skip
    m.force("motor", mb.JointForce(control.value()), arm)
    for k, other in enumerate(others):
        m.sample_hold(f"reading {k}", arm.angle(), period=other, quantum=quantum)
    m.output("angle", arm.angle())
    m.output("torque", control.value())
    return m


def exact_map(period: float) -> Any:
    """Return the map of (angle, rate, integral) over a period, by the exact map from the held torque to the state."""
    stiffness = -WEIGHT * np.sin(TARGET)
    flow = np.zeros((3, 3))  # angle, rate, held torque
    flow[0, 1], flow[1] = 1.0, np.array([-stiffness, -FRICTION, 1.0]) / INERTIA
    step = expm(period * flow)
    feedback = np.array([-P, -D])
    plant = np.hstack((step[:2, :2] + np.outer(step[:2, 2], feedback), step[:2, 2:]))
    return np.vstack((plant, [-INTEGRAL * period, 0.0, 1.0]))


def nonzero(multipliers: Any) -> Any:
    found = multipliers[np.abs(multipliers) > 1e-9]
    return np.sort_complex(found)


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize(("period", "stays"), [(0.02, True), (0.2, False)])
def test_a_digital_controller_holds_an_arm(period: float, stays: bool, scale: float) -> None:
    """Closed form: the integral carries the weight. Between samples the exact map of the linear plant; a run from the
    state remains there if it is stable, and a deviation grows by the largest multiplier if not.
    """
    state = mb.equilibrium(servo(period, scale=scale))
    assert state.outputs["angle"] == pytest.approx(TARGET, abs=1e-9)
    assert state.outputs["torque"] == pytest.approx(WEIGHT * np.cos(TARGET) * scale**2, rel=1e-9)
    exact = np.linalg.eigvals(exact_map(period))
    assert state.multipliers is not None
    np.testing.assert_allclose(nonzero(state.multipliers), nonzero(exact), rtol=0.0, atol=1e-8)
    assert state.stability == ("stable" if stays else "unstable")
    assert stays == (np.abs(exact).max() < 1.0)


def test_a_run_stays_in_the_steady_state() -> None:
    """Closed form, as above: the first sample finds the state that the samples before would have left."""
    result = mb.simulate(servo(0.02), 3.0, interval=0.1, solver="adams", tolerance=1e-8, start_at_equilibrium=True)
    np.testing.assert_allclose(result["angle"], TARGET, rtol=0.0, atol=1e-8)
    assert not result.warning
    result = mb.simulate(servo(0.2), 0.4, interval=0.1, solver="adams", tolerance=1e-8, start_at_equilibrium=True)
    assert "unstable-start" in [diagnostic.code for diagnostic in result.diagnostics]


def test_deviations_follow_the_map() -> None:
    """Reference: powers of the exact map, for a small impulse on the arm in the unstable state."""
    period, push, m = 0.2, 1e-4, servo(0.2)
    m.event("push", at=0.0, then=mb.Impulse(m.bodies[1], push))
    result = mb.simulate(m, 4.0, interval=period, solver="adams", tolerance=1e-10, start_at_equilibrium=True)
    step, deviation, expected = exact_map(period), np.array([0.0, push / INERTIA, 0.0]), []
    for _ in result.t:
        expected.append(deviation[0])
        deviation = step @ deviation
    assert np.abs(expected[-3:]).max() > 4.0 * np.abs(expected[:3]).max()
    np.testing.assert_allclose(result["angle"] - TARGET, expected, rtol=1e-2, atol=1e-9)


def test_blocks_of_several_periods() -> None:
    """Identity: blocks that act on nothing have the multiplier zero; a longer common period gives powers."""
    alone = mb.equilibrium(servo(0.02)).multipliers
    for others, power in (((0.01,), 1), ((0.04, 0.01), 2), ((0.03,), 3)):
        state = mb.equilibrium(servo(0.02, *others))
        assert state.multipliers is not None
        assert state.stability == "stable"
        expected = np.sort_complex(nonzero(alone) ** power)
        np.testing.assert_allclose(nonzero(state.multipliers), expected, rtol=0.0, atol=1e-9)


def test_periods_without_a_common_multiple() -> None:
    state = mb.equilibrium(servo(0.02, 0.02 * np.sqrt(2.0)))
    assert state.stability == "unknown"
    assert state.multipliers is None
    assert "their periods have no common multiple that is short enough" in str(state)


def test_a_mass_that_nothing_holds_is_neutral() -> None:
    m = servo(0.02)
    m.body("free", m.ground, mb.Translational(axis="x"), mass=1.0)
    assert mb.equilibrium(m).stability == "neutral"


def test_what_samples_do_not_have_is_refused() -> None:
    with pytest.raises(
        UserError, match=r"block 'reading 0' of model 'mechanism' rounds its outputs to multiples of 0\.1"
    ):
        mb.equilibrium(servo(0.02, 0.02, quantum=0.1))
    text = "model 'mechanism' has sampled blocks, about whose steady state no linear model in continuous time"
    for function in (mb.linearize, mb.modes):
        with pytest.raises(UserError, match=text):
            function(servo(0.02))
