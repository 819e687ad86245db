"""How two bodies are to each other: distance, angle between axes, where one is seen from the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import angle_of, arm, point_offset, point_offset_rate
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, Vec3, i8

from .base import Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class DistanceRecord(Record):
    """Parameters of :class:`Distance`."""

    a: i8
    b: i8
    component: i8
    Pa: Vec3  # points, m, or unit vectors, body axes
    Pb: Vec3


@kernel
def distance(sensor: DistanceRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    (x, y, z), _, _ = point_offset(state.bodies[sensor.a], state.bodies[sensor.b], sensor.Pa, sensor.Pb)
    return np.sqrt(x * x + y * y + z * z)


@kernel
def distance_rate(sensor: DistanceRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. In the frame of a: a rotation does not change the distance. Coincident points: zero."""
    A, B = state.bodies[sensor.a], state.bodies[sensor.b]
    (x, y, z), _, _ = point_offset(A, B, sensor.Pa, sensor.Pb)
    vx, vy, vz = point_offset_rate(A, B, sensor.Pa, sensor.Pb)
    length = np.sqrt(x * x + y * y + z * z)
    return (x * vx + y * vy + z * vz) / length if length.real > 0.0 else length


@kernel
def angle(sensor: DistanceRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. By the lengths of both products: the cosine is inaccurate at small angles."""
    nx, ny, nz = arm(state.bodies[sensor.a], sensor.Pa)
    mx, my, mz = arm(state.bodies[sensor.b], sensor.Pb)
    x, y, z = ny * mz - nz * my, nz * mx - nx * mz, nx * my - ny * mx
    return angle_of(np.sqrt(x * x + y * y + z * z), nx * mx + ny * my + nz * mz)


@kernel
def relative_position(sensor: DistanceRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    A, k = state.bodies[sensor.a], sensor.component
    (x, y, z), _, _ = point_offset(A, state.bodies[sensor.b], sensor.Pa, sensor.Pb)
    return A.A[0, k] * x + A.A[1, k] * y + A.A[2, k] * z


@kernel
def relative_velocity(sensor: DistanceRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    A, k = state.bodies[sensor.a], sensor.component
    x, y, z = point_offset_rate(A, state.bodies[sensor.b], sensor.Pa, sensor.Pb)
    return A.A[0, k] * x + A.A[1, k] * y + A.A[2, k] * z


@dataclass(frozen=True, kw_only=True)
class PairSensor(Sensor):
    """Quantity of a point or an axis ``at_a`` on the first and ``at_b`` on the second of ``bodies`` (body axes)."""

    record = DistanceRecord
    is_kinematic = True

    at_a: Any = (0.0, 0.0, 0.0)
    at_b: Any = (0.0, 0.0, 0.0)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write which bodies, where on them, and the component."""
        record["a"], record["b"] = site.bodies
        record["Pa"], record["Pb"], record["component"] = self.at_a, self.at_b, self.component


@dataclass(frozen=True, kw_only=True)
class Distance(PairSensor):
    """Distance between the points (m, body axes)."""

    read = distance

    def rate_sensor(self) -> Sensor | None:
        """See :class:`.Sensor`."""
        return DistanceRate(unit="m/s", bodies=self.bodies, at_a=self.at_a, at_b=self.at_b)


@dataclass(frozen=True, kw_only=True)
class DistanceRate(PairSensor):
    """Its rate."""

    read = distance_rate


@dataclass(frozen=True, kw_only=True)
class AngleBetween(PairSensor):
    """Angle between unit vectors ``at_a`` and ``at_b`` of the two bodies, from 0 to pi."""

    unit: str = "rad"
    read = angle


@dataclass(frozen=True, kw_only=True)
class RelativePosition(PairSensor):
    """Component of the way from a's point to b's along an axis of a."""

    read = relative_position

    def rate_sensor(self) -> Sensor | None:
        """See :class:`.Sensor`."""
        at = {"at_a": self.at_a, "at_b": self.at_b, "component": self.component}
        return RelativeVelocity(unit="m/s", bodies=self.bodies, **at)


@dataclass(frozen=True, kw_only=True)
class RelativeVelocity(PairSensor):
    """Its rate: the velocity of b's point relative to body a."""

    read = relative_velocity
