"""A sheet on a carriage that a controller moves: its states by SciPy, and its motion as by the same force alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from controlled_sheets import FILTER_TIME, INTEGRAL, PROPORTIONAL, TARGET, carried_sheet
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import mbfmu as mb
from mbfmu.session.simulation import Settings, Simulation
from solvers.steppers.esdirk.tree import TreeESDIRKStepper
from solvers.steppers.ida.tree import TreeIDAStepper

TIMES = np.linspace(0.0, 0.5, 501)  # s


@pytest.mark.parametrize(
    ("solver", "stepper", "tolerance"), [("ida", TreeIDAStepper, 1e-8), ("esdirk", TreeESDIRKStepper, 1e-6)]
)
def test_states_and_motion(solver: str, stepper: type, tolerance: float) -> None:
    settings = Settings(solver=solver, tolerance=tolerance)
    assert isinstance(Simulation(carried_sheet(), settings).stepper, stepper)
    interval = float(TIMES[1])
    result = mb.simulate(carried_sheet(), TIMES[-1], interval=interval, solver=solver, tolerance=tolerance)
    corner = CubicSpline(TIMES, result["corner"])

    def rates(t: float, y: Any) -> Any:
        return (corner(t) - y[0]) / FILTER_TIME, INTEGRAL * (TARGET - y[0])

    exact = solve_ivp(rates, (0.0, TIMES[-1]), [0.0, 0.0], rtol=1e-10, atol=1e-12, t_eval=TIMES, max_step=interval).y
    assert np.ptp(result["corner"]) > 0.01
    assert result["seen"] == pytest.approx(exact[0], abs=1e-6)
    assert result["force"] == pytest.approx(PROPORTIONAL * (TARGET - exact[0]) + exact[1], abs=1e-5)
    given = mb.Table(TIMES, result["force"])
    replayed = mb.simulate(carried_sheet(given), TIMES[-1], interval=interval, solver=solver, tolerance=tolerance)
    assert replayed["corner"] == pytest.approx(result["corner"], abs=1e-5)
