"""Small dense linear algebra as closed kernels: factorizations and solves for constraint Jacobians and mass matrices.

Sizes are a mechanism's few degrees of freedom, so everything is plain loops over C-contiguous arrays; sizes
are passed with the arrays because scratch is allocated once at its largest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

REGULARIZATION_RATIO = 1e-16  # below what one addition rounds by, relative to the larger
MIN_RESOLVED_FRACTION = 0.1  # part of a square that must be left after a subtraction for its digits to be trusted


@kernel
def factor_lq(A: Reals, m: int, n: int, tau: Reals, pivots: Integers, left: Any) -> None:
    """Householder factors of A (m, n) in place with rows exchanged, the longest remaining one first: A[pivots] = L Q^T.

    L (m, min(m, n)) lies on and below the diagonal; row k right of it and ``tau`` (m,) hold reflector k, whose first
    entry is one, Q = H_0 H_1 ... |L_kk| is the distance of row k from the span of those before it, so that the
    first rows are independent and the last diagonal entries measure the dependence of the others. ``left`` (m,) is
    scratch: the squares of what is left of the rows, from those of the step before as long as they have digits.
    """
    for i in range(m):
        pivots[i], tau[i] = i, 0.0
        left[i] = dot(A, i, A, i, 0, n)
    for k in range(min(m, n)):
        pivot_row(k, m, n, A, pivots, left)
        square = dot(A, k, A, k, k, n)
        if square == 0.0:
            return
        length = np.sqrt(square) if A[k, k] < 0.0 else -np.sqrt(square)
        tau[k] = (length - A[k, k]) / length
        scale = 1.0 / (A[k, k] - length)
        for j in range(k + 1, n):
            A[k, j] *= scale
        A[k, k] = length
        for i in range(k + 1, m):
            factor = tau[k] * (A[i, k] + dot(A, i, A, k, k + 1, n))
            A[i, k] -= factor
            for j in range(k + 1, n):
                A[i, j] -= factor * A[k, j]
            before, left[i] = left[i], left[i] - A[i, k] * A[i, k]
            if not left[i] > MIN_RESOLVED_FRACTION * before:
                left[i] = dot(A, i, A, i, k + 1, n)


@inlined
def dot(A: Reals, i: int, B: Reals, j: int, begin: int, end: int) -> float:
    """A[i] . B[j] from column ``begin`` to before ``end``; four sums, because one alone waits for itself."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    k = begin
    while k + 3 < end:
        a += A[i, k] * B[j, k]
        b += A[i, k + 1] * B[j, k + 1]
        c += A[i, k + 2] * B[j, k + 2]
        d += A[i, k + 3] * B[j, k + 3]
        k += 4
    while k < end:
        a += A[i, k] * B[j, k]
        k += 1
    return (a + b) + (c + d)


@inlined
def pivot_row(k: int, m: int, n: int, A: Reals, pivots: Integers, left: Any) -> None:
    """Swap the row longest from column k on to place k."""
    best = k
    for i in range(k + 1, m):
        if left[i] > left[best]:
            best = i
    if best != k:
        pivots[k], pivots[best] = pivots[best], pivots[k]
        left[k], left[best] = left[best], left[k]
        for j in range(n):
            A[k, j], A[best, j] = A[best, j], A[k, j]


@inlined
def apply_Q(A: Any, tau: Any, rank: int, n: int, x: Any) -> None:
    """x <- Q x, x (n,), with the first ``rank`` reflectors of :func:`factor_lq`."""
    for back in range(rank):
        apply_householder(A, tau, rank - 1 - back, n, x)


@inlined
def apply_Qt(A: Any, tau: Any, rank: int, n: int, x: Any) -> None:
    """x <- Q^T x, x (n,)."""
    for k in range(rank):
        apply_householder(A, tau, k, n, x)


@inlined
def apply_householder(A: Reals, tau: Reals, k: int, n: int, x: Reals) -> None:
    """x <- H_k x."""
    total = x[k]
    for j in range(k + 1, n):
        total += A[k, j] * x[j]
    total *= tau[k]
    x[k] -= total
    for j in range(k + 1, n):
        x[j] -= total * A[k, j]


@inlined
def solve_least_norm(b: Reals, n: int, rank: int, A: Reals, tau: Any, pivots: Integers, x: Reals) -> None:
    """Shortest x (n,) with A x = b (m,) in the first ``rank`` pivot rows, from the factors of :func:`factor_lq`."""
    for j in range(n):
        x[j] = 0.0
    for i in range(rank):
        total = b[pivots[i]]
        for k in range(i):
            total -= A[i, k] * x[k]
        x[i] = total / A[i, i]
    apply_Q(A, tau, rank, n, x)


@inlined
def solve_transposed_basic(f: Reals, m: int, n: int, rank: int, A: Reals, tau: Any, pivots: Integers, y: Reals) -> None:
    """y (m,) with A^T y = f in the span of the first ``rank`` pivot rows, zero elsewhere; ``f`` (n,) is used up."""
    apply_Qt(A, tau, rank, n, f)
    for i in range(m):
        y[i] = 0.0
    for back in range(rank):
        i = rank - 1 - back
        total = f[i]
        for k in range(i + 1, rank):
            total -= A[k, i] * y[pivots[k]]
        y[pivots[i]] = total / A[i, i]


@kernel
def rank_at(sigma: Reals, rank: int, tolerance: float) -> int:
    """How many of the first ``rank`` of these descending values exceed ``tolerance`` times the first."""
    while rank > 0 and not sigma[rank - 1] > tolerance * sigma[0]:
        rank -= 1
    return rank


@kernel
def pivot_ratio(sigma: Reals, rank: int) -> float:
    """Value number ``rank`` relative to the first; 1 if there is none."""
    return sigma[rank - 1] / sigma[0] if rank > 0 else 1.0


@kernel
def length(v: Reals) -> float:
    """|v|."""
    square = 0.0
    for i in range(v.shape[0]):
        square += v[i] * v[i]
    return np.sqrt(square)


@inlined
def regularize_diagonal(A: Reals, rank: int) -> None:
    """Regularize the diagonal of a triangular factor relative to its first entry, for inverse iteration."""
    least = REGULARIZATION_RATIO * abs(A[0, 0])
    for i in range(rank):
        if abs(A[i, i]) < least:
            A[i, i] = least


@inlined
def scale_to_unit(v: Reals) -> None:
    """v <- v / |v|; nothing where that is zero."""
    size = length(v)
    if size > 0.0:
        for i in range(v.shape[0]):
            v[i] /= size


@kernel
def factor_full_pivot(A: Reals, m: int, n: int, tolerance: float, rows: Any, columns: Any) -> int:
    """LU factors of A (m, n) in place by Gauss elimination with full pivoting; return the rank.

    ``rows`` (m,) and ``columns`` (n,) become permutations whose first ``rank`` entries are the pivots in
    order; a pivot at or below ``tolerance`` times the first one ends the elimination.
    """
    for i in range(m):
        rows[i] = i
    for j in range(n):
        columns[j] = j
    first = 0.0
    for k in range(min(m, n)):
        row, column, largest = k, k, 0.0
        for i in range(k, m):
            for j in range(k, n):
                if abs(A[rows[i], columns[j]]) > largest:
                    row, column, largest = i, j, abs(A[rows[i], columns[j]])
        if k == 0:
            first = largest
        if largest <= tolerance * first:
            return k
        rows[k], rows[row] = rows[row], rows[k]
        columns[k], columns[column] = columns[column], columns[k]
        for i in range(k + 1, m):
            A[rows[i], columns[k]] /= A[rows[k], columns[k]]
            for j in range(k + 1, n):
                A[rows[i], columns[j]] -= A[rows[i], columns[k]] * A[rows[k], columns[j]]
    return min(m, n)


@kernel
def solve_full_pivot(A: Reals, n: int, rank: int, rows: Any, columns: Any, b: Reals, x: Reals) -> None:
    """Solve the ``rank`` pivot rows of A x = b with the factors of :func:`factor_full_pivot`; the other unknowns are
    zero.

    ``b`` (m,) and ``x`` (n,) are different arrays.
    """
    for j in range(n):
        x[j] = 0.0
    for i in range(rank):
        total = b[rows[i]]
        for k in range(i):
            total -= A[rows[i], columns[k]] * x[columns[k]]
        x[columns[i]] = total
    for back in range(rank):
        i = rank - 1 - back
        for k in range(i + 1, rank):
            x[columns[i]] -= A[rows[i], columns[k]] * x[columns[k]]
        x[columns[i]] /= A[rows[i], columns[i]]


@kernel
def factor_lu(A: Reals, n: int, order: Integers) -> bool:
    """LU factors of A (n, n) in place, rows exchanged as in ``order`` (n,); False where a pivot is zero."""
    for i in range(n):
        order[i] = i
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[best, k]):
                best = i
        if not abs(A[best, k]) > 0.0:
            return False
        if best != k:
            order[k], order[best] = order[best], order[k]
            for j in range(n):
                A[k, j], A[best, j] = A[best, j], A[k, j]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            A[i, k] = factor
            for j in range(k + 1, n):
                A[i, j] -= factor * A[k, j]
    return True


@kernel
def is_determinant_positive(LU: Reals, n: int, order: Integers) -> bool:
    """Whether the determinant of a matrix is positive, from its factors of :func:`factor_lu`."""
    positive = True
    for i in range(n):
        positive = positive == (LU[i, i] > 0.0)
        for j in range(i):
            positive = positive == (order[j] < order[i])
    return positive


@kernel
def solve_lu(LU: Reals, n: int, order: Integers, b: Reals, x: Reals) -> None:
    """Solve A x = b with the factors of :func:`factor_lu`; ``b`` (n,) and ``x`` (n,) are different arrays."""
    for i in range(n):
        x[i] = b[order[i]]
        for j in range(i):
            x[i] -= LU[i, j] * x[j]
    for back in range(n):
        i = n - 1 - back
        for j in range(i + 1, n):
            x[i] -= LU[i, j] * x[j]
        x[i] /= LU[i, i]


@kernel
def solve_lu_transposed(LU: Reals, n: int, order: Integers, b: Reals, x: Reals) -> None:
    """Solve A^T x = b with the factors of :func:`factor_lu`; ``b`` (n,) is used up and is not to be ``x`` (n,)."""
    for i in range(n):
        b[i] /= LU[i, i]
        for j in range(i + 1, n):
            b[j] -= LU[i, j] * b[i]
    for back in range(n):
        i = n - 1 - back
        for j in range(i):
            b[j] -= LU[i, j] * b[i]
    for i in range(n):
        x[order[i]] = b[i]


@inlined
def solve_positive_definite(A: Reals, n: int, x: Reals) -> bool:
    """Solve A x = b for a symmetric positive definite A (n, n), in place; False where A is not."""
    for i in range(n):
        for j in range(i):
            A[i, j] = (A[i, j] - dot(A, i, A, j, 0, j)) / A[j, j]
        A[i, i] -= dot(A, i, A, i, 0, i)
        if not A[i, i] > 0.0:
            return False
        A[i, i] = np.sqrt(A[i, i])
    for i in range(n):
        for k in range(i):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]
    for back in range(n):
        i = n - 1 - back
        for k in range(i + 1, n):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]
    return True


@kernel
def count_positive_pivots(A: Reals, n: int) -> int:
    """Number of positive pivots of a symmetric A (n, n), the largest remaining one first: A, used up, is positive
    definite in a subspace of that dimension.
    """
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if A[i, i] > A[best, best]:
                best = i
        if not A[best, best] > 0.0:
            return k
        for j in range(n):
            A[k, j], A[best, j] = A[best, j], A[k, j]
        for i in range(n):
            A[i, k], A[i, best] = A[i, best], A[i, k]
        for i in range(k + 1, n):
            for j in range(k + 1, n):
                A[i, j] -= A[i, k] * A[k, j] / A[k, k]
    return n


@inlined
def largest_change(x: Reals, size: Reals) -> float:
    """Largest entry of x (n,) in units of ``size``; not a number if one is not."""
    largest = 0.0
    for i in range(x.shape[0]):
        part = abs(x[i]) / size[i]
        if not (part <= largest or np.isnan(largest)):
            largest = part
    return largest
