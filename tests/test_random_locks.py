"""Random pendulums of one to four rods whose joints are locked and released, against SciPy with absolute angles.

Locked joints are constraints with multipliers there; the equations of the pendulum are those of test_random_stops.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb

from .test_events import SMALL, G

STOP_TIME, TOLERANCE = 2.5, 1e-9
ERROR, GROWTH = 2e-8, 4.0  # of an angle, rad, and its growth, 1/s


class LockedPendulum:
    """A pendulum of n rods with absolute angles (n,) from the horizontal, and the times at which its joints change."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.n = n = int(rng.integers(1, 5))
        self.lengths, self.masses = l, m = rng.uniform(0.3, 1.5, n), rng.uniform(0.3, 3.0, n)
        beyond = np.append(np.cumsum(m[::-1])[::-1][1:], 0.0)
        self.c = np.outer(l, l) * (m / 2.0 + beyond)[np.maximum.outer(np.arange(n), np.arange(n))]
        np.fill_diagonal(self.c, l * l * (m / 3.0 + beyond))
        self.w = G * l * (m / 2.0 + beyond)
        self.start = np.concatenate((rng.uniform(-2.5, 1.0, n), 2.0 * rng.normal(size=n)))
        self.slopes = np.eye(n) - np.eye(n, k=-1)  # joint coordinates by absolute angles
        self.changes: list[tuple[float, set[int], set[int]]] = []  # s, joints that are locked then, and released
        locked = set[int]()
        for t in np.sort(rng.uniform(0.1, STOP_TIME, 5)):
            free = [k for k in range(n) if k not in locked]
            then = {int(k) for k in rng.permutation(free)[: rng.integers(1, 3)]} if free else set()
            released = {k for k in locked if rng.random() < 0.5 or not then}
            self.changes.append((float(t), then, released))
            locked = (locked | then) - released

    def mass_matrix(self, a: Any) -> Any:
        return self.c * np.cos(a[:, np.newaxis] - a)

    def constrained(self, a: Any, force: Any, locked: list[int], right: Any) -> Any:
        """Return x with M x = force + S^T p and S x = right, S being the slopes of the locked joints."""
        S, M = self.slopes[locked], self.mass_matrix(a)
        whole = np.block([[M, S.T], [S, np.zeros((len(S), len(S)))]])
        return np.linalg.solve(whole, np.concatenate((force, right)))[: self.n]

    def motion(self, times: Any) -> Any:
        """Return the joint coordinates (k, n) at times (k,)."""
        y, t, locked, rows = self.start, 0.0, set[int](), np.zeros((len(times), self.n))
        for until, then, released in [*self.changes, (STOP_TIME, set(), set())]:
            held = sorted(locked)

            def rate(_: float, y: Any, held: list[int] = held) -> Any:
                a, v = y[: self.n], y[self.n :]
                force = -(self.c * np.sin(a[:, np.newaxis] - a)) @ (v * v) - self.w * np.cos(a)
                return np.concatenate((v, self.constrained(a, force, held, np.zeros(len(held)))))

            found = solve_ivp(rate, (t, until), y, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True)
            inside = (times >= t) & (times <= until)
            if inside.any():
                rows[inside] = (self.slopes @ found.sol(times[inside])[: self.n]).T
            y, t = found.y[:, -1], until
            held = sorted(locked | then)
            a, v = y[: self.n], y[self.n :]
            y = np.concatenate((a, self.constrained(a, self.mass_matrix(a) @ v, held, np.zeros(len(held)))))
            locked = (locked | then) - released
        return rows

    def mechanism(self) -> mb.Mechanism:
        """Return it in relative angles."""
        m = mb.Mechanism(gravity=(0.0, -G, 0.0))
        body, at, relative = m.ground, 0.0, self.slopes @ self.start.reshape(2, self.n).T
        for k in range(self.n):
            joint = mb.Revolute(at=(at, 0.0, 0.0), start=float(relative[k, 0]), rate=float(relative[k, 1]))
            at = float(self.lengths[k])
            body = m.body(f"rod{k}", body, joint, **mb.rod(mass=self.masses[k], length=at))
            m.output(f"angle{k}", body.angle())
        for i, (t, then, released) in enumerate(self.changes):
            actions: list[Any] = [mb.Lock(m.bodies[k + 1]) for k in sorted(then)]
            m.event(f"change{i}", at=t, then=[*actions, *(mb.Release(m.bodies[k + 1]) for k in sorted(released))])
        return m


SEEDS = [pytest.param(seed, marks=() if seed in (8, 18, 19) else pytest.mark.campaign) for seed in range(100)]


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_pendulum_is_locked_and_released(seed: int) -> None:
    pendulum, solver = LockedPendulum(np.random.default_rng(seed)), SMALL[seed % len(SMALL)]
    result = mb.simulate(pendulum.mechanism(), STOP_TIME, interval=0.1, solver=solver, tolerance=TOLERANCE)
    assert not result.failed, result.failure
    assert not result.warning
    errors = np.abs(result.values[:, : pendulum.n] - pendulum.motion(result.t)).max(axis=1)
    assert np.all(errors <= ERROR * np.exp(GROWTH * result.t)), errors
    assert abs(result["energy_error"]).max() <= 1e-5
