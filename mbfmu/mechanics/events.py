"""Events: instants at which a quantity crosses a value, or given times, and what happens at them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mbfmu.mechanics.cuts import CutJoint, DistanceCutJoint, PlaneCutJoint
from mbfmu.mechanics.joints import Section
from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH
from mbfmu.mechanics.sensors import Coordinate, Distance, PointPosition, RelativePosition, Sensor

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.bodies import Body
    from mbfmu.mechanics.builder.joint_handle import JointHandle

DIRECTIONS = {"up": 1, "down": -1, "both": 0}  # by name: sign of the rate of the quantity; 0: any


@dataclass(frozen=True)
class EndRun:
    """Action of an event: the run ends at the event."""


@dataclass(frozen=True)
class SetInput:
    """Action of an event: set an input, as :meth:`.Simulation.set_input` does.

    Parameters
    ----------
    name
        Name of the input.
    value
        Value from the event on, in the unit of the input.
    """

    name: str
    value: float


@dataclass(frozen=True)
class SetParameter:
    """Action of an event: change a tunable parameter of the model, as :meth:`.Simulation.retune` does.

    Parameters
    ----------
    name
        Name of the parameter, which is tunable.
    value
        Value from the event on, in the unit of the parameter. The run continues with the mechanism that the model
        builds with it, at the same positions and velocities.
    """

    name: str
    value: Any


@dataclass(frozen=True)
class Impulse:
    """Action of an event: an impulse on a joint coordinate, between the body and its parent.

    The velocities jump by dv with M dv + J^T Lambda = p and J dv = 0: p is the impulse in the direction of the
    coordinate, and Lambda are the impulses of the loop-closing joints. Positions and first-order states do not change.

    Parameters
    ----------
    body
        Body whose joint to its parent has the coordinate, or a joint from :meth:`.Mechanism.joint`. The coordinate is
        not driven.
    value
        Impulse, N s for a displacement or N m s for an angle.
    coordinate
        Number of the coordinate of the joint, from 0.
    """

    body: Body | JointHandle
    value: float
    coordinate: int = 0


@dataclass(frozen=True)
class Restart:
    """Action of an event: forces begin or end abruptly here, and the solver restarts.

    It takes at least eight steps from here to the next event with a Restart, so that a short force is not passed within
    one step, such as a thin elastic stop or a spike in a law of force. The motion is otherwise not changed.
    """


@dataclass(frozen=True)
class Bounce:
    """Action of an event: its sensor hits a stop, and its rate is reversed.

    The rate g' = G v + g_t of the sensor g(t, q) becomes -restitution times what it was (Newton's law of restitution).
    The velocities jump by dv with M dv + J^T Lambda = G^T p and J dv = 0: the impulse p acts on what the sensor
    measures, without friction, and Lambda are the impulses of the loop-closing joints. Positions and first-order states
    do not change. The impulses of all stops that are hit at one time are determined together and push only, before
    other actions.

    A sensor comes to rest at the stop when the rest of its bounces is not resolved by the tolerance, or at the first
    impact if the restitution is 0: the stop holds it until the force of the stop would pull. Sensors that are held are
    the coordinate of a joint with one coordinate and, in models with up to 60 joint coordinates, positions, relative
    positions and distances.

    Parameters
    ----------
    restitution
        Coefficient of restitution, 0 to 1; 1: the impact does not change the energy.
    """

    restitution: float


@dataclass(frozen=True)
class Lock:
    """Action of an event: a joint is locked at its present coordinate, until a :class:`Release`.

    The rate v_k of the coordinate becomes zero. The velocities jump by dv with M dv + J^T Lambda = p e_k, J dv = 0 and
    dv_k = -v_k: the impulse p acts between the body and its parent, and Lambda are the impulses of the loop-closing
    joints. Positions and first-order states do not change. From then on the coordinate is constant, whatever the force
    that this requires. A joint that is locked already remains locked.

    Parameters
    ----------
    joint
        Body whose joint to its parent is locked, or a joint from :meth:`.Mechanism.joint`. The joint has one
        coordinate, which is not driven.
    """

    joint: Body | JointHandle


@dataclass(frozen=True)
class Release:
    """Action of an event: a joint that a :class:`Lock` has locked moves freely again, from rest.

    Parameters
    ----------
    joint
        As for :class:`Lock`. A run ends with an error if the joint is not locked.
    """

    joint: Body | JointHandle


Action = EndRun | SetInput | SetParameter | Impulse | Restart | Bounce | Lock | Release


class HoldingCut(NamedTuple):
    """Cut joint that holds a sensor at its stop: residual zero there, with the rate of the sensor."""

    cut: CutJoint
    a: int  # numbers of its bodies
    b: int


@dataclass(frozen=True)
class Event:
    """An event of a mechanism, which :meth:`.Mechanism.event` adds.

    Parameters
    ----------
    name
        Name, unique among the events.
    actions
        What happens, in this order.
    sensor
        Quantity that crosses a value; None: the event has a given time.
    value
        The value, in the unit of the sensor.
    direction
        Sign of the rate of the quantity at the crossing; 0: any.
    time
        Given time, s.
    within
        Longest time between two evaluations of the sensor, s; None: as the solver's steps need.
    lasts
        Time for which the quantity must remain beyond the value, s, before the event occurs; 0: it occurs at the
        crossing.
    is_listed
        Whether the list of the events that have occurred contains it; otherwise it belongs to an element.
    """

    name: str
    actions: tuple[Action, ...]
    sensor: Sensor | None = None
    value: float = 0.0
    direction: int = 0
    time: float = 0.0
    within: float | None = None
    lasts: float = 0.0
    is_listed: bool = True

    @property
    def restarts(self) -> bool:
        """Whether the solver restarts."""
        return any(isinstance(action, Restart) for action in self.actions)

    @property
    def bounce(self) -> Bounce | None:
        """The action at which its value is a stop; None: it has none."""
        return next((action for action in self.actions if isinstance(action, Bounce)), None)

    @property
    def holding_joint(self) -> int | None:
        """Number of the body whose joint, if it is locked, holds the sensor at its stop; None: there is none.

        The sensor is the coordinate of a joint with one coordinate, which is not driven.
        """
        if self.bounce is None or not isinstance(self.sensor, Coordinate):
            return None
        joint = self.sensor.item.joint
        is_lockable = joint.nv == 1 and joint.drive is None and not isinstance(joint, Section)
        return int(self.sensor.item.index) if is_lockable else None

    @property
    def holding_cut(self) -> HoldingCut | None:
        """Cut joint that holds the sensor at its stop: a point in a plane, or a rod; None: there is none."""
        sensor, value = self.sensor, self.value
        if self.bounce is None:
            return None
        if isinstance(sensor, PointPosition):
            at = value * np.eye(3)[sensor.component]
            cut = PlaneCutJoint(axis="xyz"[sensor.component], at_a=at, at_b=sensor.point)
            return HoldingCut(cut, 0, sensor.item.index)
        if isinstance(sensor, RelativePosition):
            at = np.array(sensor.at_a, float) + value * np.eye(3)[sensor.component]
            cut = PlaneCutJoint(axis="xyz"[sensor.component], at_a=at, at_b=sensor.at_b)
            return HoldingCut(cut, *(body.index for body in sensor.bodies))
        if isinstance(sensor, Distance) and MIN_LENGTH <= value <= MAX_LENGTH:
            rod = DistanceCutJoint(length=value, at_a=sensor.at_a, at_b=sensor.at_b)
            return HoldingCut(rod, *(body.index for body in sensor.bodies))
        return None
