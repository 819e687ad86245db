"""Kernels that read quantities by their kind and place, see :mod:`.quantities`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import part_sensor_value, signal_value
from mbfmu.mechanics.quantity_kinds import BLOCK, SENSOR, VELOCITY
from solvers.compiled.indirect_call import call_f
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

VALUE = 1  # kernel of the output of a block, see mbfmu.mechanics.sensors.blocks


@inlined
def block_value(k: int, t: float, arrays: Arrays, state: State) -> float:
    """Value of part k, an output of a block, at time t."""
    item = arrays.parts[k]
    return call_f(arrays.kernels[item.kind + VALUE], arrays.memory, item.at, state.time, (t, arrays, state))


@kernel
def read_quantity(kind: int, place: int, t: float, arrays: Arrays, state: State) -> float:
    """Value of a signal, a first-order state, a sensor or the output of a block."""
    if kind == VELOCITY:
        return state.v[place]
    if kind == SENSOR:
        return part_sensor_value(place, arrays, state)
    if kind == BLOCK:
        return block_value(place, t, arrays, state)
    return signal_value(place, t, arrays) + 0.0 * state.time[0]  # of the type of the state
