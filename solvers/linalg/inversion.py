"""Inverses of the diagonal blocks of :mod:`.blocks`: dense matrices of some ten to some hundred rows.

All loops run along rows, which are contiguous, and skip zeros. The order of all sums is fixed, so that the results
do not depend on the vector instructions of a processor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

ROOK_RATIO = (1.0 + 17.0**0.5) / 8.0  # bounds the growth in steps with pivots of one and of two rows alike
PANEL = 4  # columns that are eliminated at once
SINGULAR = -1  # instead of a number of negative eigenvalues
MIN_ROW_RATIO = 1e-12  # ratio of the largest entries of two rows below which rows and columns are scaled


@inlined
def add_rows(sign: float, factors: Reals, first: int, end: int, A: Reals, out: Reals) -> None:
    """out += sign sum_k factors[k] A[k, :len(out)] for k from ``first`` up to ``end``: four rows at once."""
    width, found = out.shape[0], 0
    i, j, k = 0, 0, 0
    for row in range(first, end):
        if factors[row] == 0.0:
            continue
        found += 1
        if found == 1:
            i = row
        elif found == 2:
            j = row
        elif found == 3:
            k = row
        else:
            a, b, c, d = sign * factors[i], sign * factors[j], sign * factors[k], sign * factors[row]
            for column in range(width):
                out[column] += a * A[i, column] + b * A[j, column] + c * A[k, column] + d * A[row, column]
            found = 0
    if found > 0:
        a = sign * factors[i]
        for column in range(width):
            out[column] += a * A[i, column]
    if found > 1:
        a = sign * factors[j]
        for column in range(width):
            out[column] += a * A[j, column]
    if found > 2:
        a = sign * factors[k]
        for column in range(width):
            out[column] += a * A[k, column]


@inlined
def find_largest(row: Reals, first: int, left_out: int) -> int:
    """Column of the largest entry of a row from column ``first`` on; -1: there is no other than that left out."""
    best, largest = -1, -1.0
    for j in range(first, row.shape[0]):
        if j != left_out and abs(row[j]) > largest:
            best, largest = j, abs(row[j])
    return best


@kernel
def factor_panel(A: Reals, first: int, end: int, order: Integers) -> bool:
    """Eliminate columns ``first`` to ``end`` of A below their diagonal, with row pivoting, in these columns alone.

    Factors of L go below the diagonal. False: A is singular.
    """
    n = A.shape[0]
    for k in range(first, end):
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
        pivot = 1.0 / A[k, k]
        for i in range(k + 1, n):
            if A[i, k] != 0.0:
                factor = A[i, k] * pivot
                A[i, k] = factor
                for j in range(k + 1, end):
                    A[i, j] -= factor * A[k, j]
    return True


@inlined
def subtract_rows(A: Reals, i: int, first: int, end: int, column: int) -> None:
    """Row i of A, from ``column`` on, less what rows ``first`` to ``end`` have to do with it: its factors times them.

    They are subtracted one after the other, four at once: each entry is read and written once.
    """
    out = A[i, column:]
    if end - first == PANEL:
        a, b, c, d = A[i, first], A[i, first + 1], A[i, first + 2], A[i, first + 3]
        if a != 0.0 or b != 0.0 or c != 0.0 or d != 0.0:
            one, two, three, four = (
                A[first, column:],
                A[first + 1, column:],
                A[first + 2, column:],
                A[first + 3, column:],
            )
            for j in range(out.shape[0]):
                out[j] = out[j] - a * one[j] - b * two[j] - c * three[j] - d * four[j]
        return
    for k in range(first, end):
        factor, row = A[i, k], A[k, column:]
        if factor != 0.0:
            for j in range(out.shape[0]):
                out[j] -= factor * row[j]


@kernel
def invert(A: Reals, order: Integers, scratch: Reals) -> bool:
    """A (n, n) <- A^-1 by LU with row pivoting; scratch (n, n) and order (n,) are scratch. False: A is singular.

    Columns are eliminated in panels, which then change the columns behind them at once. Every entry gets its terms in
    the order of the pivots, as without panels.
    """
    n = A.shape[0]
    for k in range(n):
        order[k] = k
    for first in range(0, n, PANEL):
        end = min(first + PANEL, n)
        if not factor_panel(A, first, end, order):
            return False
        for i in range(first + 1, end):
            subtract_rows(A, i, first, i, end)
        for i in range(end, n):
            subtract_rows(A, i, first, end, end)
    for i in range(n):  # scratch <- L^-1, of which what is right of the diagonal is zero
        for j in range(n):
            scratch[i, j] = 0.0
        scratch[i, i] = 1.0
        add_rows(-1.0, A[i], 0, i, scratch, scratch[i, :i])
    for back in range(n):  # scratch <- U^-1 scratch
        i = n - 1 - back
        add_rows(-1.0, A[i], i + 1, n, scratch, scratch[i])
        pivot = 1.0 / A[i, i]
        for j in range(n):
            scratch[i, j] *= pivot
    for i in range(n):
        for j in range(n):
            A[i, order[j]] = scratch[i, j]
    return True


@inlined
def largest_entry(row: Reals) -> float:
    """Largest absolute value of a row."""
    largest = 0.0
    for j in range(row.shape[0]):
        largest = max(largest, abs(row[j]))
    return largest


@kernel
def invert_scaled(A: Reals, order: Integers, scratch: Reals, units: Reals) -> bool:
    """As :func:`invert`; rows and columns of very different size are divided by their largest entries before.

    Otherwise what rounding leaves of eliminated large entries would be larger than small ones, and be taken as a pivot:
    a body without rotational inertia has c^2 M of rank three in short steps, and its joint has rows of the size of one.
    units (2 n,) is scratch.
    """
    n, smallest, largest = A.shape[0], np.inf, 0.0
    for i in range(n):
        units[i] = largest_entry(A[i])
        smallest, largest = min(smallest, units[i]), max(largest, units[i])
    if not (0.0 < smallest < MIN_ROW_RATIO * largest < np.inf):
        return invert(A, order, scratch)
    for j in range(n):
        units[n + j] = 0.0
    for i in range(n):
        for j in range(n):
            A[i, j] /= units[i]
            units[n + j] = max(units[n + j], abs(A[i, j]))
    for j in range(n):
        if not units[n + j] > 0.0:
            return False
    for i in range(n):
        for j in range(n):
            A[i, j] /= units[n + j]
    if not invert(A, order, scratch):
        return False
    for i in range(n):
        for j in range(n):
            A[i, j] /= units[n + i] * units[j]
    return True


@kernel
def invert_symmetric(A: Reals, order: Integers, scratch: Reals, product: Reals) -> int:
    """A (n, n) <- A^-1 of a symmetric matrix; return the number of negative eigenvalues, or SINGULAR.

    P A P^T = L D L^T with blocks D of one or two rows by rook pivoting, which bounds L (Ashcraft, Grimes, Lewis, SIAM
    J. Matrix Anal. Appl. 20, 1998). scratch and product (n, n) and order (n,) are scratch.
    """
    n, k, negative = A.shape[0], 0, 0
    for i in range(n):
        order[i] = i
    while k < n:
        width = choose_pivot(k, A, order)
        if width == 0:
            return SINGULAR
        if width == 2 or A[k, k] < 0.0:
            negative += 1  # of a pair the eigenvalues have both signs
        eliminate_pivot(k, width, A)
        k += width
    for i in range(n):  # scratch <- L^-1
        for j in range(n):
            scratch[i, j] = 0.0
        scratch[i, i] = 1.0
        is_second = i > 0 and order[i - 1] < 0
        add_rows(-1.0, A[i], 0, i - 1 if is_second else i, scratch, scratch[i, :i])
    k = 0
    while k < n:  # A <- D^-1 L^-1
        if order[k] >= 0:
            a = 1.0 / A[k, k]
            for j in range(n):
                A[k, j] = a * scratch[k, j]
            k += 1
            continue
        a, b, c = A[k, k], A[k, k + 1], A[k + 1, k + 1]
        low, high = a / b, c / b  # scaled by b, the largest of the block
        scale = 1.0 / (b * (low * high - 1.0))
        for j in range(n):
            A[k, j], A[k + 1, j] = (
                scale * (high * scratch[k, j] - scratch[k + 1, j]),
                scale * (low * scratch[k + 1, j] - scratch[k, j]),
            )
        order[k] = -1 - order[k]
        k += 2
    for i in range(n):  # product <- L^-T D^-1 L^-1, up to the diagonal
        for j in range(i + 1):
            product[i, j] = 0.0
        add_rows(1.0, scratch[:, i], i, n, A, product[i, : i + 1])
    for i in range(n):
        for j in range(i + 1):
            A[order[i], order[j]] = product[i, j]
            A[order[j], order[i]] = product[i, j]
    return negative


@kernel
def choose_pivot(k: int, A: Reals, order: Integers) -> int:
    """Move the next pivot to row and column k, or k and k + 1; return its number of rows, 0: there is none.

    ``order`` of the first row of a pair becomes -1 - order.
    """
    at, largest = k, 0.0
    other = find_largest(A[k], k, k)
    if other >= 0:
        largest = abs(A[k, other])
    if not max(largest, abs(A[k, k])) > 0.0:
        return 0
    while not abs(A[at, at]) >= ROOK_RATIO * largest:
        following = find_largest(A[other], k, other)
        height = abs(A[other, following])
        if abs(A[other, other]) >= ROOK_RATIO * height:
            at = other
            break
        if following == at or not height > largest:
            exchange(k, at, k, A, order)
            exchange(k + 1, at if other == k else other, k, A, order)
            order[k] = -1 - order[k]
            return 2
        at, other, largest = other, following, height
    exchange(k, at, k, A, order)
    return 1


@inlined
def exchange(i: int, j: int, first: int, A: Reals, order: Integers) -> None:
    """Exchange rows i and j, and these columns in the rows from ``first`` on."""
    if i == j:
        return
    order[i], order[j] = order[j], order[i]
    for column in range(A.shape[0]):
        A[i, column], A[j, column] = A[j, column], A[i, column]
    for row in range(first, A.shape[0]):
        A[row, i], A[row, j] = A[row, j], A[row, i]


@kernel
def eliminate_pivot(k: int, width: int, A: Reals) -> None:
    """Eliminate a pivot of one or two rows: factors of L go below it."""
    n, first = A.shape[0], k + width
    if width == 1:
        pivot = 1.0 / A[k, k]
        for i in range(first, n):
            if A[i, k] != 0.0:
                factor = A[i, k] * pivot
                A[i, k] = factor
                out, row = A[i, first:], A[k, first:]
                for j in range(out.shape[0]):
                    out[j] -= factor * row[j]
        return
    b = A[k, k + 1]
    low, high = A[k, k] / b, A[k + 1, k + 1] / b
    scale = 1.0 / (b * (low * high - 1.0))
    for i in range(first, n):
        one, two = scale * (high * A[i, k] - A[i, k + 1]), scale * (low * A[i, k + 1] - A[i, k])
        A[i, k], A[i, k + 1] = one, two
        if one != 0.0 or two != 0.0:
            out, row, second = A[i, first:], A[k, first:], A[k + 1, first:]
            for j in range(out.shape[0]):
                out[j] -= one * row[j] + two * second[j]


@inlined
def largest_column(A: Reals) -> float:
    """The largest sum of absolute entries of a column of A (n, n), its norm; infinite if it is not finite."""
    largest = 0.0
    for j in range(A.shape[1]):
        total = 0.0
        for i in range(A.shape[0]):
            total += abs(A[i, j])
        largest = max(largest, total) if np.isfinite(total) else np.inf
    return largest
