"""Friction and bristle of one coordinate, and bristle of several that slide together, see :mod:`.bristle`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .bristle import (
    BristleRecord,
    CombinedRecord,
    bristle_factors,
    deflection_of,
    stribeck_ratio,
    yielding_factor,
    yielding_part,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


@kernel
def slip_state(force: BristleRecord, normal: float, v: float, z: float) -> tuple[float, float]:
    """Friction force against the slip v (N or N m), and z' (1/s)."""
    yielding = 0.0 * (v + z)
    if v.real * z.real > 0.0:
        u = (z if z.real >= 0.0 else -z) / stribeck_ratio(force, v * v)
        yielding = yielding_part(u) * u
    rate = v * (1.0 - yielding) / deflection_of(force)
    stiffness, damping = bristle_factors(force, normal, v * v)
    return stiffness * z + damping * rate + force.viscous * v, rate


@kernel
def slip_factors(force: CombinedRecord, state: State) -> tuple[float, float]:
    """Square of the slip, and factor of z in d z' = v - factor z."""
    square, along, length = 0.0 * state.v[force.v], 0.0 * state.v[force.v], 0.0 * state.v[force.v]
    for k in range(force.count):
        v, z = force.arms[k] * state.v[force.v + k], state.v[force.state + k]
        square, along, length = square + v * v, along + v * z, length + z * z
    return square, yielding_factor(force, square, along, length)
