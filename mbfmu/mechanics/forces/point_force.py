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


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """Force times velocity of its point."""
    body, axis = state.bodies[force.a], force.axis
    x, y, z = arm(body, force.Pa)
    Y = body.Y
    speed = axis[0] * (Y[0] + Y[4] * z - Y[5] * y) + axis[1] * (Y[1] + Y[5] * x - Y[3] * z)
    speed += axis[2] * (Y[2] + Y[3] * y - Y[4] * x)
    return _value(arrays.signals[force.signal], t) * speed


@dataclass(frozen=True, kw_only=True)
class PointForce(Force):
    """Force of ``magnitude`` (N: number, signal or input) along ``axis`` (global) at ``at_a`` (m, body frame)."""

    magnitude: Any
    axis: Any = "y"
    at_a: Any = (0.0, 0.0, 0.0)

    apply = apply
    potential = nothing_stored
    power = power
