"""The hybrid partition: LU while it is safe, projection where it is not, and when to change.

All coordinates are in the history and under error control, so a change costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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
from solvers.projection.workspace import count_freedom, count_motions, factor

from .formulas import unpack_state

if TYPE_CHECKING:
    from solvers.projection.workspace import Workspace
    from solvers.steppers.adams.formulas import History
    from solvers.steppers.adams.loop import SettingsRecord
    from solvers.system import Equations, Terms

PROJECTION, LU, HYBRID = 0, 1, 2  # partitions; the first two are regimes of the third
MIN_CLEAR_STEPS = 5.0  # steps to a singular configuration beyond which a return to LU is worthwhile


@kernel
def record_position(eqs: Equations, control: Any, history: History, work: Workspace) -> None:
    """Note y as the last good position, after it was left by LU, which has noted none."""
    unpack_state(history.y, work.q, work.v)
    eqs.position(control.t, work.q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    work.branch_history[0].pivot_ratio = 0.0
    record_accepted(eqs, control.t, work.q, 0.0, 0.0, control.rank, work)
    if work.critical[0].kind == NO_CRITICAL_POINT:  # LU has compared all steps up to here
        store_reference_frame(work.q, eqs.terms, work)


@kernel
def record_orientation(terms: Terms, control: Any, history: Any, work: Workspace) -> None:
    """Note orientation and tangents of the dependents, whose J_d is factored and whose tangents are at hand."""
    control.is_det_positive = 1 if is_determinant_positive(work.D, control.rank, work.order) else 0
    n = work.T.shape[1]
    for k in range(count_freedom(control.rank, work)):
        for i in range(n):
            history.tangents[k, i] = work.T[k, i]


@kernel
def is_on_same_branch_lu(control: Any, history: Any, work: Workspace) -> bool:
    """Whether the LU step stayed on its branch for sure: J_d has kept the sign of its determinant, and tangents turned
    little.
    """
    same = (control.is_det_positive == 1) == is_determinant_positive(work.D, control.rank, work.order)
    return same and not have_tangents_turned(control.rank, history.tangents, work)


@kernel
def adopt_partition(terms: Terms, control: Any, history: Any, work: Workspace) -> None:
    """Make the candidate choice of rows and coordinates the choice, at the position of ``terms``."""
    for i in range(work.rows.shape[0]):
        history.rows[i] = work.rows[i]
    for i in range(work.columns.shape[0]):
        history.columns[i] = work.columns[i]
    factor_dependent(terms, control.rank, history.rows, history.columns, work)
    fill_dependent_tangents(terms, control.rank, history.rows, history.columns, work)
    record_orientation(terms, control, history, work)
    control.min_pivot = 0.0


@inlined
def has_energy_jump(energy: float, kinetic: float, done: float, control: Any, settings: SettingsRecord) -> bool:
    """Whether the energy less the work ``done``, J, has jumped in an LU step since :func:`record_energy_level`, in
    units of the largest kinetic energy so far; ``kinetic`` is that of now, J.
    """
    if control.regime != LU:
        return False
    allowed = settings.energy_jump * max(kinetic, control.energy_scale) + settings.rtol * (abs(energy) + abs(done))
    return abs(energy - control.last_energy) > allowed


@inlined
def record_energy_level(energy: float, kinetic: float, control: Any) -> None:
    """Record the energy less the work done, and the kinetic energy of an accepted step, J."""
    control.last_energy = energy
    control.energy_scale = max(kinetic, control.energy_scale)


@inlined
def kinetic_energy(eqs: Equations, work: Workspace) -> float:
    """Kinetic energy of the state evaluated last, J."""
    kinetic, moving = 0.0, count_motions(work)
    for i in range(moving):
        for j in range(moving):
            kinetic += 0.5 * work.v[i] * eqs.terms.M[i, j] * work.v[j]
    return kinetic


@kernel
def fall_back_to_projection(eqs: Equations, control: Any, history: Any, work: Workspace) -> None:
    """Continue by projection from the last accepted state."""
    control.regime, control.lu_ready_steps = PROJECTION, 0
    record_position(eqs, control, history, work)


@kernel
def check_switch_to_projection(
    eqs: Equations, control: Any, settings: SettingsRecord, work: Workspace, history: Any
) -> None:
    """After an accepted LU step: the paper's re-choice, and what the hybrid makes of it.

    The hybrid extrapolates the smallest pivot of J_d. If that is nearly zero, or would be within a few steps, and no
    other choice is better, it continues by projection; also if the choice changes too often.
    """
    ends = False
    if settings.partition == HYBRID:
        record_orientation(eqs.terms, control, history, work)
        before, control.min_pivot = control.min_pivot, smallest_pivot_ratio(control.rank, work)
        ends = (
            control.min_pivot < SINGULAR_PIVOT_RATIO
            or extrapolate_to_zero(before, control.min_pivot, control.hold) < LOOKAHEAD_STEPS * control.h
        )
    if not (update_choice_schedule(control) or ends):
        return
    found = choose_partition(eqs.terms, control.rank, work)
    if ends and not (found and is_better_partition(control.rank, work)):
        fall_back_to_projection(eqs, control, history, work)
        control.by_turn += 1
        return
    if not found or (settings.partition == HYBRID and not is_better_partition(control.rank, work)):
        return
    changed = not is_same_partition(control.rank, history.columns, work.columns)
    if changed or not is_same_partition(control.rank, history.rows, work.rows):
        adopt_partition(eqs.terms, control, history, work)
    if not changed:
        return
    control.flickers = control.flickers + 1 if control.steps - control.changed_at < settings.flicker_steps else 0
    control.changes += 1
    control.changed_at = control.steps
    if settings.partition == LU:
        control.start = 1
    elif control.flickers >= settings.flicker_count:
        fall_back_to_projection(eqs, control, history, work)
        control.by_flicker += 1


@inlined
def update_choice_schedule(control: Any) -> bool:
    """Record the length of the last step; return whether the paper repeats the choice: the step has shrunk, or stayed
    equal for five steps.
    """
    control.equal_steps = control.equal_steps + 1 if control.hold == control.h_before else 0
    shrunk = control.hold < control.h_before
    control.h_before = control.hold
    if not (shrunk or control.equal_steps >= 5):
        return False
    control.equal_steps = 0
    return True


@kernel
def check_switch_to_lu(control: Any, settings: SettingsRecord, terms: Terms, work: Workspace, history: Any) -> None:
    """After an accepted projection step of the hybrid: count steps in which LU would have kept its choice.

    If a singular configuration is a few steps ahead LU is not worthwhile.
    """
    here = work.branch_history[0]
    calm = here.pivot_ratio >= SINGULAR_PIVOT_RATIO and here.time_to_singular >= MIN_CLEAR_STEPS * control.h
    calm = calm and control.h >= min(control.hold, settings.max_step)
    calm = choose_partition(terms, control.rank, work) and calm
    if not factor_dependent(terms, control.rank, history.rows, history.columns, work) or is_better_partition(
        control.rank, work
    ):
        for i in range(work.rows.shape[0]):
            history.rows[i] = work.rows[i]
        for i in range(work.columns.shape[0]):
            history.columns[i] = work.columns[i]
        calm = False
    control.lu_ready_steps = control.lu_ready_steps + 1 if calm else 0
    if control.lu_ready_steps >= settings.calm_steps:
        adopt_partition(terms, control, history, work)
        control.regime, control.equal_steps, control.h_before, control.flickers = LU, 0, 0.0, 0
        control.returns += 1
