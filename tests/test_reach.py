"""Drives that loops cannot follow, and rates that they leave open: every solver says the same right thing."""

from __future__ import annotations

import numpy as np
import pytest

import mbfmu as mb

SOLVERS = ("ida", "adams", "hybrid", "radau")


def pushed(scale: float, rate: float, arms: int) -> mb.Mechanism:
    """A pivot is pushed away from the ground at ``rate`` m/s, with arms of 1 m between, from 1 m on."""
    m = mb.Mechanism(gravity=(0.0, -9.81 * scale, 0.0))
    drive = mb.Polynomial((scale, rate * scale))
    on = m.body("pusher", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    for k in range(arms):
        at = (scale, 0.0, 0.0) if k else (0.0, 0.0, 0.0)
        on = m.body(f"arm{k}", on, mb.Revolute(at=at, start=1.2), **mb.rod(mass=1.0, length=scale))
    rocker = m.body("rocker", m.ground, mb.Revolute(start=1.0), **mb.rod(mass=1.0, length=scale))
    m.cut("pin", mb.RevoluteCut(at_a=(scale, 0.0, 0.0), at_b=(scale, 0.0, 0.0)), on, rocker)
    return m


@pytest.mark.parametrize("arms", [1, 2])  # no freedom is left, or one
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_drive_out_of_reach_is_called_that(solver: str, scale: float, arms: int) -> None:
    simulation = mb.Simulation(pushed(scale, 0.5 * arms, arms), mb.Settings(solver=solver))
    assert not simulation.advance(4.0).ok
    assert simulation.failure.startswith("the drive of 'pusher' asks for a position that the loops cannot reach after")
    told = float(simulation.failure.partition("after t = ")[2].partition(" s")[0])
    assert told == pytest.approx(2.0, abs=1e-4)  # stretched out
    assert "Shorten the motion of the drive" in simulation.failure


def test_it_is_called_that_where_a_run_ends_right_there() -> None:
    found = mb.check(pushed(1.0, 0.5, 1), 2.0)
    assert "the drive of 'pusher' asks for a position that the loops cannot reach after t = 2 s" in found.failure


def flat(coupler: float | None = None, rocker: float | None = None) -> mb.Mechanism:
    """A parallelogram that starts flat."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=0.0, rate=1.0, fixed=True), **mb.rod(mass=1.0, length=1.0))
    pin = mb.Revolute(at=(1.0, 0.0, 0.0), start=0.0, rate=coupler)
    bar = m.body("coupler", crank, pin, **mb.rod(mass=1.0, length=2.5))
    pin = mb.Revolute(at=(2.5, 0.0, 0.0), start=0.0, rate=rocker)
    other = m.body("rocker", m.ground, pin, **mb.rod(mass=1.0, length=1.0))
    m.cut("pin", mb.RevoluteCut(at_a=(2.5, 0.0, 0.0), at_b=(1.0, 0.0, 0.0)), bar, other)
    return m


def test_joints_whose_rates_choose_the_branch_are_named() -> None:
    simulation = mb.Simulation(flat(), mb.Settings(solver="ida"))
    advice = "Give the rates of 'coupler' and 'rocker' to choose the branch"
    assert simulation.remarks[0].endswith(advice)
    assert not simulation.advance(1.0).ok
    assert simulation.failure.endswith(advice)
    one = mb.Simulation(flat(coupler=-1.0), mb.Settings(solver="adams"))
    assert one.remarks[0].endswith("Give the rate of 'rocker' to choose the branch")


def test_with_all_rates_given_nothing_is_asked_for() -> None:
    simulation = mb.Simulation(flat(coupler=-1.0, rocker=1.0), mb.Settings(solver="ida"))
    assert all("Give the rate" not in text for text in simulation.remarks)
    assert simulation.advance(1.0).ok
    np.testing.assert_allclose(simulation.stepper.q, [1.0, -1.0, 1.0], atol=1e-5)
