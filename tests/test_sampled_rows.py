"""Rows that are sampled on the way are what a run finds that stops there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fmus.fourbar import FourBar
from fmus.pendulum import SwingPendulum
from mbfmu.mechanics import Mechanism, Spherical, box
from mbfmu.modeling import Model
from mbfmu.session.run import simulate
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError
from solvers.steppers import SOLVERS

TIMES = np.linspace(0.0, 0.4, 41)[1:]
TOLERANCE = 1e-6


def top() -> Mechanism:
    """Return a box that tumbles about a ball joint."""
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    body = m.body(
        "box", m.ground, Spherical(rate=(1.0, -2.0, 3.0)), **box(mass=2.0, size=(1.0, 0.5, 0.2), com=(0.5, 0.0, 0.0))
    )
    for axis in "xyz":
        m.output(f"tip.{axis}", body.position(axis, (1.0, 0.0, 0.0)), "tip of the box")
        m.output(f"force.{axis}", body.joint_force(axis), "force of the joint")
    m.output("energy", m.energy, "kinetic and potential energy")
    return m


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("model", [FourBar(), SwingPendulum(), top()], ids=["loop", "driven", "quaternion"])
def test_a_row_is_what_a_run_that_stops_there_finds(model: Model | Mechanism, solver: str):
    settings = Settings(solver=solver, tolerance=TOLERANCE)
    sampled, stopped = Simulation(model, settings), Simulation(model, settings)
    rows = np.zeros((len(TIMES), len(sampled.variables)))
    assert sampled.record(TIMES, rows) == len(TIMES)
    for t, row in zip(TIMES, rows, strict=True):
        assert stopped.advance(t).ok
        np.testing.assert_array_equal(row, stopped.outputs())
    assert sampled.stepper.q.tobytes() == stopped.stepper.q.tobytes()


@pytest.mark.parametrize("solver", SOLVERS)
def test_rows_are_of_states_on_the_constraints(solver: str):
    simulation = Simulation(FourBar(), Settings(solver=solver, tolerance=TOLERANCE))
    rows = np.zeros((len(TIMES), len(simulation.variables)))
    assert simulation.record(TIMES, rows) == len(TIMES)
    found = dict(zip([v.name for v in simulation.variables], rows.T, strict=True))
    assert max(found["position_residual"].max(), found["velocity_residual"].max()) <= 1e-4 * TOLERANCE


def test_rows_may_lie_anywhere_in_memory():
    rows = [np.zeros((len(TIMES), 19)), np.zeros((19, len(TIMES))).T]
    for values in rows:
        assert Simulation(FourBar(), Settings(solver="adams")).record(TIMES, values) == len(TIMES)
    np.testing.assert_array_equal(*rows)


@pytest.mark.parametrize("end", [1e-9, 1e-11, 1e-15])
def test_a_short_run_ends_at_its_stop_time(end: float) -> None:
    assert list(simulate(top(), end, solver="adams").t) == [0.0, end]


@pytest.mark.parametrize("times", [[0.2, 0.1], [0.1, np.nan], [[0.1]], ["x"], [-1.0, 1.0], None])
def test_times_that_do_not_increase_are_refused_and_change_nothing(times: Any) -> None:
    simulation = Simulation(top(), Settings(solver="adams"))
    with pytest.raises(UserError, match="times"):
        simulation.record(times, np.zeros((2, len(simulation.variables))))
    assert simulation.t == 0.0
