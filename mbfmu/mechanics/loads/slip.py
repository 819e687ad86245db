"""Friction and bristle of one coordinate, see :mod:`.bristle`."""

from __future__ import annotations

from solvers.compiled.kernel import kernel

from .bristle import BristleRecord, bristle_factors, deflection_of, stribeck_ratio, yielding_part


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
