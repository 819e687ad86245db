"""Radau IIA: its formulas, its order, what is stiff, and its state."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from oracles import particle
from scipy.integrate import solve_ivp

from mbfmu.mechanics import JointSpring, Mechanism, Revolute, Spherical, rod
from mbfmu.settings import Settings
from mbfmu.simulation import Simulation
from solvers import SOLVERS, Options
from solvers.steppers.radau import formulas as f


def test_coefficients() -> None:
    """Collocation at the nodes, a quadrature of order 5, and transformations that undo each other."""
    for k in range(1, 4):
        np.testing.assert_allclose(f.A @ f.NODES ** (k - 1), f.NODES**k / k, atol=1e-15)
    for k in range(1, 6):
        assert f.A[2] @ f.NODES ** (k - 1) == pytest.approx(1.0 / k, abs=1e-15)
    Z = np.random.default_rng(1).normal(size=3)
    back = f.FROM_REAL * (f.TO_REAL @ Z) + (f.FROM_COMPLEX * (f.TO_COMPLEX @ Z)).real
    np.testing.assert_allclose(back, Z, atol=1e-14)
    for k in range(4):  # the embedded formula integrates cubics: 1 + E . (A t^k) is nothing for them
        start = 1.0 if k == 0 else 0.0
        assert start + f.E @ (f.A @ f.NODES**k) == pytest.approx(0.0, abs=1e-13) or k == 3


def end_of(solver: str, h: float) -> float:
    """Position of a particle on a spring of 1 rad/s after 2 s in steps of h."""
    stepper = SOLVERS[solver](particle(1.0), 0.0, np.ones(1), np.zeros(1), Options(rtol=1e-2, max_step=h))
    stepper._settings["rtol"] = stepper._settings["atol"] = 1e6  # steps are as long as they may be
    stepper._settings["exact"] = 1e-20
    stepper._control["ends"], stepper._control["h"] = 10**6, h
    assert stepper.advance(2.0).ok
    return float(stepper.q[0])


def test_order_is_five() -> None:
    errors = [abs(end_of("radau", h) - np.cos(2.0)) for h in (0.5, 0.25, 0.125)]
    orders = [np.log2(a / b) for a, b in pairwise(errors)]
    assert min(orders) > 4.7


def stiff(damping: float) -> Mechanism:
    """A pendulum in oil: its rate follows its weight within moment of inertia / damping."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    m.force("oil", JointSpring(damping=damping), bar)
    m.output("bar.angle", bar.angle())
    return m


@pytest.mark.parametrize("damping", [1e2, 1e4, 1e6])
def test_what_is_stiff_and_damped_takes_few_steps(damping: float) -> None:
    end = 0.5 * damping / 10.0

    def rates(_: float, y: object) -> list[float]:
        return [y[1], 3.0 * (-0.5 * 9.81 * np.cos(y[0]) - damping * y[1])]  # type: ignore[index]

    known = solve_ivp(rates, (0.0, end), [0.0, 0.0], method="Radau", rtol=1e-10, atol=1e-13).y[0, -1]
    simulation = Simulation(stiff(damping), Settings(solver="radau", tolerance=1e-6))
    assert simulation.advance(end).ok
    assert simulation.stepper.q[0] == pytest.approx(known, abs=1e-5)
    assert simulation.statistics.steps < 80


def spinning() -> Mechanism:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    top = m.body(
        "top",
        m.ground,
        Spherical(rate=(1.0, 2.0, 30.0)),
        mass=1.0,
        com=(0.0, 0.1, 0.2),
        inertia=(0.02, 0.03, 0.01),
    )
    low = m.body("low", top, Revolute(axis=(0.0, 1.0, 0.0), at=(0.0, 0.0, 0.3)), **rod(mass=0.2, length=0.3))
    m.force("spring", JointSpring(stiffness=20.0), low)
    m.output("low.angle", low.angle())
    return m


def test_a_restored_state_goes_on_bit_for_bit() -> None:
    one, other = (Simulation(spinning(), Settings(solver="radau")) for _ in range(2))
    assert one.advance(0.37).ok
    saved = one.save()
    assert one.advance(0.9).ok
    other.restore(saved)
    assert other.advance(0.9).ok
    np.testing.assert_array_equal(one.stepper.q, other.stepper.q)
    np.testing.assert_array_equal(one.stepper.v, other.stepper.v)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
def test_quaternions_keep_the_tolerance_where_outputs_are_asked_for(tolerance: float) -> None:
    """Between the ends of steps too; the reference is the other method at the tightest tolerance."""
    times = np.linspace(0.0, 1.0, 38)[1:]
    found = {}
    for solver, asked in (("radau", tolerance), ("adams", 1e-12)):
        simulation = Simulation(spinning(), Settings(solver=solver, tolerance=asked))
        found[solver] = simulation.stepper.sample(times).q
    assert abs(found["radau"] - found["adams"]).max() < 30.0 * tolerance
