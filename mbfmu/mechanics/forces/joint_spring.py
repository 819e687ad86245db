"""Spring-damper in a joint of one coordinate: -(k (q - q0) + c q') along it, rotational or translational."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.kernel import kernel

from .base import Force


@kernel
def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
    """See :mod:`.base`."""
    stretch = state.q[force.q] - force.free
    state.Q[force.v] -= force.stiffness * stretch + force.damping * state.v[force.v]


@kernel
def potential(force: Any, arrays: Any, state: Any) -> float:
    """k (q - q0)^2 / 2."""
    stretch = state.q[force.q] - force.free
    return 0.5 * force.stiffness * stretch * stretch


@kernel
def power(force: Any, t: float, arrays: Any, state: Any) -> float:
    """-c q'^2."""
    return -force.damping * state.v[force.v] * state.v[force.v]


@dataclass(frozen=True, kw_only=True)
class JointSpring(Force):
    """Spring-damper on the joint coordinate of a body.

    Parameters
    ----------
    stiffness, damping
        N m/rad and N m s/rad in a revolute, N/m and N s/m in a translational joint.
    free
        Unloaded coordinate, rad or m.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    free: float = 0.0

    on_joint = True
    apply = apply
    potential = potential
    power = power
