"""Large mechanisms with loops and first-order states against SciPy in other coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from towers import solve_tower, tower

from mbfmu.mechanics import CompiledMechanism
from mbfmu.session.simulation import Settings, Simulation
from solvers.steppers import describe_refusal
from solvers.steppers.adams.eliminated import EliminatedAdamsStepper
from solvers.steppers.esdirk.eliminated import EliminatedESDIRKStepper
from solvers.steppers.ida.eliminated import EliminatedIDAStepper

DURATION = 0.3  # s


def expect_motion(solver: str, stepper: type, tolerance: float, count: int, size: float, error: float) -> None:
    """A tower moves as by SciPy, to an error in radians, and of the states in units of their size."""
    angles, states = solve_tower(count, DURATION)
    simulation = Simulation(tower(count, size), Settings(solver=solver, tolerance=tolerance), duration=DURATION)
    assert isinstance(simulation.stepper, stepper)
    assert simulation.advance(DURATION).ok
    q, v = simulation.stepper.q, simulation.stepper.v
    assert np.abs(q[::3] - angles).max() < error
    scale = np.append(np.ones(count), [size, size])
    assert np.abs(v[3 * count :] / scale - states).max() < 10.0 * error


def test_solvers_with_matrices_refuse_more_than_a_thousand_coordinates() -> None:
    system = CompiledMechanism(tower(260)).system
    assert [bool(describe_refusal(name, system)) for name in ("adams", "hybrid", "radau", "ida")] == [0, 0, 1, 1]
    assert "allowed: at most 1000" in describe_refusal("radau", system)
    assert "'ida'" in describe_refusal("radau", system)
    assert "use 'adams'" in describe_refusal("ida", system)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("count", [19, 40])
def test_controlled_tower(count: int, size: float) -> None:
    expect_motion("adams", EliminatedAdamsStepper, 1e-8, count, size, 1e-7)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_controlled_tower_by_an_implicit_solver(size: float) -> None:
    expect_motion("ida", EliminatedIDAStepper, 1e-5, 19, size, 1e-4)


@pytest.mark.campaign
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_controlled_tower_by_esdirk(size: float) -> None:
    expect_motion("esdirk", EliminatedESDIRKStepper, 1e-5, 19, size, 1e-4)
