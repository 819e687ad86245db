"""Inputs that a host sets at every communication point: what they cost, and what of the accuracy they leave."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fmus.fourbar import FourBar
from mbfmu.simulation import Settings, Simulation

START, END = 0.4, 1.0
Torque = Callable[[float], float]


def exact(torque: Torque, step: float, model: FourBar, end: float = END) -> tuple[float, float]:
    """Angle and rate at the end. Equal cranks: the coupler translates, so that all is one inertia about the pivot."""
    length = model.crank_length
    inertia = (model.crank_mass + model.rocker_mass) / 3.0 + model.coupler_mass
    weight = (0.5 * (model.crank_mass + model.rocker_mass) + model.coupler_mass) * model.gravity
    y: NDArray[np.float64] = np.array([START, 0.0])
    for k in range(round(end / step)):
        held = torque(k * step)

        def rates(_t: float, y: NDArray[np.float64], held: float = held) -> list[float]:
            return [y[1], (held / length**2 - weight / length * np.cos(y[0])) / inertia]

        y = solve_ivp(rates, (0.0, step), y, rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
    return float(y[0]), float(y[1])


def moved(torque: Torque, step: float, settings: Settings, end: float = END) -> Simulation:
    simulation = Simulation(FourBar(start_angle=START), settings)
    for k in range(round(end / step)):
        simulation.set_input("crank.torque", torque(k * step))
        simulation.advance((k + 1) * step)
        assert not simulation.failure
    return simulation


def off(simulation: Simulation, goal: tuple[float, float]) -> float:
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    return max(abs(found["crank.angle"] - goal[0]), abs(found["crank.rate"] - goal[1]))


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
@pytest.mark.parametrize("step", [1e-3, 1e-2])
@pytest.mark.parametrize("amplitude", [5.0, 100.0])
def test_a_changing_torque_takes_a_step_a_point_and_no_accuracy(amplitude: float, step: float, solver: str) -> None:
    def torque(t: float) -> float:
        return float(amplitude * np.sin(7.0 * t))

    goal = exact(torque, step, FourBar())
    for tolerance in (1e-4, 1e-6, 1e-8):
        simulation = moved(torque, step, Settings(solver=solver, tolerance=tolerance))
        points = END / step
        assert off(simulation, goal) < max(tolerance, 1e-9), tolerance
        assert simulation.statistics.steps <= 1.5 * points, tolerance
        assert simulation.statistics.rhs_evals <= 10.0 * points, tolerance
        assert simulation.verdict == ""


def test_single_steps_are_of_order_five() -> None:
    """A torque that is set to the same value at every point, under a tolerance that asks for nothing."""
    steps = np.array([0.1, 0.05, 0.025])
    goal = exact(lambda _: 600.0, 0.4, FourBar(), end=0.4)  # far from where the linkage is flat
    settings = Settings(solver="adams", tolerance=1e-2)
    errors = [off(moved(lambda _: 600.0, step, settings, end=0.4), goal) for step in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert orders == pytest.approx(5.0, abs=0.7)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_ida_keeps_its_history_across_changes(tolerance: float) -> None:
    def torque(t: float) -> float:
        return float(5.0 * np.sin(7.0 * t))

    goal = exact(torque, 1e-3, FourBar())
    simulation = moved(torque, 1e-3, Settings(solver="ida", tolerance=tolerance))
    assert off(simulation, goal) < max(1e-5, 20.0 * tolerance) if tolerance > 1e-7 else off(simulation, goal) < 5e-7
    assert simulation.statistics.restarts <= 5
    assert simulation.statistics.rhs_evals <= 10_000  # of 1000 points
    assert simulation.verdict == ""


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_a_jump_after_a_long_rest_is_one_of_few(solver: str) -> None:
    """Between changes that are far apart a history is worth having, and steps pass the points again."""

    def torque(t: float) -> float:
        return 20.0 * (t // 0.25)

    goal = exact(torque, 0.25, FourBar())
    simulation = Simulation(FourBar(start_angle=START), Settings(solver=solver, tolerance=1e-8))
    for k in range(1000):
        if k % 250 == 0:
            simulation.set_input("crank.torque", torque(k * 1e-3))
        simulation.advance((k + 1) * 1e-3)
    assert off(simulation, goal) < 5e-6
    assert simulation.statistics.steps < 700
    assert simulation.verdict == ""


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
def test_a_state_saved_between_changes_goes_on_bit_for_bit(solver: str) -> None:
    def torque(t: float) -> float:
        return float(5.0 * np.sin(7.0 * t))

    settings = Settings(solver=solver, tolerance=1e-6)
    first, second = moved(torque, 1e-2, settings), Simulation(FourBar(start_angle=START), settings)
    second.restore(first.save())
    for k in range(20):
        for simulation in (first, second):
            simulation.set_input("crank.torque", float(k % 3))
            simulation.advance(END + (k + 1) * 1e-2)
        np.testing.assert_array_equal(first.outputs(), second.outputs())
