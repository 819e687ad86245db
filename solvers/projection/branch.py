"""Whether a step stays on its branch of the motion; singular configurations are described in :mod:`.singular`.

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

from typing import TYPE_CHECKING

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import pivot_ratio

from .critical import is_rheonomic
from .orientation import INDETERMINATE, LARGE_ROTATION, ORIENTATION_KEPT, ORIENTATION_REVERSED, compare_orientation
from .passage import OPPOSITE_SIDE, OTHER_BRANCH, classify_passage, count_doubtful_rows, regular_equations_keep_rank
from .singular import (
    BIFURCATION,
    NO_CRITICAL_POINT,
    SINGULAR_PIVOT_RATIO,
    classify_singularity,
    critical_point_explains_pivot,
)
from .workspace import count_freedom, distance

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

PASSED_DISTANCE_FACTOR = 3.0  # a crossing that a step has passed lies within this multiple of its length
# distance from a crossing, in units of size, at which closed positions are on one branch or on another
BRANCH_RESOLUTION = 1e-5
# distance from a crossing up to which branches are lines, in units of size; cosine
MAX_LINE_DISTANCE, MIN_LINE_COSINE = 0.3, 0.8
# ratio of the pivots per length of a step (in units of size) above which no equation loses its rank
SAFE_PIVOT_RATIO_PER_LENGTH = 2.0


@kernel
def on_same_branch(eqs: Equations, t: float, q: Reals, exact: float, rank: int, work: Workspace) -> bool:
    """Whether the step to (t, q), with its ``terms`` and factors, stayed on its branch: the orientation changed little,
    or it crossed another branch.

    Within the scaled distance ``exact`` of a bifurcation the branches cannot be distinguished numerically, and the step
    is accepted.
    """
    if rank == 0 or work.branch_history[0].is_frame_known == 0:
        return True
    return orientation_preserved(eqs, t, q, exact, rank, work) and not left_branch_line(q, exact, rank, eqs.terms, work)


@kernel
def orientation_preserved(eqs: Equations, t: float, q: Reals, exact: float, rank: int, work: Workspace) -> bool:
    """The same by the orientation and the known critical point.

    An unchanged orientation is no proof if more than one equation may have lost its rank on the way. Then a crossing
    must explain it, and all other equations must have kept their rank.
    """
    turn, critical = compare_orientation(eqs.terms, rank, work), work.critical[0]
    at_hand = critical.kind == BIFURCATION and reaches_critical_point(q, work)
    doubtful = count_doubtful_equations(q, rank, eqs.terms, work)
    if turn == ORIENTATION_KEPT and not at_hand and doubtful == 0:
        return True
    if at_hand and is_passage_comparable(q, exact, eqs.terms, work):
        side = classify_passage(eqs.terms, rank, work)
        if side == OTHER_BRANCH:
            return False
        if passes_straight(eqs, t, q, side, turn, rank, work):
            return True
    alone = count_freedom(rank, work) == 1 and not is_rheonomic(eqs.terms)  # else critical points may form curves
    keep = at_hand if turn == ORIENTATION_KEPT else alone and critical.kind == BIFURCATION and critical.is_passed == 0
    if not keep:  # what was known need not be the next one
        critical.kind, critical.failed_search_ratio = NO_CRITICAL_POINT, 0.0
    crossing = classify_singularity(eqs, t, q, rank, work) == BIFURCATION
    inside = (
        crossing
        and pivot_ratio(work.pivot, rank) < SINGULAR_PIVOT_RATIO
        and critical_point_explains_pivot(t, q, rank, work, eqs.terms)
    )
    near = critical.kind != NO_CRITICAL_POINT and reaches_critical_point(q, work)
    explained = crossing and (near or inside) and critical.lost > 0
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
        return crossing or not (near and critical.lost > 1)
    crossed = crossing and near and not drive_reversed(eqs, t, q, work)
    if crossed:
        critical.is_passed = 1
    return crossed if turn == ORIENTATION_REVERSED else turn == LARGE_ROTATION and not crossed


@inlined
def reaches_critical_point(q: Reals, work: Workspace) -> bool:
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
def count_doubtful_equations(q: Reals, rank: int, terms: Terms, work: Workspace) -> int:
    """How many equations may have lost their rank in the step to q: none if it was short, unless counted."""
    nearest = max(pivot_ratio(work.pivot, rank), work.branch_history[0].pivot_ratio)
    if rank == 1 or nearest > SAFE_PIVOT_RATIO_PER_LENGTH * distance(work.q_last, q, work):
        return 0
    return count_doubtful_rows(terms, rank, work)


@inlined
def is_passage_comparable(q: Reals, exact: float, terms: Terms, work: Workspace) -> bool:
    """Whether :func:`solvers.projection.passage.classify_passage` determines the branch of q. For a single row other
    tests are used far from the crossing, where branches are not straight, and if drives may reverse.
    """
    critical, here, last = work.critical[0], distance(work.q_c, q, work), distance(work.q_c, work.q_last, work)
    if critical.lost == 0 or here < exact or last < exact:
        return False
    return critical.lost > 1 or (max(here, last) <= MAX_LINE_DISTANCE and not is_rheonomic(terms))


@kernel
def passes_straight(eqs: Equations, t: float, q: Reals, side: int, turn: int, rank: int, work: Workspace) -> bool:
    """Whether the side of the known crossing agrees with the position of q and with the orientation, whose sign changes
    with each row that loses its rank.
    """
    critical = work.critical[0]
    if not is_on_side(q, side, eqs.terms, rank, work):
        return False
    if side == OPPOSITE_SIDE:
        if drive_reversed(eqs, t, q, work):
            return False
        critical.is_passed = 1
    return turn != INDETERMINATE and (turn == ORIENTATION_REVERSED) == (
        side == OPPOSITE_SIDE and critical.lost % 2 == 1
    )


@inlined
def is_on_side(q: Reals, side: int, terms: Terms, rank: int, work: Workspace) -> bool:
    """Whether q is on this side of the known crossing; that is known with one degree of freedom."""
    if count_freedom(rank, work) + is_rheonomic(terms) != 1:
        return True
    along = 0.0
    for i in range(q.shape[0]):
        along += (q[i] - work.q_c[i]) * (work.q_last[i] - work.q_c[i]) / work.size_q[i] ** 2
    return (side == OPPOSITE_SIDE) == (along < 0.0)


@kernel
def left_branch_line(q: Reals, exact: float, rank: int, terms: Terms, work: Workspace) -> bool:
    """Whether q is not on the line through the last accepted position and the known crossing, and so on another branch.

    The orientation does not show this if only time changes, nor in the crossing itself. The line does if the motion
    has exactly one degree of freedom.
    """
    if work.critical[0].kind != BIFURCATION or count_freedom(rank, work) + is_rheonomic(terms) != 1:
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
def drive_reversed(eqs: Equations, t: float, q: Reals, work: Workspace) -> bool:
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
