"""Stops whose limits are signals, against closed forms, and against SciPy's integration with its own events."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.util.errors import UserError

MASS, STIFFNESS, WINCH, LENGTH, SPEED, G = 2.0, 2e4, 0.5, 1.0, 0.4, 9.81


def pushed(kind: str, damping: float = 0.0) -> mb.Mechanism:
    """A mass at rest at 1 m that a limit from 0.9 m on reaches with a constant speed."""
    m = mb.Mechanism()
    slider = m.body("slider", m.ground, mb.Translational(axis="x", start=1.0, fixed=True), mass=MASS)
    lower = mb.Polynomial((0.9, SPEED))
    stops: dict[str, Any] = {"JointStop": mb.JointStop, "DistanceStop": mb.DistanceStop}
    m.force("stop", stops[kind](lower=lower, upper=5.0, stiffness=STIFFNESS, damping=damping), slider)
    m.output("x", slider.coordinate())
    m.output("v", slider.rate())
    return m


@pytest.mark.parametrize("kind", ["JointStop", "DistanceStop"])
@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_mass_that_a_moving_stop_hits_leaves_with_twice_its_speed(kind: str, solver: str) -> None:
    """Closed form in the frame of the stop: half a period of the spring, then the reversed relative speed."""
    result = mb.simulate(pushed(kind), 0.5, interval=0.5, solver=solver, tolerance=1e-8)
    contact = 0.1 / SPEED
    leave = contact + np.pi * np.sqrt(MASS / STIFFNESS)
    place = 0.9 + SPEED * leave
    assert result["v"][-1] == pytest.approx(2.0 * SPEED, abs=2e-5)
    assert result["x"][-1] == pytest.approx(place + 2.0 * SPEED * (0.5 - leave), abs=1e-5)
    assert not result.warning


def test_the_damping_of_a_moving_stop_follows_the_relative_rate() -> None:
    """Reference: SciPy, of the force k x (1 + c x') with the penetration x."""
    c = 3.0

    def rates(t: float, y: Any) -> list[float]:
        x, rate = 0.9 + SPEED * t - y[0], SPEED - y[1]
        return [y[1], STIFFNESS * x * max(0.0, 1.0 + c * rate) / MASS if x > 0.0 else 0.0]

    found = solve_ivp(rates, (0.0, 0.5), (1.0, 0.0), "DOP853", rtol=1e-10, atol=1e-12, max_step=1e-4).y
    result = mb.simulate(pushed("JointStop", c), 0.5, interval=0.5, solver="adams", tolerance=1e-9)
    assert result["v"][-1] == pytest.approx(found[1, -1], abs=1e-6)
    assert result["x"][-1] == pytest.approx(found[0, -1], abs=1e-6)
    assert not result.warning


def test_a_rope_on_a_winch_lowers_a_load() -> None:
    """Closed form: the load follows the end of the rope, from rest and stretched by its weight, with an
    oscillation in which the rope remains taut.
    """
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    stretch = MASS * G / STIFFNESS
    load = m.body("load", m.ground, mb.Translational(axis="y", start=-LENGTH - stretch, fixed=True), mass=MASS)
    rope = mb.Input(name="rope", unit="m", start=LENGTH)
    m.force("rope", mb.DistanceStop(upper=rope, stiffness=STIFFNESS), load)
    m.output("y", load.coordinate())
    times = 0.05 * np.arange(21)
    result = mb.simulate(m, 1.0, interval=0.05, inputs={"rope": f"{LENGTH} + 0.05 * t"}, solver="adams", tolerance=1e-9)
    w = np.sqrt(STIFFNESS / MASS)
    expected = -LENGTH - stretch - 0.05 * (times - np.sin(w * times) / w)
    np.testing.assert_allclose(result["y"], expected, rtol=0.0, atol=1e-7)
    assert not result.warning


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({}, "has neither lower nor upper"),
        ({"lower": 1.0, "upper": 0.5}, "allowed: lower less than upper"),
        ({"upper": np.nan}, "upper of force 'stop' is nan"),
        ({"upper": [1.0]}, "upper of force 'stop' is"),
        ({"upper": "sin(t)", "lower": np.nan}, "lower of force 'stop' is nan"),
    ],
)
def test_wrong_limits_are_refused(limits: dict[str, Any], message: str) -> None:
    m = mb.Mechanism()
    slider = m.body("slider", m.ground, mb.Translational(), mass=1.0)
    with pytest.raises(UserError, match=message):
        m.force("stop", mb.JointStop(stiffness=1.0, **limits), slider)
