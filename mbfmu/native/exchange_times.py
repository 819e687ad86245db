"""Time events of model exchange, and the inputs at the time of an evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.arrays.input_kernels import EXTRAPOLATED_LOAD, GRAVITY_LOAD, SUPPORT_MOTION
from mbfmu.mechanics.recursions.dynamics import input_step_limit
from mbfmu.mechanics.signals.step import JUMP_TIME_TOLERANCE
from solvers.compiled.kernel import kernel

from .exchange_memory import JUMP, JUMP_END

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.input_kernels import InputRecords

MAX_APPROACHES = 100  # times to which a signal halves the way, before the time at which it changes
# of times, relative to the time or 1 s: a jump of a signal takes no longer; see mbfmu.mechanics.signals.step
MAX_JUMP_DURATION_RATIO = 4.0 * JUMP_TIME_TOLERANCE
HALF_TOLERANCE = 1e-6  # relative error of half the way
ACCELERATION = 2  # coefficient of an input that is an acceleration


@kernel
def find_next_event(t: float, data: Any) -> float:
    """The time after t (s) at which a signal changes, or until which its longest step is known, s; infinite: none.

    A signal that is about to change gives half the way to this time as the next time, and again half of the rest.
    """
    longest, until = input_step_limit(t, data)
    for _ in range(MAX_APPROACHES):
        if not until < np.inf:
            break
        step, after = input_step_limit(until, data)
        half = 0.5 * (until - t)
        is_approach = abs(longest - 2.0 * half) <= HALF_TOLERANCE * half
        if not (is_approach and abs(after - until - half) <= HALF_TOLERANCE * half):
            break
        t, longest, until = until, step, after
    return float(until)


@kernel
def find_end_of_jump(t: float, data: Any) -> float:
    """The time at which a signal that jumps at t (s) has jumped; else t."""
    _, until = input_step_limit(t, data)
    return float(until) if until - t <= MAX_JUMP_DURATION_RATIO * max(1.0, abs(t)) else t


@kernel
def place_inputs(i: InputRecords, t: float) -> None:
    """Let all inputs have their present values at t, s. Motions of joints without an input of the acceleration go on
    from the start at a constant rate.
    """
    for k in range(i.inputs.shape[0]):
        role, number = i.inputs[k].role, i.inputs[k].number
        if role == EXTRAPOLATED_LOAD:
            i.polynomials[i.loads[number].polynomial].t0 = t
        elif role == SUPPORT_MOTION:
            if i.inputs[k].coefficient == ACCELERATION:
                i.polynomials[i.supports[number].polynomial].t0 = t
        elif role != GRAVITY_LOAD:
            i.polynomials[number].t0 = t


@kernel
def begin_evaluation(instance: Any, t: float) -> float:
    """Place the inputs; return the time (s) at which the equations are evaluated: t, or the end of a jump at t."""
    times = instance.exchange.times
    evaluated = times[JUMP_END] if times[JUMP] <= t < times[JUMP_END] else t
    place_inputs(instance.inputs, evaluated)
    return float(evaluated)
