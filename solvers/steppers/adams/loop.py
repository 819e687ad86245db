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
from solvers.energy_account import count_rejected_step, energy_check_scheduled, fill_account_row, update_energy_bound
from solvers.inertia import clear_growth, tolerance_factor, update_growth
from solvers.outcome import BRANCHES, COLLAPSED, MAX_STEPS, NOT_CLOSED, OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.lu_partition import (
    choose_partition,
    evaluate_dependent_acceleration,
    evaluate_dependent_multipliers,
    factor_dependent,
    project_dependents,
    restore_dependents,
)  # fmt: skip
from solvers.projection.projection import (
    evaluate_acceleration,
    evaluate_multipliers,
    is_near_bifurcation,
    project,
    project_with_frozen_jacobian,
)
from solvers.projection.reported import fill_reported_state
from solvers.projection.singular import IMPERFECT, SINGULAR_PIVOT_RATIO, branch_step_limit, record_accepted
from solvers.projection.workspace import factor
from solvers.stepper import is_discontinuity, min_step_length
from solvers.steppers.step_control import FIRST_STEP_RATIO, MIN_RTOL_TIMES_GAP, MIN_STEP_RATIO

from .formulas import (
    MAX_ORDER,
    accept,
    begin,
    coefficients,
    correct,
    correct_work,
    estimate,
    interpolate,
    join,
    predict,
    set_units,
    split,
    unwind,
)
from .hybrid import HYBRID, LU, PROJECTION, give_up_lu, jumped, leave_lu, passed_lu, return_to_lu, take_choice
from .one_step import NODES, STAGES, change_step, error_of_step, keep_stage, stage, stop_at, take_step

SETTINGS = np.dtype(
    [
        ("rtol", "f8"), ("atol", "f8"), ("max_step", "f8"), ("max_order", "i8"), ("max_steps", "i8"),
        ("partition", "i8"),  # PROJECTION, LU, or HYBRID
        ("energy_check", "i8"), ("works", "i8"),  # 1: book energy and work; 1: something does work
        ("flicker_steps", "i8"), ("flicker_count", "i8"), ("energy_jump", "f8"), ("collapse_cuts", "i8"),
        ("calm_steps", "i8"),
    ],
    align=True,
)  # fmt: skip
FROZEN_JACOBIAN_RATIO = 1e-3  # part of the tolerance: a smaller correction of the position needs no new J
# Times the nearly singular ratio of the pivots, or times the way to the target: Runge-Kutta steps are possible.
CLEARANCE_FACTOR = 2.0


@inlined
def weigh(c: Any, o: Any, H: Any, nq: int, n: int, work: Any) -> None:
    """Error weights 1 / (rtol |y| + atol unit) at y; with 'adams-lu' dependent coordinates get none: they are not
    controlled.

    Near a near miss rounding limits the accuracy: a smaller tolerance only makes steps smaller.
    """
    c.coarser = 1.0
    if work.critical[0].kind == IMPERFECT:
        gap = abs(work.critical[0].bifurcation_gap)
        c.coarser = max(1.0, MIN_RTOL_TIMES_GAP / (gap * o.rtol))
        if c.coarser > c.coarsest:
            c.coarsest, c.narrowest = c.coarser, gap
    scale = c.coarser * tolerance_factor(o.rtol, 1.0, work)
    for i in range(nq + n):
        H.weight[i] = 1.0 / (scale * (o.rtol * abs(H.y[i]) + o.atol * H.unit[i]))
    if o.partition == LU:
        for j in range(c.rank):
            H.weight[nq + H.columns[j]] = 0.0
            if nq == n:
                H.weight[H.columns[j]] = 0.0


@kernel
def differentiate(eqs: Any, t: float, closing: bool, c: Any, o: Any, H: Any, work: Any) -> int:
    """y' in ``H.yp`` at (work.q, work.v), which are closed first where ``closing`` or in the LU regime."""
    q, v, rank = work.q, work.v, c.rank
    c.evaluations += 1
    if c.regime == LU:
        if o.partition == LU:
            restore_dependents(rank, H.columns, H.y, q, v)
        if closing or o.partition == LU:
            hybrid = o.partition == HYBRID
            code = project_dependents(eqs, t, q, v, rank, H.rows, H.columns, hybrid, work)
        else:
            eqs.dynamics(t, q, v, eqs.data, eqs.terms)
            code = OK if factor_dependent(eqs.terms, rank, H.rows, H.columns, work) else NOT_CLOSED
        if code == OK:
            code = evaluate_dependent_acceleration(eqs.terms, rank, H.rows, H.columns, work, work.slope)
    else:
        code = OK
        if closing:
            code = project_with_frozen_jacobian(
                eqs, t, q, v, H.p, rank, FROZEN_JACOBIAN_RATIO * min(o.rtol, o.atol), work
            )
        else:
            eqs.dynamics(t, q, v, eqs.data, eqs.terms)
            factor(eqs.terms, work)
            if is_near_bifurcation(rank, work):  # v' of what is not closed is wrong by the inverse square of its pivot
                code = project(eqs, t, q, v, rank, work)
        if code == OK:
            code = evaluate_acceleration(eqs, t, q, v, rank, work, work.slope)
    if code == OK:
        join(eqs.terms.qdot, work.slope, H.yp)
    return code


@kernel
def power(eqs: Any, t: float, c: Any, o: Any, H: Any, work: Any) -> float:
    """W' at the state evaluated last, with v' in ``work.slope``."""
    if o.works == 0:
        return 0.0
    if c.regime == LU:
        evaluate_dependent_multipliers(eqs.terms, c.rank, H.rows, H.columns, work, work.slope, work.lam)
    else:
        evaluate_multipliers(eqs.terms, c.rank, work, work.slope, work.lam)
    return eqs.power(t, work.q, work.v, work.slope, work.lam, eqs.data)


@kernel
def book(eqs: Any, t: float, c: Any, o: Any, scales: Any, work: Any) -> None:
    """Book the energy at the state evaluated last, before :func:`power`; see :mod:`solvers.energy_account`."""
    update_growth(t, eqs.terms.M, work.v, work)
    if o.energy_check == 1 and energy_check_scheduled(c):
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, c, scales)
        c.step_energy_error_bound *= max(1.0, c.coarser)


@inlined
def settle_down(eqs: Any, c: Any, o: Any, H: Any, work: Any) -> int:
    """Close y = (work.q, work.v), look around, and choose coordinates."""
    q, v = work.q, work.v
    code = project(eqs, c.t, q, v, c.rank, work)
    if code != OK:
        return code
    join(q, v, H.y)
    work.branch_history[0].pivot_ratio = 0.0
    record_accepted(eqs, c.t, q, 0.0, 0.0, c.rank, work)
    if c.rank > 0 and work.branch_history[0].pivot_ratio < SINGULAR_PIVOT_RATIO and o.partition == HYBRID:
        c.regime = PROJECTION
    if c.regime == LU:
        if not choose_partition(eqs.terms, c.rank, work):
            return NOT_CLOSED
        take_choice(eqs.terms, c, H, work)
    c.equal, c.h_before = 0, 0.0
    return OK


@inlined
def clear_way(c: Any, work: Any, target: float) -> bool:
    """Whether no singular configuration is near the way to ``target``, so that a step may end there."""
    here = work.branch_history[0]
    if c.rank == 0:
        return True
    if c.regime == LU:
        return c.pivot == 0.0 or c.pivot >= CLEARANCE_FACTOR * SINGULAR_PIVOT_RATIO
    return (
        work.critical[0].kind != IMPERFECT
        and here.pivot_ratio >= CLEARANCE_FACTOR * SINGULAR_PIVOT_RATIO
        and here.time_to_singular >= CLEARANCE_FACTOR * (target - c.t)
    )


@kernel
def prepare(eqs: Any, c: Any, o: Any, H: Any, work: Any, scales: Any) -> int:
    """Start or restart: evaluate y' at y, in ``H.yp`` and as the first stage.

    Unless a single step has just ended at y, y is first projected and the coordinates are chosen.
    """
    q, v = work.q, work.v
    split(H.y, q, v)
    if c.placed == 0:
        code = settle_down(eqs, c, o, H, work)
        if code != OK:
            return code
    c.energy = eqs.energy(c.t, q, v, eqs.data) - H.y[H.y.shape[0] - 1]
    code = differentiate(eqs, c.t, False, c, o, H, work)
    if code == OK:
        book(eqs, c.t, c, o, scales, work)
        H.yp[H.y.shape[0] - 1] = power(eqs, c.t, c, o, H, work)
        keep_stage(H, 0)
        c.starts += 1
        c.h = c.single if c.single > 0.0 else FIRST_STEP_RATIO / work.rate[0]
        c.renew = 0
    return code


@kernel
def single_step(eqs: Any, c: Any, o: Any, H: Any, work: Any, scales: Any, target: float) -> int:
    """One accepted step by the formulas of :mod:`.one_step`, not past ``target``; or why there is none.

    Its stages are off the constraints by what the formulas leave, its end is closed.
    """
    q, v, last = work.q, work.v, H.y.shape[0] - 1
    weigh(c, o, H, q.shape[0], v.shape[0], work)
    shortest = False
    while True:
        c.h = min(c.h, o.max_step)
        stop_at(c, target)
        after, error = c.t + c.h, np.inf
        code = OK
        for i in range(1, STAGES):
            stage(c, H, i)
            at = c.t + NODES[i] * c.h
            split(H.p, q, v)
            code = differentiate(eqs, at, i == STAGES - 1, c, o, H, work)
            if code != OK:
                break
            if i == STAGES - 1:
                H.trial[last] = H.p[last]
                join(q, v, H.trial)
                book(eqs, at, c, o, scales, work)
            H.yp[last] = power(eqs, at, c, o, H, work)
            keep_stage(H, i)
        if code == OK:
            error = error_of_step(c, H)
            if error <= 1.0 or shortest:
                if stayed(eqs, after, c, o, H, work):
                    take_step(c, H, target, error)
                    return OK
                code, error = BRANCHES, np.inf
        count_rejected_step(c, code == OK)
        change_step(c, error)
        smallest = min_step_length(MIN_STEP_RATIO, work.rate[0], o.max_step, c.t)
        if not c.h > smallest:
            if shortest or code != OK or not is_discontinuity(o.max_step, c.t):
                c.single = 0.0
                return COLLAPSED if code == OK else code
            c.h, shortest = smallest, True


@kernel
def step(eqs: Any, c: Any, o: Any, H: Any, work: Any, scales: Any) -> int:
    """Attempt steps, shorter after each rejection, until one is accepted; or return the code of the last rejection."""
    q, v = work.q, work.v
    weigh(c, o, H, q.shape[0], v.shape[0], work)
    cuts, shortest = 0, False
    while True:
        coefficients(c)
        predict(c, H)
        split(H.p, q, v)
        after = c.t + c.h
        c.erk, error = 0.0, 0.0
        code = differentiate(eqs, after, False, c, o, H, work)
        if code == OK:
            error = estimate(c, H)
            if error <= 1.0 or shortest:
                correct(c, H)
                split(H.trial, q, v)
                code = differentiate(eqs, after, True, c, o, H, work)
                join(q, v, H.trial)
                if code == OK:
                    book(eqs, after, c, o, scales, work)
                    correct_work(c, H, power(eqs, after, c, o, H, work))
                    if stayed(eqs, after, c, o, H, work):
                        accept(c, H, o.max_order, o.max_step)
                        return OK
                    code = BRANCHES
        cuts += 1
        count_rejected_step(c, code == OK)
        cut(cuts, c, H)
        if o.partition == HYBRID and c.regime == LU and cuts >= o.collapse_cuts:
            give_up_lu(eqs, c, H, work)
            c.by_collapse += 1
        smallest = min_step_length(MIN_STEP_RATIO, work.rate[0], o.max_step, c.t)
        if not c.h > smallest:
            if shortest or code != OK or not is_discontinuity(o.max_step, c.t):
                return COLLAPSED if code == OK else code
            c.h, c.k, shortest = smallest, 1, True


@kernel
def stayed(eqs: Any, t: float, c: Any, o: Any, H: Any, work: Any) -> bool:
    """Whether the step to (t, work.q, work.v) may be accepted; where LU is in doubt projection tries it again.

    LU alone is not watched.
    """
    if o.partition == LU:
        return True
    done = H.trial[H.y.shape[0] - 1]
    if c.regime == PROJECTION:
        if on_same_branch(eqs, t, work.q, BRANCH_RESOLUTION, c.rank, work):
            jumped(eqs, t, done, c, o, work)
            return True
        c.refused += 1
        return False
    if not passed_lu(c, H, work):
        give_up_lu(eqs, c, H, work)
        c.by_turn += 1
        return False
    if jumped(eqs, t, done, c, o, work):
        give_up_lu(eqs, c, H, work)
        c.by_energy += 1
        return False
    return True


@inlined
def cut(cuts: int, c: Any, H: Any) -> None:
    """Block 3 of STEP: undo the attempt, halve the step, after three failures fall back to order one."""
    unwind(c, H)
    shrink = 0.5
    if cuts > 3 and 0.5 < 0.25 * c.erk:
        shrink = np.sqrt(0.5 / c.erk)
    c.h *= shrink
    if cuts >= 3:
        c.k = 1
    elif c.erk > 0.0:
        c.k = c.knew


@kernel
def advance(
    eqs: Any, settings: Any, H: Any, work: Any, scales: Any, target: float, q: Any, v: Any, energy_account: Any
) -> int:
    """Step until ``target`` is passed; put the state there, closed, into (q, v), or the last good one on failure, and
    what is booked into ``energy_account`` (ROW,).
    """
    c, o = H.control[0], settings[0]
    code, taken = OK, 0
    while c.t < target:
        if taken >= o.max_steps:
            code = MAX_STEPS
            break
        if c.start == 1 and (c.renew == 1 or c.placed == 0):
            code = prepare(eqs, c, o, H, work, scales)
            if code != OK:
                break
        if c.start == 1 and c.singles > 0 and clear_way(c, work, target):
            code = single_step(eqs, c, o, H, work, scales, target)
        else:
            if c.start == 1:
                c.singles = 0
                weigh(c, o, H, q.shape[0], v.shape[0], work)
                begin(c, H, o.max_step, work.rate[0])
            code = step(eqs, c, o, H, work, scales)
        if code != OK:
            break
        taken += 1
        c.steps += 1
        if c.regime == LU:
            c.time_lu += c.hold
            leave_lu(eqs, c, o, work, H)
        else:
            record_accepted(eqs, c.t, work.q, c.hold, c.h, c.rank, work)
            c.time_projection += c.hold
            if o.partition == HYBRID:
                return_to_lu(c, o, eqs.terms, work, H)
        if o.partition != LU:
            c.h = min(c.h, branch_step_limit(c.t, work.q, work.v, c.hold, eqs.terms, work))
    split(H.y, q, v)
    done = H.y[H.y.shape[0] - 1]
    if code == OK:
        if target < c.t:
            interpolate(c, H, target, H.trial)
            split(H.trial, q, v)
            done = H.trial[H.y.shape[0] - 1]
        code = project(eqs, target, q, v, c.rank, work)
    fill_account_row(c, done, energy_account)
    return code


@kernel
def take_options(options: Any, settings: Any) -> None:
    """Set the options of a run (``solvers.options.OPTIONS``)."""
    asked, o = options[0], settings[0]
    o.rtol, o.atol = asked.rtol, asked.absolute
    o.max_step, o.max_steps, o.energy_check = asked.max_step, asked.max_steps, asked.energy_check
    o.max_order = asked.max_order if asked.max_order > 0 else MAX_ORDER


@kernel
def set_up(g: Any, rank: int, absolute: float) -> None:
    """Take rank, units and paces as they were found at the start; ``absolute`` is the tolerance in those units."""
    c, H, work = g.memory.control[0], g.memory, g.work
    c.rank, c.changed_at = rank, -g.settings[0].flicker_steps
    c.regime = PROJECTION if g.settings[0].partition == PROJECTION else LU
    set_units(H, absolute, work, g.scales)
    clear_growth(work)


@kernel
def advance_reported(g: Any, target: float) -> int:
    """:func:`advance` for the reported state."""
    return advance(g.eqs, g.settings, g.memory, g.work, g.scales, target, g.q, g.v, g.energy_account)


@kernel
def sample(g: Any, times: Any, q: Any, v: Any, a: Any, lam: Any, energy_account: Any, outputs: Any) -> tuple[int, int]:
    """:func:`advance` to each of ``times`` in turn; state, accelerations, multipliers, energy account and outputs of
    the system in a row each.

    Returns the code and the number of complete rows; where ``advance`` failed the next row holds the last good state.
    """
    eqs, H, work, o = g.eqs, g.memory, g.work, g.settings[0]
    for i in range(times.shape[0]):
        code = advance(eqs, g.settings, H, work, g.scales, times[i], q[i], v[i], energy_account[i])
        if code == OK:
            code = fill_reported_state(eqs, times[i], q[i], v[i], o.rtol, H.control[0], work, a[i], lam[i], outputs[i])
        if code != OK:
            return code, i
    return OK, times.shape[0]
