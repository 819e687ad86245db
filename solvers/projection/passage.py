"""How a step has passed a critical point, whatever number k of rows vanishes there.

With U the forces that balance in the critical point and Z the motions of all branches, which nothing resists there,

    B(q) = U^T J~(q) Z        (k, k + freedoms)

vanishes in it and is linear in the distance to first order: along a motion that goes straight on, B after is -c times
B before, c > 0. On the same side of the point it is c times. Where a loop has gone over to another branch its rows of B
have another direction, and where that differs little the sign of those on the same side. All is measured in the
rows of B before, made orthonormal: one loop of many counts as much as one of one. A motion along the critical points
does not change B, so this holds with more freedoms too.

No determinant tells as much: its sign turns with (-1)^k, and where branches lie at small angles tangents turn little.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import lq, rank_at, solve_positive, turn_in

ASTRAY, ACROSS, ASIDE = 0, 1, 2  # on another branch; straight through; on this side of it
LOST = 1e-6  # part of the first pivot: those below vanish in the critical point
SKEW = 0.5  # part of c: by so much B may differ from what it is on the same branch
ROUNDS = 20  # of the power iteration for the largest singular value


@kernel
def hold_critical(eqs: Any, rank: int, work: Any) -> int:
    """Keep the factors of J~ at the critical point just found; return how many independent rows vanish there."""
    eqs.position(work.critical[0].t, work.q_c, eqs.data, eqs.terms)
    m, n = eqs.terms.J.shape
    scale_rows(eqs.terms, work, work.C)
    lq(work.C, m, n, work.C_tau, work.C_pivots, work.x)
    for i in range(rank):
        work.x[i] = abs(work.C[i, i])
    return rank - rank_at(work.x, rank, LOST)


@inlined
def scale_rows(terms: Any, work: Any, J: Any) -> None:
    """J (m, n) <- J~ of ``terms``."""
    m, n = terms.J.shape
    for i in range(m):
        for j in range(n):
            J[i, j] = terms.J[i, j] * (work.size[j] / work.row[i])


@kernel
def weak_part(J: Any, regular: int, work: Any, B: Any) -> None:
    """B[:m - regular, :n - regular] = U^T J Z, J (m, n) in its units, from the factors of the critical point; J and B
    are different arrays.
    """
    m, n = J.shape
    for i in range(m):
        for j in range(n):
            B[i, j] = J[work.C_pivots[i], j]
        turn_in(work.C, work.C_tau, regular, n, B[i])
        for k in range(min(i, regular)):
            for j in range(regular, n):
                B[i, j] -= work.C[i, k] * B[k, j]
        if i < regular:
            for j in range(regular, n):
                B[i, j] /= work.C[i, i]
    for i in range(regular, m):
        for j in range(regular, n):
            B[i - regular, j - regular] = B[i, j]


@kernel
def passage(terms: Any, rank: int, work: Any) -> int:
    """How the step from the last good position to that of ``terms`` lies to the critical point."""
    m, n = terms.J.shape
    lost = work.critical[0].lost
    regular = rank - lost
    weak_part(work.J_last, regular, work, work.slopes)
    scale_rows(terms, work, work.C_work)
    weak_part(work.C_work, regular, work, work.J_work)
    p = n - regular
    lq(work.slopes, m - regular, p, work.tau_B, work.pivots_B, work.x)
    trace = 0.0
    for i in range(lost):
        row = work.J_work[work.pivots_B[i]]
        for k in range(i):
            for j in range(p):
                row[j] -= work.slopes[i, k] * work.J_work[work.pivots_B[k], j]
        for j in range(p):
            row[j] /= work.slopes[i, i]
    for i in range(lost):
        turn_in(work.slopes, work.tau_B, lost, p, work.J_work[work.pivots_B[i]])
        trace += work.J_work[work.pivots_B[i], i]
    mean = trace / lost
    for i in range(lost):
        work.J_work[work.pivots_B[i], i] -= mean
    if not largest_singular(lost, p, work) <= SKEW * abs(mean):
        return ASTRAY
    return ACROSS if mean < 0.0 else ASIDE


@kernel
def largest_singular(k: int, p: int, work: Any) -> float:
    """Largest singular value of rows ``pivots_B[:k]`` of ``J_work``, p columns, by power iteration; work.x, work.f."""
    for i in range(k):
        work.x[i] = 1.0 + 0.5 * np.sin(7.3 * (i + 1.0))
    value = 0.0
    for _ in range(ROUNDS):
        square = 0.0
        for j in range(p):
            work.f[j] = 0.0
            for i in range(k):
                work.f[j] += work.x[i] * work.J_work[work.pivots_B[i], j]
            square += work.f[j] * work.f[j]
        size = 0.0
        for i in range(k):
            size += work.x[i] * work.x[i]
        if not square > 0.0:
            return value if square == 0.0 else np.inf
        value = np.sqrt(square / size)
        for i in range(k):
            work.x[i] = 0.0
            for j in range(p):
                work.x[i] += work.J_work[work.pivots_B[i], j] * work.f[j] / square
    return value


@kernel
def may_pass(terms: Any, rank: int, work: Any) -> bool:
    """Whether rows may have vanished between the last good position and that of ``terms``: whether the straight line
    from J~ there to J~ here, in normals and in units of J~ there, is not kept regular by a positive definite part.
    """
    n = terms.J.shape[1]
    for i in range(rank):
        row = work.J_work[i]
        for j in range(n):
            row[j] = terms.J[work.frame_pivots[i], j] * (work.size[j] / work.row[work.frame_pivots[i]])
        turn_in(work.frame, work.frame_tau, rank, n, row)
        for k in range(i):
            for j in range(rank):
                row[j] -= work.frame[i, k] * work.J_work[k, j]
        for j in range(rank):
            row[j] /= work.frame[i, i]
    for i in range(rank):
        work.x[i] = 0.0
        for j in range(i + 1):
            work.D[i, j] = 0.5 * (work.J_work[i, j] + work.J_work[j, i])
    return not solve_positive(work.D, rank, work.x)
