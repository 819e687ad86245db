"""Random pendulums of one to three rods that come to rest at a stop and leave it, against SciPy with absolute angles.

At rest the reference has a constraint with a multiplier, which is zero where the pendulum leaves the stop. Small
differences grow with time, so that the allowed difference does, too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import mbfmu as mb

from .test_events import SMALL
from .test_random_stops import GROWTH, SAMPLES, Pendulum

STOP_TIME, CHUNK = 2.0, 0.01  # s
SEEDS = [pytest.param(seed, marks=() if seed == 182 else pytest.mark.campaign) for seed in range(300)]
TOLERANCE, ERROR = 1e-9, 1e-6


class Held(Pendulum):
    """A pendulum with one stop without restitution, which it starts in front of."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.default_rng(seed))
        self.stop = self.stops[0]._replace(restitution=0.0)
        self.stops = [self.stop]

    def bias(self, a: Any, v: Any) -> float:
        """Return the acceleration of the quantity of the stop due to velocities."""
        arm = np.where(np.arange(self.n) <= self.stop.rod, self.lengths, 0.0)
        curve = {"angle": 0.0 * arm, "height": -arm * np.sin(a), "reach": -arm * np.cos(a)}[self.stop.kind]
        return float(curve @ (v * v))

    def push(self, y: Any) -> tuple[float, Any]:
        """Return the force by which the stop pushes if it holds, and the accelerations then."""
        a, v = y[: self.n], y[self.n :]
        free, (_, slope) = self.rate(0.0, y)[self.n :], self.measure(self.stop.kind, self.stop.rod, a)
        moved = np.linalg.solve(self.mass_matrix(a), slope)
        force = -(slope @ free + self.bias(a, v)) / (slope @ moved)
        return float(-self.stop.side * force), free + force * moved

    def events(self) -> list[tuple[str, float]]:
        """Return the direction and time of impacts and releases."""
        t, y, found, holds = 0.0, self.start, list[tuple[str, float]](), False
        side = {1: "up", -1: "down"}
        how: dict[str, Any] = {"rtol": 1e-11, "atol": 1e-12, "method": "DOP853", "dense_output": True}
        while t < STOP_TIME - 1e-12:
            end = min(STOP_TIME, t + CHUNK)
            if holds:
                path = solve_ivp(lambda _, y: np.concatenate((y[self.n :], self.push(y)[1])), (t, end), y, **how).sol
                times = np.linspace(t, end, SAMPLES)
                forces = np.array([self.push(path(x))[0] for x in times])
                pulled = np.flatnonzero(forces < 0.0)
                if len(pulled) and pulled[0] > 0:
                    bracket = times[pulled[0] - 1 : pulled[0] + 1]
                    t = float(brentq(lambda x, path=path: self.push(path(x))[0], *bracket, xtol=1e-14))
                    found.append((side[-self.stop.side], t))
                    y, holds = path(t), False
                elif len(pulled):
                    holds = False
                else:
                    t, y = end, path(end)
                continue
            path = solve_ivp(self.rate, (t, end), y, **how).sol
            hit = self._first(path, t, end, self.stop)
            t, y = (hit, self.rebound(self.stop, path(hit))) if hit <= end else (end, path(end))
            if hit <= end:
                found.append((side[self.stop.side], t))
                holds = self.push(y)[0] > 0.0
        return found


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_pendulum_rests_and_leaves(seed: int) -> None:
    pendulum = Held(seed)
    solver = SMALL[seed % len(SMALL)]
    result = mb.simulate(pendulum.mechanism(), STOP_TIME, interval=STOP_TIME, solver=solver, tolerance=TOLERANCE)
    expected = pendulum.events()
    found = [(event.direction, event.time) for event in result.events]
    if pendulum.n == 1:  # falls off its stop and returns to it without speed: rounding errors decide whether it touches
        found, expected = found[:1], expected[:1]
    assert [d for d, _ in found] == [d for d, _ in expected]
    for (_, t), (_, at) in zip(found, expected, strict=True):
        assert abs(t - at) <= ERROR * np.exp(GROWTH * at)
    assert not result.failed
    assert not result.warning
