"""What remains of a front: a quadratic form over z, the delayed directions and the interface, with R z = r.

The quadratic form counts only where R z = r. Elsewhere it may grow from loop to loop, as the motion of a chain of loops
whose first one is not closed, until rounding hides the part that counts. So with orthonormal rows R and the projection
Pi = I - R^T R, z is replaced by Pi z + R^T r::

    H <- Pi H Pi,    g <- Pi (g + H R^T r),    gain <- gain Pi,    shift <- shift - gain R^T r

The multipliers of the equations that remain are then smaller by R (H z + g) of the form before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.matrix_view import matrix_at
from solvers.system import DROPPED, DROPPED_LENGTH, DROPPED_RESIDUAL, SHORTEST

if TYPE_CHECKING:
    from mbfmu.mechanics.elimination.records import EliminationMemory, FrontRecord
    from solvers.compiled.record import Reals


@kernel
def store_message(front: FrontRecord, memory: EliminationMemory, drop: float, report: Reals) -> None:
    """Keep the message of a front that has been eliminated, and restrict it to where its equations hold."""
    values, ny, rank, delayed, nz = memory.values, front.ny, front.rank, front.delayed, front.delayed + front.np
    H, R = matrix_at(values, front.H, nz, nz), matrix_at(values, front.R, front.left, nz)
    for i in range(nz):
        at = rank + i if i < delayed else ny + i - delayed
        values[front.g + i] = memory.g[at]
        for j in range(nz):
            H[i, j] = memory.H[at, rank + j if j < delayed else ny + j - delayed]
    for i in range(front.left):
        values[front.r + i], values[front.unit + i] = memory.r[rank + i], memory.unit[rank + i]
        for j in range(nz):
            R[i, j] = memory.R[rank + i, rank + j if j < delayed else ny + j - delayed]
    front.left = orthonormalize(front, nz, drop, memory, report)
    restrict(front, nz, memory)


@kernel
def orthonormalize(front: FrontRecord, nz: int, drop: float, memory: EliminationMemory, report: Reals) -> int:
    """Make the equations that remain orthonormal (Gram and Schmidt, twice); return their number without those shorter
    than ``drop``.
    """
    values, rows, kept = memory.values, front.rows, 0
    R = matrix_at(values, front.R, front.left, nz)
    E = matrix_at(values, front.E, rows, rows)
    r, unit = values[front.r : front.r + front.left], values[front.unit : front.unit + front.left]
    for i in range(front.left):
        if i != kept:
            r[kept], unit[kept] = r[i], unit[i]
            for c in range(nz):
                R[kept, c] = R[i, c]
            for c in range(rows):
                E[front.rank + kept, c] = E[front.rank + i, c]
        for attempt in range(3):
            for j in range(kept if attempt > 0 else 0):
                factor = row_product(R, kept, j, nz)
                r[kept] -= factor * r[j]
                for c in range(nz):
                    R[kept, c] -= factor * R[j, c]
                for c in range(rows):
                    E[front.rank + kept, c] -= factor * E[front.rank + j, c]
            length = np.sqrt(row_product(R, kept, kept, nz))
            if not unit[kept] * length > drop:
                break
            unit[kept] *= length
            r[kept] /= length
            for c in range(nz):
                R[kept, c] /= length
            for c in range(rows):
                E[front.rank + kept, c] /= length
        else:
            report[SHORTEST] = min(report[SHORTEST], unit[kept])
            kept += 1
            continue
        report[DROPPED] += 1.0
        report[DROPPED_LENGTH] = max(report[DROPPED_LENGTH], unit[kept] * length)
        report[DROPPED_RESIDUAL] = max(report[DROPPED_RESIDUAL], abs(r[kept]) * unit[kept])
    return kept


@inlined
def row_product(R: Reals, i: int, j: int, n: int) -> float:
    """Product of rows i and j of n columns."""
    total = 0.0
    for c in range(n):
        total += R[i, c] * R[j, c]
    return total


@kernel
def restrict(front: FrontRecord, nz: int, memory: EliminationMemory) -> None:
    """Replace z by its projection, see the module's text."""
    values, left = memory.values, front.left
    H, R = matrix_at(values, front.H, nz, nz), matrix_at(values, front.R, left, nz)
    gain, lost = matrix_at(values, front.gain, front.ny, nz), matrix_at(values, front.lost, left, nz)
    for i in range(left):
        r = values[front.r + i]
        values[front.known + i] = 0.0
        for c in range(nz):
            total = 0.0
            for k in range(nz):
                total += R[i, k] * H[k, c]
            lost[i, c] = total
            values[front.known + i] += R[i, c] * values[front.g + c]
        for a in range(front.ny):
            total = 0.0
            for c in range(nz):
                total += gain[a, c] * R[i, c]
            values[front.shift + a] -= total * r
            for c in range(nz):
                gain[a, c] -= total * R[i, c]
    for i in range(left):
        for c in range(nz):
            values[front.g + c] += lost[i, c] * values[front.r + i]
    for i in range(left):
        total = 0.0
        for c in range(nz):
            total += R[i, c] * values[front.g + c]
        for c in range(nz):
            values[front.g + c] -= total * R[i, c]
        project_columns(H, R, i, nz)
    for i in range(left):
        project_rows(H, R, i, nz)


@inlined
def project_columns(form: Reals, R: Reals, i: int, n: int) -> None:
    """form <- form (I - R_i^T R_i)."""
    for k in range(n):
        total = 0.0
        for c in range(n):
            total += form[k, c] * R[i, c]
        for c in range(n):
            form[k, c] -= total * R[i, c]


@inlined
def project_rows(form: Reals, R: Reals, i: int, n: int) -> None:
    """form <- (I - R_i^T R_i) form."""
    for c in range(n):
        total = 0.0
        for k in range(n):
            total += R[i, k] * form[k, c]
        for k in range(n):
            form[k, c] -= R[i, k] * total
