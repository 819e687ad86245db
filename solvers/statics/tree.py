"""Steady states of a large tree by its structured tangent, in O(n); see :mod:`.newton`."""

from __future__ import annotations

from contextlib import nullcontext
from typing import NamedTuple

import numpy as np

from solvers.extrapolation import StressExtrapolation
from solvers.projection.saddle import Saddle
from solvers.system import Array, TreeSystem

from .newton import (
    EASY_STEP_FACTOR,
    EQUILIBRIUM_NEWTON_TOLERANCE,
    MAX_EQUILIBRIUM_ITERATIONS,
    MAX_FIRST_STEP,
    MAX_STATE_DISTANCE,
    REGULARIZATION_MASS,
    EquilibriumSolver,
    Outcome,
    Relaxed,
    Unknowns,
)

STEP_TOLERANCE_RATIO = 0.2  # a pseudo-transient step ends with a correction this small against its first
# Where a correction is this part of the one before, the next step is as long as this one; this part is assumed to be in
# proportion to a power of the duration. Measured on thin meshes held by a third of an edge, which crease where the
# clamp ends, and on thin bodies with large displacements.
TARGET_CONTRACTION, CONTRACTION_ORDER = 0.3, 2.0
MIN_CONTINUATION_DAMPING = 0.01  # damping of Newton alone, below which the continuation is cheaper


class Extrapolated(NamedTuple):
    """A correction with which strains were extrapolated."""

    to: Array  # (nq,) position to which it leads
    q: Array  # (nq,) position at which the strains were linearized
    step: Array  # (n,)


class TreeEquilibriumSolver(EquilibriumSolver):
    """Newton for one large tree.

    Parameters
    ----------
    system
        The tree.
    v
        Velocities (n,) of the steady motion.
    has_cyclic
        Whether there are cyclic coordinates, so that the Jacobian is singular everywhere. A small part of the mass
        matrix is then added to it from the start.
    """

    def __init__(self, system: TreeSystem, v: Array, has_cyclic: bool = False) -> None:
        super().__init__(system)
        self._has_cyclic = has_cyclic
        self.system, self._v, self._still = system, v, np.zeros(system.n)
        self._saddle = Saddle(system, exact=True)
        self.rows = np.arange(system.m)
        self._extrapolated = self._start = Extrapolated(np.zeros(0), np.zeros(0), self._still)

    def run_trial(self, q: Array) -> None:
        """See the base."""
        self._saddle.set_penalties(0.0, q)
        forces, gaps = self.residual(0.0, q, np.zeros(self.system.m))
        if self._saddle.factor(0.0, 1.0):
            self._moved(q, 0.0 * self._saddle.solve(forces, gaps)[0])

    def residual(self, t: float, q: Array, lam: Array) -> tuple[Array, Array]:
        """See the base."""
        return self._saddle.residual(t, q, self._v, self._still, lam)

    def is_singular(self, t: float, q: Array) -> bool:
        """Never: the multipliers are the shortest."""
        return False

    def _initial_multipliers(self, t: float, q: Array) -> Array:
        """Return none; Newton finds them in its first step."""
        self._saddle.set_penalties(t, q)
        return np.zeros(self.system.m)

    def _is_far_from_start(self, moved: Array) -> bool:
        return self._has_cyclic and bool(np.abs(moved / self._size).max(initial=0.0) > MAX_STATE_DISTANCE)

    def _all_multipliers(self, lam: Array) -> Array:
        return lam

    def _moved(self, q: Array, step: Array) -> Array:
        moved = q.copy()
        self.system.apply(moved, step)
        return moved

    def _changed(self, at: Unknowns, part: float, step: Array, reaction: Array) -> Unknowns:
        """Return the state moved by a part of a correction."""
        return Unknowns(self._moved(at.q, part * step), at.lam + part * reaction)

    def _accelerate(self, t: float, q: Array) -> Array:
        self._saddle.set_penalties(t, q)
        forces, gaps = self.residual(t, q, np.zeros(self.system.m))
        return self._saddle.solve(-forces, 0.0 * gaps)[0] if self._saddle.factor(0.0, 1.0) else 0.0 * forces

    def _newton(self, t: float, at: Unknowns, c2: float, mass: float) -> tuple[Outcome, Unknowns, Array, int]:
        saddle, damping, moved = self._saddle, 1.0, self._still
        if self._has_cyclic:
            mass = max(mass, REGULARIZATION_MASS * self._rate**2)
        for iteration in range(1, MAX_EQUILIBRIUM_ITERATIONS + 1):
            forces, gaps = saddle.residual(t, at.q, self._v, c2 * moved, at.lam)
            if not np.isfinite(forces).all():
                return Outcome.NOT_FINITE, at, moved, iteration
            if not saddle.factor(0.0, mass):
                return Outcome.SINGULAR, at, moved, iteration
            step, reaction = saddle.solve(-forces, -gaps)
            size = float(np.linalg.norm(step / self._size))
            if not np.isfinite(size):
                return Outcome.SINGULAR, at, moved, iteration
            if (
                iteration == 1 and self._has_cyclic and c2 == 0.0 and size > MAX_FIRST_STEP
            ):  # what is farther may be another state
                damping = MAX_FIRST_STEP / size
            if size <= EQUILIBRIUM_NEWTON_TOLERANCE * np.sqrt(len(step)):
                return Outcome.FOUND, self._changed(at, 1.0, step, reaction), moved + step, iteration
            while True:
                trial, further = self._changed(at, damping, step, reaction), moved + damping * step
                forces, gaps = saddle.residual(t, trial.q, self._v, c2 * further, trial.lam)
                after = float(np.linalg.norm(saddle.solve(forces, gaps)[0] / self._size))
                if after <= (1.0 - 0.25 * damping) * size:
                    break
                damping *= 0.5
                if damping < MIN_CONTINUATION_DAMPING:
                    return Outcome.NO_PROGRESS, at, moved, iteration
            at, moved, damping = trial, further, min(1.0, 2.0 * damping)
        return Outcome.NO_PROGRESS, at, moved, MAX_EQUILIBRIUM_ITERATIONS

    def _relax(self, t: float, at: Unknowns, c2: float) -> Relaxed:
        """Take a step by Newton without damping, until the rest is small against it."""
        saddle, moved, first, before, worst = self._saddle, self._still, 0.0, np.inf, 0.0
        stress = self._stress_extrapolation
        if stress is not None:
            self._return_to(stress, t, at.q)
        for count in range(1, MAX_EQUILIBRIUM_ITERATIONS + 1):
            forces, gaps = saddle.residual(t, at.q, self._v, c2 * moved, at.lam)
            if not np.isfinite(forces).all():
                return Relaxed(Outcome.NOT_FINITE, at, moved, count)
            if not self._factor(t, at, c2 * moved, c2):
                return Relaxed(Outcome.SINGULAR, at, moved, count)
            step, reaction = saddle.solve(-forces, -gaps)
            size = float(np.linalg.norm(step / self._size))
            if not size < before:
                break
            if count == 1:
                first = size
            else:
                worst = max(worst, size / before)
            before_step = at.q
            at, moved, before = self._changed(at, 1.0, step, reaction), moved + step, size
            if stress is not None:
                self._extrapolate(stress, t, Extrapolated(at.q, before_step, step))
            converged = size <= EQUILIBRIUM_NEWTON_TOLERANCE * np.sqrt(len(step))
            if converged or (count > 1 and size <= STEP_TOLERANCE_RATIO * first):
                longer = (TARGET_CONTRACTION / worst) ** (1.0 / CONTRACTION_ORDER) if worst else EASY_STEP_FACTOR
                return Relaxed(Outcome.FOUND, at, moved, count, min(longer, EASY_STEP_FACTOR))
        return Relaxed(Outcome.NO_PROGRESS, at, moved, count)

    @property
    def _stress_extrapolation(self) -> StressExtrapolation | None:
        """What extrapolates stresses; None: nothing, or the tangent is corrected by products, which do not."""
        is_still = not (self.system.moves() or bool(self._v.any()))
        return self.system.stress_extrapolation if is_still else None

    def _extrapolate(self, stress: StressExtrapolation, t: float, correction: Extrapolated) -> None:
        """Let elements store the strains that a correction leads to, linearized."""
        self.system.residual(t, correction.q, correction.step, self._still)
        stress.extrapolate()
        self._extrapolated = correction

    def _return_to(self, stress: StressExtrapolation, t: float, q: Array) -> None:
        """Let elements have the extrapolated strains of a position (nq,) where a pseudo-transient step starts.

        If that is the start of the last step, which has failed, they are those it started with.
        """
        if self._extrapolated.to is not q:
            last = self._start if self._start.to is q else Extrapolated(q, q, self._still)
            self._extrapolate(stress, t, last)
        self._start = self._extrapolated

    def _factor(self, t: float, at: Unknowns, a: Array, c2: float) -> bool:
        """Factor at the last residual for a pseudo-transient step, with extrapolated stresses if there are any."""
        stress = self._stress_extrapolation
        if stress is None:
            return self._saddle.factor(0.0, c2)
        with stress.imposed():
            self._saddle.residual(t, at.q, self._v, a, at.lam)
            return self._saddle.factor(0.0, c2)

    def _applied_forces(self, t: float, q: Array) -> Array:
        """See the base; with extrapolated stresses if q is the position that they belong to, where they are more
        accurate.
        """
        stress = self._stress_extrapolation
        with stress.imposed() if stress is not None and self._extrapolated.to is q else nullcontext():
            return super()._applied_forces(t, q)
