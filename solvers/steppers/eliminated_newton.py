"""Newton's equations of implicit methods with eliminated constraints: a state, and the solution of its linear systems.

With P(y) the nearest state on the constraints and f(y) = (N v, v') the equations of motion there
(:mod:`solvers.projection.eliminated`), a method solves c y - f(P(y)) = r for y = (q, v). With r = (r1, r2) and
g = (c r1 + r2) / c^2, its solution without forces, g is separated into the part that constraints allow and the other
one (the least-norm correction of velocities). The first one is solved with the structured tangent and stiff springs
alpha in place of the constraints::

    (c^2 M + c D + K + J^T alpha J) dtheta = c^2 M g_t + D r1_t,   dq = N (dtheta + g_n),   dv = c (dtheta + g_n) - r1

The term D r1_t, with the allowed part of r1, is a difference of inverse dynamics. The springs need not be much stiffer
than what they hold, since g_t is allowed: their stiffness is that of inertia forces, or of all forces if these are
larger. So the work is proportional to the number of bodies if loops are local.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.tuple_pointer import unpin
from solvers.outcome import NOT_FINITE, OK
from solvers.positions import Positions, as_motion, as_slope, count_velocities
from solvers.projection.eliminated import (
    CLOSED_RESIDUAL,
    MIN_SPEED_RATIO,
    REDUNDANT_LENGTH,
    find_velocity_correction,
    project,
)
from solvers.projection.eliminated_crossing import MAX_TURN, evaluate_closed
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration

MAX_STIFFNESS = 1e4  # by which the springs are stiffer; rounding allows no more
NEGLECTED_DAMPING_RATIO = 10.0  # rate of damping, to the rate of the motion
DAMPING_STEP_RATIO = 1e-2  # of differences of velocities, to the largest velocity
SPRING_RATIO = 10.0  # stiffness of the springs that hold the constraints, to the inertia of the mechanism times c^2


class ImplicitEquations(NamedTuple):
    """The equations of motion, and the tangent with which Newton's matrix is approximated."""

    loops: Any  # solvers.system.EliminationEquations, pinned
    factor_tangent: Any  # as solvers.system.TangentCallbacks has them
    solve_tangent: Any
    multiply_mass_matrix: Any
    tangent: Any


class Work(NamedTuple):
    """A state, where the tangent was factored last, and scratch."""

    loops: Any  # solvers.projection.eliminated.EliminationScratch, pinned
    positions: Any  # solvers.positions.Positions, pinned
    row_size: Array  # (m,) units of the constraint residuals
    inertia: Array  # (1,) kinetic energy of a motion in units of the coordinates, by degree of freedom, J s^2
    c: Array  # (1,) c where the tangent was factored, 1/s
    t: Array  # (1,) s
    speed: Array  # (1,) largest velocity there, in units, 1/s
    refusal: Array  # (1,) code of singular configurations where the equations have no solution, since the last step
    q_factored: Array  # (nq,) closed state there
    v_factored: Array  # (n,)
    a_factored: Array  # (n,)
    lam_factored: Array  # (m,)
    tau_factored: Array  # (n,) inverse dynamics there
    stiffness: Array  # (1,) ratio of all forces to inertia forces, by which the springs are stiffer
    is_damped: Array  # (1,) 1: forces that depend on velocities count in Newton's matrix
    weight: Array  # (m,) stiffness of the springs
    q: Array  # (nq,) closed state that is evaluated
    v: Array  # (n,)
    qdot: Array  # (nq,)
    a: Array  # (n,)
    lam: Array  # (m,)
    motion: Array  # (n,) scratch, as those that follow
    guess: Array  # (n,)
    change: Array  # (n,)
    load: Array  # (n,)
    damping: Array  # (n,)
    dtheta: Array  # (n,)

    @staticmethod
    def allocate(nq: int, n: int, m: int, loops: Any, positions: Positions) -> Work:
        """Return zeroed arrays."""
        z = np.zeros
        return Work(
            loops, positions, z(m), z(1), z(1), z(1), z(1), z(1), z(nq), z(n), z(n), z(m), z(n), z(1), z(1), z(m),
            z(nq), z(n), z(nq), z(n), z(m), z(n), z(n), z(n), z(n), z(n), z(n),
        )  # fmt: skip

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that are needed to continue a motion."""
        return [*unpin(self.loops).memory(), self.row_size, self.inertia, self.stiffness]

    def factored(self) -> list[NDArray[Any]]:
        """Return the arrays from which the tangent is factored again."""
        state = self.q_factored, self.v_factored, self.a_factored, self.lam_factored, self.tau_factored
        return [self.row_size, self.inertia, self.c, self.t, self.speed, *state, self.stiffness, self.is_damped]


@kernel
def close_state(t: float, y: Reals, loaded: bool, problem: Integration) -> int:
    """Close the state of the unknowns y (N,), and evaluate the equations there; return a code."""
    work, eqs, nq = problem.work, problem.eqs.loops, problem.q.shape[0]
    for i in range(y.shape[0]):
        if not np.isfinite(y[i]):
            return NOT_FINITE
    for i in range(nq):
        work.q[i] = y[i]
    for i in range(work.v.shape[0]):
        work.v[i] = y[nq + i]
    code: int = project(eqs, t, work.q, work.v, CLOSED_RESIDUAL, work.loops)
    if code != OK:
        return code
    return evaluate_closed(eqs, t, work.q, work.v, loaded, work.loops, work.qdot, work.a, work.lam)


@kernel
def factor_tangent(t: float, c: float, problem: Integration) -> bool:
    """Factor the tangent at the state that was evaluated last, with multipliers; False: it is singular."""
    work, eqs, loops = problem.work, problem.eqs, problem.eqs.loops
    loops.inverse(t, work.q, work.v, work.a, work.lam, loops.data, work.qdot, work.tau_factored)
    work.c[0], work.t[0], work.speed[0] = c, t, problem.settings[0].rate
    for i in range(work.q.shape[0]):
        work.q_factored[i] = work.q[i]
    for i in range(work.v.shape[0]):
        work.v_factored[i], work.a_factored[i] = work.v[i], work.a[i]
        if i < count_velocities(work.positions, work.v.shape[0]):
            work.speed[0] = max(work.speed[0], abs(work.v[i]) / work.loops.size[i])
    for row in range(work.lam.shape[0]):
        work.lam_factored[row] = work.lam[row]
    if not factor_with_springs(problem):
        return False
    stiffness = measure_stiffness(problem)
    if stiffness > 2.0 * work.stiffness[0]:
        work.stiffness[0] = stiffness
        if not factor_with_springs(problem):
            return False
    work.stiffness[0] = stiffness
    multiply_damping(problem)
    eqs.solve_tangent(work.damping, eqs.tangent, work.dtheta)
    moved, largest = 0.0, 0.0
    for i in range(work.dtheta.shape[0]):
        moved = max(moved, c * abs(work.dtheta[i]) / work.loops.size[i])
        largest = max(largest, abs(work.guess[i]) / work.loops.size[i])
    damped = c * moved > NEGLECTED_DAMPING_RATIO * problem.settings[0].rate * largest
    work.is_damped[0] = 1.0 if damped else 0.0
    return True


@kernel
def measure_inertia(t: float, c: float, problem: Integration) -> None:
    """Factor the tangent at the state that was evaluated last, and set work.inertia by its M."""
    work, eqs = problem.work, problem.eqs
    n = count_velocities(work.positions, problem.v.shape[0])
    factor_tangent(t, c, problem)
    work.inertia[0] = 0.0
    set_arbitrary_motion(work)
    eqs.multiply_mass_matrix(work.guess, eqs.tangent, work.load)
    for i in range(n):
        work.inertia[0] += work.guess[i] * work.load[i] / n


@inlined
def set_arbitrary_motion(work: Any) -> None:
    """work.guess (n,) <- a motion of all coordinates, by their units; first-order states are as they are."""
    moving = count_velocities(work.positions, work.guess.shape[0])
    for i in range(work.guess.shape[0]):
        work.guess[i] = work.loops.size[i] * np.sin(1.0 + i) if i < moving else 0.0


@kernel
def factor_with_springs(problem: Integration) -> bool:
    """Factor the tangent with springs in place of the constraints; False: it is singular."""
    work, eqs, c = problem.work, problem.eqs, problem.work.c[0]
    for row in range(work.weight.shape[0]):
        ratio = SPRING_RATIO * max(1.0, work.stiffness[0])
        work.weight[row] = ratio * c * c * work.inertia[0] / work.row_size[row] ** 2
    factored: bool = eqs.factor_tangent(c, c * c, work.weight, False, eqs.tangent)
    return factored


@kernel
def measure_stiffness(problem: Integration) -> float:
    """Ratio of all forces to inertia forces in a motion, work.guess, that the constraints allow."""
    work, eqs, c, free, held = problem.work, problem.eqs, problem.work.c[0], 0.0, 0.0
    set_arbitrary_motion(work)
    remove_normal_part(problem)
    eqs.multiply_mass_matrix(work.guess, eqs.tangent, work.load)
    for i in range(work.load.shape[0]):
        work.load[i] *= c * c
    eqs.solve_tangent(work.load, eqs.tangent, work.dtheta)
    for i in range(work.guess.shape[0]):
        free += (work.guess[i] / work.loops.size[i]) ** 2
        held += (work.dtheta[i] / work.loops.size[i]) ** 2
    return min(np.sqrt(free / held), MAX_STIFFNESS) if held > 0.0 else 1.0


@kernel
def multiply_damping(problem: Integration) -> None:
    """work.damping (n,) <- D work.guess, the derivative of the forces by velocities, where the tangent was factored."""
    work, eqs, scratch, largest = problem.work, problem.eqs.loops, problem.work.loops, 0.0
    for i in range(work.guess.shape[0]):
        largest = max(largest, abs(work.guess[i]) / scratch.size[i])
        work.damping[i] = 0.0
    if not 0.0 < largest < np.inf:
        return
    scale = DAMPING_STEP_RATIO * work.speed[0] / largest
    for i in range(work.guess.shape[0]):
        work.dtheta[i] = work.v_factored[i] + scale * work.guess[i]
    eqs.inverse(
        work.t[0], work.q_factored, work.dtheta, work.a_factored, work.lam_factored, eqs.data, scratch.qdot_near,
        work.damping,
    )  # fmt: skip
    for i in range(work.damping.shape[0]):
        work.damping[i] = (work.damping[i] - work.tau_factored[i]) / scale


@kernel
def remove_normal_part(problem: Integration) -> None:
    """work.change (n,) <- the part of work.guess that the constraints do not allow, and remove it from work.guess."""
    work, eqs, largest = problem.work, problem.eqs.loops, 0.0
    for i in range(work.guess.shape[0]):
        largest = max(largest, abs(work.guess[i]) / work.loops.size[i])
        work.change[i] = 0.0
    if not 0.0 < largest < np.inf:
        return
    scale = work.speed[0] / largest
    for i in range(work.guess.shape[0]):
        work.dtheta[i] = work.v_factored[i] + scale * work.guess[i]
    find_velocity_correction(eqs, work.t[0], work.q_factored, work.dtheta, REDUNDANT_LENGTH, work.loops)
    for i in range(work.guess.shape[0]):
        work.change[i] = work.loops.change[i] / -scale
        work.guess[i] -= work.change[i]


@kernel
def apply_preconditioner(y: Reals, r: Reals, z: Reals, problem: Integration) -> None:
    """z (N,) <- the solution for the residual r, by the tangent as it was factored last."""
    work, eqs, c, nq = problem.work, problem.eqs, problem.work.c[0], problem.q.shape[0]
    as_motion(work.q_factored, r, work.positions, work.motion)
    for i in range(work.motion.shape[0]):
        work.guess[i], work.damping[i] = work.motion[i], 0.0
    if work.is_damped[0] == 1.0:
        remove_normal_part(problem)
        multiply_damping(problem)
    for i in range(work.motion.shape[0]):
        work.guess[i] = (c * work.motion[i] + r[nq + i]) / (c * c)
    remove_normal_part(problem)
    eqs.multiply_mass_matrix(work.guess, eqs.tangent, work.load)
    for i in range(work.load.shape[0]):
        work.load[i] = c * c * work.load[i] + work.damping[i]
    eqs.solve_tangent(work.load, eqs.tangent, work.dtheta)
    for i in range(work.dtheta.shape[0]):
        work.dtheta[i] += work.change[i]
        z[nq + i] = c * work.dtheta[i] - work.motion[i]
    as_slope(work.q_factored, work.dtheta, work.positions, z)
    turning = work.positions.turning
    for k in range(turning.shape[0]):  # and the quaternions' length
        first, along = turning[k, 0], 0.0
        for i in range(first, first + 4):
            along += work.q_factored[i] * r[i] / (c + problem.settings[0].rate)
        for i in range(first, first + 4):
            z[i] += along * work.q_factored[i]


@inlined
def is_on_branch(y: Reals, problem: Integration) -> bool:
    """Whether closing the unknowns y (N,) has left the velocities as they were: on another branch they would differ."""
    work, nq, size = problem.work, problem.q.shape[0], problem.work.loops.size
    changed, speed = 0.0, MIN_SPEED_RATIO * problem.settings[0].rate
    for i in range(count_velocities(work.positions, work.v.shape[0])):
        changed, speed = max(changed, abs(work.v[i] - y[nq + i]) / size[i]), max(speed, abs(work.v[i]) / size[i])
    return changed <= MAX_TURN * speed
