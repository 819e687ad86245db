"""LU partitioning (Wehage, Haug 1982): dependent and independent coordinates by Gauss elimination of J.

Full pivoting of J (m, n) picks ``rank`` dependent coordinates d; only the others, i, are integrated::

    Newton on Phi for q_d with q_i held,   v_d = J_d^-1 (nu - J_i v_i)
    P = [-J_d^-1 J_i; I],   v' = [J_d^-1 gamma; 0] + P z',   P^T (M v' + h) = 0

The paper starts Newton from the dependents of the last accepted step. The choice is repeated at a corrector when the
step has shrunk or has stayed equal for five steps; a changed choice restarts the paper's integrator, whose history is
that of the independents: 'adams-lu'. The hybrid has the history of all coordinates and needs no restart. It evaluates
first where the prediction lies, and closes the corrected position with the factors of that, as projection does.

**Why it fails.** Near a singular configuration the correct root and a root on the crossing branch are about
2 |sigma_m / sigma_1| apart. The start value has an error of h |v|: once the step is longer than that distance
Newton finds the other branch (the energy jumps), or J_d is so near singular that no step is short enough (the
step collapses), while the largest pivot changes place all the time (each time the order falls to one). The
projection partition has none of this because it predicts every coordinate. Where an orientation is a unit
quaternion coordinates of q and of v do not correspond, so dependents start from their predicted
values there and the method is better than its name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import factor_full_pivot, factor_lu, solve_lu, solve_lu_transposed
from solvers.outcome import NO_MASS, NOT_CLOSED, NOT_FINITE, OK
from solvers.positions import has_quaternions

from .projection import (
    CHORD_CONTRACTION_LIMIT,
    CORRECTION_ROUNDING,
    MAX_PROJECTION_CORRECTIONS,
    add_tangent_acceleration,
    violates_constraints,
)
from .workspace import count_freedom, count_motions

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

ZERO_PIVOT_RATIO = 1e-12  # pivots this small relative to the first are zero
MIN_PIVOT_IMPROVEMENT = 3.0  # how many times larger its smallest pivot makes another choice worth a change


@kernel
def choose_partition(terms: Terms, rank: int, work: Workspace) -> bool:
    """Pivot the Jacobian held by ``terms``: fill ``work.rows`` and ``work.columns``; False below the normal rank."""
    m, n = terms.J.shape
    for i in range(m):
        for j in range(n):
            work.J_work[i, j] = terms.J[i, j] * (work.size[j] / work.row[i])
    return factor_full_pivot(work.J_work, m, n, ZERO_PIVOT_RATIO, work.rows, work.columns) >= rank


@kernel
def is_better_partition(rank: int, work: Workspace) -> bool:
    """Whether what :func:`choose_partition` has just found is worth changing for from the choice whose J_d is factored.

    Bodies that are alike give choices that are alike, which one is the best then changes by next to nothing.
    """
    least, first = np.inf, abs(work.J_work[work.rows[0], work.columns[0]])
    for k in range(rank):
        least = min(least, abs(work.J_work[work.rows[k], work.columns[k]]))
    return least > MIN_PIVOT_IMPROVEMENT * smallest_pivot_ratio(rank, work) * first


@kernel
def is_same_partition(rank: int, columns: Integers, others: Integers) -> bool:
    """Whether both permutations start with the same set of ``rank`` rows or coordinates."""
    for i in range(rank):
        found = False
        for j in range(rank):
            found = found or columns[i] == others[j]
        if not found:
            return False
    return True


@kernel
def factor_dependent(terms: Terms, rank: int, rows: Integers, columns: Integers, work: Workspace) -> bool:
    """Factor J_d, the chosen rows and dependent columns of the Jacobian held by ``terms``, in units of both."""
    for i in range(rank):
        for j in range(rank):
            work.D[i, j] = terms.J[rows[i], columns[j]] * (work.size[columns[j]] / work.row[rows[i]])
    return factor_lu(work.D, rank, work.order)


@inlined
def solve_dependent(rank: int, rows: Integers, columns: Integers, work: Workspace) -> None:
    """work.x (rank,) = J_d^-1 work.b, with the factors of J_d; ``work.b`` is used up."""
    for i in range(rank):
        work.b[i] /= work.row[rows[i]]
    solve_lu(work.D, rank, work.order, work.b, work.x)
    for j in range(rank):
        work.x[j] *= work.size[columns[j]]


@kernel
def restore_dependents(rank: int, columns: Integers, last: Reals, q: Reals, v: Reals, states: Integers) -> None:
    """Set the dependents of q to those of ``last`` if the coordinates of q and v correspond."""
    if not has_quaternions(q.shape[0], v.shape[0], states):
        for j in range(rank):
            q[columns[j]] = last[columns[j]]


@kernel
def project_dependents(
    eqs: Equations,
    t: float,
    q: Reals,
    v: Reals,
    rank: int,
    rows: Integers,
    columns: Integers,
    factored: bool,
    work: Workspace,
) -> int:
    """Solve the dependents of (q, v) from the independents, in place; leave ``terms`` and J_d at the result.

    ``factored``: the factors at hand are those of a J_d nearby.
    """
    if not solve_dependent_positions(eqs, t, q, rank, rows, columns, factored, work) or violates_constraints(
        eqs.terms, work
    ):
        return NOT_CLOSED
    if not factor_dependent(eqs.terms, rank, rows, columns, work):
        return NOT_CLOSED
    for i in range(rank):
        work.b[i] = eqs.terms.nu[rows[i]]
        for k in range(rank, v.shape[0]):
            work.b[i] -= eqs.terms.J[rows[i], columns[k]] * v[columns[k]]
    solve_dependent(rank, rows, columns, work)
    for j in range(rank):
        v[columns[j]] = work.x[j]
    eqs.motion(t, q, v, eqs.data, eqs.terms)
    return OK


@kernel
def solve_dependent_positions(
    eqs: Equations, t: float, q: Reals, rank: int, rows: Integers, columns: Integers, factored: bool, work: Workspace
) -> bool:
    """Newton on Phi(t, q) = 0 for the dependent positions; False if it does not converge. ``terms`` follow.

    Factors of a J_d nearby serve as long as each correction is a small part of the one before.
    """
    for i in range(work.dq.shape[0]):
        work.dq[i] = 0.0
    eqs.position(t, q, eqs.data, eqs.terms)
    before = 1.0
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        if not factored and not factor_dependent(eqs.terms, rank, rows, columns, work):
            return False
        for i in range(rank):
            work.b[i] = -eqs.terms.Phi[rows[i]]
        solve_dependent(rank, rows, columns, work)
        largest = 0.0
        for j in range(rank):
            work.dq[columns[j]] = work.x[j]
            largest = max(largest, abs(work.x[j]) / work.size[columns[j]])
        if factored and not largest <= CHORD_CONTRACTION_LIMIT * before:
            factored = False
            continue
        if not np.isfinite(largest):
            return False
        eqs.retract(q, work.dq, eqs.data)
        eqs.position(t, q, eqs.data, eqs.terms)
        if largest * (largest / before) <= CORRECTION_ROUNDING:
            return True
        before = largest if factored else 1.0
    return False


@kernel
def fill_dependent_tangents(terms: Terms, rank: int, rows: Integers, columns: Integers, work: Workspace) -> None:
    """Fill the first rows of ``work.T`` with the motions of one independent each, from ``terms`` and J_d's factors.

    No pivot is in the column of a first-order state: these are the last of the independents, and have no row.
    """
    n = work.T.shape[1]
    for k in range(count_freedom(rank, work)):
        for i in range(rank):
            work.b[i] = -terms.J[rows[i], columns[rank + k]]
        solve_dependent(rank, rows, columns, work)
        for j in range(rank):
            work.T[k, columns[j]] = work.x[j]
        for other in range(n - rank):
            work.T[k, columns[rank + other]] = 1.0 if other == k else 0.0


@kernel
def evaluate_dependent_acceleration(
    terms: Terms, rank: int, rows: Integers, columns: Integers, work: Workspace, a: Reals
) -> int:
    """v' from ``terms`` and the factors of their J_d."""
    n = a.shape[0]
    fill_dependent_tangents(terms, rank, rows, columns, work)
    for k in range(n - rank):
        a[columns[rank + k]] = 0.0
    for i in range(rank):
        work.b[i] = terms.gamma[rows[i]]
    solve_dependent(rank, rows, columns, work)
    for j in range(rank):
        a[columns[j]] = work.x[j]
    if not add_tangent_acceleration(terms, rank, work, a):
        return NO_MASS
    for i in range(n):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@kernel
def have_tangents_turned(rank: int, before: Reals, work: Workspace) -> bool:
    """Whether a motion of one independent has changed by more than half of what it was ``before``."""
    n = work.T.shape[1]
    for k in range(count_freedom(rank, work)):
        change, size = 0.0, 0.0
        for i in range(n):
            change += ((work.T[k, i] - before[k, i]) / work.size[i]) ** 2
            size += (before[k, i] / work.size[i]) ** 2
        if not change <= 0.25 * size:
            return True
    return False


@kernel
def smallest_pivot_ratio(rank: int, work: Workspace) -> float:
    """Smallest pivot of J_d relative to the largest: approximate distance of a singular configuration."""
    low, high = np.inf, 0.0
    for i in range(rank):
        low, high = min(low, abs(work.D[i, i])), max(high, abs(work.D[i, i]))
    return low / high if rank > 0 else 1.0


@kernel
def evaluate_dependent_multipliers(
    terms: Terms, rank: int, rows: Integers, columns: Integers, work: Workspace, a: Reals, lam: Reals
) -> None:
    """lambda of the chosen rows, zero in others, with J_d^T lambda = -(M a + h)_d, from ``terms`` and J_d's factors."""
    for j in range(rank):
        k = columns[j]
        work.b[j] = -terms.h[k]
        for i in range(count_motions(work)):
            work.b[j] -= terms.M[k, i] * a[i]
        work.b[j] *= work.size[k]
    solve_lu_transposed(work.D, rank, work.order, work.b, work.x)
    for i in range(lam.shape[0]):
        lam[i] = 0.0
    for i in range(rank):
        lam[rows[i]] = work.x[i] / work.row[rows[i]]
