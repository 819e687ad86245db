"""Position, velocity and acceleration of a body-fixed point, by components along the global axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.spatial import arm, centripetal
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Vec3

from .base import Follows, QuantityRecord, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class PointPositionRecord(QuantityRecord):
    """Parameters of :class:`PointPosition`."""

    point: Vec3


@kernel
def position(sensor: PointPositionRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    here, k = state.bodies[sensor.index], sensor.component
    return here.r[k] + arm(here, sensor.point)[k]


@kernel
def velocity(sensor: PointPositionRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. r' + w x p."""
    here, k = state.bodies[sensor.index], sensor.component
    p, i, j = arm(here, sensor.point), (k + 1) % 3, (k + 2) % 3
    return here.Y[k] + here.Y[3 + i] * p[j] - here.Y[3 + j] * p[i]


@kernel
def acceleration(sensor: PointPositionRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. r'' + w' x p + w x (w x p)."""
    here, k = state.bodies[sensor.index], sensor.component
    p, i, j = arm(here, sensor.point), (k + 1) % 3, (k + 2) % 3
    along = here.dY[k] + here.dY[3 + i] * p[j] - here.dY[3 + j] * p[i]
    return along + centripetal(here, p[0], p[1], p[2], k) + arrays.world[0].gravity[k]


@dataclass(frozen=True, kw_only=True)
class PointSensor(Sensor):
    """Quantity of ``point`` (m, body axes), a component along a global axis."""

    record = PointPositionRecord

    point: Any = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class PointPosition(PointSensor):
    """Component of its position."""

    read = position
    is_kinematic = True

    def rate_sensor(self) -> Sensor | None:
        """See :class:`.Sensor`."""
        return PointVelocity(unit="m/s", item=self.item, component=self.component, point=self.point)


@dataclass(frozen=True, kw_only=True)
class PointVelocity(PointSensor):
    """Component of its velocity."""

    read = velocity
    is_kinematic = True


@dataclass(frozen=True, kw_only=True)
class PointAcceleration(PointSensor):
    """Component of its acceleration."""

    read = acceleration
    follows = Follows.LOADS
