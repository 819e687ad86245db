"""Steady states of a large tree: h + J^T lambda = 0, Phi = 0 by Newton on the structured tangent.

As :mod:`solvers.equilibrium` does it for small mechanisms, with the linear systems solved in O(n): Newton damped by the
natural monotonicity test. Where it stops, the state is followed as the loads grow from none to whole, each step from
a straight prediction: a thin sheet that hangs almost straight down takes some ten steps. Where that ends, descent by
implicit Euler steps of the heavily damped motion (pseudo-transient continuation), T with c2 = 1 / duration^2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .equilibrium import CONVERGED, ITERATIONS, LEAST_DAMPING, LONGEST, NEAR, Outcome, Solution
from .saddle import Saddle
from .system import Array, TreeSystem

DESCENT_STEPS = 200
FIRST = 1e-2  # s, duration of the first step downhill
LAST = 1.0  # s, duration from which on Newton can take over
FIRST_PART, SMALLEST_PART = 0.05, 1e-5  # of the loads
EASY = 6  # factorings of a step after which the next one is doubled
GROWTH = 10.0  # of the duration, at most


class State(NamedTuple):
    """What is looked for."""

    q: Array  # (nq,)
    lam: Array  # (m,)


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
        self._saddle = Saddle(system)
        self.rows = np.arange(system.m)

    def rehearse(self, q: Array) -> None:
        """Have everything compiled now, and not in the time of a solution."""
        self._saddle.weigh(0.0, q)
        forces, gaps = self.unbalance(0.0, q, np.zeros(self.system.m))
        if self._saddle.factor(0.0, 1.0):
            self._moved(q, 0.0 * self._saddle.solve(forces, gaps)[0])

    def solve(self, t: float, q: Array, lam: Array | None = None, *, downhill: bool = False) -> Solution:
        """Run Newton from (q, lam), (nq,) and (m,), then with growing loads; ``downhill`` lets the descent go first."""
        start, factored = State(q.copy(), np.zeros(self.system.m) if lam is None else lam.copy()), 0
        self._saddle.weigh(t, q)
        if downhill:
            start, factored = self._descend(t, start)
        outcome, found, newton = self._newton(t, start)
        if outcome is not Outcome.FOUND and self.system.loads and not downhill:
            factored += newton
            outcome, found, newton = self._load(t, start)
        forces, gaps = self.unbalance(t, *found)
        return Solution(
            outcome=outcome,
            q=found.q,
            lam=found.lam,
            iterations=factored + newton,
            stiffness=1.0,
            forces=forces,
            gaps=gaps,
        )

    def unbalance(self, t: float, q: Array, lam: Array) -> tuple[Array, Array]:
        """Return h + J^T lambda (n,) and Phi (m,)."""
        return self._saddle.unbalance(t, q, self._v, self._still, lam)

    def singular(self, t: float, q: Array) -> bool:
        """Whether no multipliers are determined at q: never, they are the shortest."""
        return False

    def _moved(self, q: Array, step: Array) -> Array:
        moved = q.copy()
        self.system.apply(moved, step)
        return moved

    def _stepped(self, at: State, part: float, step: Array, reaction: Array) -> State:
        """Return the state moved by a part of a correction."""
        return State(self._moved(at.q, part * step), at.lam + part * reaction)

    def _newton(self, t: float, at: State) -> tuple[Outcome, State, int]:
        """Return how it ended, where, and how often T was factored."""
        saddle, damping = self._saddle, 1.0
        for iteration in range(1, ITERATIONS + 1):
            forces, gaps = self.unbalance(t, *at)
            if not np.isfinite(forces).all():
                return Outcome.NOT_FINITE, at, iteration
            if not saddle.factor(0.0, 0.0):
                return Outcome.SINGULAR, at, iteration
            step, reaction = saddle.solve(-forces, -gaps)
            size = float(np.linalg.norm(step))
            if not np.isfinite(size):
                return Outcome.SINGULAR, at, iteration
            if size <= CONVERGED * np.sqrt(len(step)):
                return Outcome.FOUND, self._stepped(at, 1.0, step, reaction), iteration
            while True:
                trial = self._stepped(at, damping, step, reaction)
                forces, gaps = self.unbalance(t, *trial)
                after = float(np.linalg.norm(saddle.solve(forces, gaps)[0]))
                if after <= (1.0 - 0.25 * damping) * size:
                    break
                damping *= 0.5
                if damping < LEAST_DAMPING:
                    return Outcome.NO_PROGRESS, at, iteration
            at, damping = trial, min(1.0, 2.0 * damping)
        return Outcome.NO_PROGRESS, at, ITERATIONS

    def _load(self, t: float, at: State) -> tuple[Outcome, State, int]:
        """Follow the state from no load to the whole; return how it ended, where, and how often T was factored."""
        whole = [load.copy() for load in self.system.loads]
        part, step, factored = 0.0, FIRST_PART, 0
        before: tuple[State, float] | None = None
        try:
            while True:
                aim = min(1.0, part + step)
                for load, full in zip(self.system.loads, whole, strict=True):
                    load[:] = aim * full
                guess = at
                if before is not None:
                    further = (aim - part) / (part - before[1])
                    guess = State(*(now + (now - past) * further for now, past in zip(at, before[0], strict=True)))
                    self.system.apply(guess.q, self._still)
                outcome, found, count = self._newton(t, guess)
                factored += count
                if outcome is Outcome.FOUND:
                    before, at, part = (at, part), found, aim
                    step *= 2.0 if count < EASY else 1.3
                    if part == 1.0:
                        return outcome, at, factored
                elif (step := 0.4 * step) < SMALLEST_PART:
                    return outcome, at, factored
        finally:
            for load, full in zip(self.system.loads, whole, strict=True):
                load[:] = full

    def _descend(self, t: float, at: State) -> tuple[State, int]:
        """Return a state downhill near rest, and how often T was factored."""
        (forces, gaps), duration = self.unbalance(t, *at), FIRST
        unbalance = float(np.linalg.norm(forces))
        for count in range(1, DESCENT_STEPS + 1):
            if not self._saddle.factor(0.0, 1.0 / duration**2):
                return at, count
            step, reaction = self._saddle.solve(-forces, -gaps)
            longest = float(np.abs(step).max())
            if not np.isfinite(longest):
                return at, count
            at = self._stepped(at, min(1.0, LONGEST / longest) if longest > 0.0 else 1.0, step, reaction)
            forces, gaps = self.unbalance(t, *at)
            after = float(np.linalg.norm(forces))
            if longest < NEAR and duration >= LAST:
                return at, count
            duration *= min(GROWTH, max(0.3, unbalance / after)) if after > 0.0 else GROWTH
            unbalance = after
        return at, DESCENT_STEPS
