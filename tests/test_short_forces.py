"""Forces that are shorter than a step of the solver are not passed where events with a Restart declare them."""

from __future__ import annotations

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation

from .test_events import SMALL, Midpoint, times

FORCE, WIDTH, PLACE = 500.0, 1e-3, 5.0  # N, m, m
EDGE = 6.0 * WIDTH  # where the force is 1e-13 N


def sled_with_spike() -> mb.Mechanism:
    """Return a mass of 1 kg that moves with 1 m/s until a force acts on it over 2 mm of its path."""
    m = mb.Mechanism()
    sled = m.body("sled", m.ground, mb.Translational(axis="x", rate=1.0), mass=1.0)
    law = f"{FORCE} * exp(-((x - {PLACE}) / {WIDTH})**2)"
    m.force("spike", mb.JointForce(law, uses={"x": sled.coordinate()}), sled)
    for name, place in (("enter", PLACE - EDGE), ("leave", PLACE + EDGE)):
        m.event(name, sled.coordinate(), crosses=place, then=mb.Restart())
    m.output("rate", sled.rate())
    return m


@pytest.mark.parametrize(("solver", "tolerance"), [*((solver, 1e-6) for solver in SMALL), (Midpoint, 1e-4)])
def test_a_spike_of_a_force_is_not_passed(solver, tolerance: float):
    """Closed form: the work of the force is its integral over the path, F w sqrt(pi)."""
    result = mb.simulate(sled_with_spike(), 5.1, interval=5.1, solver=solver, tolerance=tolerance)
    assert [event.name for event in result.events] == ["enter", "leave"]
    assert result.events[0].time == pytest.approx(
        PLACE - EDGE, abs=1e-2 * tolerance
    )  # 1e-3 of the tolerance times the step
    exact = np.sqrt(1.0 + 2.0 * FORCE * WIDTH * np.sqrt(np.pi))
    assert result["rate"][-1] == pytest.approx(exact, abs=20.0 * tolerance)
    assert not result.warning


def test_a_restart_at_a_communication_point_holds_for_the_next_step():
    """Closed form, as above. The end of the first communication step is the time at which the force begins."""
    m = sled_with_spike()
    m.events.clear()
    begin, exact = PLACE - EDGE, np.sqrt(1.0 + 2.0 * FORCE * WIDTH * np.sqrt(np.pi))
    m.event("enter", at=begin, then=mb.Restart())
    m.event("leave", m.bodies[1].coordinate(), crosses=PLACE + EDGE, then=mb.Restart())
    simulation = Simulation(m, Settings(solver="adams", tolerance=1e-6))
    simulation.advance(begin)
    state = simulation.save()
    for _ in range(2):
        simulation.advance(9.0)
        assert simulation.outputs()[0] == pytest.approx(exact, abs=2e-5)
        simulation.restore(state)


def test_the_limit_of_the_steps_is_part_of_a_saved_run():
    """The state is saved between the event and the force."""
    simulation = Simulation(sled_with_spike(), Settings(solver="adams", tolerance=1e-6))
    simulation.advance(PLACE - 0.9 * EDGE)
    state = simulation.save()
    simulation.advance(8.0)
    reached = simulation.outputs().copy()
    simulation.restore(state)
    simulation.advance(8.0)
    np.testing.assert_array_equal(simulation.outputs(), reached)
    assert len(simulation.events) == 2


@pytest.mark.parametrize("solver", SMALL)
def test_an_arm_hits_a_thin_elastic_stop(solver: str):
    """Closed form: the end of an arm of 20 rad/s comes within 0.01 m of a stiff point, and turns back without loss.

    In 2 s it hits the point seven times, once for each turn but the first quarter.
    """
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(rate=20.0), **mb.rod(mass=1.0, length=1.0))
    places = {"at_a": (0.0, 1.005, 0.0), "at_b": (1.0, 0.0, 0.0)}
    m.force("stop", mb.DistanceStop(lower=0.01, stiffness=5e7, **places), m.ground, arm)
    m.event("stop", m.distance(m.ground, arm, **places), crosses=0.01, then=mb.Restart())
    m.output("rate", arm.rate())
    result = mb.simulate(m, 2.0, interval=2.0, solver=solver, tolerance=1e-6)
    half = np.arccos((1.0 + 1.005**2 - 0.01**2) / (2.0 * 1.005))
    assert times(result, "stop")[0] == pytest.approx((0.5 * np.pi - half) / 20.0, abs=1e-8)
    assert len(times(result, "stop")) == 14
    assert result["rate"][-1] == pytest.approx(-20.0, rel=1e-5)
    assert not result.warning
