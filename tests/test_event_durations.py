"""Events that occur when a quantity has remained beyond a value for a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import UserError

FREQUENCY, AMPLITUDE, LEVEL = 2.0, 0.5, 0.3  # rad/s, m, m: x = 0.5 cos(2 t)
LEAVE = np.arccos(LEVEL / AMPLITUDE) / FREQUENCY  # s, time of the first crossing of the level
PERIOD = 2.0 * np.pi / FREQUENCY
ABOVE = 2.0 * LEAVE  # s, time above the level in each period


def oscillator(*events: dict[str, Any]) -> mb.Mechanism:
    m = mb.Mechanism()
    mass = m.body("mass", m.ground, mb.Translational(axis="x", start=AMPLITUDE), mass=2.0)
    m.force("spring", mb.JointSpring(stiffness=2.0 * FREQUENCY**2), mass)
    for k, own in enumerate(events):
        m.event(f"e{k}", mass.coordinate(), **{"crosses": LEVEL, **own})
    m.output("x", mass.coordinate())
    return m


@pytest.mark.parametrize("solver", ["adams", "ida", "radau"])
def test_a_quantity_that_remains_long_enough(solver: str) -> None:
    """Closed form: below the level from LEAVE on for PERIOD - ABOVE, above it from PERIOD - LEAVE on for ABOVE, and
    from the start on. An event that requires more than the time beyond the level does not occur.
    """
    below = PERIOD - ABOVE
    m = oscillator(
        {"direction": "down", "lasts": 0.9 * below}, {"direction": "up", "lasts": 0.9 * ABOVE},
        {"direction": "up", "lasts": 0.4 * ABOVE}, {"direction": "down", "lasts": 1.1 * below},
    )  # fmt: skip
    result = mb.simulate(m, 2.0 * PERIOD, interval=0.37, solver=solver, tolerance=1e-8)
    found = {f"e{k}": [event.time for event in result.events if event.name == f"e{k}"] for k in range(4)}
    starts = LEAVE + PERIOD * np.arange(2)
    rises = PERIOD - LEAVE + PERIOD * np.arange(2)
    np.testing.assert_allclose(found["e0"], starts + 0.9 * below, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found["e1"], [rises[0] + 0.9 * ABOVE], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(found["e2"], [0.4 * ABOVE, rises[0] + 0.4 * ABOVE, rises[1] + 0.4 * ABOVE], atol=1e-6)
    assert not found["e3"]
    assert {event.direction for event in result.events if event.name == "e0"} == {"down"}


def test_an_action_occurs_once_until_the_quantity_returns() -> None:
    """Closed form: a sled that has been slower than 0.5 m/s for 0.2 s is pushed."""
    m = mb.Mechanism()
    sled = m.body("sled", m.ground, mb.Translational(axis="x", rate=1.0), mass=1.0)
    m.force("drag", mb.JointForce(-1.0), sled)
    m.event("slow", sled.rate(), crosses=0.5, direction="down", lasts=0.2, then=mb.Impulse(sled, 1.0))
    m.output("rate", sled.rate())
    result = mb.simulate(m, 1.5, interval=0.25, solver="adams", tolerance=1e-8)
    times = [event.time for event in result.events]  # 0.7 s at 0.3 m/s, then 1.3 m/s until 0.5 m/s at 1.5 s
    np.testing.assert_allclose(times, [0.7], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(result["rate"], 1.0 - result.t + (result.t > 0.7), rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("saved_at", [0.3, 0.6, 1.0])
def test_a_state_is_saved_within_the_time(saved_at: float) -> None:
    lasts = 0.3 * (PERIOD - ABOVE)
    simulations = [
        Simulation(oscillator({"direction": "down", "lasts": lasts}), Settings(solver="adams", tolerance=1e-8))
        for _ in range(2)
    ]
    simulations[0].advance(saved_at)
    state = simulations[0].save()
    simulations[1].restore(state)
    for simulation in simulations:
        simulation.advance(2.5)
        assert [event.time for event in simulation.events] == pytest.approx([LEAVE + lasts], abs=1e-6)


@pytest.mark.parametrize("given", [{"direction": "both"}, {"direction": "up", "then": mb.Bounce(0.5)}])
def test_wrong_durations_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(UserError, match="event 'e0' is given `lasts`; allowed: with a sensor, the direction 'up'"):
        oscillator({"lasts": 0.1, **given})
    with pytest.raises(UserError, match="lasts of event 'e0' is -0"):
        oscillator({"direction": "up", "lasts": -0.1})


@pytest.mark.parametrize("interval", [0.05, 1.0])
def test_a_quantity_that_begins_at_its_value(interval: float) -> None:
    """Closed form: the time begins at the start, where the quantity is at its value, also if no output is within it."""
    m = mb.Mechanism()
    sled = m.body("sled", m.ground, mb.Translational(axis="x"), mass=1.0)
    m.force("push", mb.JointForce(-1.0), sled)
    m.event("back", sled.rate(), direction="down", lasts=0.42, then=mb.Impulse(sled, 2.0))
    m.output("rate", sled.rate())
    result = mb.simulate(m, 1.0, interval=interval, solver="adams", tolerance=1e-8)
    assert [event.time for event in result.events] == pytest.approx([0.42], abs=1e-7)
    np.testing.assert_allclose(result["rate"], -result.t + 2.0 * (result.t > 0.42), rtol=0.0, atol=1e-7)
