"""Adams PECE on a large tree: the compiled step loop over its recursions.

State y = (q, v), y' by the articulated-body recursion. The formulas, their error and order control, and the rule that a
step may pass the requested time, are those of :mod:`.loop`; there is nothing to close. Quaternions are brought
back to unit length after each step, by a change of the size of the tolerance.

Explicit steps are bounded by stability: on a mesh of plates the fastest mode turns some thousand times while the
slowest moves. The error control keeps the step there, because an unstable step fails its test;
:attr:`solvers.options.Statistics.stability_limited` is their number.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel, records
from solvers.energy_account import count_rejected_step, energy_check_scheduled, fill_account_row, update_energy_bound
from solvers.inertia import INERTIA, clear_growth, tolerance_factor, update_tree_growth
from solvers.outcome import COLLAPSED, MAX_STEPS, NO_MASS, NOT_FINITE, OK
from solvers.positions import Positions, position_sizes
from solvers.stepper import is_discontinuity, min_step_length, start_rate
from solvers.steppers.step_control import FIRST_STEP_RATIO, MIN_STEP_RATIO
from solvers.system import Array

from .formulas import (
    accept_adams_step,
    correct_state,
    correct_work,
    estimate_errors,
    interpolate,
    pack_state,
    predict,
    set_tolerance_units,
    start_history,
    unpack_state,
    update_coefficients,
)
from .loop import shorten_step
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
        ("rate", "f8"),  # of the motion, 1/s
        ("energy_check", "i8"), ("works", "i8"),  # 1: record energy and work; 1: some force does work
    ],
    align=True,
)  # fmt: skip
# Absolute tolerance of a rate to that of its coordinate, in units of the motion's rate. A tighter one than IDA's costs
# nothing if stability limits the step, and a looser one lets the fastest modes grow.
RATE_TOLERANCE_RATIO = 1.5


class TreeEquations(NamedTuple):
    """What the loop calls."""

    forward: Any
    inverse: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    inertia_parts: Any
    data: Any


class Scratch(NamedTuple):
    """Units, a state, its rates, and arguments of inverse dynamics.

    Only the units and :meth:`memory` are needed after a call.
    """

    positions: Any  # solvers.positions.Positions
    size: Array  # (n,)   units of the coordinates
    size_q: Array  # (nq,)  units of the positions
    coordinate_rates: Array  # (n,)   1/s, that of the motion, as the tolerances of rates take it
    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    zero: Array  # (n,)
    lam: Array  # (0,)
    parts: Array  # (1 + n,) see solvers.system.TreeSystem.inertia_parts
    inertia: NDArray[Any]  # (1,) record of solvers.inertia.INERTIA

    @staticmethod
    def allocate(nq: int, n: int, positions: Positions) -> Scratch:
        """Return zeroed arrays."""
        sizes = n, nq, n, nq, n, n, nq, n, 0, 1 + n
        return Scratch._make((positions, *(np.zeros(size) for size in sizes), records(1, INERTIA)))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that are needed to continue a motion."""
        return [self.inertia]


@inlined
def evaluate_forward_dynamics(eqs: Any, t: float, q: Any, v: Any, qdot: Any, a: Any) -> int:
    """qdot (nq,) = N v and a (n,) = v' at (t, q, v)."""
    if eqs.forward(t, q, v, eqs.data, qdot, a) != 0:
        return NO_MASS
    for i in range(a.shape[0]):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@inlined
def evaluate_derivative(eqs: Any, t: float, control: Any, history: Any, scratch: Any) -> int:
    """y' in ``history.yp`` at (s.q, s.v)."""
    control.evaluations += 1
    code = evaluate_forward_dynamics(eqs, t, scratch.q, scratch.v, scratch.qdot, scratch.a)
    if code == OK:
        pack_state(scratch.qdot, scratch.a, history.yp)
    return code


@inlined
def set_error_weights(settings: Any, history: Any, scratch: Any) -> None:
    """Error weights at y, such that in meshes the norm is a root mean square: they have many coordinates of a kind."""
    size = history.y.shape[0] - 1
    scale = tolerance_factor(settings.rtol, 1.0, scratch) if scratch.inertia[0].watched == 1 else np.sqrt(1.0 * size)
    for i in range(size):
        history.weight[i] = 1.0 / (scale * (settings.rtol * abs(history.y[i]) + settings.atol * history.unit[i]))


@inlined
def evaluate_power(eqs: Any, t: float, settings: Any, scratch: Any) -> float:
    """W' at the state evaluated last."""
    return eqs.power(t, scratch.q, scratch.v, scratch.a, scratch.lam, eqs.data) if settings.works == 1 else 0.0


@kernel
def record_energy(eqs: Any, t: float, control: Any, settings: Any, scales: Any, scratch: Any) -> None:
    """Record the energy at (scratch.q, scratch.v); this costs an inverse dynamics (`solvers.energy_account`)."""
    if settings.energy_check == 1 and energy_check_scheduled(control):
        eqs.inverse(t, scratch.q, scratch.v, scratch.zero, scratch.lam, eqs.data, scratch.qdot, scratch.a)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, scales)
    if scratch.inertia[0].watched == 1:
        eqs.inertia_parts(eqs.data, scratch.parts)
        update_tree_growth(t, scratch.parts, scratch.v, scratch)


@kernel
def prepare(eqs: Any, control: Any, settings: Any, history: Any, scratch: Any, scales: Any) -> int:
    """Take y' at y, in ``history.yp`` and as the first stage."""
    unpack_state(history.y, scratch.q, scratch.v)
    code = evaluate_derivative(eqs, control.t, control, history, scratch)
    if code == OK:
        control.starts += 1
        history.yp[history.y.shape[0] - 1] = evaluate_power(eqs, control.t, settings, scratch)
        record_energy(eqs, control.t, control, settings, scales, scratch)
        store_stage(history, 0)
        control.h = control.rk_step_size if control.rk_step_size > 0.0 else FIRST_STEP_RATIO / settings.rate
        control.needs_derivative = 0
    return code


@kernel
def runge_kutta_step(
    eqs: Any, control: Any, settings: Any, history: Any, scratch: Any, scales: Any, target: float
) -> int:
    """One step by the formulas of :mod:`solvers.steppers.adams.one_step`, not past ``target``; or why there is none."""
    last = history.y.shape[0] - 1
    set_error_weights(settings, history, scratch)
    is_min_step = False
    while True:
        control.h = min(control.h, settings.max_step)
        truncate_step(control, target)
        code, error = OK, np.inf
        for i in range(1, N_STAGES):
            compute_stage(control, history, i)
            unpack_state(history.p, scratch.q, scratch.v)
            if i == N_STAGES - 1:
                eqs.retract(scratch.q, scratch.zero, eqs.data)
            code = evaluate_derivative(eqs, control.t + NODES[i] * control.h, control, history, scratch)
            if code != OK:
                break
            history.yp[last] = evaluate_power(eqs, control.t + NODES[i] * control.h, settings, scratch)
            store_stage(history, i)
        if code == OK:
            error = estimate_error(control, history)
            if error <= 1.0 or is_min_step:
                history.trial[last] = history.p[last]
                pack_state(scratch.q, scratch.v, history.trial)
                record_energy(eqs, control.t + control.h, control, settings, scales, scratch)
                accept_runge_kutta_step(control, history, target, error)
                return OK
        count_rejected_step(control, code == OK)
        adapt_step(control, error)
        smallest = min_step_length(MIN_STEP_RATIO, settings.rate, settings.max_step, control.t)
        if not control.h > smallest:
            if is_min_step or code != OK or not is_discontinuity(settings.max_step, control.t):
                control.rk_step_size = 0.0
                return COLLAPSED if code == OK else code
            control.h, is_min_step = smallest, True


@kernel
def adams_step(eqs: Any, control: Any, settings: Any, history: Any, scratch: Any, scales: Any) -> int:
    """Attempt steps, shorter after each rejection, until one is accepted; or return the code of the last rejection."""
    set_error_weights(settings, history, scratch)
    cuts, is_min_step = 0, False
    while True:
        update_coefficients(control)
        predict(control, history)
        unpack_state(history.p, scratch.q, scratch.v)
        control.erk = 0.0
        code = evaluate_derivative(eqs, control.t + control.h, control, history, scratch)
        if code == OK and (estimate_errors(control, history) <= 1.0 or is_min_step):
            correct_state(control, history)
            unpack_state(history.trial, scratch.q, scratch.v)
            eqs.retract(scratch.q, scratch.zero, eqs.data)
            code = evaluate_derivative(eqs, control.t + control.h, control, history, scratch)
            if code == OK:
                pack_state(scratch.q, scratch.v, history.trial)
                correct_work(control, history, evaluate_power(eqs, control.t + control.h, settings, scratch))
                record_energy(eqs, control.t + control.h, control, settings, scales, scratch)
                accept_adams_step(control, history, settings.max_order, settings.max_step)
                return OK
        cuts += 1
        count_rejected_step(control, code == OK)
        shorten_step(cuts, control, history)
        smallest = min_step_length(MIN_STEP_RATIO, settings.rate, settings.max_step, control.t)
        if not control.h > smallest:
            if is_min_step or code != OK or not is_discontinuity(settings.max_step, control.t):
                return COLLAPSED if code == OK else code
            control.h, control.k, is_min_step = smallest, 1, True


@kernel
def advance(
    eqs: Any,
    settings_array: Any,
    history: Any,
    scratch: Any,
    scales: Any,
    target: float,
    q: Any,
    v: Any,
    energy_account: Any,
) -> int:
    """Step until ``target`` is passed; put the state there into (q, v), or the last good one on failure, and what is
    energy account into ``energy_account`` (ACCOUNT_SIZE,).
    """
    control, settings = history.control[0], settings_array[0]
    code, taken = OK, 0
    while control.t < target:
        if taken >= settings.max_steps:
            code = MAX_STEPS
            break
        if control.start == 1 and (control.needs_derivative == 1 or control.is_projected == 0):
            code = prepare(eqs, control, settings, history, scratch, scales)
            if code != OK:
                break
        if control.start == 1 and control.rk_steps > 0:
            code = runge_kutta_step(eqs, control, settings, history, scratch, scales, target)
        else:
            if control.start == 1:
                set_error_weights(settings, history, scratch)
                start_history(control, history, settings.max_step, settings.rate)
            code = adams_step(eqs, control, settings, history, scratch, scales)
        if code != OK:
            break
        taken += 1
        control.steps += 1
    unpack_state(history.y, q, v)
    done = history.y[history.y.shape[0] - 1]
    if code == OK and target < control.t:
        interpolate(control, history, target, history.trial)
        unpack_state(history.trial, q, v)
        done = history.trial[history.y.shape[0] - 1]
        eqs.retract(q, scratch.zero, eqs.data)
    fill_account_row(control, done, energy_account)
    return code


@kernel
def set_up(integration: Any, t: float, known: float, duration: float) -> None:
    """Find units and the rate of the motion at the reported state, of time t (s); ``known`` (1/s) is what is known of
    the rate beforehand, ``duration`` (s) that of the run.
    """
    settings, history, scratch = integration.settings[0], integration.memory, integration.work
    if known > 0.0:
        settings.rate = start_rate(known, duration, scratch.size, integration.v[:0], scratch.a[:0])
    else:
        if evaluate(integration, t, scratch.a) != OK:
            for k in range(scratch.a.shape[0]):
                scratch.a[k] = 0.0
        settings.rate = start_rate(known, duration, scratch.size, integration.v, scratch.a)
    position_sizes(scratch.positions, scratch.size, scratch.size_q)
    for k in range(scratch.coordinate_rates.shape[0]):
        scratch.coordinate_rates[k] = RATE_TOLERANCE_RATIO * settings.rate
    integration.scales.mean_count[0] = 1 if scratch.inertia[0].watched == 1 else history.y.shape[0] - 1
    set_tolerance_units(history, settings.atol, scratch, integration.scales)
    clear_growth(scratch)


@kernel
def evaluate(integration: Any, t: float, a: Any) -> int:
    """Accelerations a (n,) at the reported state, of time t (s)."""
    return evaluate_forward_dynamics(integration.eqs, t, integration.q, integration.v, integration.work.qdot, a)


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
