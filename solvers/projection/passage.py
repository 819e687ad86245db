"""Which constraint equations keep their rank in a step, and how it has passed a critical point in which k lose it.

U (k rows of forces) is the left null space of J~ in the critical point, Z its null space: the tangents of all branches.

    B(q) = U^T J~(q) Z        (k, k + degrees of freedom)

is zero in the critical point and, to first order, linear in the distance from it. Along a motion that passes straight
through, B after the point is -c times B before it, c > 0; on the same side of the point it is +c times. If a loop has
changed to another branch, its rows of B have another direction, or, where branches differ little, the sign of those on
the same side. Everything is measured in the rows of B before the point, made orthonormal, so that one loop among many
counts as much as a single one. A motion along the set of critical points does not change B, so the test also holds for
more degrees of freedom.

The other equations must keep their rank and their direction. Let L Q^T be the factors of their J~ in one position and
L X Q^T its part in the same directions in another one, so that X is the identity at first. On the straight line between
the two an equation can lose its rank only where (1 - s) I + s X, 0 <= s <= 1, is singular, and that is excluded in
every subspace in which the symmetric part of X is positive definite: this is what is counted. Their direction is kept
if their tangents turn little.

The sign of a determinant cannot decide this: it changes by (-1)^k, and if branches meet at small angles the tangents
hardly turn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import apply_Qt, count_positive_pivots, factor_lq, factor_lu, rank_at, solve_lu

from .orientation import SMALL_ROTATION_TANGENT

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

OTHER_BRANCH, OPPOSITE_SIDE, SAME_SIDE = 0, 1, 2  # on another branch; straight through; on this side of it
LOST_PIVOT_RATIO = 1e-6  # ratio to the first pivot below which a pivot is zero in the critical point
MAX_DEVIATION_RATIO = 0.5  # largest difference of B from its value on the same branch, relative to c
POWER_ITERATIONS = 20  # of the power iteration for the largest singular value


@kernel
def store_critical_factors(eqs: Equations, rank: int, work: Workspace) -> int:
    """Store the factors of J~ at the critical point just found; return the number of equations that lose their rank."""
    eqs.position(work.critical[0].t, work.q_c, eqs.data, eqs.terms)
    m, n = eqs.terms.J.shape
    fill_scaled_jacobian(eqs.terms, work, work.C)
    factor_lq(work.C, m, n, work.C_tau, work.C_pivots, work.x)
    for i in range(rank):
        work.x[i] = abs(work.C[i, i])
    return rank - rank_at(work.x, rank, LOST_PIVOT_RATIO)


@inlined
def fill_scaled_jacobian(terms: Terms, work: Workspace, J: Reals) -> None:
    """J (m, n) <- J~ of ``terms``."""
    m, n = terms.J.shape
    for i in range(m):
        for j in range(n):
            J[i, j] = terms.J[i, j] * (work.size[j] / work.row[i])


@kernel
def fill_lost_block(J: Reals, regular: int, work: Workspace, B: Reals) -> bool:
    """B[:m - regular, :n - regular] = U^T J Z, J (m, n) in its units, from the factors of the critical point; J and B
    are different arrays. Return whether the regular equations keep their rank and their direction from there to J.
    """
    m, n = J.shape
    for i in range(m):
        for j in range(n):
            B[i, j] = J[work.C_pivots[i], j]
        apply_Qt(work.C, work.C_tau, regular, n, B[i])
        for k in range(min(i, regular)):
            for j in range(n):
                B[i, j] -= work.C[i, k] * B[k, j]
        if i < regular:
            for j in range(n):
                B[i, j] /= work.C[i, i]
    kept = (
        max_tangent_slope(B, regular, work) <= SMALL_ROTATION_TANGENT * SMALL_ROTATION_TANGENT
        and count_rank_kept(B, regular, work.C, work) == regular
    )
    for i in range(regular, m):
        for j in range(regular, n):
            B[i - regular, j - regular] = B[i, j]
    return kept


@kernel
def max_tangent_slope(B: Reals, regular: int, work: Workspace) -> float:
    """Largest square of a column of R^-1 N, [R N] = B[:regular]: slope of the tangents of the regular equations, seen
    from Z.
    """
    steepest = 0.0
    for i in range(regular):
        for j in range(regular):
            work.D[i, j] = B[i, j]
    if not factor_lu(work.D, regular, work.order):
        return np.inf
    for k in range(regular, B.shape[1]):
        square = 0.0
        for i in range(regular):
            work.b[i] = B[i, k]
        solve_lu(work.D, regular, work.order, work.b, work.x)
        for i in range(regular):
            square += work.x[i] * work.x[i]
        if not square < np.inf:
            return np.inf
        steepest = max(steepest, square)
    return steepest


@kernel
def regular_equations_keep_rank(terms: Terms, rank: int, work: Workspace) -> bool:
    """Whether the equations that are regular in the critical point keep their rank and their direction from the last
    good position to it, and on to that of ``terms``. Fills B of the two: work.slopes and work.J_work.
    """
    regular = rank - work.critical[0].lost
    before = fill_lost_block(work.J_last, regular, work, work.slopes)
    fill_scaled_jacobian(terms, work, work.C_work)
    return fill_lost_block(work.C_work, regular, work, work.J_work) and before


@kernel
def classify_passage(terms: Terms, rank: int, work: Workspace) -> int:
    """How the step from the last good position to that of ``terms`` lies to the critical point."""
    m, n = terms.J.shape
    lost = work.critical[0].lost
    regular = rank - lost
    if not regular_equations_keep_rank(terms, rank, work):
        return OTHER_BRANCH
    p = n - regular
    factor_lq(work.slopes, m - regular, p, work.tau_B, work.pivots_B, work.x)
    trace = 0.0
    for i in range(lost):
        row = work.J_work[work.pivots_B[i]]
        for k in range(i):
            for j in range(p):
                row[j] -= work.slopes[i, k] * work.J_work[work.pivots_B[k], j]
        for j in range(p):
            row[j] /= work.slopes[i, i]
    for i in range(lost):
        apply_Qt(work.slopes, work.tau_B, lost, p, work.J_work[work.pivots_B[i]])
        trace += work.J_work[work.pivots_B[i], i]
    mean = trace / lost
    for i in range(lost):
        work.J_work[work.pivots_B[i], i] -= mean
    if not largest_singular_value(lost, p, work) <= MAX_DEVIATION_RATIO * abs(mean):
        return OTHER_BRANCH
    return OPPOSITE_SIDE if mean < 0.0 else SAME_SIDE


@kernel
def largest_singular_value(k: int, p: int, work: Workspace) -> float:
    """Largest singular value of rows ``pivots_B[:k]`` of ``J_work``, p columns, by power iteration; work.x, work.f."""
    for i in range(k):
        work.x[i] = 1.0 + 0.5 * np.sin(7.3 * (i + 1.0))
    value = 0.0
    for _ in range(POWER_ITERATIONS):
        square = 0.0
        for j in range(p):
            work.f[j] = 0.0
            for i in range(k):
                work.f[j] += work.x[i] * work.J_work[work.pivots_B[i], j]
            square += work.f[j] * work.f[j]
        size = 0.0
        for i in range(k):
            size += work.x[i] * work.x[i]
        if not square > 0.0:
            return value if square == 0.0 else np.inf
        value = np.sqrt(square / size)
        for i in range(k):
            work.x[i] = 0.0
            for j in range(p):
                work.x[i] += work.J_work[work.pivots_B[i], j] * work.f[j] / square
    return value


@kernel
def count_doubtful_rows(terms: Terms, rank: int, work: Workspace) -> int:
    """How many equations may have lost their rank between the last accepted position and that of ``terms``."""
    n = terms.J.shape[1]
    for i in range(rank):
        row = work.J_work[i]
        for j in range(n):
            row[j] = terms.J[work.frame_pivots[i], j] * (work.size[j] / work.row[work.frame_pivots[i]])
        apply_Qt(work.frame, work.frame_tau, rank, n, row)
        for k in range(i):
            for j in range(rank):
                row[j] -= work.frame[i, k] * work.J_work[k, j]
        for j in range(rank):
            row[j] /= work.frame[i, i]
    return rank - count_rank_kept(work.J_work, rank, work.frame, work)


@kernel
def count_rank_kept(X: Reals, rank: int, L: Reals, work: Workspace) -> int:
    """How many of the first ``rank`` equations keep their rank on the straight line from L Q^T to L X Q^T: dimension of
    a subspace in which X + X^T is positive definite, X balanced by the pivots of L.

    Without that balance the changes of direction of weak equations, which L^-1 has made large, hide their signs.
    """
    for i in range(rank):
        for j in range(i + 1):
            part = np.sqrt(abs(L[i, i] / L[j, j]))
            work.D[i, j] = X[i, j] * part + X[j, i] / part
            work.D[j, i] = work.D[i, j]
    return count_positive_pivots(work.D, rank)
