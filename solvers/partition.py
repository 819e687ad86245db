"""Projection partitioning: motion tangent to the constraints, through singular positions too.

With J^T = U diag(sigma) W^T (:func:`solvers.dense.decompose`) the first ``rank`` columns of U span the
constraint normals and the others, P, the motions the constraints allow::

    v' = J^+ gamma + P (P^T M P)^-1 P^T (-h - M J^+ gamma)       (projection, paper eq. 9-13)
    q <- q (+) -J^+ Phi,   v <- v - J^+ (J v - nu)               (Gauss-Newton, velocity correction)

M itself is never factored, so bodies without mass are fine while P^T M P is positive definite. ``rank`` is
the *normal rank*, the rank where the mechanism can move generically; rows that are redundant everywhere just
lie beyond it.

**Singular positions.** Where the singular value number ``rank`` is below ``SINGULAR`` times the first, J
loses rank and a second branch of the motion crosses. Truncating there is wrong by O(1) in v', not truncating
divides by zero. But the motion has a tangent e = v/|v| that is continuous, and with it v' has a limit. It is
taken from both sides along the branch, with regular accelerations only and v(s) = P P^T v + J^+ nu::

    v' = [4 (a(d) + a(-d)) - (a(2d) + a(-2d))] / 6 + O(d^4),   a(s) at q(s) = close(q (+) s e)

Without velocity there is no tangent: the branch cannot be decided.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .dense import decompose, least_norm, least_norm_transposed, solve_positive
from .kernel import inlined, kernel
from .system import Array

OK, NOT_CLOSED, NO_MASS, UNDECIDABLE, NOT_FINITE = 0, 1, 2, 3, 4

SINGULAR = 1e-3  # sigma[rank - 1] / sigma[0] below which the limit replaces the regular formula
AT_REST = 1e-9  # |v| below which there is no tangent; regular formulas still hold above UNRESOLVED
UNRESOLVED = 1e-7  # ratio below which nothing is left of the smallest singular value's digits after squaring
REACH = 1e-2  # d of the limit, in units of q
REDUNDANT = 1e-6  # ratio that tells a redundant constraint from a singular position nearby
PASSES = 12  # Gauss-Newton corrections of a position
CLOSED = 1e-7  # a correction this small is the last: the next one would be its square


class Workspace(NamedTuple):
    """Scratch of the partitions: allocated once, nothing in it outlives a call except the factors of the last J."""

    U: Array  # (n, n)  left factor of J^T: normals, then tangents
    sigma: Array  # (m,)    singular values of J, descending
    W: Array  # (m, m)  right factor of J^T
    A: Array  # (n, m)  scratch of the decomposition
    pivots: NDArray[np.int64]  # (m,)    of the decomposition, int64
    P: Array  # (n, n)  basis of the allowed motions, first n - rank columns
    S: Array  # (n, n)  P^T M P
    f: Array  # (n,)    force of unbalance
    z: Array  # (n,)    reduced acceleration
    b: Array  # (m,)    residual
    dq: Array  # (n,)    correction
    a: Array  # (n,)    acceleration at a neighbouring position
    slope: Array  # (n,)    acceleration under evaluation
    q: Array  # (nq,)   position under evaluation
    v: Array  # (n,)    velocity under evaluation
    q_near: Array  # (nq,)   neighbouring position
    v_near: Array  # (n,)    neighbouring velocity
    J_work: Array  # (m, n)  J being eliminated
    D: Array  # (m, m)  dependent columns of J, then their LU factors
    order: NDArray[np.int64]  # (m,)    row exchanges of D, int64
    x: Array  # (m,)    solution with D
    rows: NDArray[np.int64]  # (m,)    candidate choice of rows, int64
    columns: NDArray[np.int64]  # (n,)    candidate choice of coordinates, dependent ones first, int64

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Workspace:
        """Return zeroed scratch for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        z = np.zeros
        pivots, order, rows, columns = (np.zeros(size, np.int64) for size in (m, m, m, n))
        return Workspace(
            z((n, n)), z(m), z((m, m)), z((n, m)), pivots, z((n, n)), z((n, n)), z(n), z(n), z(m), z(n), z(n),
            z(n), z(nq), z(n), z(nq), z(n), z((m, n)), z((m, m)), order, z(m), rows, columns,
        )  # fmt: skip


@kernel
def factor(terms: Any, work: Any) -> None:
    """Decompose the Jacobian held by ``terms``."""
    m, n = terms.J.shape
    decompose(terms.J, m, n, work.A, work.pivots, work.U, work.sigma, work.W)


@kernel
def rank_at(sigma: Any, rank: int, tolerance: float) -> int:
    """How many of the first ``rank`` singular values exceed ``tolerance`` times the largest."""
    while rank > 0 and not sigma[rank - 1] > tolerance * sigma[0]:
        rank -= 1
    return rank


@kernel
def length(v: Any) -> float:
    """|v|."""
    square = 0.0
    for i in range(v.shape[0]):
        square += v[i] * v[i]
    return np.sqrt(square)


@kernel
def ratio(sigma: Any, rank: int) -> float:
    """Distance from singular positions: the singular value number ``rank`` relative to the first; 1 if
    unconstrained.
    """
    return sigma[rank - 1] / sigma[0] if rank > 0 else 1.0


@inlined
def position_off(terms: Any, rank: int, work: Any) -> float:
    """work.dq = -J^+ Phi with the factors at hand; return its largest entry.

    In the singular window the vanishing direction is left alone: it would be divided by nearly zero.
    """
    m, n = terms.J.shape
    least_norm(terms.Phi, m, n, rank_at(work.sigma, rank, SINGULAR), work.U, work.sigma, work.W, work.dq)
    largest = 0.0
    for i in range(n):
        work.dq[i] = -work.dq[i]
        largest = max(largest, abs(work.dq[i]))
    return largest


@kernel
def close_position(eqs: Any, t: float, q: Any, rank: int, work: Any) -> bool:
    """Bring q onto Phi(t, q) = 0 along the constraint normals, in place; False if it does not get there.

    Leaves Phi, J and nu at the result, and the factors of a J nearby.
    """
    eqs.position(t, q, eqs.data, eqs.terms)
    for _ in range(PASSES):
        factor(eqs.terms, work)
        largest = position_off(eqs.terms, rank, work)
        if not np.isfinite(largest):
            return False
        eqs.retract(q, work.dq, eqs.data)
        eqs.position(t, q, eqs.data, eqs.terms)
        if largest <= CLOSED:
            return True
    return False


@kernel
def close_velocity(v: Any, terms: Any, rank: int, work: Any) -> None:
    """Take from v what violates J v = nu, with the factored J, in place."""
    m, n = terms.J.shape
    for i in range(m):
        work.b[i] = -terms.nu[i]
        for j in range(n):
            work.b[i] += terms.J[i, j] * v[j]
    least_norm(work.b, m, n, rank_at(work.sigma, rank, SINGULAR), work.U, work.sigma, work.W, work.dq)
    for i in range(n):
        v[i] -= work.dq[i]


@kernel
def close(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any) -> int:
    """Bring (q, v) onto the constraints, in place; leave ``terms`` and the factors of J at the result."""
    if not close_position(eqs, t, q, rank, work):
        return NOT_CLOSED
    factor(eqs.terms, work)
    close_velocity(v, eqs.terms, rank, work)
    eqs.motion(t, q, v, eqs.data, eqs.terms)
    return OK


@kernel
def settle(eqs: Any, t: float, q: Any, v: Any, near: Any, rank: int, slight: float, work: Any) -> int:
    """As :func:`close`, where ``terms`` and the factors of J are those of the prediction ``near``.

    The constraints linearised there take q onto them but for the square of the distance. What is left by that stays
    where it is ``slight``; v' depends on it by the inverse square of the smallest singular value.
    """
    if q.shape[0] != v.shape[0]:  # the formulas keep no quaternion at unit length
        for i in range(v.shape[0]):
            work.dq[i] = 0.0
        eqs.retract(q, work.dq, eqs.data)
    if rank == 0:
        eqs.dynamics(t, q, v, eqs.data, eqs.terms)
        factor(eqs.terms, work)
        return OK
    if q.shape[0] == v.shape[0]:
        for i in range(eqs.terms.Phi.shape[0]):
            for j in range(v.shape[0]):
                eqs.terms.Phi[i] += eqs.terms.J[i, j] * (q[j] - near[j])
        position_off(eqs.terms, rank, work)
        eqs.retract(q, work.dq, eqs.data)
    eqs.position(t, q, eqs.data, eqs.terms)
    rest = position_off(eqs.terms, rank, work)
    if not rest <= slight * ratio(work.sigma, rank) ** 2:
        return close(eqs, t, q, v, rank, work)
    close_velocity(v, eqs.terms, rank, work)
    eqs.motion(t, q, v, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return OK


@kernel
def tangent_motion(terms: Any, freedom: int, work: Any, a: Any) -> bool:
    """a <- a + P z, where P^T (M a + h) = 0 and P is the first ``freedom`` columns of ``work.P``."""
    n = a.shape[0]
    for i in range(n):
        work.f[i] = -terms.h[i]
        for j in range(n):
            work.f[i] -= terms.M[i, j] * a[j]
    for k in range(freedom):
        work.z[k] = 0.0
        for i in range(n):
            work.z[k] += work.P[i, k] * work.f[i]
        for low in range(k + 1):
            work.S[k, low] = 0.0
        for i in range(n):
            row = 0.0
            for j in range(n):
                row += terms.M[i, j] * work.P[j, k]
            for low in range(k + 1):
                work.S[k, low] += work.P[i, low] * row
    if not solve_positive(work.S, freedom, work.z):
        return False
    for i in range(n):
        for k in range(freedom):
            a[i] += work.P[i, k] * work.z[k]
    return True


@kernel
def regular_acceleration(terms: Any, rank: int, work: Any, a: Any) -> int:
    """v' away from singular positions, from ``terms`` and the factors of their J."""
    m, n = terms.J.shape
    least_norm(terms.gamma, m, n, rank, work.U, work.sigma, work.W, a)
    for i in range(n):
        for k in range(n - rank):
            work.P[i, k] = work.U[i, rank + k]
    if not tangent_motion(terms, n - rank, work, a):
        return NO_MASS
    for i in range(n):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@kernel
def acceleration(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any, a: Any) -> int:
    """v' anywhere; ``terms`` and the factors of J belong to (t, q, v) and do so again afterwards."""
    n = v.shape[0]
    for i in range(n):
        if not np.isfinite(eqs.terms.h[i]):
            return NOT_FINITE
    if rank_at(work.sigma, rank, SINGULAR) == rank:
        return regular_acceleration(eqs.terms, rank, work, a)
    if not length(v) > AT_REST:
        resolved = rank_at(work.sigma, rank, UNRESOLVED) == rank
        return regular_acceleration(eqs.terms, rank, work, a) if resolved else UNDECIDABLE
    code = limit_acceleration(eqs, t, q, v, rank, work, a)
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return code


@kernel
def neighbour(eqs: Any, t: float, q: Any, v: Any, distance: float, rank: int, work: Any) -> int:
    """Closed state (work.q_near, work.v_near) at a signed ``distance`` from q along v, with its terms and factors."""
    speed = length(v)
    for i in range(q.shape[0]):
        work.q_near[i] = q[i]
    for i in range(v.shape[0]):
        work.dq[i] = distance * v[i] / speed
        work.v_near[i] = v[i]
    eqs.retract(work.q_near, work.dq, eqs.data)
    return close(eqs, t, work.q_near, work.v_near, rank, work)


@kernel
def limit_acceleration(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any, a: Any) -> int:
    """v' at a singular position, by extrapolation along the tangent from both sides (module docstring)."""
    for i in range(v.shape[0]):
        a[i] = 0.0
    for far in range(1, 3):
        weight = 4.0 / 6.0 if far == 1 else -1.0 / 6.0
        for side in range(-1, 2, 2):
            code = neighbour(eqs, t, q, v, side * far * REACH, rank, work)
            if code == OK:
                code = regular_acceleration(eqs.terms, rank, work, work.a)
            if code != OK:
                return code
            for i in range(v.shape[0]):
                a[i] += weight * work.a[i]
    return OK


@kernel
def close_report(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any) -> int:
    """As :func:`close`; in a singular position the velocity across the branch is removed too, by the same limit.

    For states from a solver that does not control that component well (IDA's regularisation leaves it free).
    """
    code = close(eqs, t, q, v, rank, work)
    if code != OK or rank_at(work.sigma, rank, SINGULAR) == rank or length(v) <= AT_REST:
        return code
    for i in range(v.shape[0]):
        work.a[i] = 0.0
    for far in range(1, 3):
        weight = 4.0 / 6.0 if far == 1 else -1.0 / 6.0
        for side in range(-1, 2, 2):
            if neighbour(eqs, t, q, v, side * far * REACH, rank, work) != OK:
                return NOT_CLOSED
            for i in range(v.shape[0]):
                work.a[i] += weight * work.v_near[i]
    for i in range(v.shape[0]):
        v[i] = work.a[i]
    return OK


@kernel
def multipliers(terms: Any, rank: int, work: Any, a: Any, lam: Any) -> None:
    """Shortest lambda with J^T lambda = -(M a + h), from ``terms`` and the factors of their J."""
    m, n = terms.J.shape
    for i in range(n):
        work.f[i] = -terms.h[i]
        for j in range(n):
            work.f[i] -= terms.M[i, j] * a[j]
    least_norm_transposed(work.f, m, n, rank_at(work.sigma, rank, SINGULAR), work.U, work.sigma, work.W, lam)


@kernel
def evaluate(eqs: Any, t: float, q: Any, v: Any, rank: int, work: Any, a: Any, lam: Any) -> int:
    """Accelerations and shortest multipliers at a closed state; leaves ``terms`` there."""
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    code = acceleration(eqs, t, q, v, rank, work, a)
    if code == OK:
        multipliers(eqs.terms, rank, work, a, lam)
    return code


@kernel
def normal_rank(eqs: Any, t: float, q: Any, v: Any, work: Any) -> int:
    """Largest rank of J at q and at neighbours a finite move away, along v and along every allowed motion.

    A start in a singular position has a smaller rank than the motion that leaves it; constraints that are
    redundant everywhere on the way do not count. The neighbours are closed first: off the constraints
    redundancy is hidden.
    """
    m, n = eqs.terms.J.shape
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    here = rank_at(work.sigma, min(m, n), REDUNDANT)
    best = here
    for i in range(n):
        for k in range(n):
            work.P[i, k] = work.U[i, k]
    for k in range(here, n + 1):
        for i in range(n):
            work.v_near[i] = work.P[i, k] if k < n else v[i]
        best = max(best, rank_beside(eqs, t, q, work.v_near, work))
    return best


@kernel
def rank_beside(eqs: Any, t: float, q: Any, e: Any, work: Any) -> int:
    """Rank of J after a small closed move from q along e; zero where there is none."""
    m, n = eqs.terms.J.shape
    size = length(e)
    if not size > AT_REST:
        return 0
    for i in range(q.shape[0]):
        work.q_near[i] = q[i]
    for i in range(n):
        work.dq[i] = 5.0 * REACH * e[i] / size
    eqs.retract(work.q_near, work.dq, eqs.data)
    if not close_position(eqs, t, work.q_near, min(m, n), work):
        return 0
    eqs.position(t, work.q_near, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return rank_at(work.sigma, min(m, n), REDUNDANT)
