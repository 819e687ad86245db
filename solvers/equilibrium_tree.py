"""Steady states of a large tree: h(t, q, v) = 0 by Newton on the structured tangent.

As :mod:`solvers.equilibrium` does it for small mechanisms, with the linear systems solved in O(n): Newton damped by the
natural monotonicity test. Where it stops, the state is followed as the loads grow from none to whole, each step from
a straight prediction: a thin sheet that hangs almost straight down takes some ten steps. Where that ends, descent by
implicit Euler steps of the heavily damped motion (pseudo-transient continuation), T with c2 = 1 / duration^2.
"""

from __future__ import annotations

import numpy as np

from .equilibrium import CONVERGED, ITERATIONS, LEAST_DAMPING, LONGEST, NEAR, Outcome, Solution
from .system import Array, TreeSystem

DESCENT_STEPS = 200
FIRST = 1e-2  # s, duration of the first step downhill
LAST = 1.0  # s, duration from which on Newton can take over
FIRST_PART, SMALLEST_PART = 0.05, 1e-5  # of the loads
EASY = 6  # factorings of a step after which the next one is doubled
GROWTH = 10.0  # of the duration, at most


class TreeEquilibriumSolver:
    """Newton for one large tree.

    Parameters
    ----------
    system
        The tree.
    v
        Velocities (n,) of the steady motion.
    """

    def __init__(self, system: TreeSystem, v: Array) -> None:
        self.system, self._v, self._still = system, v, np.zeros(system.n)
        self.rows = np.zeros(0, np.int64)  # no constraints

    def rehearse(self, q: Array) -> None:
        """Have everything compiled now, and not in the time of a solution."""
        h = self._forces(0.0, q)
        if self.system.tangent.factor(0.0, 1.0):
            self._moved(q, 0.0 * self.system.tangent.solve(h))

    def solve(self, t: float, q: Array, lam: Array | None = None, *, downhill: bool = False) -> Solution:
        """Run Newton from positions q (nq,), then with growing loads; ``downhill`` lets the descent go first."""
        start, factored = q.copy(), 0
        if downhill:
            start, factored = self._descend(t, q)
        outcome, q, newton = self._newton(t, start)
        if outcome is not Outcome.FOUND and self.system.loads and not downhill:
            factored += newton
            outcome, q, newton = self._load(t, start)
        forces, gaps = self.unbalance(t, q)
        return Solution(
            outcome=outcome,
            q=q,
            lam=np.zeros(0),
            iterations=factored + newton,
            stiffness=1.0,
            forces=forces,
            gaps=gaps,
        )

    def unbalance(self, t: float, q: Array, lam: Array | None = None) -> tuple[Array, Array]:
        """Return h (n,), and no gaps."""
        return self._forces(t, q), np.zeros(0)

    def singular(self, t: float, q: Array) -> bool:
        """Without constraints no position is singular."""
        return False

    def _forces(self, t: float, q: Array) -> Array:
        return self.system.unbalance(t, q, self._v, self._still)

    def _moved(self, q: Array, step: Array) -> Array:
        moved = q.copy()
        self.system.apply(moved, step)
        return moved

    def _newton(self, t: float, q: Array) -> tuple[Outcome, Array, int]:
        """Return how it ended, where, and how often T was factored."""
        tangent, damping = self.system.tangent, 1.0
        for iteration in range(1, ITERATIONS + 1):
            h = self._forces(t, q)
            if not np.isfinite(h).all():
                return Outcome.NOT_FINITE, q, iteration
            if not tangent.factor(0.0, 0.0):
                return Outcome.SINGULAR, q, iteration
            step = -tangent.solve(h)
            size = float(np.linalg.norm(step))
            if not np.isfinite(size):
                return Outcome.SINGULAR, q, iteration
            if size <= CONVERGED * np.sqrt(len(step)):
                return Outcome.FOUND, self._moved(q, step), iteration
            while True:
                trial = self._moved(q, damping * step)
                after = float(np.linalg.norm(tangent.solve(self._forces(t, trial))))
                if after <= (1.0 - 0.25 * damping) * size:
                    break
                damping *= 0.5
                if damping < LEAST_DAMPING:
                    return Outcome.NO_PROGRESS, q, iteration
            q, damping = trial, min(1.0, 2.0 * damping)
        return Outcome.NO_PROGRESS, q, ITERATIONS

    def _load(self, t: float, q: Array) -> tuple[Outcome, Array, int]:
        """Follow the state from no load to the whole; return how it ended, where, and how often T was factored."""
        whole = [load.copy() for load in self.system.loads]
        part, step, factored = 0.0, FIRST_PART, 0
        before: tuple[Array, float] | None = None
        try:
            while True:
                aim = min(1.0, part + step)
                for load, full in zip(self.system.loads, whole, strict=True):
                    load[:] = aim * full
                guess = q
                if before is not None:
                    guess = q + (q - before[0]) * ((aim - part) / (part - before[1]))
                    self.system.apply(guess, self._still)
                outcome, found, count = self._newton(t, guess)
                factored += count
                if outcome is Outcome.FOUND:
                    before, q, part = (q, part), found, aim
                    step *= 2.0 if count < EASY else 1.3
                    if part == 1.0:
                        return outcome, q, factored
                elif (step := 0.4 * step) < SMALLEST_PART:
                    return outcome, q, factored
        finally:
            for load, full in zip(self.system.loads, whole, strict=True):
                load[:] = full

    def _descend(self, t: float, q: Array) -> tuple[Array, int]:
        """Return a position downhill near rest, and how often T was factored."""
        h, duration = self._forces(t, q), FIRST
        unbalance = float(np.linalg.norm(h))
        for count in range(1, DESCENT_STEPS + 1):
            if not self.system.tangent.factor(0.0, 1.0 / duration**2):
                return q, count
            step = -self.system.tangent.solve(h)
            longest = float(np.abs(step).max())
            if not np.isfinite(longest):
                return q, count
            q = self._moved(q, step * min(1.0, LONGEST / longest) if longest > 0.0 else step)
            h = self._forces(t, q)
            after = float(np.linalg.norm(h))
            if longest < NEAR and duration >= LAST:
                return q, count
            duration *= min(GROWTH, max(0.3, unbalance / after)) if after > 0.0 else GROWTH
            unbalance = after
        return q, DESCENT_STEPS
