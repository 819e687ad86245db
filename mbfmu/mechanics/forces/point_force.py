"""A given force at a point of a body, its direction fixed in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbfmu.mechanics import signals
from mbfmu.mechanics.cuts.base import arm
from mbfmu.mechanics.spatial import add_force
from solvers.kernel import kernel

from .base import Force, nothing_stored

_value = signals.value


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    body = state.bodies[force.a]
    f = _value(arrays.signals[force.signal], t)
    x, y, z = arm(body, force.Pa)
    add_force(body.F, x, y, z, f * force.axis[0], f * force.axis[1], f * force.axis[2])


@dataclass(frozen=True, kw_only=True)
class PointForce(Force):
    """Force of ``magnitude`` (N: number, signal or input) along ``axis`` (global) at ``at_a`` (m, body frame)."""

    magnitude: Any
    axis: Any = "y"
    at_a: Any = (0.0, 0.0, 0.0)

    apply = apply
    potential = nothing_stored
