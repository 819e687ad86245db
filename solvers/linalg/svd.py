"""Singular values of small dense matrices, as closed kernels: one-sided Jacobi, which keeps small ones accurate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

MAX_SWEEPS = 40  # one-sided Jacobi converges quadratically: 3 to 6 sweeps in practice
ORTHOGONALITY_TOLERANCE = 1e-15  # relative to the lengths of the two columns


@kernel
def decompose(J: Any, m: int, n: int, A: Reals, pivots: Integers, U: Any, sigma: Reals, W: Reals) -> None:
    """Singular value decomposition J^T = U diag(sigma) W^T with a complete U, m and n in any order.

    ``J`` (m, n) is read; ``A`` (n, m) and ``pivots`` (m,) are scratch. ``U`` (n, n) is orthogonal, its last
    columns span the null space of J. ``sigma`` (m,) descends and is zero beyond min(m, n). ``W`` (m, m) has
    as many orthonormal columns as there are nonzero singular values.

    Column-pivoted Householder QR of J^T first, then one-sided Jacobi on R^T, which keeps small singular
    values accurate (Drmac, Veselic 2008).
    """
    factor_qr_transposed(J, m, n, A, pivots, U)
    size = min(m, n)
    for i in range(m):
        sigma[i] = 0.0
        for j in range(m):
            W[i, j] = 0.0
    for j in range(size):
        for i in range(j, m):
            W[pivots[i], j] = A[j, i]
    for _ in range(MAX_SWEEPS):
        if not apply_rotations(m, n, size, U, W):
            break
    sort_singular_values(m, n, size, U, sigma, W)


@inlined
def factor_qr_transposed(J: Reals, m: int, n: int, A: Reals, pivots: Integers, U: Reals) -> None:
    """Column-pivoted QR of J^T: ``A`` holds R on and above its diagonal, ``U`` (n, n) the orthogonal factor."""
    for i in range(n):
        for j in range(m):
            A[i, j] = J[j, i]
        for j in range(n):
            U[i, j] = 1.0 if i == j else 0.0
    for j in range(m):
        pivots[j] = j
    for k in range(min(m, n)):
        pivot_column(k, m, n, A, pivots)
        square = 0.0
        for i in range(k, n):
            square += A[i, k] * A[i, k]
        if square == 0.0:
            return
        length = np.sqrt(square)
        diagonal = -length if A[k, k] > 0.0 else length
        A[k, k] -= diagonal  # column k below the diagonal is now the reflector w, with w.w = 2 scale
        scale = square - diagonal * (A[k, k] + diagonal)
        for j in range(k + 1, m):
            dot = 0.0
            for i in range(k, n):
                dot += A[i, k] * A[i, j]
            dot /= scale
            for i in range(k, n):
                A[i, j] -= dot * A[i, k]
        for row in range(n):
            dot = 0.0
            for i in range(k, n):
                dot += U[row, i] * A[i, k]
            dot /= scale
            for i in range(k, n):
                U[row, i] -= dot * A[i, k]
        A[k, k] = diagonal


@inlined
def pivot_column(k: int, m: int, n: int, A: Reals, pivots: Integers) -> None:
    """Swap the column longest below row k to place k."""
    best, longest = k, -1.0
    for j in range(k, m):
        square = 0.0
        for i in range(k, n):
            square += A[i, j] * A[i, j]
        if square > longest:
            best, longest = j, square
    if best != k:
        pivots[k], pivots[best] = pivots[best], pivots[k]
        for i in range(n):
            A[i, k], A[i, best] = A[i, best], A[i, k]


@inlined
def apply_rotations(m: int, n: int, size: int, U: Any, W: Reals) -> bool:
    """One round of Jacobi rotations making the first ``size`` columns of W orthogonal; U turns along. True: rotated."""
    rotated = False
    for p in range(size - 1):
        for q in range(p + 1, size):
            pp, qq, pq = 0.0, 0.0, 0.0
            for i in range(m):
                pp += W[i, p] * W[i, p]
                qq += W[i, q] * W[i, q]
                pq += W[i, p] * W[i, q]
            if abs(pq) <= ORTHOGONALITY_TOLERANCE * np.sqrt(pp) * np.sqrt(qq):
                continue
            rotated = True
            zeta = 0.5 * (qq - pp) / pq
            tangent = 1.0 / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
            if zeta < 0.0:
                tangent = -tangent
            c = 1.0 / np.sqrt(1.0 + tangent * tangent)
            rotate(m, p, q, c, c * tangent, W)
            rotate(n, p, q, c, c * tangent, U)
    return rotated


@inlined
def rotate(rows: int, p: int, q: int, c: float, s: float, A: Reals) -> None:
    """Turn columns p and q of A by the rotation (c, s)."""
    for i in range(rows):
        x, y = A[i, p], A[i, q]
        A[i, p] = c * x - s * y
        A[i, q] = s * x + c * y


@inlined
def sort_singular_values(m: int, n: int, size: int, U: Any, sigma: Reals, W: Reals) -> None:
    """Column lengths of W become sigma, the columns unit vectors; the largest come first."""
    for j in range(size):
        square = 0.0
        for i in range(m):
            square += W[i, j] * W[i, j]
        sigma[j] = np.sqrt(square)
        if sigma[j] > 0.0:
            for i in range(m):
                W[i, j] /= sigma[j]
    for j in range(size - 1):
        best = j
        for k in range(j + 1, size):
            if sigma[k] > sigma[best]:
                best = k
        if best != j:
            sigma[j], sigma[best] = sigma[best], sigma[j]
            rotate(m, j, best, 0.0, 1.0, W)
            rotate(n, j, best, 0.0, 1.0, U)


@inlined
def pseudo_inverse_transposed(f: Reals, m: int, n: int, rank: int, U: Reals, sigma: Reals, W: Reals, y: Reals) -> None:
    """Shortest y (m,) with J^T y = f (n,) in the first ``rank`` singular directions."""
    for i in range(m):
        y[i] = 0.0
    for j in range(rank):
        dot = 0.0
        for i in range(n):
            dot += U[i, j] * f[i]
        dot /= sigma[j]
        for i in range(m):
            y[i] += W[i, j] * dot
