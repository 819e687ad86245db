"""Singular positions: what is a crossing, what a near miss, and whether a step has passed one.

At a *critical point* the constraints lose a row of rank: there are forces u that balance with nothing behind them,

    J~^T u = 0,   nu~ . u = 0,   Phi~ = g u,   |u| = 1          (units as in :mod:`solvers.workspace`)

in the unknowns q, t, u and g. g = u . Phi~ is the *gap*: by so much the loop misses the one that is singular there. If
it is nothing, branches of the motion cross in that point, and the motion goes straight on. If it is anything, they part
before they meet, within sqrt(g) of the point, and the motion turns into one of them. No ratio of singular values tells
the two apart, for a near miss has its ratio as small as sqrt(g); the gap does, and as g has no slope there it is known
to rounding. Newton's method in all unknowns, the shortest step where it is not unique (redundant rows, critical points
that form curves), damped.

A motion of more than one freedom goes through critical points only where these divide what it can reach, that is where
they have one dimension less. Else it passes beside them, as on a cone beside its tip: a near miss too.

A step that jumps from one branch to another shows in the *orientation*: seen from the axes of the last position, in the
order normals, tangents, the rows of J~ are C = [C_n C_t]. While C_n = J~ Q_1 keeps the sign of its determinant no
position between was singular, and y = -C_n^-1 C_t is the slope of the tangents now on those before. At a crossing the
sign turns, and the slope stays small; where it does not the step went over to the other branch. In the crossing itself
nothing can be told; what comes after it is compared with what was before.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .dense import (
    dot,
    factor_lu,
    least_norm,
    length,
    lift,
    lq,
    positive_determinant,
    ratio,
    scale_to_unit,
    solve_lu,
    solve_positive,
    turn_in,
    turn_out,
)  # fmt: skip
from .kernel import inlined, kernel
from .workspace import distance, factor, factor_transposed, scaled_length

NONE, CROSSING, MISS = 0, 1, 2
STRAIGHT, FLIPPED, BENT, TURNED = 0, 1, 2, 3

SINGULAR = 1e-3  # ratio of the smallest pivot of J~ to the largest below which a position is nearly singular
GAP = 1e-12  # largest gap of a crossing, in units of the rows; Phi is known to some 1e-16 of them
NEAR = 30.0  # a critical point is that of this position when it is no farther than so many ratios
AGAIN = 4.0  # by so much the ratio must have changed before a point that was not found is looked for again
PROBE = 1e-7  # of differences, in units of size
TURNS = 5  # of the inverse iteration for the weakest forces
DAMPING = 0.01  # of the squares of singular values, in what is left of the equations: see seek
NOISE = 1e-8  # singular values of the equations below this part of all are those of the differences
FLAT = 1e-6  # below this part of the largest they count as zero
SPAN = 1e-2  # of a unit vector in q, t, u and g, its part in q and t that counts
STRIDE, FAR = 0.3, 1.0  # longest Newton step, longest way, in units of size
NEWTON, EXACT = 30, 1e-11  # steps, and what they may leave: g is known to its power of 3/2
LITTLE, SLOPE = 0.36, 1.7  # turns of a tangent in one step, as their tangents: 20 and 60 degrees
PASSED = 3.0  # a crossing that a step has passed lies within so many lengths of it
AHEAD = 3.0  # steps ahead that a singular position is looked for
JUMP = 0.7  # of the step before, to a crossing from where the next step jumps over it
LEAD = 0.67  # of a longer way, that the step before the jump may go
DARK = 1e-7  # ratio so near a crossing that any step leads out
PART = 0.3  # of the way to a near miss that one step may go


@kernel
def judge(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """What the singular position near q is; ``terms`` (of positions) and factors belong to (t, q), and do so again."""
    c, here = work.critical[0], ratio(work.pivot, rank)
    if c.kind != NONE and apart(t, q, work, eqs.terms) <= NEAR * here:
        return c.kind
    c.kind = NONE
    if c.in_vain < AGAIN * here and here < AGAIN * c.in_vain:
        return NONE
    c.in_vain = here
    if seek(eqs, t, q, rank, work):
        c.kind, c.in_vain = MISS, 0.0
        if abs(c.gap) <= GAP:
            if dimension(work) >= eqs.terms.J.shape[1] - rank:
                c.kind = CROSSING
            else:
                c.gap = np.inf
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return c.kind


@kernel
def apart(t: float, q: Any, work: Any, terms: Any) -> float:
    """Distance to the critical point, in units of size; time counts where constraints move with it."""
    far = distance(q, work.q_c, work)
    if moves(terms):
        far = np.sqrt(far * far + ((t - work.critical[0].t) * work.rate[0]) ** 2)
    return far


@inlined
def moves(terms: Any) -> bool:
    """Whether time moves a constraint."""
    for i in range(terms.nu.shape[0]):
        if terms.nu[i] != 0.0:
            return True
    return False


@kernel
def seek(eqs: Any, t: float, q: Any, rank: int, work: Any) -> bool:
    """Newton for the critical point next to q: fills ``work.q_c``, and time and gap of its record.

    Where several rows vanish at once the point is a double root: directions that matter have singular values as small
    as the square root of what is left, and steps are damped by that (Levenberg, Marquardt).
    """
    m, n = eqs.terms.J.shape
    c, N = work.critical[0], n + m + 2
    weakest(eqs.terms, rank, work)
    for i in range(q.shape[0]):
        work.q_c[i] = q[i]
    c.t, c.gap = t, 0.0
    for _ in range(NEWTON):
        fill_matrix(eqs, work)
        for i in range(N):
            if not np.isfinite(work.g[i]):
                return False
        off = length(work.g)
        if off < EXACT:
            c.gap += gap_left(m, n, work)
            return True
        if not damped_step(DAMPING * off, work):
            return False
        step_critical(eqs, min(1.0, STRIDE / max(length(work.change), 1e-300)), work)
        if not distance(work.q_c, q, work) < FAR:
            return False
    return False


@kernel
def damped_step(damping: float, work: Any) -> bool:
    """work.change = the x that minimises |K x - g|^2 + damping |x|^2: (K K^T + damping) y = g, x = K^T y; False where
    that has no digits.
    """
    N, trace = work.change.shape[0], 0.0
    for i in range(N):
        for j in range(i + 1):
            work.K_work[i, j] = dot(work.K, i, work.K, j, 0, N)
        trace += work.K_work[i, i]
    for i in range(N):
        work.K_work[i, i] += damping + NOISE * NOISE * trace
        work.change[i] = 0.0
    if not solve_positive(work.K_work, N, work.g):
        return False
    for i in range(N):
        for j in range(N):
            work.change[j] += work.K[i, j] * work.g[i]
    return True


@kernel
def dimension(work: Any) -> int:
    """Dimension of the critical points in q and t about the one just found, from the null space of its equations."""
    N, n = work.change.shape[0], work.size.shape[0]
    for i in range(N):
        for j in range(N):
            work.K_work[i, j] = work.K[i, j]
    lq(work.K_work, N, N, work.K_tau, work.K_pivots, work.change)
    flat = 0
    while flat < N and abs(work.K_work[flat, flat]) > FLAT * abs(work.K_work[0, 0]):
        flat += 1
    for k in range(N - flat):
        for j in range(N):
            work.K[k, j] = 1.0 if j == flat + k else 0.0
        turn_out(work.K_work, work.K_tau, flat, N, work.K[k])
    lq(work.K, N - flat, n + 1, work.K_tau, work.K_pivots, work.change)
    found = 0
    while found < min(N - flat, n + 1) and abs(work.K[found, found]) > SPAN:
        found += 1
    return found


@inlined
def gap_left(m: int, n: int, work: Any) -> float:
    """What u . (Phi~ - g u) is off."""
    total = 0.0
    for i in range(m):
        total += work.u[i] * work.g[n + 1 + i]
    return total


@kernel
def weakest(terms: Any, rank: int, work: Any) -> None:
    """work.u = the left singular vector of the smallest singular value of J~ that is not redundant, from its factors:
    by inverse iteration, which begins with what the last pivot row has for itself.
    """
    m, n = terms.J.shape
    factor_transposed(m, rank, work)
    lift(work.A, rank)
    lift(work.B, rank)
    for j in range(n):
        work.f[j] = 1.0 if j == rank - 1 else 0.0
    turn_out(work.A, work.tau, rank, n, work.f)
    for _ in range(TURNS):
        turn_in(work.A, work.tau, rank, n, work.f)
        least_norm(work.f, m, rank, work.B, work.tau_B, work.pivots_B, work.u)
        scale_to_unit(work.u)
        least_norm(work.u, n, rank, work.A, work.tau, work.pivots, work.f)
        scale_to_unit(work.f)


@kernel
def unbalance(eqs: Any, t: float, q: Any, work: Any, g: Any) -> None:
    """Left side less right side of the equations (N,) at (t, q) with ``work.u`` and the gap; ``terms`` follow."""
    terms, c = eqs.terms, work.critical[0]
    m, n = terms.J.shape
    eqs.position(t, q, eqs.data, terms)
    for j in range(n):
        g[j] = 0.0
    g[n], g[n + m + 1] = 0.0, -0.5
    for i in range(m):
        scaled = work.u[i] / work.row[i]
        for j in range(n):
            g[j] += scaled * terms.J[i, j] * work.size[j]
        g[n] -= scaled * terms.nu[i] / work.rate[0]
        g[n + 1 + i] = terms.Phi[i] / work.row[i] - c.gap * work.u[i]
        g[n + m + 1] += 0.5 * work.u[i] * work.u[i]


@kernel
def fill_matrix(eqs: Any, work: Any) -> None:
    """work.g and work.K (N, N), its derivative: by differences where J is differentiated."""
    terms, c = eqs.terms, work.critical[0]
    m, n = terms.J.shape
    N = n + m + 2
    unbalance(eqs, c.t, work.q_c, work, work.g)
    for k in range(n + 1):
        for i in range(work.q_c.shape[0]):
            work.q_try[i] = work.q_c[i]
        for i in range(n):
            work.dq[i] = PROBE * work.size[i] if i == k else 0.0
        eqs.retract(work.q_try, work.dq, eqs.data)
        unbalance(eqs, c.t + (PROBE / work.rate[0] if k == n else 0.0), work.q_try, work, work.g_try)
        for i in range(N):
            work.K[i, k] = (work.g_try[i] - work.g[i]) / PROBE
    eqs.position(c.t, work.q_c, eqs.data, terms)
    for k in range(m):
        for i in range(N):
            work.K[i, n + 1 + k] = 0.0
        for j in range(n):
            work.K[j, n + 1 + k] = terms.J[k, j] * (work.size[j] / work.row[k])
        work.K[n, n + 1 + k] = -terms.nu[k] / (work.row[k] * work.rate[0])
        work.K[n + 1 + k, n + 1 + k] = -c.gap
        work.K[N - 1, n + 1 + k] = work.u[k]
    for i in range(N):
        work.K[i, N - 1] = -work.u[i - n - 1] if n < i < N - 1 else 0.0


@inlined
def step_critical(eqs: Any, part: float, work: Any) -> None:
    """Go a ``part`` of Newton's step."""
    m, n = eqs.terms.J.shape
    c = work.critical[0]
    for j in range(n):
        work.dq[j] = -part * work.change[j] * work.size[j]
    eqs.retract(work.q_c, work.dq, eqs.data)
    c.t -= part * work.change[n] / work.rate[0]
    for i in range(m):
        work.u[i] -= part * work.change[n + 1 + i]
    c.gap -= part * work.change[n + m + 1]


@kernel
def note(eqs: Any, t: float, q: Any, taken: float, next_: float, rank: int, work: Any) -> None:
    """Note the last good position (t, q), whose ``terms`` and factors are at hand, and what singular position is near.

    It is looked for where the smallest pivot would vanish within a few steps, ``taken`` and ``next_`` being the last
    step and the next one. In a crossing the axes are not determined: those before it stay.
    """
    if rank == 0:
        return
    here = work.course[0]
    before, here.ratio = here.ratio, ratio(work.pivot, rank)
    here.ahead = time_left(before, here.ratio, taken)
    if here.ratio >= SINGULAR and here.ahead == np.inf:
        work.critical[0].in_vain = 0.0  # what comes next is another one
    kind = NONE
    if here.ratio < SINGULAR or here.ahead < AHEAD * next_:
        kind = judge(eqs, t, q, rank, work)
    if here.ratio < SINGULAR and kind != MISS:
        return
    here.known = 1
    for i in range(q.shape[0]):
        work.q_last[i] = q[i]
    for i in range(work.frame.shape[0]):
        work.frame_tau[i], work.frame_pivots[i] = work.tau[i], work.pivots[i]
        for j in range(work.frame.shape[1]):
            work.frame[i, j] = work.A[i, j]


@inlined
def time_left(before: float, now: float, taken: float) -> float:
    """Time until what has fallen from ``before`` to ``now`` in ``taken`` is nothing if it goes on so; else infinite."""
    return taken * now / (before - now) if now < before else np.inf


@kernel
def passed(eqs: Any, t: float, q: Any, rank: int, work: Any) -> bool:
    """Whether the way to (t, q), where ``terms`` are with their factors, stayed on its branch: it turned little or
    crossed another.
    """
    if rank == 0 or work.course[0].known == 0:
        return True
    turn = orientation(eqs.terms, rank, work)
    if turn == STRAIGHT:
        return True
    c = work.critical[0]
    c.kind, c.in_vain = NONE, 0.0  # critical points may form curves: what was known need not be the next one
    crossing = judge(eqs, t, q, rank, work) == CROSSING
    if crossing and ratio(work.pivot, rank) < SINGULAR:
        return True
    crossed = crossing and distance(work.q_c, q, work) <= PASSED * distance(work.q_last, q, work)
    return crossed if turn == FLIPPED else turn == BENT and not crossed


@kernel
def orientation(terms: Any, rank: int, work: Any) -> int:
    """Compare ``terms``, whose factors are at hand, with the frame of the last good position: STRAIGHT or FLIPPED and
    little turned, else BENT, or TURNED too far to tell.
    """
    few = 2 * rank < terms.J.shape[1]
    positive, steepest = by_normals(terms, rank, work) if few else by_tangents(terms, rank, work)
    if steepest <= LITTLE * LITTLE:
        return STRAIGHT if positive else FLIPPED
    return BENT if positive and steepest <= SLOPE * SLOPE else TURNED


@kernel
def by_normals(terms: Any, rank: int, work: Any) -> tuple[bool, float]:
    """Whether det C_n has kept its sign, and the largest square of a column of C_n^-1 C_t; for few rows."""
    n = terms.J.shape[1]
    positive, steepest = True, 0.0
    for i in range(rank):
        row, row_unit = work.J_work[i], work.row[work.frame_pivots[i]]
        for j in range(n):
            row[j] = terms.J[work.frame_pivots[i], j] * (work.size[j] / row_unit)
        turn_in(work.frame, work.frame_tau, rank, n, row)
        for j in range(rank):
            work.D[i, j] = row[j]
        positive = positive == (work.frame[i, i] > 0.0)
    if not factor_lu(work.D, rank, work.order):
        return False, np.inf
    for k in range(rank, n):
        square = 0.0
        for i in range(rank):
            work.b[i] = work.J_work[i, k]
        solve_lu(work.D, rank, work.order, work.b, work.x)
        for i in range(rank):
            square += work.x[i] * work.x[i]
        if not square < np.inf:
            return False, np.inf
        steepest = max(steepest, square)
    return positive == positive_determinant(work.D, rank, work.order), steepest


@kernel
def by_tangents(terms: Any, rank: int, work: Any) -> tuple[bool, float]:
    """The same for few freedoms, from N and T: what today's tangents, orthonormal, are in the frame's normals
    and tangents.

    The slope is N T^-1, so that its columns have the squares |T^-1 e_k|^2 - 1; and C_n = L (Q_1^T Q_1'), whose second
    factor has the determinant of T, as complementary minors of an orthogonal matrix are equal.
    """
    n = terms.J.shape[1]
    freedom, steepest = n - rank, 0.0
    for k in range(freedom):
        for j in range(n):
            work.f[j] = 1.0 if j == rank + k else 0.0
        turn_out(work.A, work.tau, rank, n, work.f)
        turn_in(work.frame, work.frame_tau, rank, n, work.f)
        for j in range(freedom):
            work.mass[j, k] = work.f[rank + j]
    same = same_side(rank, work)
    if not factor_lu(work.mass, freedom, work.order):
        return False, np.inf
    for k in range(freedom):
        for j in range(freedom):
            work.f[j] = 1.0 if j == k else 0.0
        solve_lu(work.mass, freedom, work.order, work.f, work.z)
        square = -1.0
        for j in range(freedom):
            square += work.z[j] * work.z[j]
        if not square < np.inf:
            return False, np.inf
        steepest = max(steepest, square)
    return same == positive_determinant(work.mass, freedom, work.order), steepest


@inlined
def same_side(rank: int, work: Any) -> bool:
    """Whether the rows that are the frame's, in L as it is now and as it was, have determinants of one sign."""
    positive, same = True, True
    for i in range(work.pivots.shape[0]):
        work.rows[work.pivots[i]] = i  # the place of a row in L
    for i in range(rank):
        positive = positive == (work.frame[i, i] > 0.0)
        work.order[i] = work.rows[work.frame_pivots[i]]
        same = same and work.order[i] < rank
    if same:
        return positive == positive_determinant(work.A, rank, work.order)
    for i in range(rank):
        k = work.rows[work.frame_pivots[i]]
        for j in range(rank):
            work.D[i, j] = work.A[k, j] if j <= k else 0.0
    return factor_lu(work.D, rank, work.order) and positive == positive_determinant(work.D, rank, work.order)


@kernel
def step_bound(t: float, q: Any, v: Any, taken: float, terms: Any, work: Any) -> float:
    """Longest step, s, after one of length ``taken``: the way to a near miss must not be jumped over, and a crossing
    must, from half a step before it to half a step after; no step ends where there are no digits.
    """
    c, here = work.critical[0], work.course[0]
    if c.kind == CROSSING and here.ahead > JUMP * taken and here.ratio > DARK:
        return LEAD * here.ahead
    if c.kind != MISS:
        return np.inf
    far = apart(t, q, work, terms)
    if far > FAR:
        c.kind = NONE
        return np.inf
    speed = scaled_length(v, work)
    if moves(terms):
        speed = np.sqrt(speed * speed + work.rate[0] ** 2)
    return PART * far / speed if speed > 0.0 else np.inf
