"""A given torque on a body, its direction fixed in space or in the body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import one_of
from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.compiled.record import Record, Vec3, i8

from .base import FIXED_IN, direction
from .given import GivenForce, LawRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class TorqueRecord(Record):
    """Parameters of :class:`Torque`."""

    a: i8
    signal: i8
    turns: i8  # 1: the axis is of the body
    axis: Vec3  # unit vector


@kernel
def apply(force: TorqueRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    body = state.bodies[force.a]
    torque, axis = signal_value(force.signal, t, arrays), direction(force, body)
    for k in range(3):
        body.F[3 + k] += torque * axis[k]


@kernel
def power(force: TorqueRecord, t: float, arrays: Arrays, state: State) -> float:
    """Torque times angular velocity about its axis."""
    body = state.bodies[force.a]
    Y, axis = body.Y, direction(force, body)
    return signal_value(force.signal, t, arrays) * (axis[0] * Y[3] + axis[1] * Y[4] + axis[2] * Y[5])


class TorqueLawRecord(LawRecord):
    """Parameters of :class:`Torque` whose magnitude is a law."""

    a: i8
    turns: i8  # 1: the axis is of the body
    axis: Vec3  # unit vector


@cache
def kernels_of(value: Any) -> tuple[Any, Any]:
    """Return ``apply`` and ``power`` of a torque that the kernel ``value`` computes."""

    def apply(force: Any, t: float, arrays: Arrays, state: State) -> None:
        body = state.bodies[force.a]
        torque, axis = value(force, t, arrays, state), direction(force, body)
        for k in range(3):
            body.F[3 + k] += torque * axis[k]

    def power(force: Any, t: float, arrays: Arrays, state: State) -> Any:
        body = state.bodies[force.a]
        Y, axis = body.Y, direction(force, body)
        return value(force, t, arrays, state) * (axis[0] * Y[3] + axis[1] * Y[4] + axis[2] * Y[5])

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
