"""Singular configurations: crossings, near misses, and the distance to them.

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
too. Whether a step stays on its branch is decided in :mod:`.branch`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import pivot_ratio

from .block import find_block_critical_point, find_critical_point_of_rank, max_coordinate_distance, start_block_search
from .critical import MAX_SEARCH_DISTANCE, critical_set_dimension, find_critical_point, is_rheonomic
from .passage import count_doubtful_rows, fill_scaled_jacobian, store_critical_factors
from .workspace import distance, factor, scaled_norm

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import BranchHistoryRecord, Workspace
    from solvers.system import Equations, Terms

NO_CRITICAL_POINT, BIFURCATION, IMPERFECT = 0, 1, 2

# ratio of the smallest pivot of J~ to the largest below which a position is nearly singular
SINGULAR_PIVOT_RATIO = 1e-3
MAX_BIFURCATION_GAP = 1e-12  # largest gap of a crossing, in units of the rows; Phi is known to some 1e-16 of them
# a critical point belongs to this position if its distance is at most this multiple of the ratio
MAX_DISTANCE_RATIO = 30.0
SEARCH_REPEAT_FACTOR = 4.0  # factor by which the ratio must change before a point that was not found is searched again
# of the squared rate of decrease: if less is lost before the ratio is zero, the crossing is passed
TURNING_RATIO = 0.75
MIN_ACCURATE_DISTANCE = 1e-2  # from a critical point of several equations, in units of size, from which B is accurate
LOOKAHEAD_STEPS = 3.0  # steps ahead for which a singular configuration is searched
JUMP_STEP_RATIO = 0.7  # of the previous step: distance to a crossing from which the next step jumps over it
APPROACH_FRACTION = 0.67  # of a longer distance, that the step before the jump may cover
MIN_END_PIVOT_RATIO = 1e-7  # ratio so near a crossing that any step leads away from it
BLOCK_DISTANCE_FACTOR = 4.0  # largest distance of a point with more dependent equations, in distances of one with fewer
IMPERFECT_STEP_FRACTION = 0.3  # of the way to a near miss that one step may go


@kernel
def classify_singularity(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> int:
    """Classify the singular configuration near q: NO_CRITICAL_POINT, BIFURCATION or IMPERFECT.

    ``terms`` (of positions) and factors belong to (t, q) before and after the call.
    """
    critical, here = work.critical[0], pivot_ratio(work.pivot, rank)
    if critical.kind != NO_CRITICAL_POINT and critical_point_explains_pivot(t, q, rank, work, eqs.terms):
        return critical.kind
    critical.kind = NO_CRITICAL_POINT
    if (
        critical.failed_search_ratio < SEARCH_REPEAT_FACTOR * here
        and here < SEARCH_REPEAT_FACTOR * critical.failed_search_ratio
    ):
        return NO_CRITICAL_POINT
    critical.failed_search_ratio = here
    critical.kind = search_critical_point(eqs, t, q, rank, work)
    if critical.kind != NO_CRITICAL_POINT:
        critical.is_passed, critical.failed_search_ratio, critical.slope = 0, 0.0, 1.0
        if critical.lost > 1:  # in chains of loops pivots are as small far from it
            critical.slope = min(1.0, here / max(distance_to_critical_point(t, q, work, eqs.terms), 1e-300))
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return critical.kind


@kernel
def search_critical_point(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> int:
    """Search the critical point next to q, first one of several rows if several pivots are small."""
    critical, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
    begun = start_block_search(eqs, t, q, rank, work) if rank > 2 else 0
    several = 0 < begun < rank - 1
    if several and search_block_critical_point(eqs, t, q, begun, rank, work) != NO_CRITICAL_POINT and critical.lost > 1:
        return BIFURCATION if critical.bifurcation_gap <= MAX_BIFURCATION_GAP else IMPERFECT
    # no pivot is far below the others, here or ahead
    if begun == 0 and rank > 2 and work.branch_history[0].is_frame_known == 1:
        return NO_CRITICAL_POINT
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    if find_critical_point(eqs, t, q, rank, work):
        kind = IMPERFECT
        if abs(critical.bifurcation_gap) <= MAX_BIFURCATION_GAP:
            if critical_set_dimension(eqs, work) >= freedom:
                kind = BIFURCATION
            else:
                critical.bifurcation_gap = np.inf
        critical.lost = store_critical_factors(eqs, rank, work)
        return kind
    if rank > 2 and not several:
        eqs.position(t, q, eqs.data, eqs.terms)
        factor(eqs.terms, work)
        start_block_search(eqs, t, q, rank, work)
        return search_block_critical_point(eqs, t, q, 0, rank, work)
    return NO_CRITICAL_POINT


@kernel
def search_block_critical_point(eqs: Equations, t: float, q: Reals, begun: int, rank: int, work: Workspace) -> int:
    """The same for a point of several rows, all but ``begun`` if that is not zero; also NONE if motions of more degrees
    of freedom pass near it.
    """
    critical, freedom = work.critical[0], eqs.terms.J.shape[1] - rank
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
    if regular == 0 or critical.set_dimension < freedom:
        return NO_CRITICAL_POINT
    critical.lost = store_critical_factors(eqs, rank, work)
    if critical.lost == 0:
        return NO_CRITICAL_POINT
    return BIFURCATION if critical.bifurcation_gap <= MAX_BIFURCATION_GAP else IMPERFECT


@kernel
def distance_to_critical_point(t: float, q: Reals, work: Workspace, terms: Terms) -> float:
    """Distance to the critical point, in units of size; includes time if constraints depend on it."""
    far = distance(q, work.q_c, work)
    if is_rheonomic(terms):
        far = np.sqrt(far * far + ((t - work.critical[0].t) * work.rate[0]) ** 2)
    return far


@inlined
def critical_point_explains_pivot(t: float, q: Reals, rank: int, work: Workspace, terms: Terms) -> bool:
    """Whether the critical point is the one that makes the smallest pivot here so small."""
    far = distance_to_critical_point(t, q, work, terms)
    return work.critical[0].slope * far <= MAX_DISTANCE_RATIO * pivot_ratio(work.pivot, rank)


@kernel
def record_accepted(eqs: Equations, t: float, q: Reals, taken: float, next_: float, rank: int, work: Workspace) -> None:
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
def store_reference_frame(q: Reals, terms: Terms, work: Workspace) -> None:
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
def is_frame_determined(q: Reals, kind: int, rank: int, terms: Terms, work: Workspace) -> bool:
    """Whether the axes are determined in q, where J~ is nearly singular: next to a near miss, far from a crossing of
    several equations, or if all equations but one, whose sign :mod:`.branch` has compared, have kept their rank
    since the last position of which this is known.
    """
    if kind == BIFURCATION:
        return work.critical[0].lost > 1 and distance(work.q_c, q, work) > MIN_ACCURATE_DISTANCE
    return kind == IMPERFECT or (
        work.branch_history[0].is_frame_known == 1 and count_doubtful_rows(terms, rank, work) <= 1
    )


@inlined
def extrapolate_pivot_ratio(here: BranchHistoryRecord, now: float, taken: float) -> None:
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
def branch_step_limit(t: float, q: Reals, v: Reals, taken: float, terms: Terms, work: Workspace) -> float:
    """Longest step, s, after one of length ``taken``.

    A step must not jump over a near miss. It must jump over a crossing, from half a step before it to half a step after
    it. A step must not end where the smallest pivot is below ``MIN_END_PIVOT_RATIO`` of the largest, since the
    acceleration is not resolved there.
    """
    critical, here = work.critical[0], work.branch_history[0]
    if (
        critical.kind == BIFURCATION
        and here.time_to_singular > JUMP_STEP_RATIO * taken
        and here.pivot_ratio > MIN_END_PIVOT_RATIO
    ):
        return APPROACH_FRACTION * here.time_to_singular
    if critical.kind != IMPERFECT:
        return np.inf
    far = distance_to_critical_point(t, q, work, terms)
    if far > MAX_SEARCH_DISTANCE:
        critical.kind = NO_CRITICAL_POINT
        return np.inf
    speed = scaled_norm(v, work)
    if is_rheonomic(terms):
        speed = np.sqrt(speed * speed + work.rate[0] ** 2)
    return IMPERFECT_STEP_FRACTION * far / speed if speed > 0.0 else np.inf
