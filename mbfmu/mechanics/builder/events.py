"""Events of a mechanism."""

from __future__ import annotations

from collections.abc import Sequence

from mbfmu.mechanics.events import DIRECTIONS, Action, Bounce, Event, Impulse, Lock, Release, SetInput, SetParameter
from mbfmu.mechanics.joints import Joint, Section
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.numbers import finite, is_whole, not_negative, positive
from mbfmu.mechanics.sensors import Sensor
from mbfmu.util.errors import UserError, short

from .blocks import BlockHandle, sensor_of
from .bodies import coordinate_of
from .delays import Delays
from .states import StateHandle


class Events(Delays):
    """Base of :class:`.Mechanism`: events, where the motion crosses a value or at given times."""

    def __init__(self) -> None:
        super().__init__()
        self.events: list[Event] = []

    def event(
        self,
        name: str,
        sensor: Sensor | BlockHandle | StateHandle | None = None,
        *,
        crosses: float = 0.0,
        direction: str = "both",
        at: float | None = None,
        then: Action | Sequence[Action] = (),
        within: float | None = None,
        lasts: float = 0.0,
    ) -> None:
        """Add an event: a run locates the time at which a quantity crosses a value, lists it, and executes actions.

        Parameters
        ----------
        name
            Unique name among the events.
        sensor
            Quantity that crosses the value: a sensor of positions, velocities or first-order states, such as
            ``arm.angle()``, a state, or a block or an :meth:`expression` of these, of the time and of inputs. A value
            that it has at the start of the run, or that it touches without crossing it, is no event.
        crosses
            The value, in the unit of the sensor.
        direction
            ``"up"``: crossings with increasing values; ``"down"``: with decreasing ones; ``"both"``.
        at
            Time of the event, s, in place of a sensor; not negative, since models start at 0 s. An event at the start
            of a run occurs before its first output. Events of times before the start of a run do not occur in it.
        then
            Action or actions, in their order: :class:`.SetInput`, :class:`.SetParameter`, :class:`.Impulse`,
            :class:`.Bounce`, :class:`.Lock`, :class:`.Release`, :class:`.Restart`, :class:`.EndRun`. Without actions
            the event is listed only, and the motion is not changed.
        within
            Longest time between two evaluations of the sensor, s. Two crossings that are further apart are always
            detected. By default the sensor is evaluated at four or more points of every step, between which no
            coordinate moves by more than a quarter of its unit (1 rad, or the size of the mechanism), and where the
            values or rates at the points show an extremum between them.
        lasts
            Time, s, for which the quantity must remain beyond the value, above it with the direction ``"up"`` and
            below it with ``"down"``: the event occurs at the end of this time, once until the quantity returns. It
            begins at the start of the run if the quantity is at the value or beyond it there. 0: the event occurs at
            the crossing.

        Raises
        ------
        UserError
            The name is used already, a number or the direction is invalid, both or none of ``sensor`` and ``at`` are
            given, or the sensor is not one of positions, velocities and states of this mechanism, at a
            :class:`.Bounce` one of positions.
        """
        self._new_name("event", name, [event.name for event in self.events])
        what = f"event {name!r}"
        if (sensor is None) == (at is None):
            raise UserError(
                f"{what} is given {'no' if sensor is None else 'a'} sensor and {at!r} for its time; "
                "allowed: one of the two. Give a sensor, or a time by `at`"
            )
        watched = None if sensor is None else self._crossing_sensor(f"sensor of {what}", sensor)
        if not isinstance(direction, str) or direction not in DIRECTIONS:
            raise UserError(f"direction of {what} is {direction!r}; allowed: {', '.join(map(repr, DIRECTIONS))}")
        actions = (then,) if isinstance(then, Action) else then
        if not isinstance(actions, list | tuple) or not all(isinstance(action, Action) for action in actions):
            raise UserError(
                f"actions of {what} are {short(then)}; allowed: SetInput, SetParameter, Impulse, Bounce, Lock, "
                "Release, Restart and EndRun, or a list of these"
            )
        if not_negative(f"lasts of {what}", lasts):
            _check_duration(what, actions, watched, direction)
        for action in actions:
            self._check_action(what, action, watched, direction)
        self.events.append(
            Event(
                name,
                tuple(actions),
                watched,
                finite(f"value of {what}", crosses),
                DIRECTIONS[direction],
                0.0 if at is None else not_negative(f"time of {what}", at),
                None if within is None else positive(f"within of {what}", within),
                float(lasts),
            )
        )

    def _crossing_sensor(self, what: str, given: Sensor | BlockHandle | StateHandle) -> Sensor:
        """Return the sensor of an event; UserError if there is none whose crossings can be located."""
        sensor = sensor_of(given)
        if not isinstance(sensor, Sensor):
            raise UserError(f"{what} is {short(sensor)}; allowed: a sensor, such as Body.angle(), a block or a state")
        check_element_type(what, sensor, Sensor)
        self._check_sensor(what, sensor)
        if not (sensor.is_kinematic or getattr(sensor, "is_block_output", False)):
            raise UserError(
                f"{what} is of class {type(sensor).__name__}, whose value depends on forces or "
                "accelerations; allowed: sensors of positions, velocities and states, and expressions and blocks "
                "of these, of time and of inputs. Use one of these"
            )
        return sensor

    def _check_action(self, what: str, action: Action, sensor: Sensor | None, direction: str) -> None:
        """Raise UserError if an event, ``what``, with this sensor and direction cannot have an action."""
        if isinstance(action, SetInput | SetParameter) and not isinstance(action.name, str):
            raise UserError(f"name in {type(action).__name__} of {what} is {short(action.name)}; allowed: a text")
        if isinstance(action, SetInput):
            finite(f"value of input {action.name!r} in {what}", action.value)
        elif isinstance(action, Impulse):
            finite(f"value of the impulse in {what}", action.value)
            owner = self._coordinate_owner(action.body, f"body of the impulse in {what}")
            if not is_whole(action.coordinate):
                raise UserError(
                    f"coordinate of the impulse in {what} is {short(action.coordinate)}; allowed: a number from 0"
                )
            coordinate_of(f"coordinate of the impulse in {what}", owner, action.coordinate)
            if owner.joint.drive is not None:
                raise UserError(
                    f"the impulse in {what} acts on the joint of {owner.name!r}, which is driven; "
                    "allowed: a joint that is free to move"
                )
        elif isinstance(action, Bounce):
            _check_bounce(what, action, sensor, direction)
        elif isinstance(action, Lock | Release):
            role = f"joint of the {type(action).__name__} in {what}"
            if action.joint is self.bodies[0]:
                raise UserError(
                    f"{role} is the ground, which has no joint; allowed: a body, whose joint to its parent is "
                    "meant, or a joint from Mechanism.joint"
                )
            owner = self._coordinate_owner(action.joint, role)
            owner.coordinate()  # raises for a body that is declared without a joint
            _check_lock(role, owner.name, owner.joint)


def _check_lock(role: str, name: str, joint: Joint) -> None:
    """Raise UserError if a joint cannot be locked: it has not one coordinate, or is driven."""
    if joint.drive is not None:
        raise UserError(
            f"{role} is {name!r}, which is driven; allowed: a joint that moves freely. Let the drive hold the "
            "joint, or drive it by forces"
        )
    if joint.nv != 1 or isinstance(joint, Section):
        coordinates = ", ".join(text or unit for text, unit in zip(joint.coordinates, joint.units, strict=True))
        raise UserError(
            f"{role} is {name!r}, a {type(joint).__name__} with {joint.nv} coordinates"
            f"{f' ({coordinates})' if coordinates else ''}; allowed: a joint with one coordinate, such as Revolute or "
            "Translational. Use several such joints in a row, with bodies without mass between them, and lock one of "
            "them"
        )


def _check_duration(what: str, actions: Sequence[Action], sensor: Sensor | None, direction: str) -> None:
    """Raise UserError if the event cannot be one whose quantity must remain beyond its value."""
    if sensor is None or direction == "both" or any(isinstance(action, Bounce) for action in actions):
        raise UserError(
            f"{what} is given `lasts`; allowed: with a sensor, the direction 'up' (remains above the value) or 'down' "
            "(remains below it), and without a Bounce. Give these, or leave out `lasts`"
        )


def _check_bounce(what: str, action: Bounce, sensor: Sensor | None, direction: str) -> None:
    """Raise UserError if the event cannot be one at which its sensor bounces."""
    if not 0.0 <= finite(f"restitution in {what}", action.restitution) <= 1.0:
        raise UserError(f"restitution in {what} is {action.restitution!r}; allowed: 0 to 1")
    if sensor is None or sensor.rate_sensor() is None:
        given = "no sensor" if sensor is None else f"a sensor of class {type(sensor).__name__}"
        raise UserError(
            f"{what} has a Bounce and {given}; allowed: sensors of positions whose rate is known. Use coordinate(), "
            "position(), distance(), length(), relative_position() or turn()"
        )
    if direction == "both":
        raise UserError(
            f"direction of {what} is 'both'; allowed with a Bounce: 'up', a stop above which the quantity does not go, "
            "or 'down', one below which it does not"
        )
