"""What IDA is given if constraints are eliminated: callbacks, and the function that accepts its steps.

The equations are in :mod:`.eliminated`. All kernels get the integration
(:class:`solvers.steppers.step_loop.Integration`) with the memory and the work of :mod:`.eliminated_memory`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.outcome import BRANCHES, NOT_FINITE, OK, UNDECIDABLE
from solvers.positions import as_motion, as_slope
from solvers.projection.eliminated import CLOSED_RESIDUAL, MIN_SPEED_RATIO, REDUNDANT_LENGTH, project
from solvers.projection.eliminated_crossing import MAX_TURN, evaluate_closed, record_accepted

from .dense_callbacks import RETRY_STEP_RATIO
from .loop import JACOBIANS, NONFINITE_RESIDUALS, REJECTED_STEPS, RESIDUALS, STEP_REJECTED, STEPS

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration

MAX_STIFFNESS = 1e4  # by which the springs are stiffer; rounding allows no more
NEGLECTED_DAMPING_RATIO = 10.0  # rate of damping, to the rate of the motion
DAMPING_STEP_RATIO = 1e-2  # of differences of velocities, to the largest velocity
SPRING_RATIO = 10.0  # stiffness of the springs that hold the constraints, to the inertia of the mechanism times c^2


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
def evaluate_residual(t: float, y: Reals, slopes: Reals, out: Reals, problem: Integration) -> None:
    """out (N,) <- residual of IDA; what is not finite IDA takes as a sign to cut the step."""
    work, counts, nq, rate = problem.work, problem.memory.counts, problem.q.shape[0], problem.settings[0].rate
    counts[RESIDUALS] += 1.0
    code = close_state(t, y, False, problem)
    if code != OK:
        counts[NONFINITE_RESIDUALS] += 1.0 if code == NOT_FINITE else 0.0
        if code in (BRANCHES, UNDECIDABLE):
            work.refusal[0] = code
        for i in range(out.shape[0]):
            out[i] = np.nan
        return
    for i in range(nq):
        out[i] = slopes[i] - work.qdot[i] + rate * (y[i] - work.q[i])
    for i in range(work.v.shape[0]):
        out[nq + i] = slopes[nq + i] - work.a[i] + rate * (y[nq + i] - work.v[i])


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
    for i in range(work.guess.shape[0]):
        work.guess[i] = work.loops.size[i] * np.sin(1.0 + i)
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
def set_up_preconditioner(t: float, y: Reals, cj: float, problem: Integration) -> int:
    """Factor the tangent at y; 1: it is singular there."""
    problem.memory.counts[JACOBIANS] += 1.0
    if close_state(t, y, True, problem) != OK:
        return 1
    return 0 if factor_tangent(t, cj, problem) else 1


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
    eqs.correct_velocity(
        work.t[0], work.q_factored, work.dtheta, eqs.elimination, REDUNDANT_LENGTH, work.change, work.loops.report
    )
    for i in range(work.guess.shape[0]):
        work.change[i] /= -scale
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
def fill_energy(t: float, problem: Integration) -> None:
    """Record the energy at the state that was evaluated last; see :mod:`solvers.energy_account`."""
    eqs, memory, work, done = problem.eqs.loops, problem.memory, problem.work, 0.0
    record, scratch = memory.energy_record[0], problem.work.loops
    if energy_check_scheduled(record):
        eqs.inverse(t, work.q, work.v, scratch.zero, scratch.zero_lam, eqs.data, work.qdot, work.load)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, record, problem.scales)
    if memory.progress[0].works == 1:
        eqs.inverse(t, work.q, work.v, work.a, work.lam, eqs.data, work.qdot, work.load)
        done = eqs.power(t, work.q, work.v, work.a, work.lam, eqs.data)
    record_step(memory.energy_record, t, done)


@kernel
def fill_start(problem: Integration, t: float) -> int:
    """Fill IDA's unknowns and their derivatives at the reported state of time t (s); return a code."""
    y, slopes, nq, n = problem.memory.ida.y, problem.memory.ida.slopes, problem.q.shape[0], problem.v.shape[0]
    work, eqs, rate = problem.work, problem.eqs, problem.settings[0].rate
    for i in range(nq):
        y[i] = problem.q[i]
    for i in range(n):
        y[nq + i] = problem.v[i]
    work.loops.near[0].accepted, work.loops.near[0].time_to_singular = 0.0, np.inf
    code: int = close_state(t, y, True, problem)
    if code != OK:
        return code
    for i in range(nq):
        y[i], slopes[i] = work.q[i], work.qdot[i]
    for i in range(n):
        y[nq + i], slopes[nq + i] = work.v[i], work.a[i]
    factor_tangent(t, rate, problem)  # M is that of its state
    work.inertia[0] = 0.0
    for i in range(n):
        work.guess[i] = work.loops.size[i] * np.sin(1.0 + i)
    eqs.multiply_mass_matrix(work.guess, eqs.tangent, work.load)
    for i in range(n):
        work.inertia[0] += work.guess[i] * work.load[i] / n
    return OK


@kernel
def end_start(problem: Integration, t: float) -> None:
    """Record the start of a history at t (s)."""
    problem.memory.progress[0].works = problem.settings[0].works
    for i in range(problem.memory.last_accepted.shape[0]):
        problem.memory.last_accepted[i] = problem.memory.ida.y[i]
    if problem.memory.progress[0].energy_check == 1:
        fill_energy(t, problem)


@inlined
def is_on_branch(y: Reals, problem: Integration) -> bool:
    """Whether closing the unknowns y (N,) has left the velocities as they were: on another branch they would differ."""
    work, nq, size = problem.work, problem.q.shape[0], problem.work.loops.size
    changed, speed = 0.0, MIN_SPEED_RATIO * problem.settings[0].rate
    for i in range(work.v.shape[0]):
        changed, speed = max(changed, abs(work.v[i] - y[nq + i]) / size[i]), max(speed, abs(work.v[i]) / size[i])
    return changed <= MAX_TURN * speed


@kernel
def accept_step(t: float, y: Reals, slopes: Reals, problem: Integration) -> int:
    """Accept IDA's step to (t, y), or restart it from its beginning: it may have jumped to another branch."""
    memory, work, progress = problem.memory, problem.work, problem.memory.progress[0]
    memory.counts[STEPS] += 1.0
    code = close_state(t, y, progress.works == 1, problem)
    if code in (BRANCHES, UNDECIDABLE):
        return code
    if code != OK or not is_on_branch(y, problem):
        memory.counts[REJECTED_STEPS] += 1.0
        progress.max_next_step = RETRY_STEP_RATIO * progress.last_step
        return STEP_REJECTED
    longest = record_accepted(
        problem.eqs.loops, t, work.q, work.v, work.a, progress.last_step, progress.last_step, work.loops
    )
    progress.max_next_step, progress.t_reached = min(longest, 2.0 * progress.max_next_step), t
    work.refusal[0] = OK
    for i in range(y.shape[0]):
        memory.last_accepted[i] = y[i]
    if progress.energy_check == 1:
        fill_energy(t, problem)
    return OK


@kernel
def report_unknowns(problem: Integration, t: float, y: Reals) -> int:
    """Make IDA's unknowns y (N,) at t (s) the reported state; return a code, not OK: it stays."""
    work, nq = problem.work, problem.q.shape[0]
    for i in range(nq):
        work.q[i] = y[i]
    for i in range(work.v.shape[0]):
        work.v[i] = y[nq + i]
    code: int = project(problem.eqs.loops, t, work.q, work.v, CLOSED_RESIDUAL, work.loops)
    if code == OK:
        problem.memory.control[0].t = t
        for i in range(nq):
            problem.q[i] = work.q[i]
        for i in range(work.v.shape[0]):
            problem.v[i] = work.v[i]
    return code
