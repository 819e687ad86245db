"""Joints of random loops that are locked and released, against SciPy in absolute coordinates.

A loop of five bars has two degrees of freedom, and a pendulum is connected to one of its pins. Locks leave three to no
degrees of freedom, or are redundant; released, the mechanism moves on. The reference has the position and the angle of
every rod as coordinates, and all joints and locks as constraints, also dependent ones, with their impulses at a lock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb

G, STOP_TIME = 9.81, 0.8
SMALL = ["adams", "hybrid", "ida", "radau"]
ERROR, GROWTH = 10.0, 6.0  # of an angle, in tolerances in rad, and its growth, 1/s
NEAR_SINGULAR = 0.05  # smallest singular value of the constraint Jacobian, relative to the largest
RODS = 5  # four of the loop, whose fifth bar is the ground, and the pendulum
Change = tuple[float, tuple[int, ...], tuple[int, ...]]  # s, rods whose joints are locked then, and released


@dataclass(frozen=True)
class Loop:
    """A loop of random size whose joints are locked and released; the joint of a rod leads to the rod before it.

    The pendulum is on the second rod.
    """

    points: Any  # (5, 2) pins at the start, m; the first and the last are on the ground
    masses: Any  # (5,) kg
    lengths: Any  # (5,) m
    angles: Any  # (5,) absolute angles at the start, rad
    changes: tuple[Change, ...]
    scale: float

    @staticmethod
    def random(seed: int) -> Loop:
        """Return a loop that is far from singular configurations, with random locks."""
        rng, scale = np.random.default_rng(seed), (1.0, 1e-3, 1e3)[seed % 3]
        pins = np.array([(0.0, 0.0), (-0.3, 0.7), (0.5, 1.2), (1.3, 0.8), (1.0, 0.0)]) + rng.uniform(
            -0.15, 0.15, (5, 2)
        )
        bars = np.diff(pins, axis=0)
        lengths = np.append(np.hypot(*bars.T), rng.uniform(0.3, 0.8))
        angles = np.append(np.arctan2(bars[:, 1], bars[:, 0]), rng.uniform(-3.0, 0.0))
        changes, locked = list[Change](), set[int]()
        for t in np.sort(rng.uniform(0.1, STOP_TIME, 5)):
            free = [k for k in range(RODS) if k not in locked]
            then = {int(k) for k in rng.permutation(free)[: rng.integers(0, 3)]}
            released = {k for k in locked if rng.random() < 0.6 or not then}
            changes.append((float(t), tuple(sorted(then)), tuple(sorted(released))))
            locked = (locked | then) - released
        return Loop(scale * pins, rng.uniform(0.3, 3.0, RODS), scale * lengths, angles, tuple(changes), scale)

    @property
    def before(self) -> Any:
        """Slopes of the joint angles by the absolute angles (5, 5)."""
        slopes = np.eye(RODS) - np.eye(RODS, k=-1)
        slopes[4, 3], slopes[4, 1] = 0.0, -1.0
        return slopes

    def equations(self, y: Any) -> tuple[Any, Any, Any]:
        """Return M and J of the joints, and gamma with J v' = gamma, of positions (x, y, angle) and rates of rods.

        The center of each rod is its position.
        """
        q, v = y[:15].reshape(RODS, 3), y[15:].reshape(RODS, 3)
        M = np.diag(np.column_stack((self.masses, self.masses, self.masses * self.lengths**2 / 12.0)).ravel())
        rows, right = list[Any](), list[float]()
        half = 0.5 * self.lengths
        # pins: (rod, side of its center) and another, or the ground
        for (i, a), other in (
            ((0, -1), None), ((1, -1), (0, 1)), ((2, -1), (1, 1)), ((3, -1), (2, 1)), ((3, 1), None), ((4, -1), (1, 1)),
        ):  # fmt: skip
            J, gamma = np.zeros((2, RODS, 3)), np.zeros(2)
            for sign, end in ((1.0, (i, a)), (-1.0, other)):
                if end is None:
                    continue
                k, side = end
                c, s, r = np.cos(q[k, 2]), np.sin(q[k, 2]), side * half[k]
                J[:, k, :2] += sign * np.eye(2)
                J[:, k, 2] += sign * r * np.array([-s, c])
                gamma += sign * r * np.array([c, s]) * v[k, 2] ** 2
            rows += list(J.reshape(2, 15))
            right += list(gamma)
        return M, np.array(rows), np.array(right)

    def solve(self, M: Any, J: Any, gamma: Any, force: Any, locked: set[int]) -> Any:
        """Return x with M x + J^T p = force and J x = gamma, locked joints included; dependent rows are allowed."""
        S = np.zeros((len(locked), RODS, 3))
        S[:, :, 2] = self.before[sorted(locked)]
        A = np.vstack((J / self.scale, S.reshape(-1, 15)))  # without units
        right = np.append(gamma / self.scale, np.zeros(len(locked)))
        unit = np.sqrt(np.diag(M))
        x = np.linalg.lstsq(A / unit, right, rcond=1e-10)[0]
        free = np.eye(15) - np.linalg.pinv(A / unit, rcond=1e-10) @ (A / unit)
        return (x + free @ (force / unit)) / unit

    def motion(self, times: Any) -> tuple[Any, float]:
        """Return joint angles (k, 5) at times (k,), and how near the loop has been to a singular configuration."""
        ends = np.column_stack((np.cos(self.angles), np.sin(self.angles))) * self.lengths[:, None]
        starts = np.vstack((self.points[:4], self.points[2]))
        q = np.column_stack((starts + 0.5 * ends, self.angles))
        y, t, locked, found, nearest = np.append(q.ravel(), np.zeros(15)), 0.0, set[int](), [], np.inf
        rows = np.zeros((len(times), RODS))
        weight = np.zeros((RODS, 3))
        weight[:, 1] = -G * self.scale * self.masses
        for until, then, released in [*self.changes, (STOP_TIME, (), ())]:
            held = set(locked)

            def rate(_: float, y: Any, held: set[int] = held) -> Any:
                return np.append(y[15:], self.solve(*self.equations(y), weight.ravel(), held))

            units = np.tile((self.scale, self.scale, 1.0), 2 * RODS)
            found = solve_ivp(
                rate, (t, until), y, method="DOP853", rtol=1e-10, atol=1e-11 * units, dense_output=True
            )  # fmt: skip
            inside = (times >= t) & (times <= until)
            for k in np.flatnonzero(inside):
                state = found.sol(times[k])
                rows[k] = self.before @ state[2:15:3]
                nearest = min(nearest, self.singular_ratio(state))
            y, t = found.y[:, -1], until
            nearest = min(nearest, self.singular_ratio(y))
            M, J, gamma = self.equations(y)
            locked = locked | set(then)
            y[15:] = self.solve(M, J, 0.0 * gamma, M @ y[15:], locked)
            locked -= set(released)
        return rows, nearest

    def singular_ratio(self, y: Any) -> float:
        """Return the smallest singular value of the slopes of the loop, relative to the largest."""
        angle = y[2:12:3]
        slopes = self.lengths[:4] * np.array([-np.sin(angle), np.cos(angle)])
        sigma = np.linalg.svd(slopes, compute_uv=False)
        return float(sigma[-1] / sigma[0])

    def add_to(self, m: mb.Mechanism, name: str, locks: bool) -> None:
        """Add the loop with its outputs to a mechanism, without or with its locks."""
        relative, body, bodies = self.before @ self.angles, m.ground, list[Any]()
        places = (0.0, *self.lengths[:3])
        x, y = self.points[0]
        for k in range(RODS):
            carrier = bodies[1] if k == 4 else body
            at = (x, y, 0.0) if k == 0 else (float(self.lengths[1] if k == 4 else places[k]), 0.0, 0.0)
            joint = mb.Revolute(at=at, start=float(relative[k]))
            rod = mb.rod(mass=float(self.masses[k]), length=float(self.lengths[k]))
            body = m.body(f"{name}{k}", carrier, joint, **rod)
            bodies.append(body)
            m.output(f"{name}{k}", body.angle())
        at_a, at_b = (float(self.lengths[3]), 0.0, 0.0), (*map(float, self.points[4]), 0.0)
        m.cut(f"{name} pivot", mb.RevoluteCutJoint(at_a=at_a, at_b=at_b), bodies[3], m.ground)
        for i, (t, then, released) in enumerate(self.changes if locks else ()):
            actions = [*(mb.Lock(bodies[k]) for k in then), *(mb.Release(bodies[k]) for k in released)]
            m.event(f"{name} change {i}", at=t, then=actions)


def check(loop: Loop, copies: int, solver: str, tolerance: float) -> None:
    """Compare a run of ``copies`` loops of which the first is locked with the reference."""
    m = mb.Mechanism(gravity=(0.0, -G * loop.scale, 0.0))
    for k in range(copies):
        loop.add_to(m, f"rod{k}_", k == 0)
    result = mb.simulate(m, STOP_TIME, interval=0.05, solver=solver, tolerance=tolerance)
    expected, nearest = loop.motion(result.t)
    assert nearest > NEAR_SINGULAR
    assert not result.failed, result.failure
    assert not result.warning
    if copies > 1:
        free, _ = replace(loop, changes=()).motion(result.t)
        expected = np.hstack((expected, *[free] * (copies - 1)))
    errors = np.abs(result.values[:, : RODS * copies] - expected).max(axis=1)
    assert np.all(errors <= ERROR * tolerance * np.exp(GROWTH * result.t)), errors


SEEDS = [pytest.param(seed, marks=() if seed in (0, 1, 2, 3) else pytest.mark.campaign) for seed in range(200)]


@pytest.mark.parametrize("seed", SEEDS)
def test_joints_of_a_random_loop_are_locked_and_released(seed: int) -> None:
    check(Loop.random(seed), 1, SMALL[seed % len(SMALL)], 1e-9)


LARGE = [(17, "adams", 0), (17, "esdirk", 1), (17, "ida", 2), (21, "hybrid", 3), (21, "esdirk", 4), (21, "ida", 5)]


@pytest.mark.campaign
@pytest.mark.parametrize(("copies", "solver", "seed"), LARGE)
def test_joints_of_one_of_many_loops_are_locked_and_released(copies: int, solver: str, seed: int) -> None:
    check(Loop.random(seed), copies, solver, 1e-7)
