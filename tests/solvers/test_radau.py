"""Radau IIA: its formulas, its order, what is stiff, and its state."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from oracles import INERTIA, fourbar, fourbar_q, fourbar_v, particle, pendulum, rigid_body
from scipy.integrate import solve_ivp

from mbfmu.mechanics import JointSpring, Mechanism, Revolute, Spherical, rod
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
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
    # The error estimate is zero for slopes t^0 to t^2, which the embedded formula of order 3 integrates exactly.
    estimates = [(1.0 if k == 0 else 0.0) + f.E @ (f.A @ f.NODES**k) for k in range(4)]
    np.testing.assert_allclose(estimates[:3], 0.0, atol=1e-13)
    assert abs(estimates[3]) > 1e-3


def end_of(solver: str, h: float) -> float:
    """Position of a particle on a spring of 1 rad/s after 2 s in steps of h."""
    stepper = SOLVERS[solver](particle(1.0), 0.0, np.ones(1), np.zeros(1), Options(rtol=1e-2, max_step=h))
    stepper._settings["rtol"] = stepper._settings["atol"] = 1e6  # steps are as long as they may be
    stepper._settings["newton_tolerance"] = 1e-20
    stepper._control["truncated_steps"], stepper._control["h"] = 10**6, h
    assert stepper.advance(2.0).ok
    return float(stepper.q[0])


def test_order_is_five() -> None:
    errors = [abs(end_of("radau", h) - np.cos(2.0)) for h in (0.5, 0.25, 0.125)]
    orders = [np.log2(a / b) for a, b in pairwise(errors)]
    assert min(orders) > 4.7


LOW = np.radians(-33.0)  # crank angle from which the four-bar swings between two singular configurations
SPIN = np.array([0.7, 1.9, -0.8])  # rad/s


def exact_fourbar(t: float) -> np.ndarray:
    """Positions and velocities of the four-bar released at LOW."""
    angle, rate = pendulum(LOW)(t)
    return np.concatenate((fourbar_q(angle), fourbar_v(rate)))


def exact_particle(t: float) -> np.ndarray:
    return np.array([np.cos(t), -np.sin(t)])


@lru_cache
def rotation() -> Any:
    """Rotation matrix and body rates of the free rigid body as a function of time: R' = R [w], Euler's equations."""

    def slope(_: float, y: Any) -> Any:
        w = y[9:]
        cross = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        return np.concatenate(((y[:9].reshape(3, 3) @ cross).ravel(), -np.cross(w, INERTIA * w) / INERTIA))

    start = np.concatenate((np.eye(3).ravel(), SPIN))
    return solve_ivp(slope, (0.0, 2.0), start, "DOP853", rtol=1e-13, atol=1e-13, dense_output=True).sol


def turned(q: Any) -> Any:
    """Rotation matrix of a unit quaternion."""
    r = np.array([[0.0, -q[3], q[2]], [q[3], 0.0, -q[1]], [-q[2], q[1], 0.0]])
    return np.eye(3) + 2.0 * q[0] * r + 2.0 * r @ r


CASES: dict[str, Any] = {
    "particle": (particle(1.0), [1.0], [0.0], exact_particle, lambda q, v: np.concatenate((q, v))),
    "loop": (fourbar(), fourbar_q(LOW), fourbar_v(0.0), exact_fourbar, lambda q, v: np.concatenate((q, v))),
    "quaternion": (
        rigid_body(), [1.0, 0.0, 0.0, 0.0], SPIN, rotation(),
        lambda q, v: np.concatenate((turned(q).ravel(), v)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_order_is_five_between_the_ends_of_steps(case: str) -> None:
    """Of positions and of velocities; the end of the run is left out, what counts is inside of steps."""
    system, q, v, exact, seen = CASES[case]
    found = []
    for h in (0.08, 0.04, 0.02):
        stepper = SOLVERS["radau"](system, 0.0, np.array(q), np.array(v), Options(rtol=1e-2, max_step=h))
        stepper._settings["rtol"] = stepper._settings["atol"] = 1e3
        stepper._settings["newton_tolerance"], stepper._control["h"] = 1e-15, h
        largest = np.zeros(2)
        for t in h / 8.0 * np.arange(1, round(8.0 / h)):
            assert stepper.advance(t).ok
            apart = abs(seen(stepper.q, stepper.v) - exact(t))
            largest = np.maximum(largest, [apart[: -len(v)].max(), apart[-len(v) :].max()])
        assert stepper.statistics.steps <= 1.0 / h + 2
        found.append(largest)
    assert all(np.log2(a / b).min() > 4.5 for a, b in pairwise(found)), found


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("case", CASES)
def test_reported_states_are_as_accurate_as_the_ends_of_steps(case: str, tolerance: float) -> None:
    system, q, v, exact, seen = CASES[case]
    stepper = SOLVERS["radau"](system, 0.0, np.array(q), np.array(v), Options(rtol=tolerance))
    ends, between, memory = 0.0, 0.0, stepper.method.memory
    for t in np.linspace(0.0, 2.0, 500)[1:]:
        assert stepper.advance(t).ok
        between = max(between, abs(seen(stepper.q, stepper.v) - exact(t)).max())
        reached = float(memory.control["t"][0])
        if reached <= 2.0:
            ends = max(ends, abs(seen(memory.q, memory.v) - exact(reached)).max())
    assert between < 20.0 * tolerance
    assert between < 5.0 * ends + 1e-13


def stiff(damping: float) -> Mechanism:
    """A pendulum in oil: its rate follows its weight within moment of inertia / damping."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    bar = m.body("bar", m.ground, Revolute(), **rod(mass=1.0, length=1.0))
    m.force("oil", JointSpring(damping=damping), bar)
    m.output("bar.angle", bar.angle())
    m.output("bar.rate", bar.rate())
    return m


@pytest.mark.parametrize("damping", [1e2, 1e4, 1e6])
def test_what_is_stiff_and_damped_takes_few_steps(damping: float) -> None:
    end = 0.5 * damping / 10.0

    def rates(_: float, y: object) -> list[float]:
        return [y[1], 3.0 * (-0.5 * 9.81 * np.cos(y[0]) - damping * y[1])]  # type: ignore[index]

    times = np.linspace(0.0, end, 101)[1:]
    known = solve_ivp(rates, (0.0, end), [0.0, 0.0], method="Radau", rtol=1e-10, atol=1e-13, t_eval=times).y
    simulation = Simulation(stiff(damping), Settings(solver="radau", tolerance=1e-6))
    found = np.zeros((len(times), len(simulation.variables)))
    assert simulation.record(times, found) == len(times)
    assert abs(found[:, 0] - known[0]).max() < 1e-5
    assert abs(found[:, 1] - known[1]).max() < 1e-5  # between the ends of steps, where accelerations are known badly
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
