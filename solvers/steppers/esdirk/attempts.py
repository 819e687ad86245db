"""Attempts at one step of ESDIRK3(2), and the next step size: one template for all formulations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined
from solvers.compiled.template import require_hooks, specialize
from solvers.outcome import COLLAPSED, OK
from solvers.steppers.step_control import (
    MIN_RECORDED_ERROR,
    end_of_step,
    retry_step,
    step_factor,
    truncated_step,
)

from .formulas import accept_step

# After a failure of Newton at a step size this many steps are not longer than this part of it.
RETRY_STEPS, RETRY_STEP_RATIO = 8, 0.6
ESDIRK_EXPONENT = 1.0 / 3.0  # of the estimate, of order 2
MIN_STEP_INCREASE, MAX_STEP_CHANGE = 2.0, 4.0  # next step in units of this one, if it is longer


def set_tolerances(integration: Any) -> None:
    """Hook: set the tolerances of the positions in this step."""
    raise NotImplementedError


def try_step(h: float, after: float, integration: Any) -> tuple[int, float]:
    """Hook: solve the stages of a step of h (s) to ``after`` (s); return a code and the error in tolerances."""
    raise NotImplementedError


def record_state(integration: Any) -> None:
    """Hook: record what is known of the state where the accepted step has ended."""
    raise NotImplementedError


@inlined
def next_step_size(h: float, error: float, control: Any) -> float:
    """The next step after one of h from its error and that of the step before."""
    factor = step_factor(h, error, control.last_error, control.last_error_step, ESDIRK_EXPONENT, MAX_STEP_CHANGE)
    if control.retry_steps > 0:
        control.retry_steps -= 1
        factor = min(factor, max(1.0, RETRY_STEP_RATIO * control.failed_step / h))
    return h if 1.0 <= factor < MIN_STEP_INCREASE else h * factor


def take_step(integration: Any, target: float) -> int:
    """Attempt steps, shorter after each rejection, until one is accepted; or return the code of the last rejection."""
    settings, memory = integration.settings[0], integration.memory
    control = memory.control[0]
    set_tolerances(integration)
    control.rejected_rate_error = np.inf
    while True:
        control.h = min(control.h, settings.max_step)
        h, after = control.h, control.t + control.h
        if control.truncated_steps > 0:
            h = truncated_step(control.t, control.h, target)
            after = end_of_step(control.t, h, target)
        code, error = try_step(h, after, integration)
        if code == OK and error <= 1.0:
            break
        control.rejected += 1
        if code == OK:
            control.rejected_rate_error = control.rate_error
            control.h = h * step_factor(h, error, 0.0, 0.0, ESDIRK_EXPONENT, MAX_STEP_CHANGE)
        else:
            control.h, control.failed_step, control.retry_steps = 0.5 * h, h, RETRY_STEPS
        if retry_step(control.h, settings.rate, settings.max_step, control.t, False)[0] == 0.0:
            return COLLAPSED if code == OK else code
    whole, longer = h >= control.h, next_step_size(h, error, control)
    control.last_error, control.last_error_step = max(error, MIN_RECORDED_ERROR), h
    control.last_rate_error = control.rate_error
    accept_step(h, after, memory, integration.work.stage)
    record_state(integration)
    control.h = longer if whole else max(control.h, longer)
    control.truncated_steps = max(0, control.truncated_steps - 1)
    return OK


def make_take_step(module: str, **hooks: Any) -> Callable[..., Any]:
    """Return the kernel ``take_step`` of a formulation by its hooks; ``module`` is the name of its module."""
    require_hooks(("set_tolerances", "try_step", "record_state"), module, hooks)
    return specialize(take_step, module, hooks)
