"""Adams PECE on constrained motion: the compiled step loop over the projection, LU and hybrid partitions.

State y = (q, v), all of it in the history in either regime. Predict (P), evaluate at the prediction (E),
correct (C), *close* the corrected state onto the constraints, evaluate there (E). Closing does not touch the
history: its differences belong to y' at closed states, so no restart is needed after it.

In the projection regime closing is a correction of the size of the tolerance along the constraint normals. In the LU
regime the dependents are solved from the independents (:mod:`solvers.projection.lu_partition`); in 'adams-lu' at every
evaluation, and they carry no error control, as in the paper. The hybrid changes regime by the rules of :mod:`.hybrid`.

No step is accepted that may have jumped to another branch, and steps are kept short near near misses; see
:mod:`solvers.projection.singular`.

A step may pass the requested time; the reported state is then interpolated and projected, so that the motion
does not depend on the output times. Only if loads have just changed at such a time, and may change again,
one-step formulas take steps that end there (:mod:`.one_step`), but not near a singular configuration.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import count_rejected_step, fill_account_row
from solvers.inertia import clear_growth
from solvers.outcome import BRANCHES, COLLAPSED, MAX_STEPS, NOT_CLOSED, OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.lu_partition import choose_partition
from solvers.projection.projection import project
from solvers.projection.reported import fill_reported_state
from solvers.projection.singular import IMPERFECT, SINGULAR_PIVOT_RATIO, branch_step_limit, record_accepted
from solvers.stepper import is_discontinuity, min_step_length
from solvers.steppers.step_control import FIRST_STEP_RATIO, MIN_STEP_RATIO

from .derivatives import evaluate_derivative, evaluate_power, record_energy, set_error_weights
from .formulas import (
    MAX_ORDER,
    accept_adams_step,
    correct_state,
    correct_work,
    estimate_errors,
    interpolate,
    pack_state,
    predict,
    set_tolerance_units,
    start_history,
    undo_prediction,
    unpack_state,
    update_coefficients,
)
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
)
from .one_step import (
    N_STAGES,
    NODES,
    accept_runge_kutta_step,
    adapt_step,
    compute_stage,
    estimate_error,
    store_stage,
    truncate_step,
)

SETTINGS = np.dtype(
    [
        ("rtol", "f8"), ("atol", "f8"), ("max_step", "f8"), ("max_order", "i8"), ("max_steps", "i8"),
        ("partition", "i8"),  # PROJECTION, LU, or HYBRID
        ("energy_check", "i8"), ("works", "i8"),  # 1: record energy and work; 1: some force does work
        ("flicker_steps", "i8"), ("flicker_count", "i8"), ("energy_jump", "f8"), ("collapse_cuts", "i8"),
        ("calm_steps", "i8"),
    ],
    align=True,
)  # fmt: skip
# Times the nearly singular ratio of the pivots, or times the way to the target: Runge-Kutta steps are possible.
CLEARANCE_FACTOR = 2.0


@inlined
def initialize_at_state(eqs: Any, control: Any, settings: Any, history: Any, work: Any) -> int:
    """Project y = (work.q, work.v) onto the constraints, record its position, and choose coordinates."""
    q, v = work.q, work.v
    code = project(eqs, control.t, q, v, control.rank, work)
    if code != OK:
        return code
    pack_state(q, v, history.y)
    work.branch_history[0].pivot_ratio = 0.0
    record_accepted(eqs, control.t, q, 0.0, 0.0, control.rank, work)
    if control.rank > 0 and work.branch_history[0].pivot_ratio < SINGULAR_PIVOT_RATIO and settings.partition == HYBRID:
        control.regime = PROJECTION
    if control.regime == LU:
        if not choose_partition(eqs.terms, control.rank, work):
            return NOT_CLOSED
        adopt_partition(eqs.terms, control, history, work)
    control.equal_steps, control.h_before = 0, 0.0
    return OK


@inlined
def no_singularity_ahead(control: Any, work: Any, target: float) -> bool:
    """Whether no singular configuration is near or ahead before ``target``, so that a step may end there."""
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
def prepare(eqs: Any, control: Any, settings: Any, history: Any, work: Any, scales: Any) -> int:
    """Start or restart: evaluate y' at y, in ``history.yp`` and as the first stage.

    Unless a single step has just ended at y, y is first projected and the coordinates are chosen.
    """
    q, v = work.q, work.v
    unpack_state(history.y, q, v)
    if control.is_projected == 0:
        code = initialize_at_state(eqs, control, settings, history, work)
        if code != OK:
            return code
    control.last_energy = eqs.energy(control.t, q, v, eqs.data) - history.y[history.y.shape[0] - 1]
    code = evaluate_derivative(eqs, control.t, False, control, settings, history, work)
    if code == OK:
        record_energy(eqs, control.t, control, settings, scales, work)
        history.yp[history.y.shape[0] - 1] = evaluate_power(eqs, control.t, control, settings, history, work)
        store_stage(history, 0)
        control.starts += 1
        control.h = control.rk_step_size if control.rk_step_size > 0.0 else FIRST_STEP_RATIO / work.rate[0]
        control.needs_derivative = 0
    return code


@kernel
def runge_kutta_step(eqs: Any, control: Any, settings: Any, history: Any, work: Any, scales: Any, target: float) -> int:
    """One accepted step by the formulas of :mod:`.one_step`, not past ``target``; or why there is none.

    Its stages are off the constraints by what the formulas leave, its end is closed.
    """
    q, v, last = work.q, work.v, history.y.shape[0] - 1
    set_error_weights(control, settings, history, q.shape[0], v.shape[0], work)
    is_min_step = False
    while True:
        control.h = min(control.h, settings.max_step)
        truncate_step(control, target)
        after, error = control.t + control.h, np.inf
        code = OK
        for i in range(1, N_STAGES):
            compute_stage(control, history, i)
            at = control.t + NODES[i] * control.h
            unpack_state(history.p, q, v)
            code = evaluate_derivative(eqs, at, i == N_STAGES - 1, control, settings, history, work)
            if code != OK:
                break
            if i == N_STAGES - 1:
                history.trial[last] = history.p[last]
                pack_state(q, v, history.trial)
                record_energy(eqs, at, control, settings, scales, work)
            history.yp[last] = evaluate_power(eqs, at, control, settings, history, work)
            store_stage(history, i)
        if code == OK:
            error = estimate_error(control, history)
            if error <= 1.0 or is_min_step:
                if accept_branch(eqs, after, control, settings, history, work):
                    accept_runge_kutta_step(control, history, target, error)
                    return OK
                code, error = BRANCHES, np.inf
        count_rejected_step(control, code == OK)
        adapt_step(control, error)
        smallest = min_step_length(MIN_STEP_RATIO, work.rate[0], settings.max_step, control.t)
        if not control.h > smallest:
            if is_min_step or code != OK or not is_discontinuity(settings.max_step, control.t):
                control.rk_step_size = 0.0
                return COLLAPSED if code == OK else code
            control.h, is_min_step = smallest, True


@kernel
def adams_step(eqs: Any, control: Any, settings: Any, history: Any, work: Any, scales: Any) -> int:
    """Attempt steps, shorter after each rejection, until one is accepted; or return the code of the last rejection."""
    q, v = work.q, work.v
    set_error_weights(control, settings, history, q.shape[0], v.shape[0], work)
    cuts, is_min_step = 0, False
    while True:
        update_coefficients(control)
        predict(control, history)
        unpack_state(history.p, q, v)
        after = control.t + control.h
        control.erk, error = 0.0, 0.0
        code = evaluate_derivative(eqs, after, False, control, settings, history, work)
        if code == OK:
            error = estimate_errors(control, history)
            if error <= 1.0 or is_min_step:
                correct_state(control, history)
                unpack_state(history.trial, q, v)
                code = evaluate_derivative(eqs, after, True, control, settings, history, work)
                pack_state(q, v, history.trial)
                if code == OK:
                    record_energy(eqs, after, control, settings, scales, work)
                    correct_work(control, history, evaluate_power(eqs, after, control, settings, history, work))
                    if accept_branch(eqs, after, control, settings, history, work):
                        accept_adams_step(control, history, settings.max_order, settings.max_step)
                        return OK
                    code = BRANCHES
        cuts += 1
        count_rejected_step(control, code == OK)
        shorten_step(cuts, control, history)
        if settings.partition == HYBRID and control.regime == LU and cuts >= settings.collapse_cuts:
            fall_back_to_projection(eqs, control, history, work)
            control.by_collapse += 1
        smallest = min_step_length(MIN_STEP_RATIO, work.rate[0], settings.max_step, control.t)
        if not control.h > smallest:
            if is_min_step or code != OK or not is_discontinuity(settings.max_step, control.t):
                return COLLAPSED if code == OK else code
            control.h, control.k, is_min_step = smallest, 1, True


@kernel
def accept_branch(eqs: Any, t: float, control: Any, settings: Any, history: Any, work: Any) -> bool:
    """Whether the step to (t, work.q, work.v) may be accepted; where LU is in doubt projection tries it again.

    LU alone is not watched.
    """
    if settings.partition == LU:
        return True
    done = history.trial[history.y.shape[0] - 1]
    if control.regime == PROJECTION:
        if on_same_branch(eqs, t, work.q, BRANCH_RESOLUTION, control.rank, work):
            has_energy_jump(eqs, t, done, control, settings, work)
            return True
        control.refused += 1
        return False
    if not is_on_same_branch_lu(control, history, work):
        fall_back_to_projection(eqs, control, history, work)
        control.by_turn += 1
        return False
    if has_energy_jump(eqs, t, done, control, settings, work):
        fall_back_to_projection(eqs, control, history, work)
        control.by_energy += 1
        return False
    return True


@inlined
def shorten_step(cuts: int, control: Any, history: Any) -> None:
    """Block 3 of STEP: undo the attempt, halve the step, after three failures fall back to order one."""
    undo_prediction(control, history)
    shrink = 0.5
    if cuts > 3 and 0.5 < 0.25 * control.erk:
        shrink = np.sqrt(0.5 / control.erk)
    control.h *= shrink
    if cuts >= 3:
        control.k = 1
    elif control.erk > 0.0:
        control.k = control.knew


@kernel
def advance(
    eqs: Any,
    settings_array: Any,
    history: Any,
    work: Any,
    scales: Any,
    target: float,
    q: Any,
    v: Any,
    energy_account: Any,
) -> int:
    """Step until ``target`` is passed; put the state there, closed, into (q, v), or the last good one on failure, and
    the energy account into ``energy_account`` (ACCOUNT_SIZE,).
    """
    control, settings = history.control[0], settings_array[0]
    code, taken = OK, 0
    while control.t < target:
        if taken >= settings.max_steps:
            code = MAX_STEPS
            break
        if control.start == 1 and (control.needs_derivative == 1 or control.is_projected == 0):
            code = prepare(eqs, control, settings, history, work, scales)
            if code != OK:
                break
        if control.start == 1 and control.rk_steps > 0 and no_singularity_ahead(control, work, target):
            code = runge_kutta_step(eqs, control, settings, history, work, scales, target)
        else:
            if control.start == 1:
                control.rk_steps = 0
                set_error_weights(control, settings, history, q.shape[0], v.shape[0], work)
                start_history(control, history, settings.max_step, work.rate[0])
            code = adams_step(eqs, control, settings, history, work, scales)
        if code != OK:
            break
        taken += 1
        control.steps += 1
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
    unpack_state(history.y, q, v)
    done = history.y[history.y.shape[0] - 1]
    if code == OK:
        if target < control.t:
            interpolate(control, history, target, history.trial)
            unpack_state(history.trial, q, v)
            done = history.trial[history.y.shape[0] - 1]
        code = project(eqs, target, q, v, control.rank, work)
    fill_account_row(control, done, energy_account)
    return code


@kernel
def set_options(options: Any, settings_array: Any) -> None:
    """Set the options of a run (``solvers.options.OPTIONS``)."""
    requested, settings = options[0], settings_array[0]
    settings.rtol, settings.atol = requested.rtol, requested.absolute
    settings.max_step, settings.max_steps, settings.energy_check = (
        requested.max_step,
        requested.max_steps,
        requested.energy_check,
    )
    settings.max_order = requested.max_order if requested.max_order > 0 else MAX_ORDER


@kernel
def set_up(integration: Any, rank: int, absolute: float) -> None:
    """Take rank, units and paces as they were found at the start; ``absolute`` is the tolerance in those units."""
    control, history, work = integration.memory.control[0], integration.memory, integration.work
    control.rank, control.changed_at = rank, -integration.settings[0].flicker_steps
    control.regime = PROJECTION if integration.settings[0].partition == PROJECTION else LU
    set_tolerance_units(history, absolute, work, integration.scales)
    clear_growth(work)


@kernel
def advance_reported(integration: Any, target: float) -> int:
    """:func:`advance` for the reported state."""
    return advance(
        integration.eqs,
        integration.settings,
        integration.memory,
        integration.work,
        integration.scales,
        target,
        integration.q,
        integration.v,
        integration.energy_account,
    )


@kernel
def sample(
    integration: Any, times: Any, q: Any, v: Any, a: Any, lam: Any, energy_account: Any, outputs: Any
) -> tuple[int, int]:
    """:func:`advance` to each of ``times`` in turn; state, accelerations, multipliers, energy account and outputs of
    the system in a row each.

    Returns the code and the number of complete rows; where ``advance`` failed the next row holds the last good state.
    """
    eqs, history, work, settings = integration.eqs, integration.memory, integration.work, integration.settings[0]
    for i in range(times.shape[0]):
        code = advance(
            eqs, integration.settings, history, work, integration.scales, times[i], q[i], v[i], energy_account[i]
        )
        if code == OK:
            code = fill_reported_state(
                eqs, times[i], q[i], v[i], settings.rtol, history.control[0], work, a[i], lam[i], outputs[i]
            )
        if code != OK:
            return code, i
    return OK, times.shape[0]
