"""Singular positions: what is a crossing, what a near miss, and whether a step has passed one.

At a *critical point* the constraints lose a row of rank: there are forces u that balance with nothing behind them,

    J~^T u = 0,   nu~ . u = 0,   Phi~ = g u,   |u| = 1          (units as in :mod:`solvers.projection.workspace`)

in the unknowns q, t, u and g. g = u . Phi~ is the *gap*: by so much the loop misses the one that is singular there. If
it is nothing, branches of the motion cross in that point, and the motion goes straight on. If it is anything, they part
before they meet, within sqrt(g) of the point, and the motion turns into one of them. No ratio of singular values tells
the two apart, for a near miss has its ratio as small as sqrt(g); the gap does, and as g has no slope there it is known
to rounding. :mod:`solvers.projection.critical` finds the point.

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

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import factor_lu, positive_determinant, ratio, solve_lu, turn_in, turn_out

from .critical import FAR, dimension, moves, seek
from .workspace import distance, factor, scaled_length

NONE, CROSSING, MISS = 0, 1, 2
STRAIGHT, FLIPPED, BENT, TURNED = 0, 1, 2, 3

SINGULAR = 1e-3  # ratio of the smallest pivot of J~ to the largest below which a position is nearly singular
GAP = 1e-12  # largest gap of a crossing, in units of the rows; Phi is known to some 1e-16 of them
NEAR = 30.0  # a critical point is that of this position when it is no farther than so many ratios
AGAIN = 4.0  # by so much the ratio must have changed before a point that was not found is looked for again
LITTLE, SLOPE = 0.36, 1.7  # turns of a tangent in one step, as their tangents: 20 and 60 degrees
PASSED = 3.0  # a crossing that a step has passed lies within so many lengths of it
TURN = 0.75  # of the squared rate of fall: more than that must be lost before the ratio is nothing, or it goes through
CLOSED = 1e-5  # distance from a crossing, in units of size, at which closed positions are on one branch or on another
ROUND, LINE = 0.3, 0.8  # so near a crossing, in units of size, branches are lines; cosine of what is still the same
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
        c.kind, c.behind, c.in_vain = MISS, 0, 0.0
        if abs(c.gap) <= GAP:
            if dimension(eqs, work) >= eqs.terms.J.shape[1] - rank:
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


@kernel
def note(eqs: Any, t: float, q: Any, taken: float, next_: float, rank: int, work: Any) -> None:
    """Note the last good position (t, q), whose ``terms`` and factors are at hand, and what singular position is near.

    It is looked for where the smallest pivot would vanish within a few steps, ``taken`` and ``next_`` being the last
    step and the next one. In a crossing the axes are not determined: those before it stay.
    """
    if rank == 0:
        return
    here = work.course[0]
    watch(here, ratio(work.pivot, rank), taken)
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
    for i in range(work.row.shape[0]):
        work.nu_last[i] = eqs.terms.nu[i] / work.row[i]


@inlined
def watch(here: Any, now: float, taken: float) -> None:
    """Note the ratio and when it would vanish. Where it falls ever slower, and would hardly get there, the motion turns
    back in a singular position or beside it: then when that is, for a step must jump over it too.
    """
    here.ahead = time_left(here.ratio, now, taken)
    fall = (here.ratio - now) / taken if here.ratio > 0.0 and taken > 0.0 else 0.0
    if fall > 0.0 and here.fall > fall:
        slower = 2.0 * (here.fall - fall) / (here.taken + taken)
        end = fall - 0.5 * slower * taken  # at the end of the step, as in its middle it was ``fall``
        if end > 0.0 and 2.0 * slower * now > TURN * end * end:
            here.ahead = max(here.ahead, end / slower)
    here.fall, here.taken, here.ratio = fall, taken, now


@inlined
def time_left(before: float, now: float, taken: float) -> float:
    """Time until what has fallen from ``before`` to ``now`` in ``taken`` is nothing if it goes on so; else infinite."""
    return taken * now / (before - now) if now < before else np.inf


@kernel
def passed(eqs: Any, t: float, q: Any, exact: float, rank: int, work: Any) -> bool:
    """Whether the way to (t, q), where ``terms`` are with their factors, stayed on its branch: it turned little or
    crossed another. Nearer to a crossing than ``exact``, in units of size, branches are as good as one.
    """
    if rank == 0 or work.course[0].known == 0:
        return True
    return goes_on(eqs, t, q, rank, work) and not strayed(q, exact, rank, eqs.terms, work)


@kernel
def goes_on(eqs: Any, t: float, q: Any, rank: int, work: Any) -> bool:
    """What the orientation says of that."""
    turn = orientation(eqs.terms, rank, work)
    if turn == STRAIGHT:
        return True
    c = work.critical[0]
    alone = eqs.terms.J.shape[1] - rank == 1 and not moves(eqs.terms)  # else critical points may form curves
    if not (alone and c.kind == CROSSING and c.behind == 0):  # what was known need not be the next one
        c.kind, c.in_vain = NONE, 0.0
    crossing = judge(eqs, t, q, rank, work) == CROSSING
    if crossing and ratio(work.pivot, rank) < SINGULAR:
        return True
    crossed = crossing and distance(work.q_c, q, work) <= PASSED * distance(work.q_last, q, work)
    crossed = crossed and not turned_back(eqs, t, q, work)
    if crossed:
        c.behind = 1
    return crossed if turn == FLIPPED else turn == BENT and not crossed


@kernel
def strayed(q: Any, exact: float, rank: int, terms: Any, work: Any) -> bool:
    """Whether q lies off the line through the last good position and a crossing at hand, and so on another branch.

    The orientation does not tell that where only time moves, nor in the crossing itself; a line does, where the motion
    has one freedom and no more.
    """
    if work.critical[0].kind != CROSSING or terms.J.shape[1] - rank + moves(terms) != 1:
        return False
    along, here, last = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        now, before = (q[i] - work.q_c[i]) / work.size_q[i], (work.q_last[i] - work.q_c[i]) / work.size_q[i]
        along += now * before
        here += now * now
        last += before * before
    if max(here, last) > ROUND * ROUND or here < exact * exact or last < exact * exact:
        return False
    return along * along < LINE * LINE * here * last


@kernel
def turned_back(eqs: Any, t: float, q: Any, work: Any) -> bool:
    """Whether the drives have reversed since the last good position: a crossing they turn back in is not passed.

    What they would do now in that position is compared with what they did there: on the way their arms may have changed
    sign. ``terms`` (of positions) belong to (t, q), and do so again.
    """
    if not moves(eqs.terms):
        return False
    eqs.position(t, work.q_last, eqs.data, eqs.terms)
    same = 0.0
    for i in range(work.row.shape[0]):
        same += work.nu_last[i] * eqs.terms.nu[i] / work.row[i]
    eqs.position(t, q, eqs.data, eqs.terms)
    return same < 0.0


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
