"""A given torque on a body, its direction fixed in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbfmu.mechanics import signals
from solvers.kernel import kernel

from .base import Force, nothing_stored

_value = signals.value


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    torque = _value(arrays.signals[force.signal], t)
    for k in range(3):
        state.bodies[force.a].F[3 + k] += torque * force.axis[k]


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """Torque times angular velocity about its axis."""
    Y, axis = state.bodies[force.a].Y, force.axis
    return _value(arrays.signals[force.signal], t) * (axis[0] * Y[3] + axis[1] * Y[4] + axis[2] * Y[5])


@dataclass(frozen=True, kw_only=True)
class Torque(Force):
    """Torque of ``magnitude`` (N m: number, signal or input) about ``axis`` (global)."""

    magnitude: Any
    axis: Any = "z"

    apply = apply
    potential = nothing_stored
    power = power
