"""Applied forces besides inertia, weight and joints: the sums over loads and flexible bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import apply_load, load_potential, load_power
from mbfmu.mechanics.flexible import modal
from solvers.compiled.kernel import inlined, kernel

from .active_loads import apply_active_loads

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


@inlined
def apply_loads(t: float, arrays: Arrays, state: State) -> None:
    """Let every load and flexible body add its own to the applied wrenches and to the coordinate forces, which
    scatter_coordinates has cleared.
    """
    for i in range(state.bodies.shape[0]):
        F = state.bodies[i].F
        for k in range(6):
            F[k] = 0.0
    state.cached_power[0] = 0.0
    if arrays.world[0].has_clearances == 1:
        apply_active_loads(t, arrays, state)
    else:
        for i in range(arrays.loads.shape[0]):
            apply_load(arrays.loads[i], t, arrays, state)
    for i in range(arrays.flexibles.shape[0]):
        modal.apply_elastic_forces(arrays.flexibles[i], state, arrays.numbers)


@kernel
def apply_single_load(k: int, t: float, arrays: Arrays, state: State) -> None:
    """Let one load add its own to the applied wrenches and the coordinate forces."""
    apply_load(arrays.loads[k], t, arrays, state)


@inlined
def stored_energy(arrays: Arrays, state: State) -> float:
    """Energy stored in all loads and flexible bodies, J."""
    total = 0.0
    for i in range(arrays.loads.shape[0]):
        total += load_potential(arrays.loads[i], arrays, state)
    for i in range(arrays.flexibles.shape[0]):
        total += modal.potential(arrays.flexibles[i], state, arrays.numbers)
    return total


@inlined
def sum_load_powers(t: float, arrays: Arrays, state: State) -> float:
    """Power of all loads and flexible bodies, W, without the change of :func:`stored_energy`; :func:`apply_loads` was
    called last for this state.
    """
    total = state.cached_power[0]
    for i in range(arrays.loads.shape[0]):
        total += load_power(arrays.loads[i], t, arrays, state)
    for i in range(arrays.flexibles.shape[0]):
        total += modal.power(arrays.flexibles[i], state, arrays.numbers)
    return total
