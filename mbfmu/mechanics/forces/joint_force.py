"""A given force or torque along the coordinate of a joint, a motor between parent and child."""

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
    state.Q[force.v] += _value(arrays.signals[force.signal], t)


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """Force times rate of the coordinate."""
    return _value(arrays.signals[force.signal], t) * state.v[force.v]


@dataclass(frozen=True, kw_only=True)
class JointForce(Force):
    """Torque (N m) or force (N) on a joint's coordinate: a number, a signal or an input."""

    magnitude: Any

    on_joint = True
    apply = apply
    potential = nothing_stored
    power = power
