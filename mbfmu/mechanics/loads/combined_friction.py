"""Dry friction with stick on several coordinates of a joint that slide together, see :mod:`.bristle`.

The slip is a vector with one component for each coordinate: its rate times an arm, the displacement of the bearing per
unit of the coordinate. The magnitude of the friction depends on that of the slip, and its direction is opposite to the
slip. The force on a coordinate is its component of the friction times the arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from mbfmu.mechanics.joints import Cylindrical, Planar, Spherical
from mbfmu.mechanics.joints.base import Joint
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.quantity_kinds import TIME
from solvers.compiled.kernel import jit_uncached, kernel

from .base import FirstOrderState
from .bristle import BristleFriction, CombinedRecord, bristle_factors, deflection_of, signal_of_normal
from .reaction import BALL, PLANE, SLEEVE, Bearings
from .reaction_friction import ReactionFriction
from .slip import slip_factors

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


@kernel
def resist(force: CombinedRecord, normal: float, state: State) -> None:
    """Add the friction and the rates of the bristle."""
    square, factor = slip_factors(force, state)
    stiffness, damping = bristle_factors(force, normal, square)
    d = deflection_of(force)
    for k in range(force.count):
        v, z = force.arms[k] * state.v[force.v + k], state.v[force.state + k]
        rate = (v - factor * z) / d
        state.Q[force.v + k] -= force.arms[k] * (stiffness * z + damping * rate + force.viscous * v)
        state.Q[force.state + k] += rate


@kernel
def resisted_power(force: CombinedRecord, normal: float, state: State) -> float:
    """Friction times slip: heat, and what the bristle stores."""
    square, factor = slip_factors(force, state)
    stiffness, damping = bristle_factors(force, normal, square)
    d, total = deflection_of(force), 0.0 * square
    for k in range(force.count):
        v, z = force.arms[k] * state.v[force.v + k], state.v[force.state + k]
        total -= (stiffness * z + damping * (v - factor * z) / d + force.viscous * v) * v
    return total


@kernel
def apply(force: CombinedRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    resist(force, signal_of_normal(force, t, arrays, state), state)


@kernel
def power(force: CombinedRecord, t: float, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
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
class CombinedFriction(BristleFriction):
    """Base class of friction on several coordinates that slide together."""

    record = CombinedRecord
    apply = apply
    power = power
    kernels_of_normal = kernels_of_normal
    variants = (ReactionFriction,)
    law_quantities: ClassVar = {"t": TIME}
    joint: ClassVar[type[Joint]]
    suffixes: ClassVar[tuple[str, ...]]  # of the states
    own_bearings: ClassVar[Bearings]

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return the components of the force of the bristle over the Coulomb force."""
        suffixes = self.suffixes[: len(self.coordinates)]
        return tuple(FirstOrderState(name=f"bristle.{suffix}", is_held_at_rest=True) for suffix in suffixes)

    def describe_joint_refusal(self, joint: Any) -> str:
        """Return the need of the joint for which it is."""
        return "" if isinstance(joint, self.joint) else f"a {self.joint.__name__} joint"

    def bearings(self, joint: Any) -> Bearings:
        """Return the bearings of the coordinates that slide together."""
        return self.own_bearings

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the coordinates too."""
        super().fill(record, site)
        record["count"], record["arms"][: len(self.arms)] = len(self.arms), self.arms


@dataclass(frozen=True, kw_only=True)
class SphericalFriction(CombinedFriction):
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

    joint = Spherical
    suffixes = ("x", "y", "z")
    own_bearings = Bearings(BALL, ("radius",))

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Return the three components of the angular velocity."""
        return (0, 1, 2)


@dataclass(frozen=True, kw_only=True)
class CylindricalFriction(CombinedFriction):
    """Dry friction on the surface of a cylindrical joint, with stick: against the helical slip of turning and sliding.

    A shaft that turns fast offers little resistance to a slow displacement, and the other way round. The bristle is a
    vector with two first-order states.

    Parameters
    ----------
    coulomb, static, stribeck, viscous, normal_force, uses, deflection
        As for :class:`.JointFriction` of a displacement: forces on the surface in N, slip in m/s. A normal force with
        ``uses`` cannot contain q and v. None of ``deflection``: 1e-5 of the radius.
    radius
        Radius of the surface, m.
    """

    joint = Cylindrical
    suffixes = ("angle", "displacement")
    own_bearings = Bearings(SLEEVE, (), ("length",))

    radius: float

    def check(self, what: str) -> None:
        """Refuse a radius that is none, too."""
        super().check(what)
        positive(f"radius of {what}", self.radius)

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Return the angle and the displacement."""
        return (0, 1)

    @property
    def arms(self) -> tuple[float, ...]:
        """Return the slip on the surface per rad and per m."""
        return (self.radius, 1.0)


@dataclass(frozen=True, kw_only=True)
class PlanarFriction(CombinedFriction):
    """Dry friction of a body that slides on the plane of its planar joint, with stick: the same in all directions.

    The bristle is a vector with two first-order states, with a ``radius`` three.

    Parameters
    ----------
    coulomb, static, stribeck, viscous, normal_force, uses, deflection
        As for :class:`.JointFriction` of a displacement: forces in N, slip in m/s, of the origin of the body's joint
        frame. A normal force with ``uses`` cannot contain q and v.
    radius
        Effective radius of the friction against rotation, m: the friction torque of a body that only turns is this
        radius times the friction force, 2 R / 3 for a disk of radius R under uniform pressure. If the body also slides,
        the friction is that of the slip vector with the third component radius times angular velocity. None: there is
        no friction against rotation.
    """

    joint = Planar
    suffixes = ("x", "y", "angle")
    own_bearings = Bearings(PLANE)

    radius: float | None = None

    def check(self, what: str) -> None:
        """Refuse a radius that is none, too."""
        super().check(what)
        if self.radius is not None:
            positive(f"radius of {what}", self.radius)

    @property
    def coordinates(self) -> tuple[int, ...]:
        """Return the two displacements, and the angle if there is a radius."""
        return (0, 1) if self.radius is None else (0, 1, 2)

    @property
    def arms(self) -> tuple[float, ...]:
        """Return the slip per m and per rad."""
        return (1.0, 1.0) if self.radius is None else (1.0, 1.0, self.radius)
