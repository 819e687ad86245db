"""Adams PECE by matrices: the projection, LU and hybrid partitions, as the formulation of :mod:`.pece`.

State y = (q, v), all of it in the history in either regime. In the projection regime closing is a correction of the
size of the tolerance along the constraint normals. In the LU regime the dependents are solved from the independents
(:mod:`solvers.projection.lu_partition`); in 'adams-lu' at every evaluation, and they carry no error control, as in the
paper. The hybrid changes regime by the rules of :mod:`.hybrid`.

No step is accepted that may have jumped to another branch, and steps are kept short near near misses; see
:mod:`solvers.projection.singular`. The reported state is projected. Near a singular configuration no one-step formulas
are used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import f8, i8
from solvers.inertia import clear_growth
from solvers.outcome import NOT_CLOSED, OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.lu_partition import choose_partition
from solvers.projection.projection import project
from solvers.projection.reported import fill_reported_state
from solvers.projection.singular import IMPERFECT, SINGULAR_PIVOT_RATIO, branch_step_limit, record_accepted
from solvers.steppers.step_loop import StepSettingsRecord, make_sample

from .derivatives import evaluate_derivative, evaluate_power, record_energy, set_error_weights
from .formulas import pack_state, set_tolerance_units, unpack_state
from .hybrid import (
    HYBRID,
    LU,
    PROJECTION,
    adopt_partition,
    check_switch_to_lu,
    check_switch_to_projection,
    fall_back_to_projection,
    has_energy_jump,
    is_on_same_branch_lu,
    kinetic_energy,
    record_energy_level,
)
from .pece import make_pece_loop

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration


class SettingsRecord(StepSettingsRecord):
    """Options of Adams on matrices."""

    max_order: i8
    partition: i8  # PROJECTION, LU, or HYBRID
    flicker_steps: i8
    flicker_count: i8
    energy_jump: f8
    collapse_cuts: i8
    calm_steps: i8


SETTINGS = SettingsRecord.dtype
# Times the nearly singular ratio of the pivots, or times the way to the target: Runge-Kutta steps are possible.
CLEARANCE_FACTOR = 2.0


@kernel
def begin(integration: Integration) -> int:
    """Make y the state under evaluation. Unless a single step has just ended there, it is projected onto the
    constraints, its position is recorded, and the coordinates are chosen.
    """
    eqs, work, history = integration.eqs, integration.work, integration.memory
    control, q, v = history.control[0], work.q, work.v
    unpack_state(history.y, q, v)
    if control.is_projected == 0:
        code = project(eqs, control.t, q, v, control.rank, work)
        if code != OK:
            return code
        pack_state(q, v, history.y)
        if not record_start(integration):
            return NOT_CLOSED
        control.equal_steps, control.h_before = 0, 0.0
    control.last_energy = eqs.energy(control.t, q, v, eqs.data) - history.y[history.y.shape[0] - 1]
    return OK


@inlined
def record_start(integration: Integration) -> bool:
    """Record the position under evaluation, and choose regime and coordinates; False if there is no choice."""
    eqs, work, control = integration.eqs, integration.work, integration.memory.control[0]
    work.branch_history[0].pivot_ratio = 0.0
    record_accepted(eqs, control.t, work.q, 0.0, 0.0, control.rank, work)
    near_singular = control.rank > 0 and work.branch_history[0].pivot_ratio < SINGULAR_PIVOT_RATIO
    if near_singular and integration.settings[0].partition == HYBRID:
        control.regime = PROJECTION
    if control.regime == LU:
        if not choose_partition(eqs.terms, control.rank, work):
            return False
        adopt_partition(eqs.terms, control, integration.memory, work)
    return True


@inlined
def motion_rate(integration: Integration) -> float:
    """Rate of the motion, 1/s."""
    return integration.work.rate[0]


@inlined
def may_end_at(integration: Integration, target: float) -> bool:
    """Whether no singular configuration is near or ahead before ``target``, so that a step may end there."""
    control, work = integration.memory.control[0], integration.work
    here = work.branch_history[0]
    if control.rank == 0:
        return True
    if control.regime == LU:
        return control.min_pivot == 0.0 or control.min_pivot >= CLEARANCE_FACTOR * SINGULAR_PIVOT_RATIO
    return (
        work.critical[0].kind != IMPERFECT
        and here.pivot_ratio >= CLEARANCE_FACTOR * SINGULAR_PIVOT_RATIO
        and here.time_to_singular >= CLEARANCE_FACTOR * (target - control.t)
    )


@kernel
def accept_branch(integration: Integration, t: float) -> bool:
    """Whether the step to (t, work.q, work.v) may be accepted; where LU is in doubt projection tries it again.

    LU alone is not watched.
    """
    eqs, work, history, settings = integration.eqs, integration.work, integration.memory, integration.settings[0]
    control = history.control[0]
    if settings.partition == LU:
        return True
    if control.regime == PROJECTION:
        if not on_same_branch(eqs, t, work.q, BRANCH_RESOLUTION, control.rank, work):
            control.refused += 1
            return False
    elif not is_on_same_branch_lu(control, history, work):
        fall_back_to_projection(eqs, control, history, work)
        control.by_turn += 1
        return False
    if settings.partition == HYBRID:
        done = history.trial[history.y.shape[0] - 1]
        energy, kinetic = eqs.energy(t, work.q, work.v, eqs.data) - done, kinetic_energy(eqs, work)
        if has_energy_jump(energy, kinetic, done, control, settings):
            fall_back_to_projection(eqs, control, history, work)
            control.by_energy += 1
            return False
        record_energy_level(energy, kinetic, control)
    return True


@inlined
def respond_to_cuts(integration: Integration, cuts: int) -> None:
    """Leave LU in the hybrid if a step has been shortened too often."""
    control, settings = integration.memory.control[0], integration.settings[0]
    if settings.partition == HYBRID and control.regime == LU and cuts >= settings.collapse_cuts:
        fall_back_to_projection(integration.eqs, control, integration.memory, integration.work)
        control.by_collapse += 1


@inlined
def end_step(integration: Integration) -> None:
    """Record an accepted step, change the regime of the hybrid, and limit the step near singular configurations."""
    eqs, work, history, settings = integration.eqs, integration.work, integration.memory, integration.settings[0]
    control = history.control[0]
    if control.regime == LU:
        control.time_lu += control.hold
        check_switch_to_projection(eqs, control, settings, work, history)
    else:
        record_accepted(eqs, control.t, work.q, control.hold, control.h, control.rank, work)
        control.time_projection += control.hold
        if settings.partition == HYBRID:
            check_switch_to_lu(control, settings, eqs.terms, work, history)
    if settings.partition != LU:
        control.h = min(control.h, branch_step_limit(control.t, work.q, work.v, control.hold, eqs.terms, work))


@inlined
def close(integration: Integration, t: float, q: Reals, v: Reals) -> int:
    """Project a reported state onto the constraints."""
    return project(integration.eqs, t, q, v, integration.memory.control[0].rank, integration.work)


@inlined
def fill_row(integration: Integration, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, outputs: Reals) -> int:
    """Accelerations, multipliers and outputs of the system at the state reported last."""
    control, settings = integration.memory.control[0], integration.settings[0]
    return fill_reported_state(integration.eqs, t, q, v, settings.rtol, control, integration.work, a, lam, outputs)


@kernel
def set_up(integration: Integration, rank: int, absolute: float) -> None:
    """Take rank, units and paces as they were found at the start; ``absolute`` is the tolerance in those units."""
    control, history, work = integration.memory.control[0], integration.memory, integration.work
    control.rank, control.changed_at = rank, -integration.settings[0].flicker_steps
    control.regime = PROJECTION if integration.settings[0].partition == PROJECTION else LU
    set_tolerance_units(history, absolute, work, integration.scales)
    clear_growth(work)


advance, advance_reported = make_pece_loop(
    __name__,
    begin=begin,
    motion_rate=motion_rate,
    set_error_weights=set_error_weights,
    evaluate_derivative=evaluate_derivative,
    evaluate_power=evaluate_power,
    record_energy=record_energy,
    accept_branch=accept_branch,
    respond_to_cuts=respond_to_cuts,
    may_end_at=may_end_at,
    close=close,
    end_step=end_step,
)
sample = make_sample(__name__, advance=advance, fill_row=fill_row)
