"""Critical points of mechanisms whose constraints are eliminated along their structure: crossings and near misses.

They are defined in :mod:`.singular`. The point is searched along the motion: the shortest equation of four closed
neighbors, two on either side, with its sign changed beyond the point, is interpolated by a cubic, whose zero is the
critical point. There all equations are closed but those that lose their rank. What remains of these is the *gap*: it
is stationary there, so that the errors of the point enter with their squares. It is zero at a crossing. At a near miss
the neighbors are on both branches that do not meet, and it is not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.outcome import BRANCHES, OK, UNDECIDABLE
from solvers.system import DROPPED_LENGTH, DROPPED_RESIDUAL, RANK

from .eliminated import (
    CLOSED_RESIDUAL,
    LEFT_OUT_LENGTH,
    PROJECTED_LENGTH,
    REDUNDANT_LENGTH,
    SINGULAR_LENGTH,
    accelerate,
    close_position,
    find_position_correction,
    largest_distance,
    project,
    shortest_of,
)
from .projection import LIMIT_NODE_DISTANCE, MIN_TANGENT_SPEED, UNRESOLVED_PIVOT_RATIO, lagrange_polynomial
from .singular import (
    APPROACH_FRACTION,
    BIFURCATION,
    IMPERFECT,
    IMPERFECT_STEP_FRACTION,
    JUMP_STEP_RATIO,
    LOOKAHEAD_STEPS,
    MAX_DISTANCE_RATIO,
    MIN_END_PIVOT_RATIO,
    NO_CRITICAL_POINT,
    extrapolate_to_zero,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.eliminated import EliminationScratch
    from solvers.system import EliminationEquations

UNRESOLVED_LENGTH = UNRESOLVED_PIVOT_RATIO  # an equation that is shorter has no accurate digits
MAX_CROSSING_GAP = 1e-12  # largest gap of a crossing; the errors of the interpolated point enter with their squares
MIN_RESOLVED_GAP = 3e-11  # of a near miss: rounding errors of the positions divided by the gap decide the branch
LIMIT_HALVINGS, LIMIT_TOLERANCE = 2, 1e-6  # of the distance of neighbors; relative change of the accelerations then
MAX_CROSSING_LENGTH = 1e-5  # shortest equation in the interpolated point of a crossing
MAX_CENTER_OFFSET = 0.5  # of the point from the middle of its neighbors, in their distance
NODE_REFINEMENTS, NODE_REFINEMENT_FACTOR = 2, 0.25  # of the distance of the neighbors, to confirm a near miss
MAX_SEARCHES, MAX_EXPECTED_DISTANCE = 7, 0.5  # of the point; farthest, in units of the coordinates
CRITICAL_POINT_CORRECTIONS = 3  # of the interpolated point
LOOKAHEAD_LENGTH = 0.5  # shortest equation below which a critical point ahead is searched
MAX_TURN = 0.1  # change of the velocity by a projection, relative to the largest velocity, on the same branch
MAX_NEAR_MISS_DISTANCE = 1.0  # from which a near miss does not limit steps


@inlined
def loop_speed(v: Reals, in_loops: Reals, size: Reals) -> float:
    """Largest velocity of the coordinates in loops, in units of their size a second."""
    speed = 0.0
    for i in range(v.shape[0]):
        speed = max(speed, in_loops[i] * abs(v[i]) / size[i])
    return speed


@kernel
def close_neighbor(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, a: Reals, time: float, work: EliminationScratch
) -> float:
    """work.q_near: the closed position of the loops a ``time`` (s) after (q, v) with accelerations a. Return the
    shortest equation there; negative: it cannot be closed.
    """
    for i in range(q.shape[0]):
        work.q_near[i] = q[i]
    for i in range(v.shape[0]):
        work.change[i] = eqs.in_loops[i] * time * (v[i] + 0.5 * time * a[i])
    eqs.retract(work.q_near, work.change, eqs.data)
    if close_position(eqs, t + time, work.q_near, CLOSED_RESIDUAL, work) != OK:
        return -1.0
    find_position_correction(eqs, t + time, work.q_near, REDUNDANT_LENGTH, -1.0, work)
    return shortest_of(work.report, work.near[0].rank)


@kernel
def find_critical_point(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, a: Reals, time: float, work: EliminationScratch
) -> int:
    """Search the critical point near where the motion from (t, q, v) with accelerations a is after a ``time`` (s).
    Return its kind, and put it into work.q_c. A near miss is confirmed with nearer neighbors: next to another singular
    configuration the interpolation is not accurate.
    """
    near, speed = work.near[0], loop_speed(v, eqs.in_loops, work.size)
    near.kind, near.gap = NO_CRITICAL_POINT, 0.0
    if not speed > 0.0:
        return near.kind
    interval, refined, gap = LIMIT_NODE_DISTANCE / speed, 0, 0.0
    for _ in range(MAX_SEARCHES):
        if not abs(time) * speed <= MAX_EXPECTED_DISTANCE:
            break
        outer_before = store_node(eqs, t, q, v, a, time - 2.0 * interval, 0, work)
        before = store_node(eqs, t, q, v, a, time - interval, 1, work)
        after = store_node(eqs, t, q, v, a, time + interval, 2, work)
        outer_after = store_node(eqs, t, q, v, a, time + 2.0 * interval, 3, work)
        if not min(outer_before, before, after, outer_after) > 0.0:
            break
        offset = (before - after) / (before + after)
        if abs(offset) <= MAX_CENTER_OFFSET and outer_before > before and outer_after > after:
            x = zero_of_cubic(outer_before, before, -after, -outer_after, offset)
            near.kind = classify_node(eqs, t + time + x * interval, x, work)
            gap = max(gap, near.gap)
            if near.kind != IMPERFECT or refined == NODE_REFINEMENTS:
                break
            time, interval, refined = time + x * interval, NODE_REFINEMENT_FACTOR * interval, refined + 1
        elif outer_before > before > after > outer_after:
            time += interval * (2.0 + 4.0 * outer_after / (outer_before - outer_after))
        elif outer_before < before < after < outer_after:
            time -= interval * (2.0 + 4.0 * outer_before / (outer_after - outer_before))
        else:
            break
    if near.kind == IMPERFECT:
        near.gap = gap  # neighbors that are nearer than the branches would show none
    return near.kind


@kernel
def store_node(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, a: Reals, time: float, node: int, work: EliminationScratch
) -> float:
    """As :func:`close_neighbor`; the position is stored as a node."""
    shortest = close_neighbor(eqs, t, q, v, a, time, work)
    for i in range(q.shape[0]):
        work.nodes[node, i] = work.q_near[i]
    return shortest


@inlined
def zero_of_cubic(far_before: float, before: float, after: float, far_after: float, x: float) -> float:
    """Zero near x of the cubic through these values at -2, -1, 1 and 2 (secant method)."""
    last, value = 0.0, 0.0
    for attempt in range(6):
        here = (
            far_before * lagrange_polynomial(-2, x)
            + before * lagrange_polynomial(-1, x)
            + after * lagrange_polynomial(1, x)
            + far_after * lagrange_polynomial(2, x)
        )
        if here == 0.0 or (attempt > 0 and here == value):
            return x
        slope = (here - value) / (x - last) if attempt > 0 else 0.5 * (after - before)
        last, value = x, here
        x = min(1.0, max(-1.0, x - here / slope))
    return x


@kernel
def classify_node(eqs: EliminationEquations, t: float, x: float, work: EliminationScratch) -> int:
    """Interpolate the critical point at x, in distances of the nodes, close the equations that keep their rank there,
    and classify it.
    """
    near, report = work.near[0], work.report
    for i in range(work.q_c.shape[0]):
        work.q_c[i] = 0.0
        for k in range(4):
            node = (-2, -1, 1, 2)[k]
            work.q_c[i] += lagrange_polynomial(node, x) * work.nodes[k, i]
    eqs.retract(work.q_c, work.zero, eqs.data)
    for _ in range(CRITICAL_POINT_CORRECTIONS):
        eqs.correct_position(t, work.q_c, eqs.elimination, LEFT_OUT_LENGTH, -1.0, work.change, report)
        eqs.retract(work.q_c, work.change, eqs.data)
    eqs.correct_position(t, work.q_c, eqs.elimination, LEFT_OUT_LENGTH, -1.0, work.change, report)
    if report[RANK] >= near.rank:
        return NO_CRITICAL_POINT
    near.gap = report[DROPPED_RESIDUAL]
    exact = near.gap <= MAX_CROSSING_GAP and report[DROPPED_LENGTH] <= MAX_CROSSING_LENGTH
    return BIFURCATION if exact else IMPERFECT


@inlined
def explains(q: Reals, shortest: float, work: EliminationScratch) -> bool:
    """Whether the known critical point is the one that makes an equation so short at q."""
    return work.near[0].kind != NO_CRITICAL_POINT and largest_distance(
        q, work.q_c, work.size_q
    ) <= MAX_DISTANCE_RATIO * max(shortest, UNRESOLVED_LENGTH)


@kernel
def evaluate_closed(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, loaded: bool, work: EliminationScratch,
    qdot: Reals, a: Reals, lam: Reals,
) -> int:  # fmt: skip
    """N v, accelerations and, if ``loaded``, multipliers of a projected state, in singular configurations the limit
    along the motion; return a code.
    """
    code = accelerate(eqs, t, q, v, loaded, work, qdot, a, lam)
    shortest = work.near[0].shortest
    if code != OK or shortest >= SINGULAR_LENGTH:
        return code
    if not explains(q, shortest, work):
        for i in range(v.shape[0]):
            work.a_near[i] = 0.0
        find_critical_point(eqs, t, q, v, work.a_near, 0.0, work)
    near, speed = work.near[0], loop_speed(v, eqs.in_loops, work.size)
    if near.kind == IMPERFECT and near.gap < MIN_RESOLVED_GAP:
        return BRANCHES
    if near.kind == BIFURCATION and speed > MIN_TANGENT_SPEED * work.coordinate_rates[0]:
        code = take_limit(eqs, t, q, v, loaded, speed, work, a, lam)
    elif not shortest > UNRESOLVED_LENGTH:
        code = UNDECIDABLE
    near.shortest = shortest
    return code


@kernel
def take_limit(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, loaded: bool, speed: float, work: EliminationScratch,
    a: Reals, lam: Reals,
) -> int:  # fmt: skip
    """Accelerations and multipliers near a crossing, from closed neighbors on the branch on both sides of it. Half the
    distance of the neighbors must give the same accelerations; UNDECIDABLE if it does not, as next to another singular
    configuration.
    """
    code = interpolate_neighbors(eqs, t, q, v, loaded, LIMIT_NODE_DISTANCE / speed, work, a, lam)
    interval, size = 0.5 * LIMIT_NODE_DISTANCE / speed, work.size
    for _ in range(LIMIT_HALVINGS):
        for i in range(a.shape[0]):
            work.a_before[i] = a[i]
        if code == OK:
            code = interpolate_neighbors(eqs, t, q, v, loaded, interval, work, a, lam)
        if code != OK:
            return code
        changed, largest = 0.0, speed * speed
        for i in range(a.shape[0]):
            changed = max(changed, eqs.in_loops[i] * abs(a[i] - work.a_before[i]) / size[i])
            largest = max(largest, eqs.in_loops[i] * abs(a[i]) / size[i])
        if changed <= LIMIT_TOLERANCE * largest:
            return OK
        interval *= 0.5
    return UNDECIDABLE


@kernel
def interpolate_neighbors(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, loaded: bool, interval: float, work: EliminationScratch,
    a: Reals, lam: Reals,
) -> int:  # fmt: skip
    """The cubic through the accelerations and multipliers of four closed neighbors, in its middle; ``interval`` (s) is
    between them.
    """
    for i in range(a.shape[0]):
        a[i] = 0.0
    for k in range(lam.shape[0]):
        lam[k] = 0.0
    for node in (-2, -1, 1, 2):
        for i in range(a.shape[0]):
            work.a_near[i] = 0.0
        if not close_neighbor(eqs, t, q, v, work.a_near, node * interval, work) > SINGULAR_LENGTH:
            return UNDECIDABLE
        for i in range(v.shape[0]):
            work.v_near[i] = v[i]
        code = project(eqs, t + node * interval, work.q_near, work.v_near, CLOSED_RESIDUAL, work)
        if code == OK:
            code = accelerate(
                eqs,
                t + node * interval,
                work.q_near,
                work.v_near,
                loaded,
                work,
                work.qdot_near,
                work.a_near,
                work.lam_near,
            )
        if code != OK:
            return code
        weight = lagrange_polynomial(node, 0.0)
        for i in range(a.shape[0]):
            a[i] += weight * work.a_near[i]
        for k in range(lam.shape[0]):
            lam[k] += weight * work.lam_near[k]
    return OK


@kernel
def evaluate_prediction(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, loaded: bool, work: EliminationScratch,
    qdot: Reals, a: Reals, lam: Reals,
) -> int:  # fmt: skip
    """As :func:`evaluate_closed` at a state that need not be closed. Near singular configurations, and where redundant
    equations are hidden by the residual, it is projected first.
    """
    near = work.near[0]
    if near.accepted >= PROJECTED_LENGTH:
        code = accelerate(eqs, t, q, v, loaded, work, qdot, a, lam)
        if code != OK or (near.shortest >= PROJECTED_LENGTH and work.report[RANK] == near.rank):
            return code
    code = project(eqs, t, q, v, CLOSED_RESIDUAL, work)
    return evaluate_closed(eqs, t, q, v, loaded, work, qdot, a, lam) if code == OK else code


@kernel
def record_accepted(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, a: Reals, taken: float, following: float,
    work: EliminationScratch,
) -> float:  # fmt: skip
    """Record the end of a step of ``taken`` (s; 0: the motion starts here), evaluated last; ``following`` is the step
    that accuracy allows next. Return the longest next step, s: it must not jump over a near miss, and must jump over a
    crossing from half a step before it to half a step after it.
    """
    near = work.near[0]
    here = near.shortest
    near.time_to_singular = extrapolate_to_zero(near.accepted, here, taken) if taken > 0.0 else np.inf
    near.accepted = here
    ahead = near.time_to_singular
    if here < LOOKAHEAD_LENGTH and (here < SINGULAR_LENGTH or ahead < LOOKAHEAD_STEPS * following):
        time = ahead if ahead < np.inf else 0.0
        if not explains(q, here, work):
            find_critical_point(eqs, t, q, v, a, time, work)
    if near.kind == BIFURCATION and ahead > JUMP_STEP_RATIO * taken and here > MIN_END_PIVOT_RATIO:
        return APPROACH_FRACTION * ahead
    if near.kind != IMPERFECT:
        return np.inf
    far, speed = largest_distance(q, work.q_c, work.size_q), loop_speed(v, eqs.in_loops, work.size)
    if far > MAX_NEAR_MISS_DISTANCE:
        near.kind = NO_CRITICAL_POINT
        return np.inf
    return IMPERFECT_STEP_FRACTION * max(far, here) / speed if speed > 0.0 else np.inf


@inlined
def stays_on_branch(work: EliminationScratch) -> bool:
    """Whether the last projection left the velocity as it was: on another branch it would be a different one."""
    return work.near[0].turned <= MAX_TURN
