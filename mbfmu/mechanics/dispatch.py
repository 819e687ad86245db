"""How the recursions meet what they do not know: the kernels of kinds, called by their address.

``Arrays.kernels`` has the addresses of each kind from ``kind`` on, in the order in which its role names them
(``Joint.kernels``); ``Arrays.memory`` has the records.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.child_frame import attach_bias, attach_child
from solvers.compiled.indirect_call import call_f, call_ff, call_fff, call_void
from solvers.compiled.kernel import inlined
from solvers.compiled.record_view import record_at

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, BodyRecord, CouplingRecord, CutRecord, ItemRecord, SensorRecord, State
    from solvers.compiled.record import Reals

PLACE, BIAS = 0, 1  # of a joint
EVALUATE = 0  # of a cut joint, of a coupling, of a signal
LONGEST_STEP = 1  # of a signal
APPLY, POTENTIAL, POWER, TANGENT, MONITOR, MISPLACEMENT, CLEARANCE, LONGEST_LOAD_STEP = range(8)  # of a load
MONITOR_CUT = 1  # of a cut joint
READ = 0  # of a sensor


@inlined
def place_child(body: BodyRecord, arrays: Arrays, state: State) -> None:
    """Let a body's joint write its subspace and placement into State.rel; see :mod:`.joints.base`."""
    call_void(arrays.kernels[body.kind + PLACE], arrays.memory, body.at, (body.qi, state))
    if body.attached == 1:
        attach_child(body, state.rel[0])


@inlined
def has_bias(body: BodyRecord, arrays: Arrays) -> bool:
    """Whether the subspace of a body's joint turns in its frame."""
    return arrays.kernels[body.kind + BIAS] != 0 or body.attached == 1


@inlined
def joint_bias(body: BodyRecord, arrays: Arrays, state: State) -> None:
    """Let a body's joint write into State.rel what that adds."""
    if body.attached == 1:
        call_void(arrays.kernels[body.kind + PLACE], arrays.memory, body.at, (body.qi, state))
        for k in range(6):
            state.rel[0].bias[k] = 0.0
    if arrays.kernels[body.kind + BIAS] != 0:
        call_void(arrays.kernels[body.kind + BIAS], arrays.memory, body.at, (body.qi, body.vi, state))
    if body.attached == 1:
        attach_bias(body, state.v, state.rel[0])


@inlined
def evaluate_cut(cut: CutRecord, arrays: Arrays, state: State) -> None:
    """Let a cut joint write its rows; see :mod:`.cuts.base`."""
    A, B = state.bodies[cut.a], state.bodies[cut.b]
    call_void(arrays.kernels[cut.kind + EVALUATE], arrays.memory, cut.at, (A, B, cut.row, arrays, state))


@inlined
def cut_monitor(cut: CutRecord, arrays: Arrays, state: State) -> tuple[float, float, float]:
    """What the kernel ``monitor`` of a cut joint returns, see :mod:`.cuts.base`; zeros: it has none."""
    address = arrays.kernels[cut.kind + MONITOR_CUT]
    if address == 0:
        return 0.0, 0.0, 0.0
    A, B = state.bodies[cut.a], state.bodies[cut.b]
    return call_fff(address, arrays.memory, cut.at, state.time, (A, B, arrays))


@inlined
def evaluate_coupling(coupling: CouplingRecord, arrays: Arrays, state: State) -> tuple[float, float, float]:
    """f, f' and f'' of a coupling where its second coordinate is; see :mod:`.couplings.base`."""
    address = arrays.kernels[coupling.kind + EVALUATE]
    return call_fff(address, arrays.memory, coupling.at, state.q, (state.q[coupling.qb], arrays))


@inlined
def apply_load(load: ItemRecord, t: float, arrays: Arrays, state: State) -> None:
    """Let a load add its own; see :mod:`.loads.base`."""
    call_void(arrays.kernels[load.kind + APPLY], arrays.memory, load.at, (t, arrays, state))


@inlined
def load_potential(load: ItemRecord, arrays: Arrays, state: State) -> float:
    """Energy a load stores, J."""
    address = arrays.kernels[load.kind + POTENTIAL]
    if address == 0:
        return 0.0 * state.time[0]
    return call_f(address, arrays.memory, load.at, state.time, (arrays, state))


@inlined
def load_power(load: ItemRecord, t: float, arrays: Arrays, state: State) -> float:
    """Power of a load but for what it stores, W."""
    address = arrays.kernels[load.kind + POWER]
    if address == 0:
        return 0.0 * state.time[0]
    return call_f(address, arrays.memory, load.at, state.time, (t, arrays, state))


@inlined
def load_tangent(load: ItemRecord, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals) -> float:
    """Let a load add its tangent to K; return 1.0, or 0.0 where there is none."""
    address = arrays.kernels[load.kind + TANGENT]
    return call_f(address, arrays.memory, load.at, state.time, (c1, arrays, state, perturbed, K))


@inlined
def signal(k: int, t: float, arrays: Arrays) -> tuple[float, float, float]:
    """Value and two derivatives of signal k at time t; see :mod:`.signals.base`."""
    item = arrays.signals[k]
    return call_fff(arrays.kernels[item.kind + EVALUATE], arrays.memory, item.at, arrays.world[0].gravity, (t, arrays))


@inlined
def signal_value(k: int, t: float, arrays: Arrays) -> float:
    """Value of signal k at time t."""
    return signal(k, t, arrays)[0]


@inlined
def longest_step(k: int, t: float, arrays: Arrays) -> tuple[float, float]:
    """The longest step from time t (s) on that signal k allows, and until when, s."""
    item = arrays.signals[k]
    address = arrays.kernels[item.kind + LONGEST_STEP]
    if address == 0:
        return np.inf, np.inf
    return call_ff(address, arrays.memory, item.at, arrays.world[0].gravity, (t, arrays))


@inlined
def load_monitor(load: ItemRecord, arrays: Arrays, state: State) -> float:
    """How far a load is from the limits of its theory; see :mod:`.loads.base`. Zero where it does not say."""
    address = arrays.kernels[load.kind + MONITOR]
    if address == 0:
        return 0.0
    return call_f(address, arrays.memory, load.at, state.time, (arrays, state))


@inlined
def load_misplacement(load: ItemRecord, arrays: Arrays, state: State) -> float:
    """How far bodies of a load are from where it requires them, see :mod:`.loads.base`; zero: nothing is required."""
    address = arrays.kernels[load.kind + MISPLACEMENT]
    if address == 0:
        return 0.0
    return call_f(address, arrays.memory, load.at, state.time, (arrays, state))


@inlined
def load_clearance(load: ItemRecord, arrays: Arrays, state: State) -> float:
    """How far bodies may move before a load acts, m; see :mod:`.loads.base`. Zero where it does not say."""
    address = arrays.kernels[load.kind + CLEARANCE]
    if address == 0:
        return 0.0 * state.time[0]
    return call_f(address, arrays.memory, load.at, state.time, (arrays, state))


@inlined
def load_longest_step(load: ItemRecord, taken: float, arrays: Arrays, state: State) -> float:
    """The longest step that a load allows after one of ``taken``, s; see :mod:`.loads.base`. Infinite where it does not
    say.
    """
    address = arrays.kernels[load.kind + LONGEST_LOAD_STEP]
    if address == 0:
        return np.inf
    return call_f(address, arrays.memory, load.at, state.time, (taken, arrays, state))


@inlined
def part_value(k: int, kernel: int, arrays: Arrays, state: State, argument: Any) -> float:
    """What kernel number ``kernel`` of part k returns, called with one record."""
    item = arrays.parts[k]
    return call_f(arrays.kernels[item.kind + kernel], arrays.memory, item.at, state.time, (argument,))


@inlined
def part_sensor_value(k: int, arrays: Arrays, state: State) -> float:
    """Value of part k, a sensor of positions and velocities, where these are those of the state."""
    item = arrays.parts[k]
    lam = state.time  # which no such sensor reads
    return call_f(arrays.kernels[item.kind + READ], arrays.memory, item.at, state.time, (lam, arrays, state))


@inlined
def scratch_record(place: int, dtype: Any, state: State) -> Any:
    """Scratch memory of an element type in a state: a record of ``dtype``, where its ``fill`` got the ``place`` of it.

    Its numbers are complex if the state is. All elements with these fields share it: a kernel writes before it reads.
    """
    return record_at(state.scratch, place, dtype, state.time)


@inlined
def read_sensor(sensor: SensorRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """Value of a sensor; see :mod:`.sensors.base`."""
    return call_f(arrays.kernels[sensor.kind + READ], arrays.memory, sensor.at, state.time, (lam, arrays, state))
