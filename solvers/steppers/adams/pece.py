"""Adams PECE on any formulation, as templates (:mod:`solvers.compiled.template`).

Predict (P), evaluate at the prediction (E), correct (C), *close* the corrected state onto the constraints, evaluate
there (E). Closing does not touch the history: its differences belong to y' at closed states, so that no restart is
needed after it. Only if loads have just changed at the requested time, and may change again, one-step formulas take
steps that end there (:mod:`.one_step`).

A formulation is a module with the hooks below: :mod:`.loop` for matrices, :mod:`.tree_loop` for recursions. The state
under evaluation is in ``work.q`` and ``work.v``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.compiled.template import require_hooks, specialize
from solvers.energy_account import count_rejected_step, fill_account_row
from solvers.outcome import BRANCHES, COLLAPSED, OK
from solvers.steppers.step_control import FIRST_STEP_RATIO, retry_step
from solvers.steppers.step_loop import Loop, make_loop, set_step_options

from .formulas import (
    MAX_ORDER,
    accept_adams_step,
    correct_state,
    correct_work,
    estimate_errors,
    interpolate,
    pack_state,
    predict,
    start_history,
    undo_prediction,
    unpack_state,
    update_coefficients,
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
from .order_control import shorten_step

PECE_HOOKS = (
    "begin", "motion_rate", "set_error_weights", "evaluate_derivative", "evaluate_power", "record_energy",
    "accept_branch", "respond_to_cuts", "may_end_at", "close", "end_step",
)  # fmt: skip


def begin(integration: Any) -> int:
    """Hook: make y the state under evaluation, closed; return a code."""
    raise NotImplementedError


def motion_rate(integration: Any) -> float:
    """Hook: rate of the motion, 1/s."""
    raise NotImplementedError


def set_error_weights(integration: Any) -> None:
    """Hook: set ``history.weight`` to 1 / (rtol |y| + atol unit) at y."""
    raise NotImplementedError


def evaluate_derivative(integration: Any, t: float, closing: bool) -> int:
    """Hook: y' in ``history.yp`` at the state under evaluation, which is closed first if ``closing``; return a code."""
    raise NotImplementedError


def evaluate_power(integration: Any, t: float) -> float:
    """Hook: W' at the state evaluated last, W."""
    raise NotImplementedError


def record_energy(integration: Any, t: float) -> None:
    """Hook: record the energy at the state evaluated last, after its power (:mod:`solvers.energy_account`)."""
    raise NotImplementedError


def accept_branch(integration: Any, t: float) -> bool:
    """Hook: whether the step to the state evaluated last has stayed on its branch of the motion."""
    raise NotImplementedError


def respond_to_cuts(integration: Any, cuts: int) -> None:
    """Hook: change the formulation if a step has been shortened too often."""
    raise NotImplementedError


def may_end_at(integration: Any, target: float) -> bool:
    """Hook: whether a step may end at the requested time."""
    raise NotImplementedError


def close(integration: Any, t: float, q: Any, v: Any) -> int:
    """Hook: close a state that is reported at t; return a code."""
    raise NotImplementedError


def prepare(integration: Any) -> int:
    """Start or restart: evaluate y' at y, in ``history.yp`` and as the first stage, unless a one-step formula has done
    so.
    """
    history, control = integration.memory, integration.memory.control[0]
    if control.start == 0 or (control.needs_derivative == 0 and control.is_projected == 1):
        return OK
    code = begin(integration)
    if code == OK:
        code = evaluate_derivative(integration, control.t, False)
    if code == OK:
        history.yp[history.y.shape[0] - 1] = evaluate_power(integration, control.t)
        record_energy(integration, control.t)
        store_stage(history, 0)
        control.starts += 1
        control.h = control.rk_step_size if control.rk_step_size > 0.0 else FIRST_STEP_RATIO / motion_rate(integration)
        control.needs_derivative = 0
    return code


def take_step(integration: Any, target: float) -> int:
    """One accepted step, or the code of the reason why there is none."""
    history, control, settings = integration.memory, integration.memory.control[0], integration.settings[0]
    if control.start == 1 and control.rk_steps > 0 and may_end_at(integration, target):
        code = runge_kutta_step(integration, target)
    else:
        if control.start == 1:
            control.rk_steps = 0
            set_error_weights(integration)
            start_history(control, history, settings.max_step, motion_rate(integration))
        code = adams_step(integration)
    if code == OK:
        control.steps += 1
    return code


def runge_kutta_step(integration: Any, target: float) -> int:
    """One accepted step by the formulas of :mod:`.one_step`, not past ``target``; or why there is none.

    Its stages are off the constraints by what the formulas leave, its end is closed.
    """
    history, control, settings = integration.memory, integration.memory.control[0], integration.settings[0]
    q, v, last = integration.work.q, integration.work.v, history.y.shape[0] - 1
    set_error_weights(integration)
    is_forced = False
    while True:
        control.h = min(control.h, settings.max_step)
        truncate_step(control, target)
        code, error = OK, np.inf
        for i in range(1, N_STAGES):
            compute_stage(control, history, i)
            at = control.t + NODES[i] * control.h
            unpack_state(history.p, q, v)
            code = evaluate_derivative(integration, at, i == N_STAGES - 1)
            if code != OK:
                break
            history.yp[last] = evaluate_power(integration, at)
            store_stage(history, i)
        if code == OK:
            history.trial[last] = history.p[last]
            pack_state(q, v, history.trial)
            error = estimate_error(control, history)
            if error <= 1.0 or is_forced:
                record_energy(integration, control.t + control.h)
                if accept_branch(integration, control.t + control.h):
                    accept_runge_kutta_step(control, history, target, error)
                    return OK
                code, error = BRANCHES, np.inf
        count_rejected_step(control, code == OK)
        adapt_step(control, error)
        may_force = code == OK and not is_forced
        h, forces = retry_step(control.h, motion_rate(integration), settings.max_step, control.t, may_force)
        if h == 0.0:
            control.rk_step_size = 0.0
            return COLLAPSED if code == OK else code
        control.h, is_forced = h, is_forced or forces


def adams_step(integration: Any) -> int:
    """Attempt steps, shorter after each rejection, until one is accepted; or return the code of the last rejection."""
    history, control, settings = integration.memory, integration.memory.control[0], integration.settings[0]
    q, v = integration.work.q, integration.work.v
    set_error_weights(integration)
    cuts, is_forced = 0, False
    while True:
        update_coefficients(control)
        predict(control, history)
        unpack_state(history.p, q, v)
        after = control.t + control.h
        control.erk = 0.0
        code = evaluate_derivative(integration, after, False)
        if code == OK and (estimate_errors(control, history) <= 1.0 or is_forced):
            correct_state(control, history)
            unpack_state(history.trial, q, v)
            code = evaluate_derivative(integration, after, True)
            pack_state(q, v, history.trial)
            if code == OK:
                correct_work(control, history, evaluate_power(integration, after))
                record_energy(integration, after)
                if accept_branch(integration, after):
                    accept_adams_step(control, history, settings.max_order, settings.max_step)
                    return OK
                code = BRANCHES
        cuts += 1
        count_rejected_step(control, code == OK)
        undo_prediction(control, history)
        shorten_step(cuts, control)
        respond_to_cuts(integration, cuts)
        may_force = code == OK and not is_forced
        h, forces = retry_step(control.h, motion_rate(integration), settings.max_step, control.t, may_force)
        if h == 0.0:
            return COLLAPSED if code == OK else code
        control.h, is_forced = h, is_forced or forces
        if forces:
            control.k = 1


def report(integration: Any, code: int, target: float, q: Any, v: Any, energy_account: Any) -> int:
    """The state at ``target``, interpolated and closed, or where the last step ended; and its energy account."""
    history, control = integration.memory, integration.memory.control[0]
    last = history.y.shape[0] - 1
    unpack_state(history.y, q, v)
    done = history.y[last]
    if code == OK:
        if target < control.t:
            interpolate(control, history, target, history.trial)
            unpack_state(history.trial, q, v)
            done = history.trial[last]
        code = close(integration, target, q, v)
    fill_account_row(control, done, energy_account)
    return code


@kernel
def set_options(options: Any, settings_array: Any) -> None:
    """Set the options of a run (``solvers.options.OPTIONS``)."""
    set_step_options(options, settings_array)
    settings_array[0].max_order = options[0].max_order if options[0].max_order > 0 else MAX_ORDER


def make_pece_loop(module: str, **hooks: Any) -> Loop:
    """Return the kernels of the method on a formulation by its hooks; ``module`` is the name of its module."""
    require_hooks(PECE_HOOKS, module, hooks)
    for template in (prepare, runge_kutta_step, adams_step, take_step, report):
        hooks[template.__name__] = specialize(template, module, hooks)
    own = ("prepare", "take_step", "end_step", "report")
    return make_loop(module, **{name: hooks[name] for name in own})
