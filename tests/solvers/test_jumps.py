"""Loads that jump on a motion that is smooth otherwise: each solver keeps its tolerance, wherever the jumps are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import mbfmu as mb
from solvers.steppers import SOLVERS

SMALL = [solver for solver in SOLVERS if solver != "adams-lu"]
END, FREQUENCY = 2.0, 0.5  # s, Hz
ALLOWED = 50.0  # tolerances, in units of the largest rate: an integral over the run and the jumps
JUMPS = 15  # runs

Array = NDArray[np.float64]


def turning(rate: float, load: mb.Signal) -> mb.Mechanism:
    """Return a rotor of 1 kg m2 under a harmonic torque and a second one."""
    m = mb.Mechanism()
    rotor = m.body("rotor", m.ground, mb.Revolute(rate=rate), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.force("load", mb.JointForce(load), rotor)
    m.force("harmonic", mb.JointForce(mb.Harmonic(amplitude=1.0, frequency=FREQUENCY)), rotor)
    m.output("rate", rotor.rate())
    return m


def smooth_part(t: Array) -> Array:
    """Return the integral of the harmonic torque."""
    w = 2.0 * np.pi * FREQUENCY
    return (1.0 - np.cos(w * t)) / w


def check(run: mb.Result, rate: float, jump: float, kick: Callable[[Array], Array], tolerance: float) -> None:
    expected = rate + smooth_part(run.t) + jump * kick(run.t)
    assert not run.failure
    assert not run.warning
    size = max(1.0, float(np.abs(expected).max()))
    assert np.abs(run["rate"] - expected).max() < ALLOWED * tolerance * size


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("solver", SMALL)
def test_the_error_does_not_depend_on_where_a_load_jumps(solver: str, tolerance: float) -> None:
    """Closed form: the integrals of both torques."""
    random = np.random.default_rng(11)
    for _ in range(JUMPS):
        begin, rate = float(random.uniform(0.05, 1.95)), float(random.choice([0.0, 10.0]))
        jump = float(10.0 ** random.uniform(-1.0, 2.0))
        run = mb.simulate(
            turning(rate, mb.Step(height=jump, begin=begin)), END, interval=0.05, solver=solver, tolerance=tolerance
        )
        check(run, rate, jump, lambda t, begin=begin: np.maximum(0.0, t - begin), tolerance)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("solver", ["adams", "hybrid"])
def test_two_jumps_close_to_each_other(solver: str, tolerance: float) -> None:
    random = np.random.default_rng(12)
    for _ in range(JUMPS):
        begin, width = float(random.uniform(0.1, 1.5)), float(10.0 ** random.uniform(-6.0, -1.0))
        pulse = mb.Sum(mb.Step(height=4.0, begin=begin), mb.Step(height=-4.0, begin=begin + width))
        run = mb.simulate(turning(10.0, pulse), END, interval=0.05, solver=solver, tolerance=tolerance)
        check(run, 10.0, 4.0, lambda t, a=begin, w=width: np.clip(t - a, 0.0, w), tolerance)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau"])
@pytest.mark.parametrize("late", [0.0, 0.5])
def test_an_input_that_is_a_function_with_a_jump(solver: str, tolerance: float, late: float) -> None:
    """It is constant behind the jump, or rises linearly."""

    def kick(s: Array) -> Array:
        return s + 0.5 * late * s**2

    random = np.random.default_rng(13)
    for _ in range(JUMPS):
        begin = float(random.uniform(0.1, 1.95))
        run = mb.simulate(
            turning(10.0, mb.Input(name="u", unit="N*m")),
            END,
            interval=0.05,
            solver=solver,
            tolerance=tolerance,
            inputs={"u": lambda t, begin=begin: 4.0 * (t >= begin) * (1.0 + late * (t - begin))},
        )
        check(run, 10.0, 4.0, lambda t, begin=begin: kick(np.maximum(0.0, t - begin)), tolerance)


@pytest.mark.parametrize("solver", SMALL)
@pytest.mark.parametrize("beyond", [1e-9, 1e-5, 2e-4])
def test_a_jump_next_to_a_power_of_two(solver: str, beyond: float) -> None:
    """Intervals that approximate the function end there, and no node of theirs may lie behind the jump."""
    for begin in (0.5 + beyond, 1.25 - beyond):
        run = mb.simulate(
            turning(0.0, mb.Input(name="u", unit="N*m")),
            END,
            interval=0.3,
            solver=solver,
            tolerance=1e-8,
            inputs={"u": lambda t, begin=begin: 4.0 * (t >= begin)},
        )
        check(run, 0.0, 4.0, lambda t, begin=begin: np.maximum(0.0, t - begin), 1e-8)
