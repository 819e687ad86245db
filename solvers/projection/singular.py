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

Where several rows lose their rank at once (:mod:`.block`) the sign turns with each, and a jump of one loop of many
turns tangents little: there :mod:`.passage` compares what vanishes in the critical point, before and after it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import ratio

from .block import begin_block, farthest, seek_block, seek_held
from .critical import FAR, dimension, moves, seek
from .orientation import BENT, FLIPPED, STRAIGHT, TURNED, orientation
from .passage import ACROSS, ASTRAY, hold_critical, may_pass, passage, scale_rows
from .workspace import distance, factor, scaled_length

NONE, CROSSING, MISS = 0, 1, 2

SINGULAR = 1e-3  # ratio of the smallest pivot of J~ to the largest below which a position is nearly singular
GAP = 1e-12  # largest gap of a crossing, in units of the rows; Phi is known to some 1e-16 of them
NEAR = 30.0  # a critical point is that of this position when it is no farther than so many ratios
AGAIN = 4.0  # by so much the ratio must have changed before a point that was not found is looked for again
PASSED = 3.0  # a crossing that a step has passed lies within so many lengths of it
TURN = 0.75  # of the squared rate of fall: more than that must be lost before the ratio is nothing, or it goes through
CLOSED = 1e-5  # distance from a crossing, in units of size, at which closed positions are on one branch or on another
ROUND, LINE = 0.3, 0.8  # so near a crossing, in units of size, branches are lines; cosine of what is still the same
LEAST_TURN = 2.0  # ratio of the pivots per length of a step (in units of size) above which no equation loses its rank
ACCURATE_DISTANCE = (
    1e-2  # distance from a critical point of several equations, in units of size, from which B is accurate
)
AHEAD = 3.0  # steps ahead that a singular position is looked for
JUMP = 0.7  # of the step before, to a crossing from where the next step jumps over it
LEAD = 0.67  # of a longer way, that the step before the jump may go
DARK = 1e-7  # ratio so near a crossing that any step leads out
NO_FARTHER = 4.0  # a point in which more equations vanish counts, in ways to the one in which fewer do
PART = 0.3  # of the way to a near miss that one step may go


@kernel
def judge(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """What the singular position near q is; ``terms`` (of positions) and factors belong to (t, q), and do so again."""
    c, here = work.critical[0], ratio(work.pivot, rank)
    if c.kind != NONE and c.slope * apart(t, q, work, eqs.terms) <= NEAR * here:
        return c.kind
    c.kind = NONE
    if c.in_vain < AGAIN * here and here < AGAIN * c.in_vain:
        return NONE
    c.in_vain = here
    c.kind = find(eqs, t, q, rank, work)
    if c.kind != NONE:
        c.behind, c.in_vain, c.slope = 0, 0.0, 1.0
        if c.lost > 1:  # in chains of loops pivots are as small far from it
            c.slope = min(1.0, here / max(apart(t, q, work, eqs.terms), 1e-300))
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return c.kind


@kernel
def find(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """Look for the critical point next to q, first for one of several rows where several pivots are small."""
    c, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
    begun = begin_block(eqs, t, q, rank, work) if rank > 2 else 0
    several = 0 < begun < rank - 1
    if several and find_block(eqs, t, q, begun, rank, work) != NONE:
        return CROSSING if c.gap <= GAP else MISS
    if begun == 0 and rank > 2 and work.course[0].known == 1:  # no pivot is far below the others, here or ahead
        return NONE
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    if seek(eqs, t, q, rank, work):
        kind = MISS
        if abs(c.gap) <= GAP:
            if dimension(eqs, work) >= freedom:
                kind = CROSSING
            else:
                c.gap = np.inf
        c.lost = hold_critical(eqs, rank, work)
        if c.lost != 1 or (rank > 1 and abs(work.C[rank - 2, rank - 2]) < SINGULAR * abs(work.C[0, 0])):
            c.lost = 0
        return kind
    if rank > 2 and not several:
        eqs.position(t, q, eqs.data, eqs.terms)
        factor(eqs.terms, work)
        begin_block(eqs, t, q, rank, work)
        return find_block(eqs, t, q, 0, rank, work)
    return NONE


@kernel
def find_block(eqs: Any, t: float, q: Any, begun: int, rank: int, work: Any) -> int:
    """The same for one of several rows, all but ``begun`` if that is not zero; NONE too if motions of more degrees
    of freedom pass near it.
    """
    c, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
    regular = seek_block(eqs, t, q, rank, work)
    if begun > 0 and regular != begun:
        nearest = farthest(q, t, work) if regular > 0 else np.inf
        begin_block(eqs, t, q, rank, work)
        held = seek_held(eqs, t, q, begun, rank, work)
        if held > 0 and farthest(q, t, work) <= NO_FARTHER * nearest:
            regular = held
        elif regular > 0:
            begin_block(eqs, t, q, rank, work)
            regular = seek_block(eqs, t, q, rank, work)
    if regular == 0 or c.spread < freedom:
        return NONE
    c.lost = hold_critical(eqs, rank, work)
    if c.lost == 0:
        return NONE
    return CROSSING if c.gap <= GAP else MISS


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
    several = kind == CROSSING and work.critical[0].lost > 1 and distance(work.q_c, q, work) > ACCURATE_DISTANCE
    if here.ratio < SINGULAR and kind != MISS and not several:
        return
    here.known = 1
    for i in range(q.shape[0]):
        work.q_last[i] = q[i]
    for i in range(work.frame.shape[0]):
        work.frame_tau[i], work.frame_pivots[i] = work.tau[i], work.pivots[i]
        for j in range(work.frame.shape[1]):
            work.frame[i, j] = work.A[i, j]
    scale_rows(eqs.terms, work, work.J_last)
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
    return goes_on(eqs, t, q, exact, rank, work) and not strayed(q, exact, rank, eqs.terms, work)


@kernel
def goes_on(eqs: Any, t: float, q: Any, exact: float, rank: int, work: Any) -> bool:
    """What orientation and the critical point at hand say of that.

    An orientation that has stayed is no proof: an even number of rows may have vanished on the way.
    """
    turn, c = orientation(eqs.terms, rank, work), work.critical[0]
    at_hand = c.kind == CROSSING and within_reach(q, work)
    if turn == STRAIGHT and not at_hand and not suspicious(q, rank, eqs.terms, work):
        return True
    if at_hand and comparable(q, exact, eqs.terms, work):
        side = passage(eqs.terms, rank, work)
        if side == ASTRAY:
            return False
        if goes_straight(eqs, t, q, side, turn, rank, work):
            return True
    alone = eqs.terms.J.shape[1] - rank == 1 and not moves(eqs.terms)  # else critical points may form curves
    keep = at_hand if turn == STRAIGHT else alone and c.kind == CROSSING and c.behind == 0
    if not keep:  # what was known need not be the next one
        c.kind, c.in_vain = NONE, 0.0
    crossing = judge(eqs, t, q, rank, work) == CROSSING
    inside = crossing and ratio(work.pivot, rank) < SINGULAR
    near = c.kind != NONE and within_reach(q, work)
    if crossing and (near or inside) and comparable(q, exact, eqs.terms, work):
        side = passage(eqs.terms, rank, work)
        return side != ASTRAY and (inside or goes_straight(eqs, t, q, side, turn, rank, work))
    if inside:
        return True
    if turn == STRAIGHT:
        return crossing or not (near and c.lost > 1)
    crossed = crossing and near and not turned_back(eqs, t, q, work)
    if crossed:
        c.behind = 1
    return crossed if turn == FLIPPED else turn == BENT and not crossed


@inlined
def within_reach(q: Any, work: Any) -> bool:
    """Whether the step to q may have passed the critical point at hand. Where several rows vanish one loop of many may
    have gone astray, and the coordinate that went farthest counts.
    """
    if work.critical[0].lost > 1:
        far, went = 0.0, 0.0
        for i in range(q.shape[0]):
            far = max(far, abs(work.q_c[i] - q[i]) / work.size_q[i])
            went = max(went, abs(work.q_last[i] - q[i]) / work.size_q[i])
        return far <= PASSED * went
    return distance(work.q_c, q, work) <= PASSED * distance(work.q_last, q, work)


@inlined
def suspicious(q: Any, rank: int, terms: Any, work: Any) -> bool:
    """Whether the step to q was so long that rows may have vanished in pairs, and those of q do not deny it."""
    nearest = max(ratio(work.pivot, rank), work.course[0].ratio)
    return rank > 1 and nearest <= LEAST_TURN * distance(work.q_last, q, work) and may_pass(terms, rank, work)


@inlined
def comparable(q: Any, exact: float, terms: Any, work: Any) -> bool:
    """Whether :func:`solvers.projection.passage.passage` decides the branch that q is on. For a single row other tests
    tell it too: of these far from the crossing, where branches are no lines, and where drives may turn back.
    """
    c, here, last = work.critical[0], distance(work.q_c, q, work), distance(work.q_c, work.q_last, work)
    if c.lost == 0 or here < exact or last < exact:
        return False
    return c.lost > 1 or (max(here, last) <= ROUND and not moves(terms))


@kernel
def goes_straight(eqs: Any, t: float, q: Any, side: int, turn: int, rank: int, work: Any) -> bool:
    """Whether the side of the crossing at hand that q is on agrees with where it lies, and with the orientation, which
    turns with each row that vanishes.
    """
    c = work.critical[0]
    if eqs.terms.J.shape[1] - rank + moves(eqs.terms) == 1:
        along = 0.0
        for i in range(q.shape[0]):
            along += (q[i] - work.q_c[i]) * (work.q_last[i] - work.q_c[i]) / work.size_q[i] ** 2
        if (side == ACROSS) != (along < 0.0):
            return False
    if side == ACROSS:
        if turned_back(eqs, t, q, work):
            return False
        c.behind = 1
    return turn != TURNED and (turn == FLIPPED) == (side == ACROSS and c.lost % 2 == 1)


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
