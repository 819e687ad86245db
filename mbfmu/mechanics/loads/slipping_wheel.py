"""Wheel that may lift and slip: a circle of body a, or a torus, on a plane of body b.

Geometry and symbols are those of :mod:`mbfmu.mechanics.cuts.rolling`, with the wheel on body a and the plane on body b.
With the distance Phi of the lowest point C to the plane and the velocity V at C of the wheel relative to the plane:

    N = k x (1 + c x'),    x = -Phi, x' = -n.V,    none where x < 0 or where it would pull (:mod:`.stops`)
    force on the wheel at C = N n - f,             f: friction against the slip V - (n.V) n (:mod:`.bristle`)

The bristle is a vector in the plane with a component along each of two axes that are fixed in body b, so that the
friction is the same in all directions and a wheel at rest may turn about the normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import plane_axes, unit_axis
from mbfmu.mechanics.checks import vector
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH, finite, not_negative, positive
from mbfmu.mechanics.spatial import add_force, arm
from mbfmu.mechanics.wheels import add3, cross3, dot3, heading
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Vec3, f8

from .base import FirstOrderState, Force, PointPairRecord, Points, fill_points
from .bristle import BristleRecord, bristle_factors, check_static, deflection_of, fill_static, yielding_factor
from .stops import LimitRecord, stop_force

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State

DEFLECTION_PER_RADIUS = 1e-4  # default of the deflection, relative to the radius


class SlippingWheelRecord(BristleRecord, LimitRecord, PointPairRecord):
    """Parameters of :class:`SlippingWheel`; the limit is that of Phi."""

    radius: f8  # of the circle in the middle of the torus, m
    crown: f8  # m
    axle: Vec3  # axes of body a
    up: Vec3  # normal of the plane, axes of body b
    first: Vec3  # axes of the bristle, axes of body b
    second: Vec3


@kernel
def touch(force: SlippingWheelRecord, state: State) -> Any:
    """n, Phi, C from the origins of bodies a and b, V, and the axes of the bristle."""
    A, B = state.bodies[force.a], state.bodies[force.b]
    n, e, center = arm(B, force.up), arm(A, force.axle), arm(A, force.Pa)
    s, _, u = heading(e, n)
    at_a = add3(add3(center, force.radius, u), -force.crown, n)
    apart = A.r[0] - B.r[0], A.r[1] - B.r[1], A.r[2] - B.r[2]
    at_b = add3(at_a, 1.0, apart)
    height = add3(add3(center, 1.0, apart), -1.0, arm(B, force.Pb))
    Ya, Yb = A.Y, B.Y
    Va = add3(cross3((Ya[3], Ya[4], Ya[5]), at_a), 1.0, (Ya[0], Ya[1], Ya[2]))
    Vb = add3(cross3((Yb[3], Yb[4], Yb[5]), at_b), 1.0, (Yb[0], Yb[1], Yb[2]))
    V = add3(Va, -1.0, Vb)
    Phi = dot3(n, height) - force.radius * s - force.crown
    return n, Phi, at_a, at_b, V, arm(B, force.first), arm(B, force.second)


@kernel
def slide(force: SlippingWheelRecord, N: float, V: Any, first: Any, second: Any, state: State) -> Any:
    """Components of the friction against the slip, and of z'."""
    v1, v2, z1, z2 = dot3(V, first), dot3(V, second), state.v[force.state], state.v[force.state + 1]
    square = v1 * v1 + v2 * v2
    factor = yielding_factor(force, square, v1 * z1 + v2 * z2, z1 * z1 + z2 * z2)
    d = deflection_of(force)
    rate1, rate2 = (v1 - factor * z1) / d, (v2 - factor * z2) / d
    stiffness, damping = bristle_factors(force, N, square)
    return stiffness * z1 + damping * rate1, stiffness * z2 + damping * rate2, rate1, rate2


@kernel
def apply(force: SlippingWheelRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    n, Phi, at_a, at_b, V, first, second = touch(force, state)
    N = stop_force(force, Phi, dot3(n, V))
    f1, f2, rate1, rate2 = slide(force, N, V, first, second, state)
    pressing = N * n[0], N * n[1], N * n[2]
    fx, fy, fz = add3(add3(pressing, -f1, first), -f2, second)
    add_force(state.bodies[force.a].F, at_a[0], at_a[1], at_a[2], fx, fy, fz)
    add_force(state.bodies[force.b].F, at_b[0], at_b[1], at_b[2], -fx, -fy, -fz)
    state.Q[force.state] += rate1
    state.Q[force.state + 1] += rate2


@kernel
def potential(force: SlippingWheelRecord, arrays: Arrays, state: State) -> float:
    """k x^2 / 2."""
    _, Phi, _, _, _, _, _ = touch(force, state)
    x = force.lower - Phi if Phi.real < force.lower.real else 0.0 * Phi
    return 0.5 * force.stiffness * x * x


@kernel
def power(force: SlippingWheelRecord, t: float, arrays: Arrays, state: State) -> float:
    """Damping along the normal, heat of the friction, and what the bristle stores."""
    n, Phi, _, _, V, first, second = touch(force, state)
    rate = dot3(n, V)
    N = stop_force(force, Phi, rate)
    x = force.lower - Phi if Phi.real < force.lower.real else 0.0 * Phi
    f1, f2, _, _ = slide(force, N, V, first, second, state)
    return (N - force.stiffness * x) * rate - f1 * dot3(V, first) - f2 * dot3(V, second)


@kernel
def misplacement(force: SlippingWheelRecord, arrays: Arrays, state: State) -> float:
    """Penetration over the outer radius: the center of a wheel is above its plane."""
    _, Phi, _, _, _, _, _ = touch(force, state)
    return max(0.0, -Phi.real) / (force.radius + force.crown)


@dataclass(frozen=True, kw_only=True)
class SlippingWheel(Force):
    """Wheel of body a on a plane of body b, elastic and with dry friction: it may lift, stick, roll and slip.

    The friction is opposite to the slip, with at most ``static`` times the normal force in all directions, and
    ``friction`` times the normal force if the wheel slips. It acts without slip, too: a wheel rolls, and stands on a
    slope, without creep while the friction is below 0.9 times the largest one. The axle must not become normal to the
    plane.

    Parameters
    ----------
    radius
        Outer radius of the wheel, m.
    crown_radius
        Radius of the cross-section of its tire, m; 0: the wheel is a thin disk; ``radius``: it is a ball.
    axis
        Axle: ``"x"``, ``"y"``, ``"z"`` or three numbers in the frame of body a; ``at_a`` is the center of the wheel.
    normal
        Normal of the plane, on the side of the wheel: the same in the frame of body b; ``at_b`` is a point of the
        plane.
    stiffness
        Stiffness of wheel and plane along the normal, N/m.
    damping
        Damping c along the normal, s/m: force k x (1 + c x') as that of a :class:`.JointStop`.
    friction
        Coefficient of friction of a wheel that slips.
    static
        Coefficient of static friction, at least ``friction``. Default: ``friction``.
    stribeck
        Slip vs, m/s, of the decrease from ``static`` to ``friction`` as exp(-(slip / vs)^2). Required if ``static`` is
        larger than ``friction``. It must be much larger than sqrt(friction N d / m), the velocity of the vibration of
        the bristle, with the normal force N, the deflection d and the mass m.
    deflection
        Displacement at which the friction breaks away if the wheel is at rest, m. Default: 1e-4 of the radius.
    at_a, at_b
        Center of the wheel in the frame of body a, and point of the plane in the frame of body b, m.
    """

    record = SlippingWheelRecord
    apply = apply
    power = power
    potential = potential
    misplacement = misplacement
    symmetric = False
    stick_reason = "the bristles of wheels with friction are stiff"

    radius: float
    crown_radius: float = 0.0
    axis: Any = "y"
    normal: Any = "z"
    stiffness: float
    damping: float = 0.0
    friction: float
    static: float | None = None
    stribeck: float | None = None
    deflection: float | None = None
    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def check(self, what: str) -> None:
        """Raise UserError if a parameter is invalid."""
        radius = positive(f"radius of {what}", self.radius)
        if not MIN_LENGTH <= radius <= MAX_LENGTH:
            raise UserError(f"radius of {what} is {radius!r} m; allowed: {MIN_LENGTH:g} to {MAX_LENGTH:g}")
        crown = finite(f"crown_radius of {what}", self.crown_radius)
        if not 0.0 <= crown <= radius:
            raise UserError(f"crown_radius of {what} is {crown!r} m; allowed: 0 to the radius, {radius:g}")
        unit_axis(self.axis, f"axis of {what}")
        unit_axis(self.normal, f"normal of {what}")
        positive(f"stiffness of {what}", self.stiffness)
        not_negative(f"damping of {what}", self.damping)
        check_static(what, "friction", positive(f"friction of {what}", self.friction), self.static, self.stribeck)
        if self.deflection is not None:
            positive(f"deflection of {what}", self.deflection)

    @property
    def states(self) -> tuple[FirstOrderState, ...]:
        """Return the components of the friction force over the largest one."""
        return tuple(FirstOrderState(name=f"bristle.{k}", is_held_at_rest=True) for k in (1, 2))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the wheel, the plane and the friction."""
        fill_points(self, record, site)
        normal = unit_axis(self.normal, f"normal of {site.name}")
        record["Pa"], record["Pb"] = self.points()
        record["radius"], record["crown"] = self.radius - self.crown_radius, self.crown_radius
        record["axle"], record["up"] = unit_axis(self.axis, f"axis of {site.name}"), normal
        record["first"], record["second"] = plane_axes(normal)
        record["stiffness"], record["damping"] = self.stiffness, self.damping
        record["lower"], record["upper"] = 0.0, np.inf
        record["coulomb"], record["state"] = self.friction, site.first_state
        fill_static(record, self.friction, self.static, self.stribeck)
        record["deflection"] = DEFLECTION_PER_RADIUS * self.radius if self.deflection is None else self.deflection

    def fill_estimates(self, record: Any, inertia: float, size: float) -> None:
        """Write the mass that the bristle moves, by which it is damped: that of the wheel."""
        record["estimated_inertia"] = inertia

    def resolved_displacement(self, record: Any) -> float:
        """Return the deflection of the bristle, m."""
        return float(record["deflection"])

    def points(self) -> Points:
        """Return the center of the wheel, and the point of the plane that is nearest to the origin of its body."""
        normal = unit_axis(self.normal, "normal")
        return vector("at_a", self.at_a), (vector("at_b", self.at_b) @ normal) * normal

    def extent(self) -> float:
        """Return the radius."""
        return self.radius
