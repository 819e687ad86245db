"""Steady states by Newton-Raphson: no acceleration, drives and cyclic coordinates at constant speed, the rest still.

Unknowns z = (q, lambda); equations (20)-(24) of Choi, Park and Yoo, with v zero but for cyclic coordinates::

    f(z) = [ h(t, q, v) + J(q)^T lambda ;  Phi(t, q) ] = 0

h is the recursive inverse dynamics at no acceleration with the drives moving. Newton is damped by the natural
monotonicity test (Deuflhard, *Newton Methods for Nonlinear Problems*, 2004, section 3.3): a step is good where the next
correction, taken with the old Jacobian, is shorter. The test does not change with the units of the equations.

**Pseudo-transient continuation** (Kelley and Keyes 1998). Newton follows its path, which may end where the Jacobian is
singular. Then the start is relaxed first, by implicit Euler steps of the motion of a heavily damped mechanism,

    M (q - q_before) / s^2 + h + J^T lambda = 0,     Phi = 0,

each solved by Newton: exactly where that is cheap, on a large tree as far as the way on needs it. s grows where Newton
finds a step easy, and shrinks where it fails. A step against which the forces do work, by the trapezoidal rule, does
not count: where it is long, Newton may find a root uphill. The continuation mostly ends at a stable state where there
is one, and Newton finishes there. A thin strip, whose stiffness against stretching is a million times that against
bending, gets from flat to hanging straight down in some twenty factorizations.

**Extrapolated stresses.** A correction that bends a thin body also stretches it, by the square of the rotations. The
stress of this strain is large, and the tangent with it has little in common with that of the step's end. Therefore the
tangent of a pseudo-transient step has the stress K (e + B dq) of the strain that is linearized about the position
before the correction dq, and the residual has the stress K e of the present strain. This is Newton's method for
strains e and stresses as independent unknowns (mixed integration points: Magisano, Leonetti and Garcea 2017), and has
the same solutions. Forces at the end of a step are compared with these stresses, too. They are not used where the
structured tangent is corrected by products, and Newton's method alone does not use them.

**Families of states.** If a motion changes no force, such as that of a free spindle, the Jacobian is singular at every
state of the family and nearly so near it. If Newton then fails after the continuation, a small part of the mass
matrix is added to the Jacobian alone. Corrections along the family stay small, the others converge linearly, and what
is found balances all forces as any state does.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.system import AnySystem, Array

# the last correction, in units of the coordinates; what it leaves is of the order of its square
EQUILIBRIUM_NEWTON_TOLERANCE = 1e-10
MAX_EQUILIBRIUM_ITERATIONS = 60
MAX_FIRST_STEP = 1.0  # length of the first step
MAX_STATE_DISTANCE = 3.2  # units of size, half a turn: a state farther from the start is not the one next to it
MIN_DAMPING = 1e-4

# In the time that gravity or the drives move the mechanism in, if they do, and units of the coordinates:
FIRST_DURATION, MIN_DURATION, MAX_DURATION = 0.03, 3e-6, 3e3  # pseudo-time of the first and of any step
# a step this long that moves no coordinate further leaves the rest to Newton
RESTING_DURATION, RESTING_DISTANCE = 3.0, 1e-3
MAX_STEP_DISTANCE = 100.0  # way of a step: nothing holds it
EASY_STEP_FACTORIZATIONS = 6  # factorizations of a step after which the next one may be much longer
# changes of the duration: after an easy, a difficult and a failed step; two
EASY_STEP_FACTOR, DIFFICULT_STEP_FACTOR, FAILED_STEP_FACTOR = 4.0, 1.5, 0.3
MAX_FACTORIZATIONS = 2000  # factorizations in the continuation
# mass matrix in the Jacobian of a family of states, in units of that time; others converge by this factor
REGULARIZATION_MASS = 1e-4


class Outcome(IntEnum):
    """How a solution ended; the numbers are those a kernel returns."""

    FOUND = 0
    NO_PROGRESS = 1
    SINGULAR = 2
    NOT_FINITE = 3
    UNDETERMINED = 4  # in a singular configuration, where forces of cut joints are not unique


FOUND, NO_PROGRESS, SINGULAR, NOT_FINITE, UNDETERMINED = map(int, Outcome)  # for kernels


class Unknowns(NamedTuple):
    """Unknowns of a steady state."""

    q: Array  # (nq,)
    lam: Array  # of the independent constraints


class Relaxed(NamedTuple):
    """A step of the pseudo-transient continuation."""

    outcome: Outcome
    at: Unknowns  # where it ended
    moved: Array  # (n,) how the coordinates changed
    factored: int
    longer: float = 1.0  # how many times as long the next one may be


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What Newton found.

    Attributes
    ----------
    q, lam
        Positions (nq,) and multipliers (m,), redundant ones zero.
    iterations
        Jacobians factored.
    forces, gaps
        h + J^T lambda (n,) and Phi (m,) there.
    """

    outcome: Outcome
    q: Array
    lam: Array
    iterations: int
    forces: Array
    gaps: Array


class EquilibriumSolver(ABC):
    """Newton for one mechanism.

    Attributes
    ----------
    rows
        The constraints that are solved for, independent of each other.
    """

    rows: NDArray[np.int64]
    _v: NDArray[Any]  # (n,) velocities of the steady motion

    def __init__(self, system: AnySystem) -> None:
        self._size, self._rate, self._known_rate = system.size, system.rate or 1.0, system.rate > 0.0

    def set_velocities(self, v: Array) -> None:
        """Set the velocities (n,) of the steady motion."""
        self._v[:] = v

    def solve(self, t: float, q: Array, lam: Array | None = None, *, pseudo_transient: bool = False) -> Solution:
        """Run Newton from positions q (nq,) and multipliers lam (m,); without lam from those of least residual.

        ``pseudo_transient``: continuation goes first.
        """
        at, factored = Unknowns(q.copy(), self._initial_multipliers(t, q) if lam is None else lam[self.rows]), 0
        if not self._known_rate:
            self._rate = self._measure_rate(t, q)
        if pseudo_transient:
            at, factored = self._continue(t, at)
        outcome, found, moved, count = self._newton(t, at, 0.0, 0.0)
        if pseudo_transient and outcome in (Outcome.NO_PROGRESS, Outcome.SINGULAR):
            factored += count
            again = self._newton(t, at, 0.0, REGULARIZATION_MASS * self._rate**2)
            outcome, found, moved, count = again if again[0] is Outcome.FOUND else (outcome, found, moved, again[-1])
        at = found
        if outcome is Outcome.FOUND and lam is None and not pseudo_transient and self._is_far_from_start(moved):
            outcome = Outcome.NO_PROGRESS
        full = self._all_multipliers(at.lam)
        forces, gaps = self.residual(t, at.q, full)
        return Solution(
            outcome=outcome,
            q=at.q,
            lam=full,
            iterations=factored + count,
            forces=forces,
            gaps=gaps,
        )

    def _continue(self, t: float, at: Unknowns) -> tuple[Unknowns, int]:
        """Return a state near rest by pseudo-transient continuation, and how many Jacobians were factored."""
        duration, growth, factored, applied = FIRST_DURATION, EASY_STEP_FACTOR, 0, self._applied_forces(t, at.q)
        while factored < MAX_FACTORIZATIONS and MIN_DURATION < duration < MAX_DURATION:
            step = self._relax(t, at, (self._rate / duration) ** 2)
            factored += step.factored
            there = self._applied_forces(t, step.at.q)
            uphill = float((applied + there) @ step.moved) > 0.0
            if step.outcome not in (Outcome.FOUND, Outcome.UNDETERMINED) or uphill:
                duration, growth = FAILED_STEP_FACTOR * duration, DIFFICULT_STEP_FACTOR
                continue
            farthest = float(np.abs(step.moved / self._size).max())
            at, applied = step.at, there
            if farthest > MAX_STEP_DISTANCE or (duration >= RESTING_DURATION and farthest < RESTING_DISTANCE):
                break
            duration *= min(growth, step.longer)
            growth = min(EASY_STEP_FACTOR, DIFFICULT_STEP_FACTOR * growth)
        return at, factored

    def _relax(self, t: float, at: Unknowns, c2: float) -> Relaxed:
        """Take a pseudo-transient step; c2 as in :meth:`_newton`."""
        outcome, found, moved, count = self._newton(t, at, c2, c2)
        return Relaxed(
            outcome,
            found,
            moved,
            count,
            EASY_STEP_FACTOR if count < EASY_STEP_FACTORIZATIONS else DIFFICULT_STEP_FACTOR,
        )

    def _is_far_from_start(self, moved: Array) -> bool:
        """Whether Newton alone went so far (n,) that the state it found is not the one next to the start."""
        return False

    def _measure_rate(self, t: float, q: Array) -> float:
        """Return the rate (1/s) at which the forces at q move the mechanism from rest; 1 without forces."""
        accelerations = np.abs(self._accelerate(t, q)) / self._size
        return float(np.sqrt(accelerations.max(initial=0.0))) or 1.0

    def _applied_forces(self, t: float, q: Array) -> Array:
        """Return h (n,), the forces without those of the cut joints, which do no work."""
        return self.residual(t, q, self._all_multipliers(np.zeros(len(self.rows))))[0]

    @abstractmethod
    def run_trial(self, q: Array) -> None:
        """Compile all that a solution calls, so that its time is its own."""

    @abstractmethod
    def residual(self, t: float, q: Array, lam: Array) -> tuple[Array, Array]:
        """Return h + J^T lambda (n,) and Phi (m,)."""

    @abstractmethod
    def is_singular(self, t: float, q: Array) -> bool:
        """Whether the independent constraints lose rank at q, so that no multipliers are determined."""

    @abstractmethod
    def _initial_multipliers(self, t: float, q: Array) -> Array:
        """Return the multipliers of the independent constraints to start from."""

    @abstractmethod
    def _accelerate(self, t: float, q: Array) -> Array:
        """Return the accelerations (n,) at q by the forces without those of cut joints."""

    @abstractmethod
    def _newton(self, t: float, at: Unknowns, c2: float, mass: float) -> tuple[Outcome, Unknowns, Array, int]:
        """Return how it ended, where, how the coordinates changed (n,), and how many Jacobians were factored.

        Of an orientation the change is the sum of its small turns.
        c2, 1/s^2: of the pseudo-transient step that starts there; zero: the steady state itself.
        mass, 1/s^2: times the mass matrix in the Jacobian; that of the equations is c2.
        """

    @abstractmethod
    def _all_multipliers(self, lam: Array) -> Array:
        """Return the multipliers (m,) of all constraints."""
