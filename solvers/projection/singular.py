"""Singular configurations: crossings, near misses, and whether a step has passed one.

At a *critical point* the constraint Jacobian loses one rank (in the sense of bifurcation theory). There is a unit left
null vector u of the scaled Jacobian: constraint forces u produce no generalized force (self-stress),

    J~^T u = 0,   nu~ . u = 0,   Phi~ = g u,   |u| = 1          (units as in :mod:`solvers.projection.workspace`)

in the unknowns q, t, u and g. g = u . Phi~ is the *gap*, the distance of the loop from one that is singular there
(unfolding parameter). If it is zero, branches of the motion cross in that point (BIFURCATION), and the motion continues
straight on. If it is not zero (IMPERFECT), the branches part within a distance sqrt(g) of the point, and the motion
turns into one of them. No ratio of singular values distinguishes the two cases, since it is as small as sqrt(g) at a
near miss. The gap does, and since g is stationary there, it is known to rounding. :mod:`solvers.projection.critical`
finds the point.

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
from solvers.linalg.dense import pivot_ratio

from .block import find_block_critical_point, find_critical_point_of_rank, max_coordinate_distance, start_block_search
from .critical import MAX_SEARCH_DISTANCE, critical_set_dimension, find_critical_point, is_rheonomic
from .orientation import INDETERMINATE, LARGE_ROTATION, ORIENTATION_KEPT, ORIENTATION_REVERSED, compare_orientation
from .passage import (
    OPPOSITE_SIDE,
    OTHER_BRANCH,
    classify_passage,
    count_doubtful_rows,
    fill_scaled_jacobian,
    regular_equations_keep_rank,
    store_critical_factors,
)
from .workspace import distance, factor, scaled_norm

NO_CRITICAL_POINT, BIFURCATION, IMPERFECT = 0, 1, 2

# ratio of the smallest pivot of J~ to the largest below which a position is nearly singular
SINGULAR_PIVOT_RATIO = 1e-3
MAX_BIFURCATION_GAP = 1e-12  # largest gap of a crossing, in units of the rows; Phi is known to some 1e-16 of them
# a critical point belongs to this position if its distance is at most this multiple of the ratio
MAX_DISTANCE_RATIO = 30.0
SEARCH_REPEAT_FACTOR = 4.0  # factor by which the ratio must change before a point that was not found is searched again
PASSED_DISTANCE_FACTOR = 3.0  # a crossing that a step has passed lies within this multiple of its length
# of the squared rate of decrease: if less is lost before the ratio is zero, the crossing is passed
TURNING_RATIO = 0.75
# distance from a crossing, in units of size, at which closed positions are on one branch or on another
BRANCH_RESOLUTION = 1e-5
# distance from a crossing up to which branches are lines, in units of size; cosine
MAX_LINE_DISTANCE, MIN_LINE_COSINE = 0.3, 0.8
# ratio of the pivots per length of a step (in units of size) above which no equation loses its rank
SAFE_PIVOT_RATIO_PER_LENGTH = 2.0
MIN_ACCURATE_DISTANCE = 1e-2  # from a critical point of several equations, in units of size, from which B is accurate
LOOKAHEAD_STEPS = 3.0  # steps ahead for which a singular configuration is searched
JUMP_STEP_RATIO = 0.7  # of the previous step: distance to a crossing from which the next step jumps over it
APPROACH_FRACTION = 0.67  # of a longer distance, that the step before the jump may cover
MIN_END_PIVOT_RATIO = 1e-7  # ratio so near a crossing that any step leads away from it
BLOCK_DISTANCE_FACTOR = 4.0  # largest distance of a point with more dependent equations, in distances of one with fewer
IMPERFECT_STEP_FRACTION = 0.3  # of the way to a near miss that one step may go


@kernel
def classify_singularity(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """Classify the singular configuration near q: NO_CRITICAL_POINT, BIFURCATION or IMPERFECT.

    ``terms`` (of positions) and factors belong to (t, q) before and after the call.
    """
    c, here = work.critical[0], pivot_ratio(work.pivot, rank)
    if c.kind != NO_CRITICAL_POINT and critical_point_explains_pivot(t, q, rank, work, eqs.terms):
        return c.kind
    c.kind = NO_CRITICAL_POINT
    if c.failed_search_ratio < SEARCH_REPEAT_FACTOR * here and here < SEARCH_REPEAT_FACTOR * c.failed_search_ratio:
        return NO_CRITICAL_POINT
    c.failed_search_ratio = here
    c.kind = search_critical_point(eqs, t, q, rank, work)
    if c.kind != NO_CRITICAL_POINT:
        c.is_passed, c.failed_search_ratio, c.slope = 0, 0.0, 1.0
        if c.lost > 1:  # in chains of loops pivots are as small far from it
            c.slope = min(1.0, here / max(distance_to_critical_point(t, q, work, eqs.terms), 1e-300))
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return c.kind


@kernel
def search_critical_point(eqs: Any, t: float, q: Any, rank: int, work: Any) -> int:
    """Search the critical point next to q, first one of several rows if several pivots are small."""
    c, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
    begun = start_block_search(eqs, t, q, rank, work) if rank > 2 else 0
    several = 0 < begun < rank - 1
    if several and search_block_critical_point(eqs, t, q, begun, rank, work) != NO_CRITICAL_POINT and c.lost > 1:
        return BIFURCATION if c.bifurcation_gap <= MAX_BIFURCATION_GAP else IMPERFECT
    # no pivot is far below the others, here or ahead
    if begun == 0 and rank > 2 and work.branch_history[0].is_frame_known == 1:
        return NO_CRITICAL_POINT
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    if find_critical_point(eqs, t, q, rank, work):
        kind = IMPERFECT
        if abs(c.bifurcation_gap) <= MAX_BIFURCATION_GAP:
            if critical_set_dimension(eqs, work) >= freedom:
                kind = BIFURCATION
            else:
                c.bifurcation_gap = np.inf
        c.lost = store_critical_factors(eqs, rank, work)
        return kind
    if rank > 2 and not several:
        eqs.position(t, q, eqs.data, eqs.terms)
        factor(eqs.terms, work)
        start_block_search(eqs, t, q, rank, work)
        return search_block_critical_point(eqs, t, q, 0, rank, work)
    return NO_CRITICAL_POINT


@kernel
def search_block_critical_point(eqs: Any, t: float, q: Any, begun: int, rank: int, work: Any) -> int:
    """The same for a point of several rows, all but ``begun`` if that is not zero; also NONE if motions of more degrees
    of freedom pass near it.
    """
    c, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
    regular = find_block_critical_point(eqs, t, q, rank, work)
    if begun > 0 and regular != begun:
        nearest = max_coordinate_distance(q, t, work) if regular > 0 else np.inf
        start_block_search(eqs, t, q, rank, work)
        held = find_critical_point_of_rank(eqs, t, q, begun, rank, work)
        if held > 0 and max_coordinate_distance(q, t, work) <= BLOCK_DISTANCE_FACTOR * nearest:
            regular = held
        elif regular > 0:
            start_block_search(eqs, t, q, rank, work)
            regular = find_block_critical_point(eqs, t, q, rank, work)
    if regular == 0 or c.set_dimension < freedom:
        return NO_CRITICAL_POINT
    c.lost = store_critical_factors(eqs, rank, work)
    if c.lost == 0:
        return NO_CRITICAL_POINT
    return BIFURCATION if c.bifurcation_gap <= MAX_BIFURCATION_GAP else IMPERFECT


@kernel
def distance_to_critical_point(t: float, q: Any, work: Any, terms: Any) -> float:
    """Distance to the critical point, in units of size; includes time if constraints depend on it."""
    far = distance(q, work.q_c, work)
    if is_rheonomic(terms):
        far = np.sqrt(far * far + ((t - work.critical[0].t) * work.rate[0]) ** 2)
    return far


@inlined
def critical_point_explains_pivot(t: float, q: Any, rank: int, work: Any, terms: Any) -> bool:
    """Whether the critical point is the one that makes the smallest pivot here so small."""
    far = distance_to_critical_point(t, q, work, terms)
    return work.critical[0].slope * far <= MAX_DISTANCE_RATIO * pivot_ratio(work.pivot, rank)


@kernel
def record_accepted(eqs: Any, t: float, q: Any, taken: float, next_: float, rank: int, work: Any) -> None:
    """Record the last accepted position (t, q), with its ``terms`` and factors, and the nearest singular configuration.

    It is searched if the smallest pivot would be zero within a few steps; ``taken`` and ``next_`` are the last
    step and the next one. In a crossing the axes are not determined: the previous ones are kept.
    """
    if rank == 0:
        return
    here = work.branch_history[0]
    extrapolate_pivot_ratio(here, pivot_ratio(work.pivot, rank), taken)
    if here.pivot_ratio >= SINGULAR_PIVOT_RATIO and here.time_to_singular == np.inf:
        work.critical[0].failed_search_ratio = 0.0  # what comes next is another one
    kind = NO_CRITICAL_POINT
    if here.pivot_ratio < SINGULAR_PIVOT_RATIO or here.time_to_singular < LOOKAHEAD_STEPS * next_:
        kind = classify_singularity(eqs, t, q, rank, work)
    if here.pivot_ratio >= SINGULAR_PIVOT_RATIO or is_frame_determined(q, kind, rank, eqs.terms, work):
        store_reference_frame(q, eqs.terms, work)


@kernel
def store_reference_frame(q: Any, terms: Any, work: Any) -> None:
    """Store q, with its ``terms`` and factors, as the position with which later ones are compared."""
    work.branch_history[0].is_frame_known = 1
    for i in range(q.shape[0]):
        work.q_last[i] = q[i]
    for i in range(work.frame.shape[0]):
        work.frame_tau[i], work.frame_pivots[i] = work.tau[i], work.pivots[i]
        for j in range(work.frame.shape[1]):
            work.frame[i, j] = work.A[i, j]
    fill_scaled_jacobian(terms, work, work.J_last)
    for i in range(work.row.shape[0]):
        work.nu_last[i] = terms.nu[i] / work.row[i]


@inlined
def is_frame_determined(q: Any, kind: int, rank: int, terms: Any, work: Any) -> bool:
    """Whether the axes are determined in q, where J~ is nearly singular: next to a near miss, far from a crossing of
    several equations, or if all equations but one, whose sign :func:`on_same_branch` has compared, have kept their rank
    since the last position of which this is known.
    """
    if kind == BIFURCATION:
        return work.critical[0].lost > 1 and distance(work.q_c, q, work) > MIN_ACCURATE_DISTANCE
    return kind == IMPERFECT or (
        work.branch_history[0].is_frame_known == 1 and count_doubtful_rows(terms, rank, work) <= 1
    )


@inlined
def extrapolate_pivot_ratio(here: Any, now: float, taken: float) -> None:
    """Extrapolate the pivot ratio; ``time_to_singular`` is the estimated time to the singular configuration (inf if
    none).

    The extrapolation is linear. If the decrease slows down so that the ratio would just about reach zero, the motion
    reverses in or near the singular configuration, and the minimum of the quadratic extrapolation is used instead,
    because a step must jump over that as well.
    """
    here.time_to_singular = extrapolate_to_zero(here.pivot_ratio, now, taken)
    fall = (here.pivot_ratio - now) / taken if here.pivot_ratio > 0.0 and taken > 0.0 else 0.0
    if fall > 0.0 and here.decrease_rate > fall:
        slower = 2.0 * (here.decrease_rate - fall) / (here.step + taken)
        end = fall - 0.5 * slower * taken  # at the end of the step, as in its middle it was ``fall``
        if end > 0.0 and 2.0 * slower * now > TURNING_RATIO * end * end:
            here.time_to_singular = max(here.time_to_singular, end / slower)
    here.decrease_rate, here.step, here.pivot_ratio = fall, taken, now


@inlined
def extrapolate_to_zero(before: float, now: float, taken: float) -> float:
    """Time until a quantity that fell from ``before`` to ``now`` in ``taken`` is zero, linearly; else infinite."""
    return taken * now / (before - now) if now < before else np.inf


@kernel
def on_same_branch(eqs: Any, t: float, q: Any, exact: float, rank: int, work: Any) -> bool:
    """Whether the step to (t, q), with its ``terms`` and factors, stayed on its branch: the orientation changed little,
    or it crossed another branch.

    Within the scaled distance ``exact`` of a bifurcation the branches cannot be distinguished numerically, and the step
    is accepted.
    """
    if rank == 0 or work.branch_history[0].is_frame_known == 0:
        return True
    return orientation_preserved(eqs, t, q, exact, rank, work) and not left_branch_line(q, exact, rank, eqs.terms, work)


@kernel
def orientation_preserved(eqs: Any, t: float, q: Any, exact: float, rank: int, work: Any) -> bool:
    """The same by the orientation and the known critical point.

    An unchanged orientation is no proof if more than one equation may have lost its rank on the way. Then a crossing
    must explain it, and all other equations must have kept their rank.
    """
    turn, c = compare_orientation(eqs.terms, rank, work), work.critical[0]
    at_hand = c.kind == BIFURCATION and reaches_critical_point(q, work)
    doubtful = count_doubtful_equations(q, rank, eqs.terms, work)
    if turn == ORIENTATION_KEPT and not at_hand and doubtful == 0:
        return True
    if at_hand and is_passage_comparable(q, exact, eqs.terms, work):
        side = classify_passage(eqs.terms, rank, work)
        if side == OTHER_BRANCH:
            return False
        if passes_straight(eqs, t, q, side, turn, rank, work):
            return True
    alone = eqs.terms.J.shape[1] - rank == 1 and not is_rheonomic(eqs.terms)  # else critical points may form curves
    keep = at_hand if turn == ORIENTATION_KEPT else alone and c.kind == BIFURCATION and c.is_passed == 0
    if not keep:  # what was known need not be the next one
        c.kind, c.failed_search_ratio = NO_CRITICAL_POINT, 0.0
    crossing = classify_singularity(eqs, t, q, rank, work) == BIFURCATION
    inside = (
        crossing
        and pivot_ratio(work.pivot, rank) < SINGULAR_PIVOT_RATIO
        and critical_point_explains_pivot(t, q, rank, work, eqs.terms)
    )
    near = c.kind != NO_CRITICAL_POINT and reaches_critical_point(q, work)
    explained = crossing and (near or inside) and c.lost > 0
    if explained and is_passage_comparable(q, exact, eqs.terms, work):
        side = classify_passage(eqs.terms, rank, work)
        if side == OTHER_BRANCH or not is_on_side(q, side, eqs.terms, rank, work):
            return False
        return inside or passes_straight(eqs, t, q, side, turn, rank, work)
    if (explained and not regular_equations_keep_rank(eqs.terms, rank, work)) or (doubtful > 1 and not explained):
        return False
    if inside:
        return True
    if turn == ORIENTATION_KEPT:
        return crossing or not (near and c.lost > 1)
    crossed = crossing and near and not drive_reversed(eqs, t, q, work)
    if crossed:
        c.is_passed = 1
    return crossed if turn == ORIENTATION_REVERSED else turn == LARGE_ROTATION and not crossed


@inlined
def reaches_critical_point(q: Any, work: Any) -> bool:
    """Whether the step to q may have passed the known critical point. If several rows lose their rank one loop of many
    may have left its branch, and the largest change of a coordinate is used.
    """
    if work.critical[0].lost > 1:
        far, went = 0.0, 0.0
        for i in range(q.shape[0]):
            far = max(far, abs(work.q_c[i] - q[i]) / work.size_q[i])
            went = max(went, abs(work.q_last[i] - q[i]) / work.size_q[i])
        return far <= PASSED_DISTANCE_FACTOR * went
    return distance(work.q_c, q, work) <= PASSED_DISTANCE_FACTOR * distance(work.q_last, q, work)


@inlined
def count_doubtful_equations(q: Any, rank: int, terms: Any, work: Any) -> int:
    """How many equations may have lost their rank in the step to q: none if it was short, unless counted."""
    nearest = max(pivot_ratio(work.pivot, rank), work.branch_history[0].pivot_ratio)
    if rank == 1 or nearest > SAFE_PIVOT_RATIO_PER_LENGTH * distance(work.q_last, q, work):
        return 0
    return count_doubtful_rows(terms, rank, work)


@inlined
def is_passage_comparable(q: Any, exact: float, terms: Any, work: Any) -> bool:
    """Whether :func:`solvers.projection.passage.classify_passage` determines the branch of q. For a single row other
    tests are used far from the crossing, where branches are not straight, and if drives may reverse.
    """
    c, here, last = work.critical[0], distance(work.q_c, q, work), distance(work.q_c, work.q_last, work)
    if c.lost == 0 or here < exact or last < exact:
        return False
    return c.lost > 1 or (max(here, last) <= MAX_LINE_DISTANCE and not is_rheonomic(terms))


@kernel
def passes_straight(eqs: Any, t: float, q: Any, side: int, turn: int, rank: int, work: Any) -> bool:
    """Whether the side of the known crossing agrees with the position of q and with the orientation, whose sign changes
    with each row that loses its rank.
    """
    c = work.critical[0]
    if not is_on_side(q, side, eqs.terms, rank, work):
        return False
    if side == OPPOSITE_SIDE:
        if drive_reversed(eqs, t, q, work):
            return False
        c.is_passed = 1
    return turn != INDETERMINATE and (turn == ORIENTATION_REVERSED) == (side == OPPOSITE_SIDE and c.lost % 2 == 1)


@inlined
def is_on_side(q: Any, side: int, terms: Any, rank: int, work: Any) -> bool:
    """Whether q is on this side of the known crossing; that is known with one degree of freedom."""
    if terms.J.shape[1] - rank + is_rheonomic(terms) != 1:
        return True
    along = 0.0
    for i in range(q.shape[0]):
        along += (q[i] - work.q_c[i]) * (work.q_last[i] - work.q_c[i]) / work.size_q[i] ** 2
    return (side == OPPOSITE_SIDE) == (along < 0.0)


@kernel
def left_branch_line(q: Any, exact: float, rank: int, terms: Any, work: Any) -> bool:
    """Whether q is not on the line through the last accepted position and the known crossing, and so on another branch.

    The orientation does not show this if only time changes, nor in the crossing itself. The line does if the motion
    has exactly one degree of freedom.
    """
    if work.critical[0].kind != BIFURCATION or terms.J.shape[1] - rank + is_rheonomic(terms) != 1:
        return False
    along, here, last = 0.0, 0.0, 0.0
    for i in range(q.shape[0]):
        now, before = (q[i] - work.q_c[i]) / work.size_q[i], (work.q_last[i] - work.q_c[i]) / work.size_q[i]
        along += now * before
        here += now * now
        last += before * before
    if max(here, last) > MAX_LINE_DISTANCE * MAX_LINE_DISTANCE or here < exact * exact or last < exact * exact:
        return False
    return along * along < MIN_LINE_COSINE * MIN_LINE_COSINE * here * last


@kernel
def drive_reversed(eqs: Any, t: float, q: Any, work: Any) -> bool:
    """Whether the drives have reversed since the last accepted position: a crossing in which they reverse is not
    passed.

    Their present effect in that position is compared with their previous effect there, since their lever arms may have
    changed sign on the way. ``terms`` (of positions) belong to (t, q) before and after the call.
    """
    if not is_rheonomic(eqs.terms):
        return False
    eqs.position(t, work.q_last, eqs.data, eqs.terms)
    same = 0.0
    for i in range(work.row.shape[0]):
        same += work.nu_last[i] * eqs.terms.nu[i] / work.row[i]
    eqs.position(t, q, eqs.data, eqs.terms)
    return same < 0.0


@kernel
def branch_step_limit(t: float, q: Any, v: Any, taken: float, terms: Any, work: Any) -> float:
    """Longest step, s, after one of length ``taken``.

    A step must not jump over a near miss. It must jump over a crossing, from half a step before it to half a step after
    it. A step must not end where the smallest pivot is below ``MIN_END_PIVOT_RATIO`` of the largest, since the
    acceleration is not resolved there.
    """
    c, here = work.critical[0], work.branch_history[0]
    if (
        c.kind == BIFURCATION
        and here.time_to_singular > JUMP_STEP_RATIO * taken
        and here.pivot_ratio > MIN_END_PIVOT_RATIO
    ):
        return APPROACH_FRACTION * here.time_to_singular
    if c.kind != IMPERFECT:
        return np.inf
    far = distance_to_critical_point(t, q, work, terms)
    if far > MAX_SEARCH_DISTANCE:
        c.kind = NO_CRITICAL_POINT
        return np.inf
    speed = scaled_norm(v, work)
    if is_rheonomic(terms):
        speed = np.sqrt(speed * speed + work.rate[0] ** 2)
    return IMPERFECT_STEP_FRACTION * far / speed if speed > 0.0 else np.inf
