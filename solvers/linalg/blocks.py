"""Systems whose blocks form a tree, by block elimination from its leaves.

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

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.lanes import dot_column, dot_four_columns
from solvers.compiled.matrix_view import matrix_at
from solvers.system import Array

from .inversion import SINGULAR, add_rows, invert, invert_scaled, invert_symmetric

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

PANEL_WIDTH = 4  # columns that are multiplied at once: what they are added to is read and written once
PANEL_ROW_STEP = 8  # rows of a panel come in such pieces


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
    # (blocks,) where the sum of L_k D_k^-1 U_k over the neighbors outward is kept until the block is eliminated;
    # -1: there are none
    update_start: NDArray[np.int64]
    is_first: NDArray[np.int64]  # (blocks,) 1: the first block with this neighbor inward
    symmetric: NDArray[np.int64]  # (1,) 1: of inverses what is below the diagonal, and WIDTH columns begin in one row
    averaged: NDArray[np.int64]  # (1,) 1: the mean of the matrix and its transpose is factored
    negative: NDArray[np.int64]  # (1,) number of negative eigenvalues of the blocks D_k of a symmetric matrix
    inverse: Array  # D_k^-1, n_k^2 entries
    right: Array  # panels of U_k (n_k, n_i)
    left: Array  # the same of L_k^T; not used where it is symmetric
    updates: Array  # by update_start, by columns
    D: Array  # (largest n_k^2,) the block that is eliminated next, by columns: see block_matrices
    U: Array
    L: Array
    order: NDArray[np.int64]  # (largest n_k,) scratch
    X: Array  # (largest n_k^2,) scratch, and Y
    Y: Array
    y: Array  # (largest n_k,) scratch

    @staticmethod
    def allocate(sizes: Sequence[int], inward: Sequence[int]) -> Factors:
        """Return the memory of the factors of a matrix.

        Parameters
        ----------
        sizes
            Rows of every block.
        inward
            Of every block its neighbor inward, by number, a later one; -1: there is none.
        """
        n = np.array([*sizes, 0], np.int64)  # the last one stands for no neighbor
        inner, z, integers = np.array(inward, np.int64), np.zeros, np.int64
        own, other, largest = n[:-1], n[inner], int(n.max())
        most = -(-other // PANEL_WIDTH) * ((own // PANEL_ROW_STEP + 2) // 2)  # panels
        starts = [np.concatenate(([0], np.cumsum(counts))) for counts in (own, own**2, own * other, most)]
        first_unknown, inverse_start, entry_start, panel = (start.astype(np.int64) for start in starts)
        places, is_first, count = find_places(inward)
        square = largest**2
        return Factors(
            inner, first_unknown, inverse_start, entry_start, panel, z(len(own), integers), z((panel[-1], 5), integers),
            np.where(places >= 0, places * square, -1), is_first, z(1, integers), z(1, integers), z(1, integers),
            z(inverse_start[-1]), z(entry_start[-1]), z(entry_start[-1]), z(count * square), z(square), z(square),
            z(square), z(largest, integers), z(square), z(square), z(largest),
        )  # fmt: skip


def find_places(inward: Sequence[int]) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Return places for what blocks add to their neighbors inward, which are free again once those are eliminated.

    Of every block its place (blocks,), -1: it has no neighbor outward; 1 if it is the first with its neighbor inward
    (blocks,); and the number of places.
    """
    places, is_first = np.full(len(inward), -1), np.zeros(len(inward), np.int64)
    free, count = list[int](), 0
    for k, inner in enumerate(inward):
        if inner >= 0 and places[inner] < 0:
            if not free:
                free.append(count)
                count += 1
            places[inner], is_first[k] = free.pop(), 1
        if places[k] >= 0:
            free.append(int(places[k]))
    return places, is_first, count


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


@kernel
def store_inverse(k: int, D: Reals, factors: Factors) -> None:
    """Store D_k^-1, by columns; of a symmetric one, the part below the diagonal."""
    at, n = factors.inverse_start[k], D.shape[0]
    whole = n - n % PANEL_WIDTH
    for j in range(n):
        first = 0 if factors.symmetric[0] == 0 else j - j % PANEL_WIDTH if j < whole else j
        for i in range(first, j):
            factors.inverse[at] = D[j, i]
            at += 1
        for i in range(j, n):
            factors.inverse[at] = D[j, i]
            at += 1


@kernel
def store_panels(k: int, U: Reals, L: Reals, factors: Factors) -> None:
    """Store the panels of U_k, given by columns, and of L_k."""
    panel, at, n = factors.first_panel[k], factors.panel_entry_start[k], U.shape[1]
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


@inlined
def block_matrices(k: int, factors: Factors) -> tuple[Reals, Reals, Reals]:
    """The matrices that are to be filled for block k before it is eliminated, by columns; all blocks share the memory.

    D (n, n) transposed; U (n', n) transposed: in its rows what the neighbor inward does; L (n, n') transposed: in the
    neighbor's rows what it does, not read where the matrix is symmetric.
    """
    n, inner = factors.first_unknown[k + 1] - factors.first_unknown[k], factors.inward[k]
    m = factors.first_unknown[inner + 1] - factors.first_unknown[inner] if inner >= 0 else 0
    return matrix_at(factors.D, 0, n, n), matrix_at(factors.U, 0, m, n), matrix_at(factors.L, 0, n, m)


@kernel
def reset(symmetric: bool, averaged: bool, factors: Factors) -> None:
    """Discard the factors. Of a symmetric matrix D below its diagonal and U are read alone.

    ``averaged``: the mean of the matrix and its transpose is factored instead.
    """
    factors.symmetric[0] = 1 if symmetric or averaged else 0
    factors.averaged[0] = 1 if averaged else 0
    factors.negative[0] = 0


@kernel
def eliminate(k: int, factors: Factors) -> bool:
    """Eliminate the next block, whose matrices have been filled; False where it is singular."""
    D, U, L = block_matrices(k, factors)
    n, m = U.shape[1], U.shape[0]
    symmetric = factors.symmetric[0] == 1
    if symmetric:
        make_symmetric(factors.averaged[0] == 1, D, U, L)
    at = factors.update_start[k]
    if at >= 0:
        for i in range(n):
            for j in range(n):
                D[i, j] -= factors.updates[at + i * n + j]
    X = matrix_at(factors.X, 0, n, n)
    if symmetric:
        negative = invert_symmetric(D, factors.order, X, matrix_at(factors.Y, 0, n, n))
        if negative == SINGULAR:
            return False
        factors.negative[0] += negative
    elif not (invert_scaled(D, factors.order, X, factors.Y) if n > 1 else invert(D, factors.order, X)):
        return False
    store_inverse(k, D, factors)
    store_panels(k, U, L, factors)
    if m > 0:
        add_update(k, D, U, L, factors)
    return True


@inlined
def make_symmetric(averaged: bool, D: Reals, U: Reals, L: Reals) -> None:
    """Fill what is left of D and L, or take the mean of the matrix and its transpose."""
    for i in range(D.shape[0]):
        for j in range(i):
            if averaged:
                D[j, i] = 0.5 * (D[i, j] + D[j, i])
            D[i, j] = D[j, i]
        for j in range(U.shape[0]):
            if averaged:
                U[j, i] = 0.5 * (U[j, i] + L[i, j])
            L[i, j] = U[j, i]


@kernel
def add_update(k: int, D: Reals, U: Reals, L: Reals, factors: Factors) -> None:
    """Add L_k D_k^-1 U_k to what is subtracted from the neighbor inward, by columns; D is D_k^-1 now."""
    m, n = U.shape
    X, Y = matrix_at(factors.X, 0, n, m), matrix_at(factors.Y, 0, m, n)
    at = factors.update_start[factors.inward[k]]
    for j in range(m):  # row j of U D as a column of X
        out = factors.y
        for i in range(n):
            out[i] = 0.0
        add_rows(1.0, U[j], 0, n, D, out[:n])
        for i in range(n):
            X[i, j], Y[j, i] = out[i], L[i, j]
    for j in range(m):  # column j of the update
        out = factors.y
        for i in range(m):
            out[i] = 0.0
        add_rows(1.0, Y[j], 0, n, X, out[:m])
        for i in range(m):
            if factors.is_first[k] == 1:
                factors.updates[at + i * m + j] = out[i]
            else:
                factors.updates[at + i * m + j] += out[i]
