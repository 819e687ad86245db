"""The orientation of the constraints, seen from the axes of the last good position; see :mod:`.singular`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import apply_Q, apply_Qt, factor_lu, is_determinant_positive, solve_lu

if TYPE_CHECKING:
    from solvers.projection.workspace import Workspace
    from solvers.system import Terms

ORIENTATION_KEPT, ORIENTATION_REVERSED, LARGE_ROTATION, INDETERMINATE = 0, 1, 2, 3
# Turns of a tangent in one step, as their tangents: 20 and 60 degrees
SMALL_ROTATION_TANGENT, MAX_ROTATION_TANGENT = 0.36, 1.7


@kernel
def compare_orientation(terms: Terms, rank: int, work: Workspace) -> int:
    """Compare ``terms``, whose factors are at hand, with the frame of the last good position:
    ORIENTATION_KEPT or ORIENTATION_REVERSED and little rotated, else LARGE_ROTATION, or INDETERMINATE if rotated too
    far to decide.
    """
    few = 2 * rank < terms.J.shape[1]
    positive, steepest = (
        orientation_from_range_space(terms, rank, work) if few else orientation_from_null_space(terms, rank, work)
    )
    if steepest <= SMALL_ROTATION_TANGENT * SMALL_ROTATION_TANGENT:
        return ORIENTATION_KEPT if positive else ORIENTATION_REVERSED
    return LARGE_ROTATION if positive and steepest <= MAX_ROTATION_TANGENT * MAX_ROTATION_TANGENT else INDETERMINATE


@kernel
def orientation_from_range_space(terms: Terms, rank: int, work: Workspace) -> tuple[bool, float]:
    """Whether det C_n has kept its sign, and the largest square of a column of C_n^-1 C_t; for few rows."""
    n = terms.J.shape[1]
    positive, steepest = True, 0.0
    for i in range(rank):
        row, row_unit = work.J_work[i], work.row[work.frame_pivots[i]]
        for j in range(n):
            row[j] = terms.J[work.frame_pivots[i], j] * (work.size[j] / row_unit)
        apply_Qt(work.frame, work.frame_tau, rank, n, row)
        for j in range(rank):
            work.D[i, j] = row[j]
        positive = positive == (work.frame[i, i] > 0.0)
    if not factor_lu(work.D, rank, work.order):
        return False, np.inf
    for k in range(rank, n):
        square = 0.0
        for i in range(rank):
            work.b[i] = work.J_work[i, k]
        solve_lu(work.D, rank, work.order, work.b, work.x)
        for i in range(rank):
            square += work.x[i] * work.x[i]
        if not square < np.inf:
            return False, np.inf
        steepest = max(steepest, square)
    return positive == is_determinant_positive(work.D, rank, work.order), steepest


@kernel
def orientation_from_null_space(terms: Terms, rank: int, work: Workspace) -> tuple[bool, float]:
    """The same for few degrees of freedom, from N and T: the present orthonormal tangents in the frame's normals
    and tangents.

    The slope is N T^-1, so that its columns have the squares |T^-1 e_k|^2 - 1; and C_n = L (Q_1^T Q_1'), whose second
    factor has the determinant of T, as complementary minors of an orthogonal matrix are equal.
    """
    n = terms.J.shape[1]
    freedom, steepest = n - rank, 0.0
    for k in range(freedom):
        for j in range(n):
            work.f[j] = 1.0 if j == rank + k else 0.0
        apply_Q(work.A, work.tau, rank, n, work.f)
        apply_Qt(work.frame, work.frame_tau, rank, n, work.f)
        for j in range(freedom):
            work.mass[j, k] = work.f[rank + j]
    same = frame_determinants_agree(rank, work)
    if not factor_lu(work.mass, freedom, work.order):
        return False, np.inf
    for k in range(freedom):
        for j in range(freedom):
            work.f[j] = 1.0 if j == k else 0.0
        solve_lu(work.mass, freedom, work.order, work.f, work.z)
        square = -1.0
        for j in range(freedom):
            square += work.z[j] * work.z[j]
        if not square < np.inf:
            return False, np.inf
        steepest = max(steepest, square)
    return same == is_determinant_positive(work.mass, freedom, work.order), steepest


@inlined
def frame_determinants_agree(rank: int, work: Workspace) -> bool:
    """Whether the rows of the frame have determinants of the same sign in the present L and in that of the frame."""
    positive, same = True, True
    for i in range(work.pivots.shape[0]):
        work.rows[work.pivots[i]] = i  # the place of a row in L
    for i in range(rank):
        positive = positive == (work.frame[i, i] > 0.0)
        work.order[i] = work.rows[work.frame_pivots[i]]
        same = same and work.order[i] < rank
    if same:
        return positive == is_determinant_positive(work.A, rank, work.order)
    for i in range(rank):
        k = work.rows[work.frame_pivots[i]]
        for j in range(rank):
            work.D[i, j] = work.A[k, j] if j <= k else 0.0
    return factor_lu(work.D, rank, work.order) and positive == is_determinant_positive(work.D, rank, work.order)
