"""Elimination of the coordinates of one front.

    min 1/2 x^T H x + g^T x    subject to    R x = r,      x = (y, p)

y (ny) are the coordinates to eliminate, p the interface. Equations are solved for rotated coordinates Q^T y:

1. Every equation that is not solved yet is scaled to length one. One that has become shorter than a limit, relative to
   its original length, is redundant or singular: it is left out.
2. The equation with the largest part in y is solved if that part is at least MIN_PIVOT: one Householder reflection in
   y, and the pivot is eliminated from the other equations.
3. If there is none, an entry of p is eliminated from the other equations, the largest first. An equation without p has
   a large part in y, or none.
4. What remains are at most as many equations as p has components. The directions of y that they contain are *delayed*:
   they are eliminated by the target. A small pivot is never used: errors would grow with the power of its inverse along
   a chain of loops.
5. No equation contains the other directions of y: they are free, and eliminated by the minimum (Cholesky).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.system import DROPPED, DROPPED_LENGTH, DROPPED_RESIDUAL, SHORTEST

if TYPE_CHECKING:
    from mbfmu.mechanics.elimination.records import EliminationMemory
    from solvers.compiled.record import Reals

MIN_PIVOT = 0.5  # part of a unit equation in y: of the two parts the larger one is solved for, so that no error grows
MIN_DELAYED_LENGTH = 1e-14  # part of a unit equation that is rounding


@inlined
def swap_rows(i: int, j: int, n: int, rows: int, memory: EliminationMemory) -> None:
    """Exchange equations i and j of n columns, with their right-hand sides, units and operations."""
    if i == j:
        return
    R, r, unit, E = memory.R, memory.r, memory.unit, memory.E
    for c in range(n):
        R[i, c], R[j, c] = R[j, c], R[i, c]
    for c in range(rows):
        E[i, c], E[j, c] = E[j, c], E[i, c]
    r[i], r[j] = r[j], r[i]
    unit[i], unit[j] = unit[j], unit[i]


@inlined
def subtract_row(pivot: int, column: int, i: int, first: int, n: int, rows: int, memory: EliminationMemory) -> None:
    """Eliminate a column from equation i by the equation ``pivot``; columns from ``first`` on are not zero."""
    R, E = memory.R, memory.E
    factor = R[i, column] / R[pivot, column]
    if factor == 0.0:
        return
    for c in range(first, n):
        R[i, c] -= factor * R[pivot, c]
    R[i, column] = 0.0
    memory.r[i] -= factor * memory.r[pivot]
    for c in range(rows):
        E[i, c] -= factor * E[pivot, c]


@inlined
def scale_rows(
    rank: int, taken: int, end: int, n: int, rows: int, drop: float, memory: EliminationMemory, report: Reals
) -> int:
    """Scale the equations that are neither solved nor taken to length one, and move those shorter than ``drop`` behind
    ``end``; return the new end.
    """
    R, r, unit, E = memory.R, memory.r, memory.unit, memory.E
    i = rank
    while i < end - taken:
        square = 0.0
        for c in range(rank, n):
            square += R[i, c] * R[i, c]
        length = np.sqrt(square)
        part = length * unit[i]
        if not part > drop:
            report[DROPPED] += 1.0
            report[DROPPED_LENGTH] = max(report[DROPPED_LENGTH], part)
            report[DROPPED_RESIDUAL] = max(report[DROPPED_RESIDUAL], abs(r[i]) * unit[i])
            swap_rows(i, end - taken - 1, n, rows, memory)
            swap_rows(end - taken - 1, end - 1, n, rows, memory)
            end -= 1
            continue
        report[SHORTEST] = min(report[SHORTEST], part)
        for c in range(rank, n):
            R[i, c] /= length
        r[i] /= length
        unit[i] = part
        for c in range(rows):
            E[i, c] /= length
        i += 1
    return end


@inlined
def find_pivot(rank: int, end: int, ny: int, n: int, R: Reals, report: Reals) -> int:
    """Return the equation with the largest part in y, which is reported; -1: all parts are below MIN_PIVOT."""
    best, found = MIN_PIVOT * MIN_PIVOT, -1
    for i in range(rank, end if rank < ny else rank):
        inside, outside = 0.0, 0.0
        for c in range(rank, ny):
            inside += R[i, c] * R[i, c]
        for c in range(ny, n):
            outside += R[i, c] * R[i, c]
        if inside > best * (inside + outside):
            best, found = inside / (inside + outside), i
    if found >= 0:
        report[SHORTEST] = min(report[SHORTEST], np.sqrt(best))
    return found


@kernel
def rotate_coordinates(row: int, first: int, end: int, ny: int, n: int, memory: EliminationMemory) -> None:
    """Rotate columns ``first`` to ny so that the equation ``row`` has one entry there, the first (Householder)."""
    R, Q, H, g, w = memory.R, memory.Q, memory.H, memory.g, memory.w
    if ny - first < 2:
        return
    square = 0.0
    for c in range(first, ny):
        w[c] = R[row, c]
        square += w[c] * w[c]
    length = np.sqrt(square)
    if length == 0.0:
        return
    w[first] += length if w[first] > 0.0 else -length
    norm = square - R[row, first] * R[row, first] + w[first] * w[first]
    if norm == 0.0:
        return
    twice = 2.0 / norm
    for i in range(row, end):
        reflect_row(R, i, first, ny, twice, w)
    for i in range(ny):
        reflect_row(Q, i, first, ny, twice, w)
    for i in range(n):
        reflect_row(H, i, first, ny, twice, w)
    for j in range(n):
        total = 0.0
        for c in range(first, ny):
            total += H[c, j] * w[c]
        total *= twice
        for c in range(first, ny):
            H[c, j] -= total * w[c]
    total = 0.0
    for c in range(first, ny):
        total += g[c] * w[c]
    total *= twice
    for c in range(first, ny):
        g[c] -= total * w[c]


@inlined
def reflect_row(A: Reals, i: int, first: int, end: int, twice: float, w: Reals) -> None:
    """A[i] <- A[i] (I - twice w w^T) in these columns."""
    total = 0.0
    for c in range(first, end):
        total += A[i, c] * w[c]
    total *= twice
    for c in range(first, end):
        A[i, c] -= total * w[c]


@inlined
def take_interface_row(rank: int, taken: int, end: int, ny: int, n: int, rows: int, memory: EliminationMemory) -> bool:
    """Eliminate one more component of the interface from the equations that are not taken; False: there is none."""
    R, row, column, largest = memory.R, -1, -1, 0.0
    for i in range(rank, end - taken):
        for c in range(ny, n):
            if not memory.taken[c] and abs(R[i, c]) > largest:
                row, column, largest = i, c, abs(R[i, c])
    if row < 0:
        return False
    memory.taken[column] = True
    swap_rows(row, end - taken - 1, n, rows, memory)
    for i in range(rank, end - taken - 1):
        subtract_row(end - taken - 1, column, i, rank, n, rows, memory)
    return True


@kernel
def solve_equations(
    rows: int, ny: int, n: int, drop: float, memory: EliminationMemory, report: Reals
) -> tuple[int, int, int]:
    """Steps 1 to 4 of the module's text: return the rank, the delayed directions and the equations that remain.

    The columns are then pivots, delayed directions, free directions and interface; equations follow the pivots in that
    order.
    """
    R, rank, taken, end = memory.R, 0, 0, rows
    for c in range(n):
        memory.taken[c] = False
    while True:
        end = scale_rows(rank, taken, end, n, rows, drop, memory, report)
        row = find_pivot(rank, end, ny, n, R, report)
        if row >= 0:
            if row >= end - taken:  # all others may use the interface again
                taken = 0
                for c in range(n):
                    memory.taken[c] = False
            swap_rows(rank, row, n, rows, memory)
            rotate_coordinates(rank, rank, end, ny, n, memory)
            for i in range(rank + 1, end):
                subtract_row(rank, rank, i, rank, n, rows, memory)
            rank += 1
        elif take_interface_row(rank, taken, end, ny, n, rows, memory):
            taken += 1
        else:
            break
    delayed, left = 0, end - rank
    while delayed < left and rank + delayed < ny:
        first, best, row = rank + delayed, MIN_DELAYED_LENGTH * MIN_DELAYED_LENGTH, -1
        for i in range(first, end):
            square = 0.0
            for c in range(first, ny):
                square += R[i, c] * R[i, c]
            if square > best:
                best, row = square, i
        if row < 0:
            break
        swap_rows(first, row, n, rows, memory)
        rotate_coordinates(first, first, end, ny, n, memory)
        delayed += 1
    return rank, delayed, left


@kernel
def substitute_pivots(rank: int, ny: int, n: int, memory: EliminationMemory) -> None:
    """Pivots = u - U p, by their equations, which are triangular; put into H and g of the other columns."""
    R, r, H, g, u, U, W = memory.R, memory.r, memory.H, memory.g, memory.u, memory.U, memory.W
    for a in range(rank):
        u[a] = r[a]
        for c in range(ny, n):
            U[a, c] = R[a, c]
        for b in range(a):
            factor = R[a, b]
            if factor != 0.0:
                u[a] -= factor * u[b]
                for c in range(ny, n):
                    U[a, c] -= factor * U[b, c]
        u[a] /= R[a, a]
        for c in range(ny, n):
            U[a, c] /= R[a, a]
    if rank == 0:
        return
    for i in range(n):
        for a in range(rank):
            g[i] += H[i, a] * u[a]
        for c in range(ny, n):
            total = 0.0
            for a in range(rank):
                total += H[i, a] * U[a, c]
            W[i, c] = total
    for c in range(ny, n):
        for a in range(rank):
            g[c] -= U[a, c] * g[a]
    for i in range(rank, ny):
        for c in range(ny, n):
            H[i, c] -= W[i, c]
            H[c, i] = H[i, c]
    for i in range(ny, n):
        for c in range(ny, i + 1):
            total = H[i, c] - W[i, c] - W[c, i]
            for a in range(rank):
                total += U[a, i] * W[a, c]
            H[i, c] = total
            H[c, i] = total


@kernel
def eliminate_free(rank: int, delayed: int, ny: int, n: int, memory: EliminationMemory) -> bool:
    """Eliminate the free directions by the minimum; False: one of them moves no mass."""
    H, g = memory.H, memory.g
    for c in range(rank + delayed, ny):
        if not H[c, c] > 0.0:
            return False
        for i in range(rank, n):
            if rank + delayed <= i <= c:
                continue
            factor = H[c, i] / H[c, c]
            if factor == 0.0:
                continue
            g[i] -= factor * g[c]
            for j in range(rank, n):
                if j < rank + delayed or j > c:
                    H[i, j] -= factor * H[c, j]
    return True


@kernel
def store_solution(
    rank: int, delayed: int, ny: int, n: int, memory: EliminationMemory, shift: Reals, gain: Reals
) -> None:
    """Rotated coordinates = shift (ny,) - gain (ny, nz) z, z the delayed directions and the interface."""
    H, g, u, U = memory.H, memory.g, memory.u, memory.U
    for a in range(rank + delayed):
        shift[a] = u[a] if a < rank else 0.0
        for j in range(delayed):
            gain[a, j] = -1.0 if rank + j == a else 0.0
        for c in range(ny, n):
            gain[a, delayed + c - ny] = U[a, c] if a < rank else 0.0
    for a in range(ny - 1, rank + delayed - 1, -1):
        shift[a] = -g[a] / H[a, a]
        for j in range(delayed):
            gain[a, j] = H[a, rank + j] / H[a, a]
        for c in range(ny, n):
            gain[a, delayed + c - ny] = H[a, c] / H[a, a]
        for b in range(a + 1, ny):
            factor = H[a, b] / H[a, a]
            if factor != 0.0:
                shift[a] -= factor * shift[b]
                for j in range(gain.shape[1]):
                    gain[a, j] -= factor * gain[b, j]
