"""What IDA is given if constraints are eliminated: callbacks, and the function that accepts its steps.

The equations are in :mod:`.eliminated`. All kernels get the integration
(:class:`solvers.steppers.step_loop.Integration`) with the memory and the work of :mod:`.eliminated_memory`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.outcome import BRANCHES, NOT_CLOSED, NOT_FINITE, OK, UNDECIDABLE
from solvers.projection.eliminated import CLOSED_RESIDUAL, project
from solvers.projection.eliminated_crossing import record_accepted
from solvers.steppers.eliminated_newton import close_state, factor_tangent, is_on_branch, measure_inertia

from .dense_callbacks import RETRY_STEP_RATIO
from .loop import JACOBIANS, NONFINITE_RESIDUALS, REJECTED_STEPS, RESIDUALS, STEP_REJECTED, STEPS

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration


@kernel
def evaluate_residual(t: float, y: Reals, slopes: Reals, out: Reals, problem: Integration) -> None:
    """out (N,) <- residual of IDA; what is not finite IDA takes as a sign to cut the step."""
    work, counts, nq, rate = problem.work, problem.memory.counts, problem.q.shape[0], problem.settings[0].rate
    counts[RESIDUALS] += 1.0
    code = close_state(t, y, False, problem)
    if code != OK:
        counts[NONFINITE_RESIDUALS] += 1.0 if code == NOT_FINITE else 0.0
        if code in (BRANCHES, UNDECIDABLE, NOT_CLOSED):
            work.refusal[0] = code
        for i in range(out.shape[0]):
            out[i] = np.nan
        return
    for i in range(nq):
        out[i] = slopes[i] - work.qdot[i] + rate * (y[i] - work.q[i])
    for i in range(work.v.shape[0]):
        out[nq + i] = slopes[nq + i] - work.a[i] + rate * (y[nq + i] - work.v[i])


@kernel
def set_up_preconditioner(t: float, y: Reals, cj: float, problem: Integration) -> int:
    """Factor the tangent at y; 1: it is singular there."""
    problem.memory.counts[JACOBIANS] += 1.0
    if close_state(t, y, True, problem) != OK:
        return 1
    return 0 if factor_tangent(t, cj, problem) else 1


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
    work, rate = problem.work, problem.settings[0].rate
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
    measure_inertia(t, rate, problem)
    return OK


@kernel
def end_start(problem: Integration, t: float) -> None:
    """Record the start of a history at t (s)."""
    problem.memory.progress[0].works = problem.settings[0].works
    for i in range(problem.memory.last_accepted.shape[0]):
        problem.memory.last_accepted[i] = problem.memory.ida.y[i]
    if problem.memory.progress[0].energy_check == 1:
        fill_energy(t, problem)


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
    loops = problem.eqs.loops
    longest = min(longest, loops.longest_load_step(progress.last_step, loops.data))
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
