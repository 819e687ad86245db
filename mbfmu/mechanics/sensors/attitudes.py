"""How a body is turned and how fast: its quaternion, its direction cosines, its angular velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbfmu.mechanics.spatial import quaternion_of
from solvers.compiled.kernel import kernel
from solvers.compiled.record import i8

from .base import QuantityRecord, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class DirectionCosineRecord(QuantityRecord):
    """Parameters of :class:`DirectionCosine`."""

    axis: i8


@kernel
def quaternion(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Of e and -e, which are one attitude, the one whose first component is positive."""
    A = state.bodies[sensor.index].A
    e = quaternion_of(A[0], A[1], A[2])
    for k in range(4):
        if e[k].real != 0.0:
            return e[sensor.component] if e[k].real > 0.0 else -e[sensor.component]
    return e[sensor.component]


@kernel
def cosine(sensor: DirectionCosineRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.bodies[sensor.index].A[sensor.component, sensor.axis]


@kernel
def angular_velocity(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
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
    is_kinematic = True


@dataclass(frozen=True, kw_only=True)
class DirectionCosine(Sensor):
    """Global component of an axis of a body's frame."""

    record = DirectionCosineRecord
    unit: str = "1"
    read = cosine
    is_kinematic = True

    axis: int = 0


@dataclass(frozen=True, kw_only=True)
class AngularVelocity(Sensor):
    """Component of a body's angular velocity along a global axis, from component 3 on along one of the body."""

    unit: str = "rad/s"
    read = angular_velocity
    is_kinematic = True
