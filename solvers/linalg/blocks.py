"""Systems whose blocks form a tree, by block elimination from its leaves with LAPACK.

With i the neighbor inward of block k, and c its neighbors outward, whose matrices L_c stand in the rows of k::

    D_k x_k + U_k x_i + sum_c L_c x_c = b_k
    D_i <- D_i - L_k (D_k^-1 U_k),    pivoting inside a diagonal block

A path of blocks is a block-tridiagonal matrix. The elimination is stable where the diagonal blocks stay well
conditioned. Blocks may differ in size. They are factored by LAPACK; what is solved with the factors, far more often, is
one kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController

from solvers.compiled.held import hold
from solvers.compiled.kernel import inlined, kernel
from solvers.system import Array

_threads = ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS keeps to one thread: blocks of some hundred rows only lose by more."""
    return _threads.limit(limits=1, user_api="blas")


class Factors(NamedTuple):
    """Factors of all blocks, one after the other; matrices by columns, along which the loops run."""

    inward: NDArray[np.int64]  # (blocks,) the neighbor inward; -1: none
    first: NDArray[np.int64]  # (blocks + 1,) its first unknown
    at: NDArray[np.int64]  # (blocks + 1,) where its LU begins, n_k^2 entries
    tied: NDArray[np.int64]  # (blocks + 1,) where its right and left begin, n_k n_i entries each
    lu: Array  # P D_k = L U
    pivots: NDArray[np.int64]  # (unknowns,) which row each is exchanged with, counted in its block
    right: Array  # D_k^-1 U_k (n_k, n_i)
    left: Array  # L_k (n_i, n_k)


@inlined
def subtract(a: float, columns: Any, at: int, count: int, y: Any, first: int) -> None:
    """y[first:] -= a times the column that begins at ``at``, ``count`` entries."""
    column, out = columns[at : at + count], y[first : first + count]
    for i in range(count):
        out[i] -= a * column[i]


@inlined
def subtract_four(
    a: float, b: float, c: float, d: float, columns: Any, at: int, apart: int, count: int, y: Any, first: int
) -> None:
    """The same with four columns, which begin ``apart``: y is read and written once for all of them."""
    out = y[first : first + count]
    A, B = columns[at : at + count], columns[at + apart : at + apart + count]
    C, D = columns[at + 2 * apart : at + 2 * apart + count], columns[at + 3 * apart : at + 3 * apart + count]
    for i in range(count):
        out[i] -= a * A[i] + b * B[i] + c * C[i] + d * D[i]


@inlined
def subtract_product(columns: Any, at: int, rows: int, count: int, x: Any, begin: int, y: Any, first: int) -> None:
    """y[first:] -= A x[begin:], the columns of A (rows, count) one after the other from ``at`` on."""
    j = 0
    while j + 4 <= count:
        k = begin + j
        subtract_four(x[k], x[k + 1], x[k + 2], x[k + 3], columns, at + j * rows, rows, rows, y, first)
        j += 4
    while j < count:
        subtract(x[begin + j], columns, at + j * rows, rows, y, first)
        j += 1


@kernel
def solve_block(B: Any, k: int, x: Any) -> None:
    """x_k <- D_k^-1 x_k."""
    first, n, at = B.first[k], B.first[k + 1] - B.first[k], B.at[k]
    for i in range(n):
        other = B.pivots[first + i]
        x[first + i], x[first + other] = x[first + other], x[first + i]
    whole = n - n % 4
    for j in range(0, whole, 4):
        for l in range(j, j + 3):
            subtract(x[first + l], B.lu, at + l * n + l + 1, j + 3 - l, x, first + l + 1)
        i = first + j
        below = at + j * n + j + 4
        subtract_four(x[i], x[i + 1], x[i + 2], x[i + 3], B.lu, below, n, n - j - 4, x, i + 4)
    for j in range(whole, n):
        subtract(x[first + j], B.lu, at + j * n + j + 1, n - j - 1, x, first + j + 1)
    for j in range(n - 1, whole - 1, -1):
        x[first + j] /= B.lu[at + j * n + j]
        subtract(x[first + j], B.lu, at + j * n, j, x, first)
    for j in range(whole - 4, -1, -4):
        for l in range(j + 3, j - 1, -1):
            x[first + l] /= B.lu[at + l * n + l]
            subtract(x[first + l], B.lu, at + l * n + j, l - j, x, first + j)
        i = first + j
        subtract_four(x[i], x[i + 1], x[i + 2], x[i + 3], B.lu, at + j * n, n, j, x, first)


@kernel
def solve_blocks(B: Any, x: Any) -> None:
    """x (unknowns,) <- the solution for the right-hand side x."""
    blocks = B.inward.shape[0]
    for k in range(blocks):
        solve_block(B, k, x)
        inner, first = B.inward[k], B.first[k]
        if inner >= 0:
            to, size = B.first[inner], B.first[inner + 1] - B.first[inner]
            subtract_product(B.left, B.tied[k], size, B.first[k + 1] - first, x, first, x, to)
    for back in range(blocks):
        k = blocks - 1 - back
        inner, first = B.inward[k], B.first[k]
        if inner >= 0:
            begin, n = B.first[inner], B.first[k + 1] - first
            subtract_product(B.right, B.tied[k], n, B.first[inner + 1] - begin, x, begin, x, first)


class Blocks(NamedTuple):
    """What is to be filled for one block before it is eliminated, by columns: the factors take their place."""

    D: Array  # (n, n) transposed
    U: Array  # (n', n) transposed: in its rows what the neighbor inward does
    L: Array  # (n, n') transposed: in the neighbor's rows what it does


class BlockTree:
    """Factors of a matrix whose blocks are eliminated outer ones first.

    Parameters
    ----------
    sizes
        Rows of every block.
    inward
        Of every block its neighbor inward, by number, a later one; -1: there is none.

    Attributes
    ----------
    blocks
        Of every block the arrays to be filled, held.
    factors
        What :func:`solve_blocks` takes, held.
    """

    def __init__(self, sizes: Sequence[int], inward: Sequence[int]) -> None:
        n = np.array([*sizes, 0], np.int64)  # the last one stands for no neighbor
        inner = np.array(inward, np.int64)
        starts = [np.concatenate(([0], np.cumsum(counts))) for counts in (n[:-1], n[:-1] ** 2, n[:-1] * n[inner])]
        first, at, tied = (start.astype(np.int64) for start in starts)
        F = self._factors = Factors(
            inner, first, at, tied,
            np.zeros(at[-1]), np.zeros(first[-1], np.int64), np.zeros(tied[-1]), np.zeros(tied[-1]),
        )  # fmt: skip
        self.factors = hold(F)
        self._blocks = [
            Blocks(
                F.lu[at[k] : at[k + 1]].reshape(own, own),
                F.right[tied[k] : tied[k + 1]].reshape(other, own),
                F.left[tied[k] : tied[k + 1]].reshape(own, other),
            )
            for k, (own, other) in enumerate(zip(n[:-1], n[inner], strict=True))
        ]
        self.blocks = [hold(block) for block in self._blocks]
        self.begin()

    def begin(self) -> None:
        """Forget what has been factored."""
        self._carried: dict[int, Array] = {}  # sum of L_k D_k^-1 U_k, transposed, by the neighbor inward

    def eliminate(self, k: int) -> bool:
        """Eliminate the next block, whose arrays have been filled; False where it is singular."""
        F, (D, U, L) = self._factors, self._blocks[k]
        if k in self._carried:
            D -= self._carried.pop(k)
        if not D.size:
            return True
        lu, F.pivots[F.first[k] : F.first[k + 1]], info = lapack.dgetrf(D.T, overwrite_a=1)  # in place
        if info == 0 and U.size:
            lapack.dgetrs(lu, F.pivots[F.first[k] : F.first[k + 1]], U.T, overwrite_b=1)  # in place
            inner = int(F.inward[k])
            if inner in self._carried:
                self._carried[inner] += U @ L
            else:
                self._carried[inner] = U @ L
        return bool(info == 0)
