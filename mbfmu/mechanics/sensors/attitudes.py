"""How a body is turned and how fast: its quaternion, its direction cosines, its angular velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import quaternion_of
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, i8

from .base import Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State


class DirectionCosineRecord(Record):
    """Parameters of :class:`DirectionCosine`."""

    index: i8
    component: i8
    axis: i8


@kernel
def quaternion(sensor: DirectionCosineRecord, lam: Any, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Of e and -e, which are one attitude, the one whose first component is positive."""
    A = state.bodies[sensor.index].A
    e = quaternion_of(A[0], A[1], A[2])
    for k in range(4):
        if e[k].real != 0.0:
            return e[sensor.component] if e[k].real > 0.0 else -e[sensor.component]
    return e[sensor.component]


@kernel
def cosine(sensor: DirectionCosineRecord, lam: Any, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.bodies[sensor.index].A[sensor.component, sensor.axis]


@kernel
def angular_velocity(sensor: DirectionCosineRecord, lam: Any, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Of component 3 to 5: in the body's axes."""
    here, k = state.bodies[sensor.index], sensor.component
    if k < 3:
        return here.Y[3 + k]
    return here.A[0, k - 3] * here.Y[3] + here.A[1, k - 3] * here.Y[4] + here.A[2, k - 3] * here.Y[5]


@dataclass(frozen=True, kw_only=True)
class Quaternion(Sensor):
    """Component of the unit quaternion of a body's attitude, scalar first and not negative.

    It is a function of the attitude alone and so jumps, from q to -q, where the body has turned by half a turn from the
    ground's axes.
    """

    unit: str = "1"
    read = quaternion


@dataclass(frozen=True, kw_only=True)
class DirectionCosine(Sensor):
    """Global component of an axis of a body's frame."""

    record = DirectionCosineRecord.dtype
    unit: str = "1"
    read = cosine

    axis: int = 0

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the axis too."""
        super().fill(record, site)
        record["axis"] = self.axis


@dataclass(frozen=True, kw_only=True)
class AngularVelocity(Sensor):
    """Component of a body's angular velocity along a global axis, from component 3 on along one of the body."""

    unit: str = "rad/s"
    read = angular_velocity
