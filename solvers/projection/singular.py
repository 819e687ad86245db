"""Singular configurations: crossings, near misses, and whether a step has passed one.

At a *critical point* the constraint Jacobian loses one rank (in the sense of bifurcation theory). There is a unit left
null vector u of the scaled Jacobian: constraint forces u produce no generalized force (self-stress),

    J~^T u = 0,   nu~ . u = 0,   Phi~ = g u,   |u| = 1          (units as in :mod:`solvers.projection.workspace`)

in the unknowns q, t, u and g. g = u . Phi~ is the *gap*, the distance of the loop from one that is singular there
(unfolding parameter). If it is zero, branches of the motion cross in that point, and the motion continues straight on.
If it is not zero, the branches part within a distance sqrt(g) of the point, and the motion turns into one of them. No
ratio of singular values distinguishes the two cases, since it is as small as sqrt(g) at a near miss. The gap does, and
since g is stationary there, it is known to rounding. :mod:`solvers.projection.critical` finds the point.

A motion of several degrees of freedom passes through critical points only if these divide the reachable positions, that
is if their dimension is smaller by one. Otherwise it passes next to them, as next to the tip of a cone: a near miss
too.

A step that jumps from one branch to another changes the *orientation*: in the axes of the last position, normals before
tangents, the rows of J~ are C = [C_n C_t]. While C_n = J~ Q_1 keeps the sign of its determinant no position between was
singular, and y = -C_n^-1 C_t is the slope of the new tangents relative to the previous ones. At a crossing the sign
changes and the slope remains small. If the slope is large, the step has changed the branch. In the crossing itself the
orientation is not determined; the position after it is compared with that before.

If several rows lose their rank at once (:mod:`.block`) the sign changes with each, and a jump of one loop of many
changes the tangents only slightly. Then :mod:`.passage` compares the part of J~ that is zero in the critical point,
before and after it. A critical point does not describe equations that lose their rank next to it. Therefore the
equations that may have lost their rank are counted in each step, and all that the critical point does not explain must
be shown to keep it; a step in which they are not is refused.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import ratio

from .block import begin_block, farthest, seek_block, seek_held
from .critical import FAR, dimension, moves, seek
from .orientation import BENT, FLIPPED, STRAIGHT, TURNED, orientation
from .passage import ACROSS, ASTRAY, count_doubtful, hold_critical, others_stay, passage, scale_rows
from .workspace import distance, factor, scaled_length

NONE, CROSSING, MISS = 0, 1, 2

SINGULAR = 1e-3  # ratio of the smallest pivot of J~ to the largest below which a position is nearly singular
GAP = 1e-12  # largest gap of a crossing, in units of the rows; Phi is known to some 1e-16 of them
NEAR = 30.0  # a critical point belongs to this position if its distance is at most this multiple of the ratio
AGAIN = 4.0  # factor by which the ratio must change before a point that was not found is searched again
PASSED = 3.0  # a crossing that a step has passed lies within this multiple of its length
TURN = 0.75  # of the squared rate of decrease: if less is lost before the ratio is zero, the crossing is passed
CLOSED = 1e-5  # distance from a crossing, in units of size, at which closed positions are on one branch or on another
ROUND, LINE = 0.3, 0.8  # distance from a crossing up to which branches are lines, in units of size; cosine
LEAST_TURN = 2.0  # ratio of the pivots per length of a step (in units of size) above which no equation loses its rank
ACCURATE_DISTANCE = 1e-2  # from a critical point of several equations, in units of size, from which B is accurate
AHEAD = 3.0  # steps ahead for which a singular configuration is searched
JUMP = 0.7  # of the previous step: distance to a crossing from which the next step jumps over it
LEAD = 0.67  # of a longer distance, that the step before the jump may cover
DARK = 1e-7  # ratio so near a crossing that any step leads away from it
NO_FARTHER = 4.0  # largest distance of a point with more dependent equations, in distances of one with fewer
PART = 0.3  # of the way to a near miss that one step may go


@kernel
def judge(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """Classify the singular configuration near q: NONE, CROSSING or MISS.

    ``terms`` (of positions) and factors belong to (t, q) before and after the call.
    """
    c, here = work.critical[0], ratio(work.pivot, rank)
    if c.kind != NONE and belongs(t, q, rank, work, eqs.terms):
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
    """Search the critical point next to q, first one of several rows if several pivots are small."""
    c, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
    begun = begin_block(eqs, t, q, rank, work) if rank > 2 else 0
    several = 0 < begun < rank - 1
    if several and find_block(eqs, t, q, begun, rank, work) != NONE and c.lost > 1:
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
        return kind
    if rank > 2 and not several:
        eqs.position(t, q, eqs.data, eqs.terms)
        factor(eqs.terms, work)
        begin_block(eqs, t, q, rank, work)
        return find_block(eqs, t, q, 0, rank, work)
    return NONE


@kernel
def find_block(eqs: Any, t: float, q: Any, begun: int, rank: int, work: Any) -> int:
    """The same for a point of several rows, all but ``begun`` if that is not zero; also NONE if motions of more degrees
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
    """Distance to the critical point, in units of size; includes time if constraints depend on it."""
    far = distance(q, work.q_c, work)
    if moves(terms):
        far = np.sqrt(far * far + ((t - work.critical[0].t) * work.rate[0]) ** 2)
    return far


@inlined
def belongs(t: float, q: Any, rank: int, work: Any, terms: Any) -> bool:
    """Whether the critical point is the one that makes the smallest pivot here so small."""
    return work.critical[0].slope * apart(t, q, work, terms) <= NEAR * ratio(work.pivot, rank)


@kernel
def note(eqs: Any, t: float, q: Any, taken: float, next_: float, rank: int, work: Any) -> None:
    """Record the last accepted position (t, q), with its ``terms`` and factors, and the nearest singular configuration.

    It is searched if the smallest pivot would be zero within a few steps; ``taken`` and ``next_`` are the last
    step and the next one. In a crossing the axes are not determined: the previous ones are kept.
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
    if here.ratio >= SINGULAR or determined(q, kind, rank, eqs.terms, work):
        hold_frame(q, eqs.terms, work)


@kernel
def hold_frame(q: Any, terms: Any, work: Any) -> None:
    """Keep q, whose ``terms`` and factors are at hand, as the position that later ones are compared with."""
    work.course[0].known = 1
    for i in range(q.shape[0]):
        work.q_last[i] = q[i]
    for i in range(work.frame.shape[0]):
        work.frame_tau[i], work.frame_pivots[i] = work.tau[i], work.pivots[i]
        for j in range(work.frame.shape[1]):
            work.frame[i, j] = work.A[i, j]
    scale_rows(terms, work, work.J_last)
    for i in range(work.row.shape[0]):
        work.nu_last[i] = terms.nu[i] / work.row[i]


@inlined
def determined(q: Any, kind: int, rank: int, terms: Any, work: Any) -> bool:
    """Whether the axes are determined in q, where J~ is nearly singular: next to a near miss, far from a crossing of
    several equations, or if all equations but one, whose sign :func:`passed` has compared, have kept their rank since
    the last position of which this is known.
    """
    if kind == CROSSING:
        return work.critical[0].lost > 1 and distance(work.q_c, q, work) > ACCURATE_DISTANCE
    return kind == MISS or (work.course[0].known == 1 and count_doubtful(terms, rank, work) <= 1)


@inlined
def watch(here: Any, now: float, taken: float) -> None:
    """Extrapolate the pivot ratio; ``ahead`` is the estimated time to the singular configuration (inf if none).

    The extrapolation is linear. If the decrease slows down so that the ratio would just about reach zero, the motion
    reverses in or near the singular configuration, and the minimum of the quadratic extrapolation is used instead,
    because a step must jump over that as well.
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
    """Time until a quantity that fell from ``before`` to ``now`` in ``taken`` is zero, linearly; else infinite."""
    return taken * now / (before - now) if now < before else np.inf


@kernel
def passed(eqs: Any, t: float, q: Any, exact: float, rank: int, work: Any) -> bool:
    """Whether the step to (t, q), with its ``terms`` and factors, stayed on its branch: the orientation changed little,
    or it crossed another branch.

    Within the scaled distance ``exact`` of a bifurcation the branches cannot be distinguished numerically, and the step
    is accepted.
    """
    if rank == 0 or work.course[0].known == 0:
        return True
    return goes_on(eqs, t, q, exact, rank, work) and not strayed(q, exact, rank, eqs.terms, work)


@kernel
def goes_on(eqs: Any, t: float, q: Any, exact: float, rank: int, work: Any) -> bool:
    """The same by the orientation and the known critical point.

    An unchanged orientation is no proof if more than one equation may have lost its rank on the way. Then a crossing
    must explain it, and all other equations must have kept their rank.
    """
    turn, c = orientation(eqs.terms, rank, work), work.critical[0]
    at_hand = c.kind == CROSSING and within_reach(q, work)
    doubtful = doubtful_equations(q, rank, eqs.terms, work)
    if turn == STRAIGHT and not at_hand and doubtful == 0:
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
    inside = crossing and ratio(work.pivot, rank) < SINGULAR and belongs(t, q, rank, work, eqs.terms)
    near = c.kind != NONE and within_reach(q, work)
    explained = crossing and (near or inside) and c.lost > 0
    if explained and comparable(q, exact, eqs.terms, work):
        side = passage(eqs.terms, rank, work)
        if side == ASTRAY or not on_side(q, side, eqs.terms, rank, work):
            return False
        return inside or goes_straight(eqs, t, q, side, turn, rank, work)
    if (explained and not others_stay(eqs.terms, rank, work)) or (doubtful > 1 and not explained):
        return False
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
    """Whether the step to q may have passed the known critical point. If several rows lose their rank one loop of many
    may have left its branch, and the largest change of a coordinate is used.
    """
    if work.critical[0].lost > 1:
        far, went = 0.0, 0.0
        for i in range(q.shape[0]):
            far = max(far, abs(work.q_c[i] - q[i]) / work.size_q[i])
            went = max(went, abs(work.q_last[i] - q[i]) / work.size_q[i])
        return far <= PASSED * went
    return distance(work.q_c, q, work) <= PASSED * distance(work.q_last, q, work)


@inlined
def doubtful_equations(q: Any, rank: int, terms: Any, work: Any) -> int:
    """How many equations may have lost their rank in the step to q: none if it was short, unless counted."""
    nearest = max(ratio(work.pivot, rank), work.course[0].ratio)
    if rank == 1 or nearest > LEAST_TURN * distance(work.q_last, q, work):
        return 0
    return count_doubtful(terms, rank, work)


@inlined
def comparable(q: Any, exact: float, terms: Any, work: Any) -> bool:
    """Whether :func:`solvers.projection.passage.passage` determines the branch of q. For a single row other tests are
    used far from the crossing, where branches are not straight, and if drives may reverse.
    """
    c, here, last = work.critical[0], distance(work.q_c, q, work), distance(work.q_c, work.q_last, work)
    if c.lost == 0 or here < exact or last < exact:
        return False
    return c.lost > 1 or (max(here, last) <= ROUND and not moves(terms))


@kernel
def goes_straight(eqs: Any, t: float, q: Any, side: int, turn: int, rank: int, work: Any) -> bool:
    """Whether the side of the known crossing agrees with the position of q and with the orientation, whose sign changes
    with each row that loses its rank.
    """
    c = work.critical[0]
    if not on_side(q, side, eqs.terms, rank, work):
        return False
    if side == ACROSS:
        if turned_back(eqs, t, q, work):
            return False
        c.behind = 1
    return turn != TURNED and (turn == FLIPPED) == (side == ACROSS and c.lost % 2 == 1)


@inlined
def on_side(q: Any, side: int, terms: Any, rank: int, work: Any) -> bool:
    """Whether q is on this side of the known crossing; that is known with one degree of freedom."""
    if terms.J.shape[1] - rank + moves(terms) != 1:
        return True
    along = 0.0
    for i in range(q.shape[0]):
        along += (q[i] - work.q_c[i]) * (work.q_last[i] - work.q_c[i]) / work.size_q[i] ** 2
    return (side == ACROSS) == (along < 0.0)


@kernel
def strayed(q: Any, exact: float, rank: int, terms: Any, work: Any) -> bool:
    """Whether q is not on the line through the last accepted position and the known crossing, and so on another branch.

    The orientation does not show this if only time changes, nor in the crossing itself. The line does if the motion
    has exactly one degree of freedom.
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
    """Whether the drives have reversed since the last accepted position: a crossing in which they reverse is not
    passed.

    Their present effect in that position is compared with their previous effect there, since their lever arms may have
    changed sign on the way. ``terms`` (of positions) belong to (t, q) before and after the call.
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
    """Longest step, s, after one of length ``taken``.

    A step must not jump over a near miss. It must jump over a crossing, from half a step before it to half a step after
    it. A step must not end where the smallest pivot is below ``DARK`` of the largest, since the acceleration is not
    resolved there.
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
