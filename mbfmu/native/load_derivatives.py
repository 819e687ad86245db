"""Derivatives by inputs that move no joint: forces, gravity, and quantities in laws, blocks and frictions.

The equations of motion and the outputs are linear in most of them. A symmetric difference is exact then, except for
rounding, whatever its step. In the others (:meth:`.CompiledMechanism.nonlinear_inputs`) differences of fourth order are
taken over steps that become shorter. Each derivative is the one with the smallest relative difference from that over
the step before: over longer steps the difference quotients have errors of the method, over shorter ones of rounding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.arrays.input_kernels import EXTRAPOLATED_LOAD, GRAVITY_LOAD, SUPPORT_MOTION
from mbfmu.mechanics.recursions.dynamics import gather_free, observe
from solvers.compiled.kernel import inlined, kernel

from .derivatives import NONLINEAR_LOAD

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.input_kernels import InputRecords
    from mbfmu.mechanics.records import Data
    from solvers.compiled.record import Reals

    from .derivatives import Linearization

FIRST_STEP_RATIO = 1.0 / 64.0  # of the first step to the input, or to 1 in its unit if that is larger
STEP_DECREASE = 0.125
# Shortest steps, to the input, and of one that is zero: over shorter ones rounding errors may agree
SHORTEST_STEP_RATIO, SHORTEST_STEP = 1e-7, 1e-9
AGREEMENT = 1e-13  # relative difference of derivatives over two steps, after which no other step is tried


@kernel
def differentiate_loads(inputs: InputRecords, data: Data, own: Linearization) -> None:
    """Fill ``loads`` and ``outputs`` with what inputs that move no joint contribute along the direction."""
    step = np.inf
    for i in range(own.loads.shape[0]):
        own.loads[i] = 0.0
    for i in range(own.outputs.shape[0]):
        own.outputs[i] = 0.0
    for k in range(own.signals.shape[0]):
        own.before[k] = load_input(inputs, k)
        if own.inputs[k] != 0.0 and is_load_value(inputs, k):
            if own.signals[k] == NONLINEAR_LOAD:
                differentiate_nonlinear(k, inputs, data, own)
            else:
                step = min(step, max(abs(own.before[k]), 1.0) / abs(own.inputs[k]))
    if not step < np.inf:
        return
    clear(own.quotients)
    for side in range(2):
        signed = step if side == 0 else -step
        for k in range(own.signals.shape[0]):
            if is_linear_load(inputs, k, own):
                set_load_input(inputs, k, own.before[k] + signed * own.inputs[k])
        add_evaluation(0.5 / signed, data, own)
    for k in range(own.signals.shape[0]):
        if is_linear_load(inputs, k, own):
            set_load_input(inputs, k, own.before[k])
    add_derivatives(1.0, own.quotients, own)


@inlined
def clear(values: Reals) -> None:
    """Set all to zero."""
    for i in range(values.shape[0]):
        values[i] = 0.0


@kernel
def add_evaluation(weight: float, data: Data, own: Linearization) -> None:
    """Add the forces and the outputs with the present inputs, times a weight, to ``quotients``."""
    n = own.loads.shape[0]
    observe(own.point[0].t, own.q, own.v, own.a, own.lam, data, own.observed)
    gather_free(data.state.tau, data.arrays, own.accelerations)
    for i in range(n):
        own.quotients[i] += weight * own.accelerations[i]
    for i in range(own.outputs.shape[0]):
        own.quotients[n + i] += weight * own.observed[i]


@inlined
def add_derivatives(factor: float, derivatives: Reals, own: Linearization) -> None:
    """Add derivatives (n + outputs,), times a factor, to ``loads`` and ``outputs``."""
    n = own.loads.shape[0]
    for i in range(n):
        own.loads[i] += factor * derivatives[i]
    for i in range(own.outputs.shape[0]):
        own.outputs[i] += factor * derivatives[n + i]


@kernel
def differentiate_nonlinear(k: int, inputs: InputRecords, data: Data, own: Linearization) -> None:
    """Add the derivatives by input k, times its part of the direction."""
    size = abs(own.before[k])
    step, is_first = FIRST_STEP_RATIO * max(size, 1.0), True
    shortest = SHORTEST_STEP_RATIO * size if size > 0.0 else SHORTEST_STEP
    while step > shortest:
        clear(own.quotients)
        for place in (-2.0, -1.0, 1.0, 2.0):
            set_load_input(inputs, k, own.before[k] + place * step)
            weight = (8.0 if abs(place) == 1.0 else -1.0) * np.sign(place)
            add_evaluation(weight / (12.0 * step), data, own)
        if compare_quotients(own, is_first):
            break
        is_first = False
        step *= STEP_DECREASE
    set_load_input(inputs, k, own.before[k])
    add_derivatives(own.inputs[k], own.estimates, own)


@kernel
def compare_quotients(own: Linearization, is_first: bool) -> bool:
    """Let quotients that differ less from the previous ones than others have done be the estimates; return whether all
    agree with the previous ones. Where all are zero, shorter steps may find a change.
    """
    agree, changes = not is_first, False
    for i in range(own.quotients.shape[0]):
        quotient, change = own.quotients[i], np.inf
        if not is_first and quotient != 0.0:
            change = abs(quotient - own.previous[i]) / abs(quotient)
        if is_first or change < own.changes[i] or not np.isfinite(own.estimates[i]):
            own.estimates[i], own.changes[i] = quotient, change if np.isfinite(change) else np.inf
        agree = agree and (change <= AGREEMENT or quotient == own.previous[i])
        changes = changes or quotient != 0.0
        own.previous[i] = quotient
    return agree and changes


@inlined
def is_linear_load(inputs: InputRecords, k: int, own: Linearization) -> bool:
    """Whether an input is a force or a component of gravity in which everything is linear."""
    return bool(is_load_value(inputs, k) and own.signals[k] != NONLINEAR_LOAD)


@inlined
def is_load_value(inputs: InputRecords, k: int) -> bool:
    """Whether an input is a value that acts at once, such as a force or a component of gravity, and not a rate."""
    role = inputs.inputs[k].role
    return bool(role == GRAVITY_LOAD or (role != SUPPORT_MOTION and inputs.inputs[k].coefficient == 0))


@inlined
def polynomial_of(inputs: InputRecords, k: int) -> int:
    """Number of the polynomial of an input that is a force."""
    number: int = inputs.inputs[k].number
    return inputs.loads[number].polynomial if inputs.inputs[k].role == EXTRAPOLATED_LOAD else number


@inlined
def load_input(inputs: InputRecords, k: int) -> float:
    """The value of an input that is a force or a component of gravity; zero: it is not."""
    if not is_load_value(inputs, k):
        return 0.0
    if inputs.inputs[k].role == GRAVITY_LOAD:
        return float(inputs.world[0].gravity[inputs.inputs[k].coefficient])
    return float(inputs.polynomials[polynomial_of(inputs, k)].c[0])


@inlined
def set_load_input(inputs: InputRecords, k: int, value: float) -> None:
    """Set it."""
    if inputs.inputs[k].role == GRAVITY_LOAD:
        inputs.world[0].gravity[inputs.inputs[k].coefficient] = value
    else:
        inputs.polynomials[polynomial_of(inputs, k)].c[0] = value
