"""Events of a mechanism."""

from __future__ import annotations

from collections.abc import Sequence

from mbfmu.mechanics.events import DIRECTIONS, Action, Event, Impulse, SetInput
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.numbers import finite, positive
from mbfmu.mechanics.sensors import Sensor
from mbfmu.util.errors import UserError, short

from .bodies import coordinate_of
from .states import States


class Events(States):
    """Base of :class:`.Mechanism`: events, where the motion crosses a value or at given times."""

    def __init__(self) -> None:
        super().__init__()
        self.events: list[Event] = []

    def event(
        self,
        name: str,
        sensor: Sensor | None = None,
        *,
        crosses: float = 0.0,
        direction: str = "both",
        at: float | None = None,
        then: Action | Sequence[Action] = (),
        within: float | None = None,
    ) -> None:
        """Add an event: a run locates the time at which a quantity crosses a value, lists it, and executes actions.

        Parameters
        ----------
        name
            Unique name among the events.
        sensor
            Quantity that crosses the value: a sensor of positions, velocities or first-order states, such as
            ``arm.angle()``. A value that it has at the start of the run, or that it touches without crossing it, is no
            event.
        crosses
            The value, in the unit of the sensor.
        direction
            ``"up"``: crossings with increasing values; ``"down"``: with decreasing ones; ``"both"``.
        at
            Time of the event, s, in place of a sensor.
        then
            Action or actions, in their order: :class:`.SetInput`, :class:`.Impulse`, :class:`.EndRun`. Without actions
            the event is listed only, and the motion is not changed.
        within
            Longest time between two evaluations of the sensor, s. Two crossings that are further apart are always
            detected. By default the sensor is evaluated at four points of every step, and where the values between
            them may have an extremum.

        Raises
        ------
        UserError
            The name is used already, a number or the direction is invalid, both or none of ``sensor`` and ``at`` are
            given, or the sensor is not one of positions, velocities and states of this mechanism.
        """
        self._new_name("event", name, [event.name for event in self.events])
        what = f"event {name!r}"
        if (sensor is None) == (at is None):
            raise UserError(
                f"{what} is given {'no' if sensor is None else 'a'} sensor and {at!r} for its time; "
                "allowed: one of the two. Give a sensor, or a time by `at`"
            )
        if sensor is not None:
            if not isinstance(sensor, Sensor):
                raise UserError(f"sensor of {what} is {short(sensor)}; allowed: a sensor, such as Body.angle()")
            check_element_type(f"sensor of {what}", sensor, Sensor)
            self._check_sensor(f"sensor of {what}", sensor)
            if not sensor.is_kinematic:
                raise UserError(
                    f"sensor of {what} is of class {type(sensor).__name__}, whose value depends on forces or "
                    "accelerations; allowed: sensors of positions, velocities and states. Use one of these"
                )
        if direction not in DIRECTIONS:
            raise UserError(f"direction of {what} is {direction!r}; allowed: {', '.join(map(repr, DIRECTIONS))}")
        actions = (then,) if isinstance(then, Action) else then
        if not isinstance(actions, list | tuple) or not all(isinstance(action, Action) for action in actions):
            raise UserError(
                f"actions of {what} are {short(then)}; allowed: SetInput, Impulse and EndRun, or a list of these"
            )
        for action in actions:
            if isinstance(action, SetInput):
                finite(f"value of input {action.name!r} in {what}", action.value)
            elif isinstance(action, Impulse):
                finite(f"value of the impulse in {what}", action.value)
                self._member(action.body, f"body of the impulse in {what}")
                coordinate_of(f"coordinate of the impulse in {what}", action.body, action.coordinate)
                if action.body.joint.drive is not None:
                    raise UserError(
                        f"the impulse in {what} acts on the joint of body {action.body.name!r}, which is driven; "
                        "allowed: a joint that is free to move"
                    )
        self.events.append(
            Event(
                name,
                tuple(actions),
                sensor,
                finite(f"value of {what}", crosses),
                DIRECTIONS[direction],
                0.0 if at is None else finite(f"time of {what}", at),
                None if within is None else positive(f"within of {what}", within),
            )
        )
