"""What IDA is given in dense form: callbacks, and the function that accepts its steps.

All get the integration: :class:`solvers.steppers.step_loop.Integration` with the memory of :mod:`.dense_memory`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.inertia import tolerance_factor, update_growth
from solvers.linalg.dense import apply_Q, pivot_ratio
from solvers.outcome import BRANCHES, OK
from solvers.projection.branch import on_same_branch
from solvers.projection.projection import RESIDUAL_TOLERANCE
from solvers.projection.singular import IMPERFECT, SINGULAR_PIVOT_RATIO, branch_step_limit, record_accepted
from solvers.projection.workspace import factor, factor_transposed

from .ggl import (
    POSITION_REGULARIZATION,
    apply_preconditioner,
    assemble_matrix,
    filter_speed_loss,
    matvec_passthrough,
    residual,
    self_stress_residual,
    set_up_preconditioner,
    velocity,
)
from .loop import REJECTED_STEPS, STEP_REJECTED, STEPS

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.energy_account import EnergyScales
    from solvers.projection.workspace import Workspace
    from solvers.steppers.ida.ggl import Unknowns
    from solvers.steppers.step_loop import Integration
    from solvers.system import Equations, Terms

RTOL_EXPONENT = 1.2  # of a motion's tolerance: IDA bounds the error of a step, see solvers.steppers.ida.dense
WEAK_RESIDUAL_RATIO = 0.2  # part of a near miss's gap: bound of the residual of a step near it
NEAR_MISS_REGULARIZATION = 1e-4  # of D near a near miss, where only redundant constraints need it
RETRY_STEP_RATIO = 0.25  # next step after a rejected one, in units of that


@kernel
def record_energy(
    eqs: Equations,
    t: float,
    y: Reals,
    yp: Reals,
    works: bool,
    unknowns: Unknowns,
    work: Workspace,
    energy_record: Any,
    scales: EnergyScales,
) -> None:
    """Record the energy after a step of IDA to (t, y, yp); see :mod:`solvers.energy_account`."""
    record, nq, n, power = energy_record[0], unknowns.q.shape[0], unknowns.v.shape[0], 0.0
    unknowns.evaluated_at[0] = np.nan  # the terms move
    for i in range(nq):
        unknowns.q[i] = y[i]
    for i in range(n):
        unknowns.v[i], unknowns.a[i] = velocity(i, t, y, unknowns), yp[nq + i] + unknowns.velocity_shift[1, i]
    if works or energy_check_scheduled(record):
        eqs.dynamics(t, unknowns.q, unknowns.v, eqs.data, eqs.terms)
    if energy_check_scheduled(record):
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, record, scales)
    if works:
        for row in range(unknowns.lam.shape[0]):
            unknowns.lam[row] = y[nq + n + row] / work.row[row]
        power = eqs.power(t, unknowns.q, unknowns.v, unknowns.a, unknowns.lam, eqs.data)
    record_step(energy_record, t, power)


@kernel
def project_redundant(rank: int, unknowns: Unknowns, work: Workspace) -> None:
    """unknowns.P = projection onto the left null space of J~, from its factors."""
    m = unknowns.P.shape[0]
    factor_transposed(m, rank, work)
    for i in range(m):
        for j in range(m):
            unknowns.P[i, j] = 0.0
    for k in range(rank, m):
        for i in range(m):
            work.x[i] = 1.0 if i == k else 0.0
        apply_Q(work.B, work.tau_B, rank, m, work.x)
        for i in range(m):
            for j in range(m):
                unknowns.P[i, j] += work.x[i] * work.x[j]


@inlined
def is_contradicted(terms: Terms, rtol: float, unknowns: Unknowns, work: Workspace) -> bool:
    """Whether redundant combinations P Phi of the constraint equations have a residual above the tolerance.

    IDA's regularization leaves it where constraints contradict each other.
    """
    for row in range(terms.Phi.shape[0]):
        total = 0.0
        for other in range(terms.Phi.shape[0]):
            total += unknowns.P[row, other] * terms.Phi[other] / work.row[other]
        if not abs(total) <= max(RESIDUAL_TOLERANCE, rtol):
            return True
    return False


@kernel
def check_step(
    eqs: Equations, t: float, y: Reals, taken: float, rank: int, rtol: float, unknowns: Unknowns, work: Workspace
) -> float:
    """Longest next step after one of IDA's to (t, y), s; negative where the step may have jumped to another branch, or
    constraints contradict each other.
    """
    for i in range(unknowns.q.shape[0]):
        unknowns.q[i] = y[i]
    for i in range(unknowns.v.shape[0]):
        unknowns.v[i] = velocity(i, t, y, unknowns)
    eqs.position(t, unknowns.q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    for row in range(unknowns.lam.shape[0]):
        unknowns.lam[row] = y[unknowns.q.shape[0] + unknowns.v.shape[0] + row] / work.row[row]
    if not on_same_branch(eqs, t, unknowns.q, unknowns.branch_distance[0], rank, work):
        return -1.0
    if rank < unknowns.P.shape[0] and is_contradicted(eqs.terms, rtol, unknowns, work):
        return -1.0
    unknowns.speed_loss[0] += filter_speed_loss(taken, eqs.terms, unknowns, work)
    if pivot_ratio(work.pivot, rank) >= SINGULAR_PIVOT_RATIO:
        unknowns.speed_loss[0] = 0.0
    record_accepted(eqs, t, unknowns.q, taken, taken, rank, work)
    if rank < unknowns.P.shape[0] and (
        pivot_ratio(work.pivot, rank) >= SINGULAR_PIVOT_RATIO or work.critical[0].kind == IMPERFECT
    ):
        project_redundant(rank, unknowns, work)
    unknowns.evaluated_at[0] = np.nan  # the terms have moved
    bound = branch_step_limit(t, unknowns.q, unknowns.v, taken, eqs.terms, work)
    unknowns.d[0], unknowns.d[1] = unknowns.d_default[0], unknowns.d_default[1]
    if work.critical[0].kind == IMPERFECT:
        unknowns.d[0] = NEAR_MISS_REGULARIZATION * unknowns.d_default[0] if rank < eqs.terms.J.shape[0] else 0.0
        unknowns.d[1] *= min(1.0, bound * work.rate[0] / POSITION_REGULARIZATION)
        if not abs(self_stress_residual(eqs.terms, work)) <= WEAK_RESIDUAL_RATIO * abs(
            work.critical[0].bifurcation_gap
        ):
            return -1.0
    return bound


@kernel
def set_error_weights(y: Reals, out: Reals, problem: Integration) -> None:
    """out (N,) <- one over the tolerances of the unknowns."""
    rtol, atol = problem.settings[0].rtol, problem.memory.ida.atol
    finer = tolerance_factor(rtol, RTOL_EXPONENT, problem.work)
    for i in range(out.shape[0]):
        out[i] = 1.0 / (finer * (rtol * abs(y[i]) + atol[i]))


@kernel
def accept_step(t: float, y: Reals, slopes: Reals, problem: Integration) -> int:
    """Accept IDA's step to (t, y), or restart it from its beginning."""
    memory, work = problem.memory, problem.work
    progress, unknowns = memory.progress[0], memory.unknowns
    memory.counts[STEPS] += 1.0
    longest = problem.eqs.longest_load_step(progress.last_step, problem.eqs.data)
    if unknowns.lam.shape[0] > 0:
        bound = check_step(
            problem.eqs, t, y, progress.last_step, memory.control[0].rank, problem.settings[0].rtol, unknowns, work
        )
        if bound < 0.0:
            memory.counts[REJECTED_STEPS] += 1.0
            progress.max_next_step = RETRY_STEP_RATIO * progress.last_step
            return STEP_REJECTED
        longest = min(bound, longest, 2.0 * progress.max_next_step)
        if unknowns.speed_loss[0] > problem.settings[0].max_speed_loss:
            return BRANCHES
    progress.t_reached, progress.max_next_step = t, longest
    for i in range(y.shape[0]):
        memory.last_accepted[0, i], memory.last_accepted[1, i] = y[i], slopes[i]
    for i in range(unknowns.v.shape[0]):
        unknowns.v[i] = velocity(i, t, y, unknowns)
    update_growth(t, problem.eqs.terms.M, unknowns.v, work)  # M of Newton's last correction
    if progress.energy_check == 1:
        record_energy(
            problem.eqs, t, y, slopes, progress.works == 1, unknowns, work, memory.energy_record, problem.scales
        )
    return OK


@kernel
def evaluate_residual_at(t: float, y: Reals, slopes: Reals, out: Reals, problem: Integration) -> None:
    """out (N,) <- residual of IDA."""
    residual(problem.eqs, t, y, slopes, out, problem.memory.unknowns, problem.work)


@kernel
def set_up_preconditioner_at(t: float, y: Reals, slopes: Reals, problem: Integration) -> None:
    """Set up the preconditioner."""
    set_up_preconditioner(problem.eqs, t, y, slopes, problem.memory.unknowns, problem.work)


@kernel
def apply_preconditioner_at(
    t: float, y: Reals, slopes: Reals, right: Reals, left: Reals, cj: float, problem: Integration
) -> None:
    """left (N,) <- the solution for ``right``."""
    apply_preconditioner(problem.eqs, t, y, slopes, right, left, cj, problem.memory.unknowns, problem.work)


@kernel
def multiply_matrix(x: Reals, product: Reals, problem: Integration) -> None:
    """product (N,) <- the product of Newton's matrix and x (N,), for the preconditioner to undo."""
    matvec_passthrough(x, product, problem.memory.unknowns)


@kernel
def evaluate_jacobian_at(t: float, cj: float, y: Reals, slopes: Reals, out: Reals, problem: Integration) -> None:
    """Fill Newton's matrix column by column, out (N N,)."""
    unknowns, n = problem.memory.unknowns, y.shape[0]
    set_up_preconditioner(problem.eqs, t, y, slopes, unknowns, problem.work)
    assemble_matrix(problem.eqs, unknowns, problem.work, cj)
    for i in range(n):
        for j in range(n):
            out[j * n + i] = unknowns.matrix[i, j]
