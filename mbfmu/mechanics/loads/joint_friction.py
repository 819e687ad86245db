"""Dry friction with stick on one coordinate of a joint, see :mod:`.bristle`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.numbers import is_whole
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import jit_uncached, kernel

from .bristle import BristleFriction, BristleRecord, signal_of_normal
from .reaction import bearings_of
from .reaction_friction import ReactionFriction
from .slip import slip_state

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


@kernel
def apply(force: BristleRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    normal = signal_of_normal(force, t, arrays, state)
    resistance, rate = slip_state(force, normal, state.v[force.v], state.v[force.state])
    state.Q[force.v] -= resistance
    state.Q[force.state] += rate


@kernel
def power(force: BristleRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times slip: heat, and what the bristle stores."""
    v, normal = state.v[force.v], signal_of_normal(force, t, arrays, state)
    resistance, _ = slip_state(force, normal, v, state.v[force.state])
    return -resistance * v


@cache
def kernels_of_normal(normal: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` with the normal force that the kernel ``normal`` computes."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        resistance, rate = slip_state(force, normal(force, t, arrays, state), state.v[force.v], state.v[force.state])
        state.Q[force.v] -= resistance
        state.Q[force.state] += rate

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        v = state.v[force.v]
        resistance, _ = slip_state(force, normal(force, t, arrays, state), v, state.v[force.state])
        return -resistance * v

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class JointFriction(BristleFriction):
    """Dry friction on a joint coordinate, with stick: Coulomb, Stribeck and viscous friction.

    The joint sticks if the load is smaller than the breakaway force ``static * normal_force``: it is then held by an
    elastic bristle, whose largest deflection before sliding is about ``deflection``. It does not creep under a load
    that stays below 0.9 times the breakaway force. With an input as the normal force it is a brake or a clutch.

    Parameters
    ----------
    coulomb
        Friction of sliding per unit of the normal force: the force in N or the torque in N m if the normal force is not
        given. With a normal force in N it is the coefficient of friction of a displacement, and of an angle this
        coefficient times the radius, m.
    static
        Friction at breakaway, as ``coulomb`` and at least as large; None: the same.
    stribeck
        Velocity vs, rad/s or m/s, of the decrease from ``static`` to ``coulomb`` as exp(-(v / vs)^2). Required if
        ``static`` is larger than ``coulomb``. It must be much larger than sqrt(F d / m), the velocity of the vibration
        of the bristle: friction force F, deflection d, moved mass or inertia m.
    viscous
        Coefficient of viscous friction, N m s/rad or N s/m. It is independent of the normal force.
    normal_force
        Normal force: number, signal or input. With ``uses`` also a function or an expression of the time t, of the
        coordinate q, of its rate v and of the names there. Negative values count as zero. A :class:`.Reaction` is the
        normal force that the joint itself transmits; ``coulomb`` then is the coefficient of friction.
    uses
        Other quantities in the normal force, by their names, see :class:`.JointForce`.
    deflection
        Deflection of the bristle at the force ``coulomb``, rad or m: the displacement before sliding. None: 1e-5 of the
        size of the coordinate (1 rad, or the length of the mechanism, or ``nominal`` of the joint). Positions where the
        joint stops have errors of several deflections.
    coordinate
        Number of the coordinate, from 0, of a joint that has several. For ball joints use
        :class:`.SphericalFriction`; for coordinates that slide together :class:`.CylindricalFriction` and
        :class:`.PlanarFriction`.
    """

    apply = apply
    power = power
    kernels_of_normal = kernels_of_normal
    variants = (ReactionFriction,)

    coordinate: int = 0

    def check(self, what: str) -> None:
        """Refuse a number that is none, too."""
        super().check(what)
        if not is_whole(self.coordinate) or self.coordinate < 0:
            raise UserError(f"coordinate of {what} is {self.coordinate!r}; allowed: a whole number from 0 on")

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Return the one coordinate."""
        return (self.coordinate,)

    def describe_joint_refusal(self, joint: Any) -> str:
        """Return the need of a coordinate of this number that is no part of a rotation by a quaternion."""
        if self.coordinate >= joint.nv - 3 * joint.quaternion:
            return f"a joint with a coordinate {self.coordinate} (of a ball joint: SphericalFriction)"
        if self.follows_reaction and not bearings_of(joint):
            kinds = "translational, revolute, cylindrical, screw or universal"
            return f"a {kinds} joint, as its normal force is a Reaction"
        return ""
