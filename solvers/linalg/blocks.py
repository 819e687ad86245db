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
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack
from threadpoolctl import ThreadpoolController

from solvers.compiled.kernel import inlined, kernel, reordered
from solvers.compiled.tuple_pointer import pin
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

PANEL_WIDTH = 4  # columns that are multiplied at once: what they are added to is read and written once
PANEL_ROW_STEP = 8  # rows of a panel come in such pieces

_threads = ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS keeps to one thread: blocks of some hundred rows only lose by more."""
    return _threads.limit(limits=1, user_api="blas")


class Factors(NamedTuple):
    """What all blocks are solved with, one after the other; matrices by columns, along which the loops run.

    A panel is WIDTH neighboring columns of U_k, or what is left of them at its end, in rows without a gap.
    """

    inward: NDArray[np.int64]  # (blocks,) the neighbor inward; -1: none
    first_unknown: NDArray[np.int64]  # (blocks + 1,)
    inverse_start: NDArray[np.int64]  # (blocks + 1,) where its inverse begins
    panel_entry_start: NDArray[np.int64]  # (blocks + 1,) where its right and left begin
    first_panel: NDArray[np.int64]  # (blocks + 1,)
    end_panel: NDArray[np.int64]  # (blocks,)
    panels: NDArray[np.int64]  # (.., 5) first column, columns, first row, rows, where they begin
    symmetric: NDArray[np.int64]  # (1,) 1: of inverses what is below the diagonal, and WIDTH columns begin in one row
    inverse: Array  # D_k^-1, n_k^2 entries
    right: Array  # panels of U_k (n_k, n_i)
    left: Array  # the same of L_k^T; not used where it is symmetric
    y: Array  # (largest n_k,) scratch


@inlined
def add_column(a: float, columns: Any, at: int, count: int, y: Reals, first: int) -> None:
    """y[first:] += a times the column that begins at ``at``, ``count`` entries."""
    column, out = columns[at : at + count], y[first : first + count]
    for i in range(count):
        out[i] += a * column[i]


@inlined
def add_four_columns(
    a: float, b: float, c: float, d: float, columns: Any, at: int, count: int, y: Reals, first: int
) -> None:
    """The same with four columns, one after the other."""
    out = y[first : first + count]
    A, B = columns[at : at + count], columns[at + count : at + 2 * count]
    C, D = columns[at + 2 * count : at + 3 * count], columns[at + 3 * count : at + 4 * count]
    for i in range(count):
        out[i] += a * A[i] + b * B[i] + c * C[i] + d * D[i]


@reordered
def dot_column(columns: Any, at: int, count: int, x: Reals, first: int) -> float:
    """The column that begins at ``at`` . x[first:]."""
    column, other = columns[at : at + count], x[first : first + count]
    total = 0.0
    for i in range(count):
        total += column[i] * other[i]
    return total


@reordered
def dot_four_columns(columns: Any, at: int, stride: int, count: int, x: Reals, first: int) -> Any:
    """The same for four columns, ``stride`` entries from one beginning to the next."""
    other = x[first : first + count]
    A, B = columns[at : at + count], columns[at + stride : at + stride + count]
    C, D = columns[at + 2 * stride : at + 2 * stride + count], columns[at + 3 * stride : at + 3 * stride + count]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        a += A[i] * other[i]
        b += B[i] * other[i]
        c += C[i] * other[i]
        d += D[i] * other[i]
    return a, b, c, d


@kernel
def store_inverse(k: int, block: Blocks, factors: Factors) -> None:
    """Store D_k^-1, by columns; of a symmetric one, the part below the diagonal is given."""
    D, at = block.D, factors.inverse_start[k]
    n = D.shape[0]
    whole = n - n % PANEL_WIDTH
    for j in range(n):
        first = 0 if factors.symmetric[0] == 0 else j - j % PANEL_WIDTH if j < whole else j
        for i in range(first, j):
            factors.inverse[at] = D[j, i] if factors.symmetric[0] == 0 else D[i, j]
            at += 1
        for i in range(j, n):
            factors.inverse[at] = D[j, i]
            at += 1


@kernel
def store_panels(k: int, block: Blocks, factors: Factors) -> None:
    """Store the panels of U_k, given by columns, and of L_k."""
    U, L, panel, at = block.U, block.L, factors.first_panel[k], factors.panel_entry_start[k]
    n = U.shape[1]
    for column in range(0, U.shape[0], PANEL_WIDTH):
        end_column, row = min(column + PANEL_WIDTH, U.shape[0]), 0
        while row < n:
            end = row
            while end < n and has_nonzeros(column, end_column, end, min(end + PANEL_ROW_STEP, n), U, L, factors):
                end = min(end + PANEL_ROW_STEP, n)
            if end > row:
                factors.panels[panel, 0], factors.panels[panel, 1] = column, end_column - column
                factors.panels[panel, 2], factors.panels[panel, 3], factors.panels[panel, 4] = row, end - row, at
                panel += 1
            for j in range(column, end_column):
                for i in range(row, end):
                    factors.right[at] = U[j, i]
                    if factors.symmetric[0] == 0:
                        factors.left[at] = L[i, j]
                    at += 1
            row = end + PANEL_ROW_STEP
    factors.end_panel[k] = panel


@inlined
def has_nonzeros(column: int, end_column: int, row: int, end: int, U: Reals, L: Reals, factors: Factors) -> bool:
    """Whether there is anything in these columns and rows of U_k or L_k^T."""
    for j in range(column, end_column):
        for i in range(row, end):
            if U[j, i] != 0.0 or (factors.symmetric[0] == 0 and L[i, j] != 0.0):
                return True
    return False


@kernel
def multiply_inverse(k: int, factors: Factors, x: Reals) -> None:
    """B.y <- D_k^-1 x_k; of a symmetric one, every entry below the diagonal is used twice."""
    y, n, at, j = factors.y, factors.first_unknown[k + 1] - factors.first_unknown[k], factors.inverse_start[k], 0
    for i in range(n):
        y[i] = 0.0
    while j < n:
        width = PANEL_WIDTH if j + PANEL_WIDTH <= n else 1
        first = j if factors.symmetric[0] == 1 else 0
        i, count, below = factors.first_unknown[k] + j, n - first, n - j - width
        if width == PANEL_WIDTH:
            add_four_columns(x[i], x[i + 1], x[i + 2], x[i + 3], factors.inverse, at, count, y, first)
        else:
            add_column(x[i], factors.inverse, at, count, y, first)
        if factors.symmetric[0] == 1 and width == PANEL_WIDTH:
            a, b, c, d = dot_four_columns(factors.inverse, at + PANEL_WIDTH, count, below, x, i + PANEL_WIDTH)
            y[j], y[j + 1], y[j + 2], y[j + 3] = y[j] + a, y[j + 1] + b, y[j + 2] + c, y[j + 3] + d
        elif factors.symmetric[0] == 1:
            y[j] += dot_column(factors.inverse, at + 1, below, x, i + 1)
        at, j = at + width * count, j + width


@kernel
def subtract_inward(k: int, left: Any, factors: Factors, x: Reals) -> None:
    """x_i -= L_k B.y."""
    for p in range(factors.first_panel[k], factors.end_panel[k]):
        width, row, rows, at = factors.panels[p, 1], factors.panels[p, 2], factors.panels[p, 3], factors.panels[p, 4]
        i = factors.first_unknown[factors.inward[k]] + factors.panels[p, 0]
        if width == PANEL_WIDTH:
            a, b, c, d = dot_four_columns(left, at, rows, rows, factors.y, row)
            x[i], x[i + 1], x[i + 2], x[i + 3] = x[i] - a, x[i + 1] - b, x[i + 2] - c, x[i + 3] - d
        else:
            for l in range(width):
                x[i + l] -= dot_column(left, at + l * rows, rows, factors.y, row)


@kernel
def subtract_outward(k: int, factors: Factors, x: Reals) -> None:
    """x_k -= U_k x_i."""
    for p in range(factors.first_panel[k], factors.end_panel[k]):
        width, row, rows, at = (
            factors.panels[p, 1],
            factors.first_unknown[k] + factors.panels[p, 2],
            factors.panels[p, 3],
            factors.panels[p, 4],
        )
        i = factors.first_unknown[factors.inward[k]] + factors.panels[p, 0]
        if width == PANEL_WIDTH:
            add_four_columns(-x[i], -x[i + 1], -x[i + 2], -x[i + 3], factors.right, at, rows, x, row)
        else:
            for l in range(width):
                add_column(-x[i + l], factors.right, at + l * rows, rows, x, row)


@kernel
def solve_blocks(factors: Factors, x: Reals) -> None:
    """x (unknowns,) <- the solution for the right-hand side x."""
    blocks = factors.inward.shape[0]
    for k in range(blocks):
        if factors.inward[k] >= 0:
            multiply_inverse(k, factors, x)
            if factors.symmetric[0] == 1:
                subtract_inward(k, factors.right, factors, x)
            else:
                subtract_inward(k, factors.left, factors, x)
    for back in range(blocks):
        k = blocks - 1 - back
        if factors.inward[k] >= 0:
            subtract_outward(k, factors, x)
        multiply_inverse(k, factors, x)
        for i in range(factors.first_unknown[k + 1] - factors.first_unknown[k]):
            x[factors.first_unknown[k] + i] = factors.y[i]


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
        Of every block the arrays to be filled, pinned.
    factors
        What :func:`solve_blocks` takes, pinned.
    negative
        Number of negative eigenvalues, where the matrix is taken as symmetric (inertia of the factors).
    """

    negative = 0

    def __init__(self, sizes: Sequence[int], inward: Sequence[int]) -> None:
        n = np.array([*sizes, 0], np.int64)  # the last one stands for no neighbor
        inner = np.array(inward, np.int64)
        own, other, largest = n[:-1], n[inner], int(n.max())
        most = -(-other // PANEL_WIDTH) * ((own // PANEL_ROW_STEP + 2) // 2)  # panels
        starts = [np.concatenate(([0], np.cumsum(counts))) for counts in (own, own**2, own * other, most)]
        first_unknown, inverse_start, entry_start, panel = (start.astype(np.int64) for start in starts)
        z, integers = np.zeros, np.int64
        built = self._factors = Factors(
            inner, first_unknown, inverse_start, entry_start, panel,
            z(len(own), integers), z((panel[-1], 5), integers), z(1, integers),
            z(inverse_start[-1]), z(entry_start[-1]), z(entry_start[-1]), z(largest),
        )  # fmt: skip
        self.factors = pin(built)
        space = z((3, largest**2))
        self._blocks = [
            Blocks(
                space[0, : a * a].reshape(a, a), space[1, : a * b].reshape(b, a), space[2, : a * b].reshape(a, b)
            )
            for a, b in zip(own, other, strict=True)
        ]  # fmt: skip
        self.blocks = [pin(block) for block in self._blocks]
        self.reset(symmetric=False)

    def reset(self, symmetric: bool, averaged: bool = False) -> None:
        """Discard the factors. Of a symmetric matrix D below its diagonal and U are read alone.

        ``averaged``: the mean of the matrix and its transpose is factored instead.
        """
        self._factors.symmetric[0] = symmetric or averaged
        self._averaged = averaged
        self.negative = 0
        self._schur_updates: dict[int, Array] = {}  # sum of L_k D_k^-1 U_k, transposed, by the neighbor inward

    def eliminate(self, k: int) -> bool:
        """Eliminate the next block, whose arrays have been filled; False where it is singular."""
        (D, U, L), inner = self._blocks[k], int(self._factors.inward[k])
        if self._averaged:
            D[:], U[:] = 0.5 * (D + D.T), 0.5 * (U + L.T)
        if k in self._schur_updates:
            D -= self._schur_updates.pop(k)
        if D.size and not self._invert(D):
            return False
        store_inverse(k, self.blocks[k], self.factors)
        store_panels(k, self.blocks[k], self.factors)
        if U.size:
            if self._factors.symmetric[0]:
                schur_update = U @ blas.dsymm(1.0, D.T, U.T, lower=1)
            else:
                schur_update = U @ D @ L
            self._schur_updates[inner] = (
                self._schur_updates[inner] + schur_update if inner in self._schur_updates else schur_update
            )
        return True

    def _invert(self, D: Array) -> bool:
        """D <- D^-1, of a symmetric one below the diagonal, of the transpose above it; False where it is singular."""
        A, work_size = D.T, 64 * len(D)
        if self._factors.symmetric[0]:
            factors, pivots, info = lapack.dsytrf(A, lower=1, lwork=work_size, overwrite_a=1)  # in place
            if info == 0:
                single = pivots > 0  # the others are pairs, of which one is negative
                self.negative += int(np.sum(np.diag(factors)[single] < 0.0)) + int(np.sum(~single)) // 2
                _, info = lapack.dsytri(factors, pivots, lower=1, overwrite_a=1)
        else:
            factors, pivots, info = lapack.dgetrf(A, overwrite_a=1)
            if info == 0:
                _, info = lapack.dgetri(factors, pivots, lwork=work_size, overwrite_lu=1)
        return bool(info == 0)
