"""What IDA is given in dense form: callbacks with the signatures of C, and the function that accepts its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import kernel
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.inertia import tolerance_factor, update_growth
from solvers.linalg.dense import apply_Q, pivot_ratio
from solvers.outcome import BRANCHES, OK
from solvers.projection.branch import on_same_branch
from solvers.projection.singular import IMPERFECT, SINGULAR_PIVOT_RATIO, branch_step_limit, record_accepted
from solvers.projection.workspace import factor, factor_transposed
from solvers.system import Array

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
from .sundials import Callbacks, matrix_data, vector_data

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.energy_account import EnergyScales
    from solvers.projection.workspace import Workspace
    from solvers.steppers.ida.ggl import Unknowns
    from solvers.system import Equations

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


class UserData(NamedTuple):
    """What IDA's callbacks and its loop are given."""

    eqs: Any
    unknowns: Any
    work: Any
    rank: int
    n_unknowns: int  # N
    energy_record: NDArray[Any]
    scales: Any
    counts: Array
    progress: NDArray[Any]
    last_accepted: Array  # (2, N) IDA's unknowns after its last step, and their derivatives
    max_speed_loss: Array  # (1,) upper limit of unknowns.speed_loss
    rtol: float  # relative tolerance of IDA
    atol: Array  # (N,)


@kernel
def check_step(
    eqs: Equations, t: float, y: Reals, taken: float, rank: int, unknowns: Unknowns, work: Workspace
) -> float:
    """Longest next step after one of IDA's to (t, y), s; negative where the step may have jumped to another branch."""
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
def set_error_weights(y: Reals, out: Reals, user_data: UserData) -> None:
    """out (N,) <- one over the tolerances of the unknowns."""
    finer = tolerance_factor(user_data.rtol, RTOL_EXPONENT, user_data.work)
    for i in range(out.shape[0]):
        out[i] = 1.0 / (finer * (user_data.rtol * abs(y[i]) + user_data.atol[i]))


@kernel
def accept_step(t: float, y: Reals, slopes: Reals, user_data: UserData) -> int:
    """Accept IDA's step to (t, y), or restart it from its beginning."""
    progress, unknowns = user_data.progress[0], user_data.unknowns
    user_data.counts[STEPS] += 1.0
    if unknowns.lam.shape[0] > 0:
        bound = check_step(user_data.eqs, t, y, progress.last_step, user_data.rank, unknowns, user_data.work)
        if bound < 0.0:
            user_data.counts[REJECTED_STEPS] += 1.0
            progress.max_next_step = RETRY_STEP_RATIO * progress.last_step
            return STEP_REJECTED
        progress.max_next_step = min(bound, 2.0 * progress.max_next_step)
        if unknowns.speed_loss[0] > user_data.max_speed_loss[0]:
            return BRANCHES
    progress.t_reached = t
    for i in range(y.shape[0]):
        user_data.last_accepted[0, i], user_data.last_accepted[1, i] = y[i], slopes[i]
    for i in range(unknowns.v.shape[0]):
        unknowns.v[i] = velocity(i, t, y, unknowns)
    update_growth(t, user_data.eqs.terms.M, unknowns.v, user_data.work)  # M of Newton's last correction
    if progress.energy_check == 1:
        record_energy(
            user_data.eqs,
            t,
            y,
            slopes,
            progress.works == 1,
            unknowns,
            user_data.work,
            user_data.energy_record,
            user_data.scales,
        )
    return OK


def call_accept(t: float, y: Any, slopes: Any, user_data: Any) -> int:
    """As the loop calls it."""
    return accept_step(t, y, slopes, user_data)


def call_residual(t: float, y: Any, slopes: Any, out: Any, user_data: Any) -> int:
    """As IDA calls it, like those that follow."""
    n = user_data.n_unknowns
    y_, slopes_, out_ = array_at(vector_data(y), n), array_at(vector_data(slopes), n), array_at(vector_data(out), n)
    residual(user_data.eqs, t, y_, slopes_, out_, user_data.unknowns, user_data.work)
    return 0


def call_preconditioner_setup(t: float, y: Any, slopes: Any, _res: Any, _cj: float, user_data: Any) -> int:
    """Set up the preconditioner."""
    set_up_preconditioner(
        user_data.eqs,
        t,
        array_at(vector_data(y), user_data.n_unknowns),
        array_at(vector_data(slopes), user_data.n_unknowns),
        user_data.unknowns,
        user_data.work,
    )
    return 0


def call_preconditioner(
    t: float, y: Any, slopes: Any, _res: Any, right: Any, left: Any, cj: float, _delta: float, user_data: Any
) -> int:
    """Apply it."""
    n = user_data.n_unknowns
    y_, slopes_ = array_at(vector_data(y), n), array_at(vector_data(slopes), n)
    apply_preconditioner(
        user_data.eqs,
        t,
        y_,
        slopes_,
        array_at(vector_data(right), n),
        array_at(vector_data(left), n),
        cj,
        user_data.unknowns,
        user_data.work,
    )
    return 0


def call_error_weights(y: Any, out: Any, user_data: Any) -> int:
    """Weigh the unknowns."""
    set_error_weights(
        array_at(vector_data(y), user_data.n_unknowns), array_at(vector_data(out), user_data.n_unknowns), user_data
    )
    return 0


def call_matvec(
    _t: float, _y: Any, _slopes: Any, _res: Any, vector: Any, product: Any, _cj: float, user_data: Any, _a: Any, _b: Any
) -> int:
    """Multiply by the matrix."""
    matvec_passthrough(
        array_at(vector_data(vector), user_data.n_unknowns),
        array_at(vector_data(product), user_data.n_unknowns),
        user_data.unknowns,
    )
    return 0


def call_jacobian(
    t: float, cj: float, y: Any, slopes: Any, _res: Any, matrix: Any, user_data: Any, _a: Any, _b: Any, _c: Any
) -> int:
    """Fill the matrix, column by column."""
    n = user_data.n_unknowns
    set_up_preconditioner(
        user_data.eqs,
        t,
        array_at(vector_data(y), n),
        array_at(vector_data(slopes), n),
        user_data.unknowns,
        user_data.work,
    )
    assemble_matrix(user_data.eqs, user_data.unknowns, user_data.work, cj)
    out = array_at(matrix_data(matrix), n * n)
    for i in range(n):
        for j in range(n):
            out[j * n + i] = user_data.unknowns.matrix[i, j]
    return 0


# Old factors serve where nothing is near singular.
ITERATIVE_CALLBACKS = Callbacks(
    call_residual, call_preconditioner_setup, call_preconditioner, call_matvec, error_weights=call_error_weights
)
DENSE_CALLBACKS = Callbacks(call_residual, jacobian=call_jacobian, error_weights=call_error_weights)
