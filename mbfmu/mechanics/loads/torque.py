"""A given torque on a body, its direction fixed in space or in the body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import one_of
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import inlined, jit_uncached, kernel
from solvers.compiled.record import Record, Vec3, i8

from .base import FIXED_IN, direction
from .given import GivenForce, LawRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class AxisRecord(Record):
    """On which body a torque acts, and about which axis."""

    a: i8
    turns: i8  # 1: the axis is of the body
    axis: Vec3  # unit vector


class TorqueRecord(AxisRecord):
    """Parameters of :class:`Torque`."""

    signal: i8


class TorqueLawRecord(LawRecord, AxisRecord):
    """Parameters of :class:`Torque` whose magnitude is a law."""


@inlined
def turn(force: Any, torque: Any, state: State) -> None:
    """Add ``torque``, N m, about its axis."""
    body = state.bodies[force.a]
    axis = direction(force, body)
    for k in range(3):
        body.F[3 + k] += torque * axis[k]


@inlined
def rate_about(force: Any, state: State) -> Any:
    """Angular velocity about its axis, rad/s."""
    body = state.bodies[force.a]
    Y, axis = body.Y, direction(force, body)
    return axis[0] * Y[3] + axis[1] * Y[4] + axis[2] * Y[5]


@kernel
def apply(force: TorqueRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    turn(force, signal_value(force.signal, t, arrays), state)


@kernel
def power(force: TorqueRecord, t: float, arrays: Arrays, state: State) -> float:
    """Torque times angular velocity about its axis."""
    return signal_value(force.signal, t, arrays) * rate_about(force, state)


@cache
def kernels_of(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a torque that the kernel ``value`` computes."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        turn(force, value(force, t, arrays, state), state)

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        return value(force, t, arrays, state) * rate_about(force, state)

    return jit_uncached(apply), jit_uncached(power)


@dataclass(frozen=True, kw_only=True)
class Torque(GivenForce):
    """Torque on a body.

    Parameters
    ----------
    magnitude
        Torque, N m: number, signal or input; block, state, or sensor of positions and velocities, as the output of a
        controller; function or expression of the time t (s), with ``uses`` also of the names there.
    uses
        Other quantities in a function or expression, by their names, see :class:`.JointForce`.
    axis
        Axis of the torque.
    fixed_in
        ``"ground"``: the axis is global; ``"body"``: the axis is fixed in the body.
    """

    record = TorqueRecord
    apply = apply
    power = power
    law_record = TorqueLawRecord
    kernels_of_law = kernels_of

    axis: Any = "z"
    fixed_in: str = "ground"

    def check(self, what: str) -> None:
        """Refuse what the axis cannot be fixed in."""
        one_of(f"fixed_in of {what}", self.fixed_in, FIXED_IN)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its body, its axis and its magnitude."""
        record["a"] = site.bodies[0]
        self.fill_magnitude(record, site)
        record["axis"] = unit_axis(self.axis, f"axis of {site.name}")
        record["turns"] = int(self.fixed_in == "body")
