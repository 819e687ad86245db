"""Coordinates of joints, what drives them, and sums of angles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.records import RIGID
from solvers.compiled.kernel import kernel

from .base import Follows, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.sensors.base import QuantityRecord
    from solvers.compiled.record import Reals


@kernel
def position(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.q[sensor.index]


@kernel
def velocity(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.v[sensor.index]


@kernel
def acceleration(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.a[sensor.index]


@kernel
def effort(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    return state.tau[sensor.index]


@kernel
def turn(sensor: QuantityRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`. Angles of revolutes, slopes of sections; component 1: their rates."""
    total, i = 0.0 * arrays.world[0].gravity[0], sensor.index
    while i > 0:
        body = arrays.bodies[i]
        if body.role != RIGID:
            for k in range(body.nv):
                slope = arrays.nodes[body.node].slope[k]
                total += slope * (state.v[body.vi + k] if sensor.component == 1 else state.q[body.qi + k])
        elif body.nv == 1:
            total += state.v[body.vi] if sensor.component == 1 else state.q[body.qi]
        i = body.parent
    return total


@dataclass(frozen=True, kw_only=True)
class Coordinate(Sensor):
    """Position of a joint."""

    read = position
    is_kinematic = True

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it is in State.q."""
        record["index"] = site.q + self.component

    def rate_sensor(self) -> Sensor | None:
        """See :class:`.Sensor`; components of a quaternion have none."""
        joint = self.item.joint
        if self.component >= joint.nv - 3 * joint.quaternion:
            return None
        return Rate(unit=self.unit + "/s", item=self.item, component=self.component, bodies=self.bodies)


@dataclass(frozen=True, kw_only=True)
class Rate(Sensor):
    """Velocity of a joint."""

    read = velocity
    is_kinematic = True

    def fill(self, record: Any, site: Attachment) -> None:
        """Write where it is in State.v."""
        record["index"] = site.v + self.component


@dataclass(frozen=True, kw_only=True)
class Acceleration(Rate):
    """Acceleration of a joint."""

    read = acceleration
    is_kinematic = False
    follows = Follows.LOADS


@dataclass(frozen=True, kw_only=True)
class Effort(Rate):
    """Force or torque of a driven joint."""

    read = effort
    is_kinematic = False
    follows = Follows.FORCES


@dataclass(frozen=True, kw_only=True)
class Turn(Sensor):
    """Angle of a body connected to the ground by parallel revolutes and sections, with full turns, or its rate."""

    read = turn
    is_kinematic = True

    def rate_sensor(self) -> Sensor | None:
        """See :class:`.Sensor`."""
        return None if self.component == 1 else Turn(unit="rad/s", item=self.item, component=1)
