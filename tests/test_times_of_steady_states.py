"""Signals in a steady state are at their ends; at the start of a run they have their values at t = 0."""

from __future__ import annotations

from math import asin, cos, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import mbfmu as mb
from mbfmu.mechanics.signals import Product, Sum

STIFFNESS, MASS, GRAVITY = 50.0, 2.0, 9.81


def pushed(load: Any) -> mb.Mechanism:
    """A mass on a spring, x = load / STIFFNESS, with aperiodic damping."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    mass = m.body("mass", m.ground, mb.Translational(axis="x", start=0.02), mass=MASS)
    m.force("spring", mb.JointSpring(stiffness=STIFFNESS, damping=2.0 * sqrt(STIFFNESS * MASS)), mass)
    m.force("push", mb.JointForce(load), mass)
    m.output("x", mass.coordinate())
    return m


def step(begin: float, duration: float = 0.0) -> mb.Step:
    return mb.Step(height=2.0, begin=begin, duration=duration, offset=3.0)


ENDING = {
    "late jump": (step(5.0), 3.0, 5.0),
    "jump between sampled times": (step(1.0), 3.0, 5.0),
    "smooth": (step(0.5, 0.2), 3.0, 5.0),
    "begun": (step(0.0), 5.0, 5.0),
    "ramp": (mb.Ramp(height=2.0, begin=0.5, duration=0.2, offset=3.0), 3.0, 5.0),
    "half risen ramp": (mb.Ramp(height=2.0, begin=-1.0, duration=2.0, offset=3.0), 4.0, 5.0),
    "table": (mb.Table([0.0, 1.0, 2.0], [3.0, 4.0, 4.5], "linear", "hold"), 3.0, 4.5),
    "spline": (mb.Table([-1.0, 0.0, 2.0], [3.0, 4.0, 4.5], "spline", "hold"), 4.0, 4.5),
    "flat table": (mb.Table([0.0, 1.0, 2.0], [3.0, 4.0, 4.0], "linear"), 3.0, 4.0),
    "sum": (Sum(step(1.0), step(2.0), 0.5), 6.5, 10.5),
    "product": (Product(step(1.0), step(2.0)), 9.0, 25.0),
    "constant expression": ("2*pi", 2.0 * pi, 2.0 * pi),
    "harmonic without amplitude": (mb.Harmonic(amplitude=0.0, frequency=1.0, mean=3.0), 3.0, 3.0),
}

ENDLESS = {
    "a Harmonic": (mb.Harmonic(amplitude=2.0, frequency=1.0, mean=1.0, phase=0.5 * pi), 3.0),
    "a Polynomial": (mb.Polynomial((3.0, 1.0)), 3.0),
    "a RunUp": (mb.RunUp(speed=1.0, duration=1.0, start=3.0), 3.0),
    "a Table": (mb.Table([0.0, 1.0, 2.0], [3.0, 4.0, 5.0], "linear"), 3.0),
    "a function of time": (lambda t: 3.0 + t * t, 3.0),
    "a Sum with a Harmonic": (Sum(step(1.0), mb.Harmonic(amplitude=1.0, frequency=1.0)), 3.0),
    "a Product with a Table": (Product(1.5, mb.Table([0.0, 1.0, 2.0], [2.0, 3.0, 2.0], beyond="periodic")), 3.0),
}


@pytest.mark.parametrize("name", ENDING)
def test_loads_are_at_their_ends(name: str) -> None:
    load, _, end = ENDING[name]
    assert mb.equilibrium(pushed(load)).outputs["x"] == pytest.approx(end / STIFFNESS, rel=1e-9)


@pytest.mark.parametrize("kind", ENDLESS)
def test_a_load_that_never_becomes_constant_is_refused_by_its_name(kind: str) -> None:
    with pytest.raises(mb.UserError, match=f"the magnitude of force 'push' is {kind}, which does not end at"):
        mb.equilibrium(pushed(ENDLESS[kind][0]))


@pytest.mark.parametrize("name", [*ENDING, *ENDLESS])
def test_a_run_starts_in_balance_with_the_loads_at_zero(name: str) -> None:
    load, begin, *_ = ENDING.get(name) or ENDLESS[name]
    found = mb.simulate(pushed(load), 0.01, solver="adams", start_at_equilibrium=True)
    assert found["x"][0] == pytest.approx(begin / STIFFNESS, rel=1e-9)


def test_a_run_continues_with_the_load_that_was_held_at_its_start() -> None:
    """Against SciPy, with a load that changes at once and a step that begins later."""

    def rate(t: float, y: Any) -> tuple[float, float]:
        load = 1.0 + 2.0 * np.cos(3.0 * t) + 2.0 * min(max(t - 0.4, 0.0) / 0.5, 1.0)
        return y[1], (load - STIFFNESS * y[0] - 2.0 * sqrt(STIFFNESS * MASS) * y[1]) / MASS

    load = Sum(
        mb.Harmonic(amplitude=2.0, frequency=1.5 / pi, phase=0.5 * pi, mean=1.0),
        mb.Ramp(height=2.0, begin=0.4, duration=0.5),
    )
    found = mb.simulate(pushed(load), 2.0, interval=0.1, solver="adams", tolerance=1e-9, start_at_equilibrium=True)
    exact = solve_ivp(rate, (0.0, 2.0), (3.0 / STIFFNESS, 0.0), t_eval=found.t, rtol=1e-11, atol=1e-13, max_step=0.01)
    np.testing.assert_allclose(found["x"], exact.y[0], atol=2e-8)


def test_a_force_of_the_joint_that_depends_on_time_is_reported_without_a_drive() -> None:
    load = "-3.0*q + 2.0*cos(t)"
    with pytest.raises(mb.UserError, match=r"balance at t = 0 leave .* at 'mass' at t = 0\.7 s, although no drive"):
        mb.equilibrium(pushed(load))
    found = mb.simulate(pushed(load), 0.01, solver="adams", start_at_equilibrium=True)
    assert found["x"][0] == pytest.approx(2.0 / (STIFFNESS + 3.0), rel=1e-9)


def turning(drive: Any, load: Any) -> mb.Mechanism:
    """A mass on a radial spring of a turning arm: STIFFNESS x = load + MASS (0.3 + x) speed^2."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(axis="z", drive=drive), mass=1.0)
    mass = m.body("mass", arm, mb.Translational(at=(0.3, 0.0, 0.0), axis="x"), mass=MASS)
    m.force("spring", mb.JointSpring(stiffness=STIFFNESS), mass)
    m.force("push", mb.JointForce(load), mass)
    m.output("x", mass.coordinate())
    m.output("speed", arm.rate())
    return m


@pytest.mark.parametrize("load", [step(0.1), step(5.0), lambda t: 3.0 * np.cos(t)])
def test_a_load_may_change_after_a_start_with_moving_drives(load: Any) -> None:
    found = mb.simulate(turning(mb.Polynomial((0.0, 3.0)), load), 0.01, solver="adams", start_at_equilibrium=True)
    assert found["x"][0] == pytest.approx((3.0 + MASS * 0.3 * 9.0) / (STIFFNESS - MASS * 9.0), rel=1e-9)


def test_run_ups_and_steps_end_together() -> None:
    found = mb.equilibrium(turning(mb.RunUp(speed=3.0, duration=1.0), step(7.0)))
    assert found.outputs["x"] == pytest.approx((5.0 + MASS * 0.3 * 9.0) / (STIFFNESS - MASS * 9.0), rel=1e-9)
    assert found.outputs["speed"] == pytest.approx(3.0)


def test_modes_and_state_matrices_are_those_of_the_final_load() -> None:
    """A rod held by a torque at an angle from the vertical."""
    m = mb.Mechanism(gravity=(0.0, -GRAVITY, 0.0))
    bar = m.body("rod", m.ground, mb.Revolute(start=-0.5 * pi), **mb.rod(mass=1.0, length=1.0))
    m.force("torque", mb.JointForce(mb.Step(height=2.0, begin=9.0, offset=1.0)), bar)
    angle = asin(3.0 / (0.5 * GRAVITY))
    frequency = sqrt(1.5 * GRAVITY * cos(angle))
    assert mb.modes(m)[0].mode.frequency == pytest.approx(frequency, rel=1e-8)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(mb.linearize(m).A)), frequency, rtol=1e-8)


def lifted(drive: Any) -> mb.Mechanism:
    """A mass suspended from a vertically driven support."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -GRAVITY))
    support = m.body("support", m.ground, mb.Translational(axis="z", drive=drive))
    mass = m.body("mass", support, mb.Translational(axis="z"), mass=MASS)
    m.force("spring", mb.JointSpring(stiffness=STIFFNESS), mass)
    m.output("x", mass.coordinate())
    m.output("support", support.coordinate())
    return m


def quintic(t: float) -> float:
    """Acceleration of a rise by 0.7 m from 0.2 s to 0.7 s, x = 6 s^5 - 15 s^4 + 10 s^3 of it."""
    s = (t - 0.2) / 0.5
    return 0.7 * (120.0 * s**3 - 180.0 * s**2 + 60.0 * s) / 0.25 if 0.0 < s < 1.0 else 0.0


SMOOTH = {
    "step": (mb.Step(height=0.7, begin=0.2, duration=0.5, offset=0.1), 0.1, quintic),
    "run-up": (mb.RunUp(speed=2.0, duration=0.8), 0.0, lambda t: 2.5 * (1.0 - cos(2.5 * pi * t)) if t < 0.8 else 0.0),
    "function": ("0.1 + t**3", 0.1, lambda t: 6.0 * t),
    "sum": (Sum(mb.Step(height=0.7, begin=0.2, duration=0.5), 0.3), 0.3, quintic),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_a_run_starts_at_rest_before_its_drives_move(name: str) -> None:
    """Against SciPy: x is relative to the support, MASS (x'' + z'') = -STIFFNESS x - MASS GRAVITY."""
    drive, place, acceleration = SMOOTH[name]
    found = mb.simulate(lifted(drive), 1.0, interval=0.1, solver="adams", tolerance=1e-9, start_at_equilibrium=True)

    def rate(t: float, y: Any) -> tuple[float, float]:
        return y[1], -STIFFNESS / MASS * y[0] - GRAVITY - acceleration(t)

    start = (-MASS * GRAVITY / STIFFNESS, 0.0)
    exact = solve_ivp(rate, (0.0, 1.0), start, t_eval=found.t, rtol=1e-11, atol=1e-13, max_step=0.01)
    assert found["support"][0] == pytest.approx(place, abs=1e-12)
    np.testing.assert_allclose(found["x"], exact.y[0], atol=1e-7)


MOVING = {
    "a Polynomial": mb.Polynomial((0.0, 0.0, 1.0)),
    "a Harmonic": mb.Harmonic(amplitude=0.1, frequency=1.0),
    "a Step": mb.Step(height=1.0, begin=-0.5, duration=1.0),
    "a RunUp": Sum(mb.RunUp(speed=1.0, duration=1.0), mb.Harmonic(amplitude=0.1, frequency=1.0)),
    "a function of time": "0.3*t*t",
}


@pytest.mark.parametrize("kind", MOVING)
def test_a_drive_that_moves_at_the_start_is_refused_with_what_is_allowed(kind: str) -> None:
    named = "a Harmonic" if kind == "a RunUp" else kind
    with pytest.raises(mb.UserError, match=f"'support' is {named} with the speed .* at t = 0.*RunUp or a Step that"):
        mb.simulate(lifted(MOVING[kind]), 0.1, start_at_equilibrium=True)


@pytest.mark.parametrize(
    "load",
    [
        mb.Table([0.0, 0.5, 1.0], [0.0, 2.0, 0.0], "spline", "periodic"),
        mb.Table([5.0, 5.2], [0.0, 4.0], "monotone", "hold"),
    ],
)
def test_a_table_that_is_flat_at_all_its_points_is_not_constant(load: mb.Table) -> None:
    """Against SciPy: the solver does not step over what happens between the points."""
    splines = {3: lambda t: CubicSpline(load.x, load.y, bc_type="periodic")(t % 1.0), 2: cubic}
    value = splines[len(load.x)]

    def rate(t: float, y: Any) -> tuple[float, float]:
        return y[1], (float(value(t)) - STIFFNESS * y[0] - 2.0 * sqrt(STIFFNESS * MASS) * y[1]) / MASS

    found = mb.simulate(pushed(load), 6.0, interval=0.5, solver="adams", tolerance=1e-8, start_at_equilibrium=True)
    exact = solve_ivp(rate, (0.0, 6.0), (0.0, 0.0), t_eval=found.t, rtol=1e-10, atol=1e-12, max_step=0.02)
    np.testing.assert_allclose(found["x"], exact.y[0], atol=1e-6)


def cubic(t: float) -> float:
    """Rise by 4 from 5 s to 5.2 s, with zero slope at both ends."""
    s = min(max((t - 5.0) / 0.2, 0.0), 1.0)
    return 4.0 * s * s * (3.0 - 2.0 * s)
