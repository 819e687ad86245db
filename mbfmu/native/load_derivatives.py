"""Derivatives by forces and gravity that inputs give, in which the equations of motion and the outputs are linear.

A symmetric difference is exact then, except for rounding, whatever its step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.arrays.input_kernels import EXTRAPOLATED_LOAD, GRAVITY_LOAD, SUPPORT_MOTION
from mbfmu.mechanics.recursions.dynamics import gather_free, observe
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.input_kernels import InputRecords
    from mbfmu.mechanics.records import Data

    from .derivatives import Linearization


@kernel
def differentiate_loads(inputs: InputRecords, data: Data, own: Linearization) -> None:
    """Fill ``loads`` and ``outputs`` with what forces and gravity that are inputs contribute along the direction."""
    step = np.inf
    for i in range(own.loads.shape[0]):
        own.loads[i] = 0.0
    for i in range(own.outputs.shape[0]):
        own.outputs[i] = 0.0
    for k in range(own.signals.shape[0]):
        own.before[k] = load_input(inputs, k)
        if own.inputs[k] != 0.0 and is_load_value(inputs, k):
            step = min(step, max(abs(own.before[k]), 1.0) / abs(own.inputs[k]))
    if not step < np.inf:
        return
    for side in range(2):
        signed = step if side == 0 else -step
        for k in range(own.signals.shape[0]):
            if is_load_value(inputs, k):
                set_load_input(inputs, k, own.before[k] + signed * own.inputs[k])
        observe(own.point[0].t, own.q, own.v, own.a, own.lam, data, own.observed)
        gather_free(data.state.tau, data.arrays, own.accelerations)
        for i in range(own.loads.shape[0]):
            own.loads[i] += 0.5 * own.accelerations[i] / signed
        for i in range(own.outputs.shape[0]):
            own.outputs[i] += 0.5 * own.observed[i] / signed
    for k in range(own.signals.shape[0]):
        if is_load_value(inputs, k):
            set_load_input(inputs, k, own.before[k])


@inlined
def is_load_value(inputs: InputRecords, k: int) -> bool:
    """Whether an input is a force or a component of gravity, and not a rate."""
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
