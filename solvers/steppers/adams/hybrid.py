"""The hybrid partition: LU while it is safe, projection where it is not, and when to change.

All coordinates are in the history and under error control, so a change costs nothing.
"""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import is_determinant_positive
from solvers.projection.lu_partition import (
    choose_partition,
    factor_dependent,
    fill_dependent_tangents,
    have_tangents_turned,
    is_better_partition,
    is_same_partition,
    smallest_pivot_ratio,
)
from solvers.projection.singular import (
    LOOKAHEAD_STEPS,
    NO_CRITICAL_POINT,
    SINGULAR_PIVOT_RATIO,
    extrapolate_to_zero,
    record_accepted,
    store_reference_frame,
)
from solvers.projection.workspace import factor

from .formulas import split

PROJECTION, LU, HYBRID = 0, 1, 2  # partitions; the first two are regimes of the third
MIN_CLEAR_STEPS = 5.0  # steps to a singular configuration beyond which a return to LU is worthwhile


@kernel
def look_around(eqs: Any, c: Any, H: Any, work: Any) -> None:
    """Note y as the last good position, after it was left by LU, which has noted none."""
    split(H.y, work.q, work.v)
    eqs.position(c.t, work.q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    work.branch_history[0].pivot_ratio = 0.0
    record_accepted(eqs, c.t, work.q, 0.0, 0.0, c.rank, work)
    if work.critical[0].kind == NO_CRITICAL_POINT:  # LU has compared all steps up to here
        store_reference_frame(work.q, eqs.terms, work)


@kernel
def frame_lu(terms: Any, c: Any, H: Any, work: Any) -> None:
    """Note orientation and tangents of the dependents, whose J_d is factored and whose tangents are at hand."""
    c.positive = 1 if is_determinant_positive(work.D, c.rank, work.order) else 0
    n = work.T.shape[1]
    for k in range(n - c.rank):
        for i in range(n):
            H.tangents[k, i] = work.T[k, i]


@kernel
def passed_lu(c: Any, H: Any, work: Any) -> bool:
    """Whether the LU step stayed on its branch for sure: J_d has kept the sign of its determinant, and tangents turned
    little.
    """
    same = (c.positive == 1) == is_determinant_positive(work.D, c.rank, work.order)
    return same and not have_tangents_turned(c.rank, H.tangents, work)


@kernel
def take_choice(terms: Any, c: Any, H: Any, work: Any) -> None:
    """Make the candidate choice of rows and coordinates the choice, at the position of ``terms``."""
    for i in range(work.rows.shape[0]):
        H.rows[i] = work.rows[i]
    for i in range(work.columns.shape[0]):
        H.columns[i] = work.columns[i]
    factor_dependent(terms, c.rank, H.rows, H.columns, work)
    fill_dependent_tangents(terms, c.rank, H.rows, H.columns, work)
    frame_lu(terms, c, H, work)
    c.pivot = 0.0


@inlined
def jumped(eqs: Any, t: float, done: float, c: Any, o: Any, work: Any) -> bool:
    """Whether the energy, less the work ``done``, has jumped in an LU step of the hybrid, in units of the largest
    kinetic energy so far.
    """
    if o.partition != HYBRID:
        return False
    after = eqs.energy(t, work.q, work.v, eqs.data) - done
    kinetic = 0.0
    for i in range(work.v.shape[0]):
        for j in range(work.v.shape[0]):
            kinetic += 0.5 * work.v[i] * eqs.terms.M[i, j] * work.v[j]
    allowed = o.energy_jump * max(kinetic, c.kinetic) + o.rtol * (abs(after) + abs(done))
    if c.regime == LU and abs(after - c.energy) > allowed:
        return True
    c.energy = after
    c.kinetic = max(kinetic, c.kinetic)
    return False


@kernel
def give_up_lu(eqs: Any, c: Any, H: Any, work: Any) -> None:
    """Go on by projection from the last accepted state."""
    c.regime, c.calm = PROJECTION, 0
    look_around(eqs, c, H, work)


@kernel
def leave_lu(eqs: Any, c: Any, o: Any, work: Any, H: Any) -> None:
    """After an accepted LU step: the paper's re-choice, and what the hybrid makes of it.

    The hybrid looks ahead by the smallest pivot of J_d. Where that is nearly nothing, or would be within a few steps,
    and no other choice helps it gives LU up, and where the choice flickers.
    """
    ends = False
    if o.partition == HYBRID:
        frame_lu(eqs.terms, c, H, work)
        before, c.pivot = c.pivot, smallest_pivot_ratio(c.rank, work)
        ends = c.pivot < SINGULAR_PIVOT_RATIO or extrapolate_to_zero(before, c.pivot, c.hold) < LOOKAHEAD_STEPS * c.h
    if not (due_for_choice(c) or ends):
        return
    found = choose_partition(eqs.terms, c.rank, work)
    if ends and not (found and is_better_partition(c.rank, work)):
        give_up_lu(eqs, c, H, work)
        c.by_turn += 1
        return
    if not found or (o.partition == HYBRID and not is_better_partition(c.rank, work)):
        return
    changed = not is_same_partition(c.rank, H.columns, work.columns)
    if changed or not is_same_partition(c.rank, H.rows, work.rows):
        take_choice(eqs.terms, c, H, work)
    if not changed:
        return
    c.flickers = c.flickers + 1 if c.steps - c.changed_at < o.flicker_steps else 0
    c.changes += 1
    c.changed_at = c.steps
    if o.partition == LU:
        c.start = 1
    elif c.flickers >= o.flicker_count:
        give_up_lu(eqs, c, H, work)
        c.by_flicker += 1


@inlined
def due_for_choice(c: Any) -> bool:
    """Whether the paper repeats the choice: the step has shrunk, or stayed equal for five steps."""
    c.equal = c.equal + 1 if c.hold == c.h_before else 0
    shrunk = c.hold < c.h_before
    c.h_before = c.hold
    if not (shrunk or c.equal >= 5):
        return False
    c.equal = 0
    return True


@kernel
def return_to_lu(c: Any, o: Any, terms: Any, work: Any, H: Any) -> None:
    """After an accepted projection step of the hybrid: count steps in which LU would have kept its choice.

    If a singular configuration is a few steps ahead LU is not worthwhile.
    """
    here = work.branch_history[0]
    calm = here.pivot_ratio >= SINGULAR_PIVOT_RATIO and here.time_to_singular >= MIN_CLEAR_STEPS * c.h
    calm = calm and c.h >= min(c.hold, o.max_step)
    calm = choose_partition(terms, c.rank, work) and calm
    if not factor_dependent(terms, c.rank, H.rows, H.columns, work) or is_better_partition(c.rank, work):
        for i in range(work.rows.shape[0]):
            H.rows[i] = work.rows[i]
        for i in range(work.columns.shape[0]):
            H.columns[i] = work.columns[i]
        calm = False
    c.calm = c.calm + 1 if calm else 0
    if c.calm >= o.calm_steps:
        take_choice(terms, c, H, work)
        c.regime, c.equal, c.h_before, c.flickers = LU, 0, 0.0, 0
        c.returns += 1
