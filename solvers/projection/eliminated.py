"""Projection and accelerations of mechanisms whose constraints are eliminated along their structure, in O(n).

The system solves its constraint equations itself (:class:`solvers.system.EliminationEquations`) and reports their
*rank* and the *shortest* equation: its part that is independent of all others, relative to its original length. That is
zero at a singular configuration, and near it about the distance in units of the coordinates. It is local, so that it
does not become smaller with the number of loops, as the ratio of pivots does.

Accelerations of a state off the constraints by e are wrong by e divided by the square of the shortest equation, and a
residual r leaves e = r divided by the shortest equation. So states near singular configurations are projected before
they are evaluated, to residuals that decrease with the cube of the shortest equation as far as rounding allows. Nearer
still, at a crossing of branches, accelerations are the limit from four neighbors on the branch, see
:mod:`.projection`; which configurations are crossings is found by :mod:`.eliminated_crossing`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, Table, f8, i8
from solvers.inertia import InertiaRecord
from solvers.linalg.dense import largest_change
from solvers.outcome import NO_MASS, NOT_CLOSED, NOT_FINITE, OK
from solvers.positions import Positions, count_velocities
from solvers.system import ELIMINATION_REPORT_SIZE, RANK, RESIDUAL, SHORTEST, Array

from .projection import MAX_PROJECTION_CORRECTIONS, RESIDUAL_TOLERANCE
from .singular import BIFURCATION, MAX_DISTANCE_RATIO, NO_CRITICAL_POINT

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.system import EliminationEquations

SINGULAR_LENGTH = 2e-4  # shortest equation below which accelerations at a crossing are its limit along the motion
PROJECTED_LENGTH = 5e-2  # ... below which states are projected before they are evaluated
LEFT_OUT_LENGTH = 10.0 * SINGULAR_LENGTH  # at a crossing: equations that are shorter lose their rank there
REDUNDANT_LENGTH = 1e-10  # of an equation that depends on others
HIDDEN_LENGTH = 1e-6  # ... at a closed position, whatever its rounding errors
HIDDEN_LENGTH_PER_RESIDUAL = 1e4  # ... elsewhere, at most: 1400 with 60 cranks on one rail
HIDDEN_LENGTH_FACTOR = 10.0  # from the shortest equation to the next limit below which equations are left out
CLOSED_RESIDUAL = 1e-13  # of a closed position, in units of the constraint equations: above rounding
ROUNDING_RESIDUAL = 1e-15  # ... that cannot be reduced
CORRECTION_ROUNDING = 1e-14  # a correction this small, in units of the coordinates, is rounding
NEIGHBOR_DISTANCE = 5e-2  # of the neighbors at which the rank is found, in units of the coordinates
MIN_SPEED_RATIO = 1e-3  # to the rate of the motion, of velocities that show the branch; smaller ones may be errors
FROZEN_RESIDUAL_RATIO = 1e-3  # part of the tolerance: a smaller residual needs no correction in a step


class NearSingularRecord(Record):
    """What is known of the singular configuration next to the motion."""

    rank: i8  # number of independent equations of the motion
    shortest: f8  # shortest equation where it was evaluated last; 0: the rank was smaller
    accepted: f8  # ... where the last step ended; 0: there was none
    time_to_singular: f8  # s, until it is zero, by extrapolation
    kind: i8  # of the critical point, see solvers.projection.singular
    gap: f8  # of the loop there, in units of the equations
    turned: f8  # change of the velocity by the last projection, relative to the largest velocity or to a slow one


class EliminationScratch(NamedTuple):
    """Units, a state, its rates, and states next to it."""

    positions: Any  # solvers.positions.Positions
    size: Array  # (n,)   units of the coordinates
    size_q: Array  # (nq,)  units of the positions
    coordinate_rates: Array  # (n,)   1/s, that of the motion, as the tolerances of rates take it
    inertia: Table[InertiaRecord]  # (1,) the rate growth is not computed
    near: Table[NearSingularRecord]  # (1,)
    q_c: Array  # (nq,)  critical point
    report: Array  # (ELIMINATION_REPORT_SIZE,)
    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    lam: Array  # (m,)
    before: Array  # (n,)   velocities before a projection
    change: Array  # (n,)   correction
    q_near: Array  # (nq,)  state of a neighbor
    v_near: Array  # (n,)
    a_near: Array  # (n,)
    a_before: Array  # (n,)
    qdot_near: Array  # (nq,)
    lam_near: Array  # (m,)
    tau: Array  # (n,)
    zero: Array  # (n,)
    zero_lam: Array  # (m,)
    nodes: Array  # (4, nq) positions of neighbors

    @staticmethod
    def allocate(nq: int, n: int, m: int, positions: Positions) -> EliminationScratch:
        """Return zeroed arrays."""
        z = np.zeros
        records = InertiaRecord.zeros(1), NearSingularRecord.zeros(1)
        return EliminationScratch(
            positions, z(n), z(nq), z(n), *records, z(nq), z(ELIMINATION_REPORT_SIZE), z(nq), z(n), z(n), z(nq), z(m),
            z(n), z(n), z(nq), z(n), z(n), z(n), z(nq), z(m), z(n), z(n), z(m), z((4, nq)),
        )  # fmt: skip

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that are needed to continue a motion."""
        return [self.inertia, self.coordinate_rates, self.near, self.q_c]


@inlined
def largest_distance(q: Reals, other: Reals, size_q: Reals) -> float:
    """Largest difference of two positions (nq,) in units of ``size_q``."""
    largest = 0.0
    for i in range(q.shape[0]):
        largest = max(largest, abs(q[i] - other[i]) / size_q[i])
    return largest


@inlined
def is_near_crossing(q: Reals, shortest: float, work: EliminationScratch) -> bool:
    """Whether the known critical point is a crossing, and the one that makes an equation so short at q."""
    return (
        shortest < SINGULAR_LENGTH
        and work.near[0].kind == BIFURCATION
        and largest_distance(q, work.q_c, work.size_q) <= MAX_DISTANCE_RATIO * SINGULAR_LENGTH
    )


@inlined
def shortest_of(report: Reals, rank: int) -> float:
    """Shortest equation of an elimination; zero if fewer than ``rank`` are independent."""
    return report[SHORTEST] if report[RANK] >= rank else 0.0


@inlined
def may_hide_redundancy(longest: float, work: EliminationScratch) -> bool:
    """Whether the last elimination may have solved redundant equations, none of them ``longest`` or longer.

    Off the constraints a redundant equation has a length too: the residual times a factor that grows with the extent of
    the loops. Solved for, its rounding errors, divided by this length, would move the mechanism along its free
    directions. An equation is redundant if the equations that are longer have the rank of the motion.
    """
    report = work.report
    limit = min(HIDDEN_LENGTH_PER_RESIDUAL * report[RESIDUAL], longest)
    return work.near[0].rank > 0 and report[RANK] >= work.near[0].rank and report[SHORTEST] < limit


@kernel
def find_position_correction(
    eqs: EliminationEquations, t: float, q: Reals, drop: float, closed: float, work: EliminationScratch
) -> float:
    """work.change (n,) <- the change of the coordinates that closes the linearized constraints, without equations
    shorter than ``drop`` and without redundant ones; return the largest residual. At most ``closed``: nothing is
    changed.
    """
    report = work.report
    eqs.correct_position(t, q, eqs.elimination, drop, closed, work.change, report)
    residual: float = report[RESIDUAL]
    while residual > closed and may_hide_redundancy(LEFT_OUT_LENGTH, work):
        shorter, drop = drop, HIDDEN_LENGTH_FACTOR * report[SHORTEST]
        eqs.correct_position(t, q, eqs.elimination, drop, closed, work.change, report)
        if report[RANK] < work.near[0].rank:
            eqs.correct_position(t, q, eqs.elimination, shorter, closed, work.change, report)
            break
    return residual


@kernel
def find_velocity_correction(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, drop: float, work: EliminationScratch
) -> None:
    """work.change (n,) <- the change of velocities that makes them consistent, as :func:`find_position_correction`."""
    report = work.report
    eqs.correct_velocity(t, q, v, eqs.elimination, drop, work.change, report)
    while may_hide_redundancy(LEFT_OUT_LENGTH, work):
        shorter, drop = drop, HIDDEN_LENGTH_FACTOR * report[SHORTEST]
        eqs.correct_velocity(t, q, v, eqs.elimination, drop, work.change, report)
        if report[RANK] < work.near[0].rank:
            eqs.correct_velocity(t, q, v, eqs.elimination, shorter, work.change, report)
            break


@kernel
def find_accelerations(
    eqs: EliminationEquations, t: float, q: Reals, v: Reals, loaded: bool, work: EliminationScratch,
    qdot: Reals, a: Reals, lam: Reals,
) -> bool:  # fmt: skip
    """As :func:`accelerate`, without redundant equations of closed states; False: a motion has no mass."""
    report, drop = work.report, REDUNDANT_LENGTH
    failed = eqs.accelerate(t, q, v, eqs.elimination, drop, loaded, qdot, a, lam, report)
    while failed == 0 and may_hide_redundancy(HIDDEN_LENGTH_PER_RESIDUAL * CLOSED_RESIDUAL, work):
        shorter, drop = drop, HIDDEN_LENGTH_FACTOR * report[SHORTEST]
        failed = eqs.accelerate(t, q, v, eqs.elimination, drop, loaded, qdot, a, lam, report)
        if failed != 0 or report[RANK] < work.near[0].rank:
            failed = eqs.accelerate(t, q, v, eqs.elimination, shorter, loaded, qdot, a, lam, report)
            break
    return failed == 0


@inlined
def closed_residual(closed: float, near: NearSingularRecord) -> float:
    """Largest residual of a closed position where the shortest equation is as it was evaluated last: such that errors
    of accelerations are no larger than far from singular configurations, where it is ``closed``, as far as rounding
    allows.
    """
    if near.rank == 0 or near.shortest >= PROJECTED_LENGTH:
        return closed
    return min(closed, max(ROUNDING_RESIDUAL, closed * (near.shortest / PROJECTED_LENGTH) ** 3))


@kernel
def close_position(eqs: EliminationEquations, t: float, q: Reals, closed: float, work: EliminationScratch) -> int:
    """Project q onto the constraints, in place, until the residual is at most ``closed``; return a code.

    Near singular configurations it is reduced further, see :func:`closed_residual`. At a crossing equations that lose
    their rank there are left out.
    """
    report, previous = work.report, np.inf
    closed = closed_residual(closed, work.near[0])
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        residual = find_position_correction(eqs, t, q, REDUNDANT_LENGTH, closed, work)
        if not np.isfinite(residual):
            return NOT_FINITE
        if residual <= closed:
            return OK
        left_out = is_near_crossing(q, shortest_of(report, work.near[0].rank), work)
        if left_out:
            eqs.correct_position(t, q, eqs.elimination, LEFT_OUT_LENGTH, closed, work.change, report)
        largest = largest_change(work.change, work.size)
        if not np.isfinite(largest):
            return NOT_CLOSED
        eqs.retract(q, work.change, eqs.data)
        if residual <= RESIDUAL_TOLERANCE and (largest <= CORRECTION_ROUNDING or not largest < 0.5 * previous):
            return OK
        if left_out and largest <= FROZEN_RESIDUAL_RATIO * SINGULAR_LENGTH:  # the next one would be its square
            return OK
        previous = largest
    return NOT_CLOSED


@kernel
def project(eqs: EliminationEquations, t: float, q: Reals, v: Reals, closed: float, work: EliminationScratch) -> int:
    """Project (q, v) onto the constraints, in place; return a code. Record how much the velocity changes."""
    code = close_position(eqs, t, q, closed, work)
    if code != OK:
        return code
    eqs.retract(q, work.zero, eqs.data)  # quaternions to unit length
    report, near = work.report, work.near[0]
    find_velocity_correction(eqs, t, q, v, REDUNDANT_LENGTH, work)
    if is_near_crossing(q, shortest_of(report, near.rank), work):
        eqs.correct_velocity(t, q, v, eqs.elimination, LEFT_OUT_LENGTH, work.change, report)
    changed, speed = largest_change(work.change, work.size), MIN_SPEED_RATIO * work.coordinate_rates[0]
    for i in range(count_velocities(work.positions, v.shape[0])):
        speed = max(speed, abs(v[i]) / work.size[i])
        v[i] += work.change[i]
    if not np.isfinite(changed):
        return NOT_CLOSED
    near.turned = changed / speed if speed > 0.0 else 0.0
    return OK


@kernel
def accelerate(
    eqs: EliminationEquations,
    t: float,
    q: Reals,
    v: Reals,
    loaded: bool,
    work: EliminationScratch,
    qdot: Reals,
    a: Reals,
    lam: Reals,
) -> int:
    """N v (nq,), accelerations a (n,) and, if ``loaded``, multipliers lam (m,) with all equations that are not
    redundant; record the shortest one.
    """
    if not find_accelerations(eqs, t, q, v, loaded, work, qdot, a, lam):
        return NO_MASS
    work.near[0].shortest = shortest_of(work.report, work.near[0].rank)
    for i in range(a.shape[0]):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@kernel
def find_normal_rank(eqs: EliminationEquations, t: float, q: Reals, v: Reals, work: EliminationScratch) -> int:
    """Largest number of independent equations at a closed position q and at two neighbors: along v, and along an
    arbitrary motion that the constraints allow. A start in a singular configuration has a smaller one.
    """
    work.near[0].rank, work.near[0].kind = 0, NO_CRITICAL_POINT
    rank = 0
    for attempt in range(3):
        for i in range(q.shape[0]):
            work.q_near[i] = q[i]
        if attempt > 0:
            moving = count_velocities(work.positions, v.shape[0])
            for i in range(v.shape[0]):
                along = v[i] if attempt == 1 else work.size[i] * np.sin(1.0 + 0.7 * i)
                work.v_near[i] = along if i < moving else 0.0
            eqs.correct_velocity(t, q, work.v_near, eqs.elimination, REDUNDANT_LENGTH, work.change, work.report)
            for i in range(v.shape[0]):
                work.v_near[i] += work.change[i]
            speed = largest_change(work.v_near, work.size)
            if not speed > 0.0:
                continue
            for i in range(v.shape[0]):
                work.change[i] = NEIGHBOR_DISTANCE * work.v_near[i] / speed
            eqs.retract(work.q_near, work.change, eqs.data)
            if close_position(eqs, t, work.q_near, CLOSED_RESIDUAL, work) != OK:
                continue
        # what redundant equations are off is as long as the residual: closed further by those that are surely not
        eqs.correct_position(
            t, work.q_near, eqs.elimination, HIDDEN_LENGTH, ROUNDING_RESIDUAL, work.change, work.report
        )
        eqs.retract(work.q_near, work.change, eqs.data)
        eqs.correct_position(t, work.q_near, eqs.elimination, REDUNDANT_LENGTH, -1.0, work.change, work.report)
        rank = max(rank, int(work.report[RANK]))
    return rank
