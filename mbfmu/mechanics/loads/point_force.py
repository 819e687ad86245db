"""A given force at a point of a body, its direction fixed in space or in the body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import one_of, vector
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import add_force, arm
from solvers.compiled.kernel import inlined, jit_uncached, kernel
from solvers.compiled.record import Record, Vec3, i8

from .base import FIXED_IN, Points, direction
from .given import GivenForce, LawRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class PointRecord(Record):
    """Where a force acts on a body, and along which axis."""

    a: i8
    turns: i8  # 1: the axis is of the body
    Pa: Vec3  # body axes, m
    axis: Vec3  # unit vector


class PointForceRecord(PointRecord):
    """Parameters of :class:`PointForce`."""

    signal: i8


class PointForceLawRecord(LawRecord, PointRecord):
    """Parameters of :class:`PointForce` whose magnitude is a law."""


@inlined
def push(force: Any, f: Any, state: State) -> None:
    """Add the force ``f``, N, at its point along its axis."""
    body = state.bodies[force.a]
    x, y, z = arm(body, force.Pa)
    nx, ny, nz = direction(force, body)
    add_force(body.F, x, y, z, f * nx, f * ny, f * nz)


@inlined
def speed_along(force: Any, state: State) -> Any:
    """Velocity of its point along its axis, m/s."""
    body = state.bodies[force.a]
    x, y, z = arm(body, force.Pa)
    nx, ny, nz = direction(force, body)
    Y = body.Y
    speed = nx * (Y[0] + Y[4] * z - Y[5] * y) + ny * (Y[1] + Y[5] * x - Y[3] * z)
    return speed + nz * (Y[2] + Y[3] * y - Y[4] * x)


@kernel
def apply(force: PointForceRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    push(force, signal_value(force.signal, t, arrays), state)


@kernel
def power(force: PointForceRecord, t: float, arrays: Arrays, state: State) -> float:
    """Force times velocity of its point."""
    return signal_value(force.signal, t, arrays) * speed_along(force, state)


@cache
def kernels_of(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a force that the kernel ``value`` computes."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        push(force, value(force, t, arrays, state), state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        return value(force, t, arrays, state) * speed_along(force, state)

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class PointForce(GivenForce):
    """Force at a point of a body.

    Parameters
    ----------
    magnitude
        Force, N: number, signal or input; block, state, or sensor of positions and velocities, as the output of a
        controller; function or expression of the time t (s), with ``uses`` also of the names there.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    axis
        Direction of the force.
    fixed_in
        ``"ground"``: the axis is global; ``"body"``: the axis is fixed in the body (follower force).
    at_a
        Point of application, m, body frame.
    """

    record = PointForceRecord
    apply = apply
    power = power
    law_record = PointForceLawRecord
    kernels_of_law = kernels_of

    axis: Any = "y"
    at_a: Any = (0.0, 0.0, 0.0)
    fixed_in: str = "ground"

    def check(self, what: str) -> None:
        """Refuse what the axis cannot be fixed in."""
        one_of(f"fixed_in of {what}", self.fixed_in, FIXED_IN)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its point, its axis and its magnitude."""
        record["a"] = site.bodies[0]
        self.fill_magnitude(record, site)
        record["Pa"] = vector(f"at_a of {site.name}", self.at_a)
        record["axis"] = unit_axis(self.axis, f"axis of {site.name}")
        record["turns"] = int(self.fixed_in == "body")

    def points(self) -> Points:
        """Return its point, and the ground's origin."""
        return (self.at_a, (0.0, 0.0, 0.0))
