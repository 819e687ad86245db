"""What IDA is given of a small mechanism: its callbacks in C's form, and what looks over its steps."""

from __future__ import annotations

from typing import Any, NamedTuple

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

from .ggl import MU, assemble, multiply, residual, set_up, solve, taken_by_filter, velocity, weak_residual
from .loop import REJECTED_STEPS, STEP_REJECTED, STEPS
from .sundials import Callbacks, data_of, data_of_matrix

RTOL_EXPONENT = 1.2  # of a motion's tolerance: IDA bounds the error of a step, see solvers.steppers.ida.dense
WEAK_RESIDUAL_RATIO = 0.2  # part of a near miss's gap: bound of the residual of a step near it
NEAR_MISS_REGULARIZATION = 1e-4  # of D near a near miss, where only redundant constraints need it
RETRY_STEP_RATIO = 0.25  # of a step that was taken back may be gone at once


@kernel
def book(eqs: Any, t: float, y: Any, yp: Any, works: bool, u: Any, work: Any, books: Any, scales: Any) -> None:
    """Book a step of IDA's to (t, y, yp); see :mod:`solvers.energy_account`."""
    c, nq, n, power = books[0], u.q.shape[0], u.v.shape[0], 0.0
    u.at[0] = np.nan  # the terms move
    for i in range(nq):
        u.q[i] = y[i]
    for i in range(n):
        u.v[i], u.a[i] = velocity(i, t, y, u), yp[nq + i] + u.lift[1, i]
    if works or energy_check_scheduled(c):
        eqs.dynamics(t, u.q, u.v, eqs.data, eqs.terms)
    if energy_check_scheduled(c):
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, c, scales)
    if works:
        for row in range(u.lam.shape[0]):
            u.lam[row] = y[nq + n + row] / work.row[row]
        power = eqs.power(t, u.q, u.v, u.a, u.lam, eqs.data)
    record_step(books, t, power)


@kernel
def project_redundant(rank: int, u: Any, work: Any) -> None:
    """u.P = projection onto the left null space of J~, from its factors."""
    m = u.P.shape[0]
    factor_transposed(m, rank, work)
    for i in range(m):
        for j in range(m):
            u.P[i, j] = 0.0
    for k in range(rank, m):
        for i in range(m):
            work.x[i] = 1.0 if i == k else 0.0
        apply_Q(work.B, work.tau_B, rank, m, work.x)
        for i in range(m):
            for j in range(m):
                u.P[i, j] += work.x[i] * work.x[j]


class Given(NamedTuple):
    """What IDA's callbacks and its loop are given."""

    eqs: Any
    u: Any
    work: Any
    rank: int
    unknowns: int  # N
    book: NDArray[Any]
    scales: Any
    counts: Array
    course: NDArray[Any]
    good: Array  # (2, N) IDA's unknowns after its last step, and their derivatives
    loss: Array  # (1,) what u.lost may be
    rtol: float  # relative tolerance of IDA
    atol: Array  # (N,)


@kernel
def look_over(eqs: Any, t: float, y: Any, taken: float, rank: int, u: Any, work: Any) -> float:
    """Longest next step after one of IDA's to (t, y), s; negative where the step may have jumped to another branch."""
    for i in range(u.q.shape[0]):
        u.q[i] = y[i]
    for i in range(u.v.shape[0]):
        u.v[i] = velocity(i, t, y, u)
    eqs.position(t, u.q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    for row in range(u.lam.shape[0]):
        u.lam[row] = y[u.q.shape[0] + u.v.shape[0] + row] / work.row[row]
    if not on_same_branch(eqs, t, u.q, u.near[0], rank, work):
        return -1.0
    u.lost[0] += taken_by_filter(taken, eqs.terms, u, work)
    if pivot_ratio(work.pivot, rank) >= SINGULAR_PIVOT_RATIO:
        u.lost[0] = 0.0
    record_accepted(eqs, t, u.q, taken, taken, rank, work)
    if rank < u.P.shape[0] and (
        pivot_ratio(work.pivot, rank) >= SINGULAR_PIVOT_RATIO or work.critical[0].kind == IMPERFECT
    ):
        project_redundant(rank, u, work)
    u.at[0] = np.nan  # the terms have moved
    bound = branch_step_limit(t, u.q, u.v, taken, eqs.terms, work)
    u.d[0], u.d[1] = u.usual[0], u.usual[1]
    if work.critical[0].kind == IMPERFECT:
        u.d[0] = NEAR_MISS_REGULARIZATION * u.usual[0] if rank < eqs.terms.J.shape[0] else 0.0
        u.d[1] *= min(1.0, bound * work.rate[0] / MU)
        if not abs(weak_residual(eqs.terms, work)) <= WEAK_RESIDUAL_RATIO * abs(work.critical[0].bifurcation_gap):
            return -1.0
    return bound


@kernel
def weigh(y: Any, out: Any, g: Any) -> None:
    """out (N,) <- one over the tolerances of the unknowns."""
    finer = tolerance_factor(g.rtol, RTOL_EXPONENT, g.work)
    for i in range(out.shape[0]):
        out[i] = 1.0 / (finer * (g.rtol * abs(y[i]) + g.atol[i]))


@kernel
def accept(t: float, y: Any, slopes: Any, g: Any) -> int:
    """Accept IDA's step to (t, y), or restart it from its beginning."""
    c, u = g.course[0], g.u
    g.counts[STEPS] += 1.0
    if u.lam.shape[0] > 0:
        bound = look_over(g.eqs, t, y, c.taken, g.rank, u, g.work)
        if bound < 0.0:
            g.counts[REJECTED_STEPS] += 1.0
            c.reach = RETRY_STEP_RATIO * c.taken
            return STEP_REJECTED
        c.reach = min(bound, 2.0 * c.reach)
        if u.lost[0] > g.loss[0]:
            return BRANCHES
    c.passed = t
    for i in range(y.shape[0]):
        g.good[0, i], g.good[1, i] = y[i], slopes[i]
    for i in range(u.v.shape[0]):
        u.v[i] = velocity(i, t, y, u)
    update_growth(t, g.eqs.terms.M, u.v, g.work)  # M of Newton's last correction
    if c.energy_check == 1:
        book(g.eqs, t, y, slopes, c.works == 1, u, g.work, g.book, g.scales)
    return OK


def call_accept(t: float, y: Any, slopes: Any, g: Any) -> int:
    """As the loop calls it."""
    return accept(t, y, slopes, g)


def call_residual(t: float, y: Any, slopes: Any, out: Any, g: Any) -> int:
    """As IDA calls it, like those that follow."""
    n = g.unknowns
    y_, slopes_, out_ = array_at(data_of(y), n), array_at(data_of(slopes), n), array_at(data_of(out), n)
    residual(g.eqs, t, y_, slopes_, out_, g.u, g.work)
    return 0


def call_set_up(t: float, y: Any, slopes: Any, _res: Any, _cj: float, g: Any) -> int:
    """Set up the preconditioner."""
    set_up(g.eqs, t, array_at(data_of(y), g.unknowns), array_at(data_of(slopes), g.unknowns), g.u, g.work)
    return 0


def call_solve(
    t: float, y: Any, slopes: Any, _res: Any, right: Any, left: Any, cj: float, _delta: float, g: Any
) -> int:
    """Apply it."""
    n = g.unknowns
    y_, slopes_ = array_at(data_of(y), n), array_at(data_of(slopes), n)
    solve(g.eqs, t, y_, slopes_, array_at(data_of(right), n), array_at(data_of(left), n), cj, g.u, g.work)
    return 0


def call_weigh(y: Any, out: Any, g: Any) -> int:
    """Weigh the unknowns."""
    weigh(array_at(data_of(y), g.unknowns), array_at(data_of(out), g.unknowns), g)
    return 0


def call_multiply(
    _t: float, _y: Any, _slopes: Any, _res: Any, vector: Any, product: Any, _cj: float, g: Any, _a: Any, _b: Any
) -> int:
    """Multiply by the matrix."""
    multiply(array_at(data_of(vector), g.unknowns), array_at(data_of(product), g.unknowns), g.u)
    return 0


def call_matrix(
    t: float, cj: float, y: Any, slopes: Any, _res: Any, matrix: Any, g: Any, _a: Any, _b: Any, _c: Any
) -> int:
    """Fill the matrix, column by column."""
    n = g.unknowns
    set_up(g.eqs, t, array_at(data_of(y), n), array_at(data_of(slopes), n), g.u, g.work)
    assemble(g.eqs, g.u, g.work, cj)
    out = array_at(data_of_matrix(matrix), n * n)
    for i in range(n):
        for j in range(n):
            out[j * n + i] = g.u.matrix[i, j]
    return 0


# Old factors serve where nothing is near singular.
ITERATIVE_CALLBACKS = Callbacks(call_residual, call_set_up, call_solve, call_multiply, weigh=call_weigh)
DENSE_CALLBACKS = Callbacks(call_residual, matrix=call_matrix, weigh=call_weigh)
