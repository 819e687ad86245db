"""Events of mechanisms whose loops are eliminated along the tree: a row of 31 four-bars, which moves as one rod."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import G, n_four_bar
from scipy.integrate import quad

import mbfmu as mb

LOOPS, STOP, SPEED = 31, 0.9, -1.0  # height of the couplers at the stop, m; rate at the start, rad/s
INERTIA, WEIGHT = (LOOPS + 1) / 3.0 + LOOPS, (0.5 * (LOOPS + 1) + LOOPS) * G  # kg m2; N m, of all rods of 1 m and 1 kg


def rate(angle: float, energy: float) -> float:
    """Return the speed of a column at an angle and an energy."""
    return float(np.sqrt(2.0 * (energy - WEIGHT * np.sin(angle)) / INERTIA))


def duration(first: float, last: float, energy: float) -> float:
    """Return the time between two angles."""
    return float(quad(lambda angle: 1.0 / rate(angle, energy), first, last, epsabs=1e-12)[0])


@pytest.mark.parametrize("solver", ["adams", "ida"])
def test_a_row_of_fourbars_bounces_and_is_kicked(solver: str) -> None:
    """Reference: SciPy's integral of the time over the angle, whose rate follows from the energy.

    The height of a coupler hits a stop; the impulse acts on the last column where all are upright again.
    """
    e, impulse, m = 0.95, 7.0, n_four_bar(LOOPS).mechanism
    middle, last = m.bodies[LOOPS], m.bodies[-1]
    m.event("stop", middle.position("y"), crosses=STOP, direction="down", then=mb.Bounce(e))
    kick = [mb.Impulse(last, impulse), mb.EndRun()]
    m.event("upright", m.bodies[1].angle(), crosses=0.5 * np.pi, direction="up", then=kick)
    m.output("rate", last.rate())
    m.output("residual", m.velocity_residual)
    result = mb.simulate(m, 5.0, interval=0.25, solver=solver, tolerance=1e-7)
    angle, energy = np.arcsin(STOP), 0.5 * INERTIA * SPEED**2 + WEIGHT
    after = WEIGHT * STOP + 0.5 * INERTIA * (e * rate(angle, energy)) ** 2
    times = np.cumsum((duration(angle, 0.5 * np.pi, energy), duration(angle, 0.5 * np.pi, after)))
    assert [event.name for event in result.events] == ["stop", "upright"]
    np.testing.assert_allclose([event.time for event in result.events], times, rtol=0.0, atol=2e-6)
    assert result["rate"][-1] == pytest.approx(rate(0.5 * np.pi, after) + impulse / INERTIA, abs=1e-5)
    assert result["residual"].max() <= 1e-9
    assert not result.warning
