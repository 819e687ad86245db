"""Systems whose blocks form a tree, by block elimination from its leaves with LAPACK.

With i the neighbor inward of block k, and c its neighbors outward, whose matrices L_c are in the rows of k::

    D_k x_k + U_k x_i + sum_c L_c x_c = b_k
    D_i <- D_i - L_k (D_k^-1 U_k),    pivoting inside a diagonal block

A path of blocks is a block-tridiagonal matrix. The elimination is stable where the diagonal blocks stay well
conditioned. Blocks may differ in size.

A solve reads D_k^-1, U_k and L_k on its way in and again on its way out. It takes as long as memory needs to hand them
over, so they are kept small: D_k^-1 as it is, which has as many entries as its factors and needs no order of its rows;
of a symmetric matrix a half of it and U_k alone; of U_k what is not zero. D_k may be indefinite.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack
from threadpoolctl import ThreadpoolController

from solvers.compiled.held import hold
from solvers.compiled.kernel import inlined, kernel, reordered
from solvers.system import Array

WIDTH = 4  # columns that are multiplied at once: what they are added to is read and written once
PIECE = 8  # rows of a panel come in such pieces

_threads = ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS keeps to one thread: blocks of some hundred rows only lose by more."""
    return _threads.limit(limits=1, user_api="blas")


class Factors(NamedTuple):
    """What all blocks are solved with, one after the other; matrices by columns, along which the loops run.

    A panel is WIDTH neighboring columns of U_k, or what is left of them at its end, in rows without a gap.
    """

    inward: NDArray[np.int64]  # (blocks,) the neighbor inward; -1: none
    first: NDArray[np.int64]  # (blocks + 1,) its first unknown
    at: NDArray[np.int64]  # (blocks + 1,) where its inverse begins
    tied: NDArray[np.int64]  # (blocks + 1,) where its right and left begin
    first_panel: NDArray[np.int64]  # (blocks + 1,)
    end_panel: NDArray[np.int64]  # (blocks,)
    panels: NDArray[np.int64]  # (.., 5) first column, columns, first row, rows, where they begin
    symmetric: NDArray[np.int64]  # (1,) 1: of inverses what is below the diagonal, and WIDTH columns begin in one row
    inverse: Array  # D_k^-1, n_k^2 entries
    right: Array  # panels of U_k (n_k, n_i)
    left: Array  # the same of L_k^T; not used where it is symmetric
    y: Array  # (largest n_k,) scratch


@inlined
def add(a: float, columns: Any, at: int, count: int, y: Any, first: int) -> None:
    """y[first:] += a times the column that begins at ``at``, ``count`` entries."""
    column, out = columns[at : at + count], y[first : first + count]
    for i in range(count):
        out[i] += a * column[i]


@inlined
def add_four(a: float, b: float, c: float, d: float, columns: Any, at: int, count: int, y: Any, first: int) -> None:
    """The same with four columns, one after the other."""
    out = y[first : first + count]
    A, B = columns[at : at + count], columns[at + count : at + 2 * count]
    C, D = columns[at + 2 * count : at + 3 * count], columns[at + 3 * count : at + 4 * count]
    for i in range(count):
        out[i] += a * A[i] + b * B[i] + c * C[i] + d * D[i]


@reordered
def along(columns: Any, at: int, count: int, x: Any, first: int) -> float:
    """The column that begins at ``at`` . x[first:]."""
    column, other = columns[at : at + count], x[first : first + count]
    total = 0.0
    for i in range(count):
        total += column[i] * other[i]
    return total


@reordered
def along_four(columns: Any, at: int, apart: int, count: int, x: Any, first: int) -> Any:
    """The same for four columns, which begin ``apart``."""
    other = x[first : first + count]
    A, B = columns[at : at + count], columns[at + apart : at + apart + count]
    C, D = columns[at + 2 * apart : at + 2 * apart + count], columns[at + 3 * apart : at + 3 * apart + count]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        a += A[i] * other[i]
        b += B[i] * other[i]
        c += C[i] * other[i]
        d += D[i] * other[i]
    return a, b, c, d


@kernel
def keep_inverse(k: int, block: Any, B: Any) -> None:
    """Keep D_k^-1, by columns; of a symmetric one, the part below the diagonal is given."""
    D, at = block.D, B.at[k]
    n = D.shape[0]
    whole = n - n % WIDTH
    for j in range(n):
        first = 0 if B.symmetric[0] == 0 else j - j % WIDTH if j < whole else j
        for i in range(first, j):
            B.inverse[at] = D[j, i] if B.symmetric[0] == 0 else D[i, j]
            at += 1
        for i in range(j, n):
            B.inverse[at] = D[j, i]
            at += 1


@kernel
def keep_panels(k: int, block: Any, B: Any) -> None:
    """Keep the panels of U_k, given by columns, and of L_k."""
    U, L, panel, at = block.U, block.L, B.first_panel[k], B.tied[k]
    n = U.shape[1]
    for column in range(0, U.shape[0], WIDTH):
        end_column, row = min(column + WIDTH, U.shape[0]), 0
        while row < n:
            end = row
            while end < n and is_tied(column, end_column, end, min(end + PIECE, n), U, L, B):
                end = min(end + PIECE, n)
            if end > row:
                B.panels[panel, 0], B.panels[panel, 1] = column, end_column - column
                B.panels[panel, 2], B.panels[panel, 3], B.panels[panel, 4] = row, end - row, at
                panel += 1
            for j in range(column, end_column):
                for i in range(row, end):
                    B.right[at] = U[j, i]
                    if B.symmetric[0] == 0:
                        B.left[at] = L[i, j]
                    at += 1
            row = end + PIECE
    B.end_panel[k] = panel


@inlined
def is_tied(column: int, end_column: int, row: int, end: int, U: Any, L: Any, B: Any) -> bool:
    """Whether there is anything in these columns and rows of U_k or L_k^T."""
    for j in range(column, end_column):
        for i in range(row, end):
            if U[j, i] != 0.0 or (B.symmetric[0] == 0 and L[i, j] != 0.0):
                return True
    return False


@kernel
def multiply_inverse(k: int, B: Any, x: Any) -> None:
    """B.y <- D_k^-1 x_k; of a symmetric one, every entry below the diagonal is used twice."""
    y, n, at, j = B.y, B.first[k + 1] - B.first[k], B.at[k], 0
    for i in range(n):
        y[i] = 0.0
    while j < n:
        width = WIDTH if j + WIDTH <= n else 1
        first = j if B.symmetric[0] == 1 else 0
        i, count, below = B.first[k] + j, n - first, n - j - width
        if width == WIDTH:
            add_four(x[i], x[i + 1], x[i + 2], x[i + 3], B.inverse, at, count, y, first)
        else:
            add(x[i], B.inverse, at, count, y, first)
        if B.symmetric[0] == 1 and width == WIDTH:
            a, b, c, d = along_four(B.inverse, at + WIDTH, count, below, x, i + WIDTH)
            y[j], y[j + 1], y[j + 2], y[j + 3] = y[j] + a, y[j + 1] + b, y[j + 2] + c, y[j + 3] + d
        elif B.symmetric[0] == 1:
            y[j] += along(B.inverse, at + 1, below, x, i + 1)
        at, j = at + width * count, j + width


@kernel
def subtract_inward(k: int, left: Any, B: Any, x: Any) -> None:
    """x_i -= L_k B.y."""
    for p in range(B.first_panel[k], B.end_panel[k]):
        width, row, rows, at = B.panels[p, 1], B.panels[p, 2], B.panels[p, 3], B.panels[p, 4]
        i = B.first[B.inward[k]] + B.panels[p, 0]
        if width == WIDTH:
            a, b, c, d = along_four(left, at, rows, rows, B.y, row)
            x[i], x[i + 1], x[i + 2], x[i + 3] = x[i] - a, x[i + 1] - b, x[i + 2] - c, x[i + 3] - d
        else:
            for l in range(width):
                x[i + l] -= along(left, at + l * rows, rows, B.y, row)


@kernel
def subtract_outward(k: int, B: Any, x: Any) -> None:
    """x_k -= U_k x_i."""
    for p in range(B.first_panel[k], B.end_panel[k]):
        width, row, rows, at = B.panels[p, 1], B.first[k] + B.panels[p, 2], B.panels[p, 3], B.panels[p, 4]
        i = B.first[B.inward[k]] + B.panels[p, 0]
        if width == WIDTH:
            add_four(-x[i], -x[i + 1], -x[i + 2], -x[i + 3], B.right, at, rows, x, row)
        else:
            for l in range(width):
                add(-x[i + l], B.right, at + l * rows, rows, x, row)


@kernel
def solve_blocks(B: Any, x: Any) -> None:
    """x (unknowns,) <- the solution for the right-hand side x."""
    blocks = B.inward.shape[0]
    for k in range(blocks):
        if B.inward[k] >= 0:
            multiply_inverse(k, B, x)
            if B.symmetric[0] == 1:
                subtract_inward(k, B.right, B, x)
            else:
                subtract_inward(k, B.left, B, x)
    for back in range(blocks):
        k = blocks - 1 - back
        if B.inward[k] >= 0:
            subtract_outward(k, B, x)
        multiply_inverse(k, B, x)
        for i in range(B.first[k + 1] - B.first[k]):
            x[B.first[k] + i] = B.y[i]


class Blocks(NamedTuple):
    """What is to be filled for one block before it is eliminated, by columns, in space that all blocks share."""

    D: Array  # (n, n) transposed
    U: Array  # (n', n) transposed: in its rows what the neighbor inward does
    L: Array  # (n, n') transposed: in the neighbor's rows what it does; not where the matrix is symmetric


class BlockTree:
    """A matrix whose blocks are eliminated outer ones first.

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
    positive
        Whether the determinant is, where the matrix is not taken as symmetric.
    negative
        Number of negative eigenvalues, where the matrix is taken as symmetric (inertia of the factors).
    """

    positive, negative = True, 0

    def __init__(self, sizes: Sequence[int], inward: Sequence[int]) -> None:
        n = np.array([*sizes, 0], np.int64)  # the last one stands for no neighbor
        inner = np.array(inward, np.int64)
        own, other, largest = n[:-1], n[inner], int(n.max())
        most = -(-other // WIDTH) * ((own // PIECE + 2) // 2)  # panels
        starts = [np.concatenate(([0], np.cumsum(counts))) for counts in (own, own**2, own * other, most)]
        first, at, tied, panel = (start.astype(np.int64) for start in starts)
        z, integers = np.zeros, np.int64
        F = self._factors = Factors(
            inner, first, at, tied, panel, z(len(own), integers), z((panel[-1], 5), integers), z(1, integers),
            z(at[-1]), z(tied[-1]), z(tied[-1]), z(largest),
        )  # fmt: skip
        self.factors = hold(F)
        space = z((3, largest**2))
        self._blocks = [
            Blocks(
                space[0, : a * a].reshape(a, a), space[1, : a * b].reshape(b, a), space[2, : a * b].reshape(a, b)
            )
            for a, b in zip(own, other, strict=True)
        ]  # fmt: skip
        self.blocks = [hold(block) for block in self._blocks]
        self.begin(symmetric=False)

    def begin(self, symmetric: bool, averaged: bool = False) -> None:
        """Forget what has been factored. Of a symmetric matrix D below its diagonal and U are read alone.

        ``averaged``: the mean of the matrix and its transpose is factored instead.
        """
        self._factors.symmetric[0] = symmetric or averaged
        self._averaged = averaged
        self.positive, self.negative = True, 0
        self._carried: dict[int, Array] = {}  # sum of L_k D_k^-1 U_k, transposed, by the neighbor inward

    def eliminate(self, k: int) -> bool:
        """Eliminate the next block, whose arrays have been filled; False where it is singular."""
        (D, U, L), inner = self._blocks[k], int(self._factors.inward[k])
        if self._averaged:
            D[:], U[:] = 0.5 * (D + D.T), 0.5 * (U + L.T)
        if k in self._carried:
            D -= self._carried.pop(k)
        if D.size and not self._invert(D):
            return False
        keep_inverse(k, self.blocks[k], self.factors)
        keep_panels(k, self.blocks[k], self.factors)
        if U.size:
            if self._factors.symmetric[0]:
                carried = U @ blas.dsymm(1.0, D.T, U.T, lower=1)
            else:
                carried = U @ D @ L
            self._carried[inner] = self._carried[inner] + carried if inner in self._carried else carried
        return True

    def _invert(self, D: Array) -> bool:
        """D <- D^-1, of a symmetric one below the diagonal, of the transpose above it; False where it is singular."""
        A, room = D.T, 64 * len(D)
        if self._factors.symmetric[0]:
            factors, pivots, info = lapack.dsytrf(A, lower=1, lwork=room, overwrite_a=1)  # in place
            if info == 0:
                single = pivots > 0  # the others are pairs, of which one is negative
                self.negative += int(np.sum(np.diag(factors)[single] < 0.0)) + int(np.sum(~single)) // 2
                _, info = lapack.dsytri(factors, pivots, lower=1, overwrite_a=1)
        else:
            factors, pivots, info = lapack.dgetrf(A, overwrite_a=1)
            if info == 0:
                turned = np.sum(np.diag(factors) < 0.0) + np.sum(pivots != np.arange(len(D)))
                self.positive ^= bool(turned % 2)
                _, info = lapack.dgetri(factors, pivots, lwork=room, overwrite_lu=1)
        return bool(info == 0)
