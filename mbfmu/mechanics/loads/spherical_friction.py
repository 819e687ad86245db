"""Dry friction with stick on a ball joint, see :mod:`.bristle`: the same in all directions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from mbfmu.mechanics.quantity_kinds import TIME
from solvers.compiled.kernel import jit_uncached, kernel

from .base import FirstOrderState
from .bristle import (
    BristleFriction,
    BristleRecord,
    bristle_factors,
    deflection_of,
    signal_of_normal,
)
from .reaction_friction import SphericalReactionFriction
from .slip import slip_factors

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


@kernel
def resist(force: BristleRecord, normal: float, state: State) -> None:
    """Add the friction and the rates of the bristle."""
    square, factor = slip_factors(force, state)
    stiffness, damping = bristle_factors(force, normal, square)
    d = deflection_of(force)
    for k in range(3):
        v, z = state.v[force.v + k], state.v[force.state + k]
        rate = (v - factor * z) / d
        state.Q[force.v + k] -= stiffness * z + damping * rate + force.viscous * v
        state.Q[force.state + k] += rate


@kernel
def resisted_power(force: BristleRecord, normal: float, state: State) -> float:
    """Friction torque times angular velocity."""
    square, factor = slip_factors(force, state)
    stiffness, damping = bristle_factors(force, normal, square)
    d, total = deflection_of(force), 0.0 * square
    for k in range(3):
        v, z = state.v[force.v + k], state.v[force.state + k]
        total -= (stiffness * z + damping * (v - factor * z) / d + force.viscous * v) * v
    return total


@kernel
def apply(force: BristleRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    resist(force, signal_of_normal(force, t, arrays, state), state)


@kernel
def power(force: BristleRecord, t: float, arrays: Arrays, state: State) -> float:
    """Heat, and what the bristle stores."""
    return resisted_power(force, signal_of_normal(force, t, arrays, state), state)


@cache
def kernels_of_normal(normal: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` with the normal force that the kernel ``normal`` computes."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        resist(force, normal(force, t, arrays, state), state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        return resisted_power(force, normal(force, t, arrays, state), state)

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class SphericalFriction(BristleFriction):
    """Dry friction on a ball joint, with stick: a torque against the relative angular velocity.

    The magnitude of the torque depends on that of the angular velocity as the friction of :class:`.JointFriction` on
    the velocity. The bristle is a vector in the axes of the child with three first-order states.

    Parameters
    ----------
    coulomb, static, stribeck, viscous, normal_force, uses, deflection
        As for :class:`.JointFriction` of an angle. A normal force with ``uses`` cannot contain q and v. With a
        :class:`.Reaction` the largest torque is ``coulomb`` times the ``radius`` of the ball times the force that the
        joint transmits.
    """

    apply = apply
    power = power
    kernels_of_normal = kernels_of_normal
    variants = (SphericalReactionFriction,)
    reaction_variant = SphericalReactionFriction
    law_quantities: ClassVar = {"t": TIME}

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return the components of the bristle's torque over the Coulomb torque, in the axes of the child."""
        return tuple(FirstOrderState(name=f"bristle.{axis}", is_held_at_rest=True) for axis in "xyz")

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Return the three components of the angular velocity."""
        return (0, 1, 2)

    def describe_joint_refusal(self, joint: Any) -> str:
        """Return the need of a ball joint."""
        return "" if joint.quaternion and joint.nv == 3 else "a ball joint, with three components of angular velocity"
