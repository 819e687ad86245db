"""Events of a run: their search, their actions and their list."""

from __future__ import annotations

from collections.abc import Callable
from math import isnan
from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.events import EndRun, Event, Impulse, Lock, Release, SetInput, SetParameter
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from solvers.outcome import OK
from solvers.stepper import spacing
from solvers.system import Array

from .event_search import EventSearch
from .impulses import Impacts, velocity_jump
from .kernels.points import account_discontinuity, check_point, energy_at
from .locked_joints import LockedJoints
from .stepper_run import SEQUENCE, StepperRun

MAX_EVENTS, MIN_EVENTS_TIME_RATIO = 100, 1e-6  # 100 events need at least this part of the duration of the run
EQUAL_TIME_SPACINGS = 8  # of floating-point numbers, up to which two given times are one: no step is so short
RESTING_BOUNCES = 3  # number of bounces at rest, each within MIN_EVENTS_TIME_RATIO of the duration after another one

Setters = dict[type, Callable[[str, Any], None]]  # by the class of the action: sets a value by its name


class EventRecord(NamedTuple):
    """An event that has occurred.

    Attributes
    ----------
    name
        Name of the event.
    time
        Time, s, at which the crossing is located.
    direction
        ``"up"`` or ``"down"``; empty: an event of a given time.
    value
        Value of its sensor before the actions, in the unit of the sensor; NaN: it has none.
    after
        Value of its sensor after the actions of all events of this time.
    """

    name: str
    time: float
    direction: str
    value: float
    after: float


class RunEvents:
    """The events of one run.

    Attributes
    ----------
    records
        Events that have occurred.
    ended
        Whether an event has ended the run.
    stop
        Why the run cannot continue: too many events, a stop that is rested on, or an impulse on what has no mass; None:
        it can.
    locked
        Joints that are locked.
    """

    def __init__(self, compiled: CompiledMechanism, run: StepperRun, setters: Setters, locked: LockedJoints) -> None:
        declared, self._compiled, self.locked = compiled.mechanism.events, compiled, locked
        self._run, self._setters = run, setters
        self._order = {event.name: k for k, event in enumerate(declared)}
        watching = [event for event in declared if event.sensor is not None]
        self._places = {event.name: k for k, event in enumerate(watching)}
        self._stops = {event.name: k for k, event in enumerate(event for event in watching if event.bounce)}
        directions = np.array([event.direction for event in watching], np.int64)
        are_stops = np.array([event.name in self._stops for event in watching], np.bool_)
        self._has_rate = np.array([e.sensor is not None and e.sensor.rate_sensor() is not None for e in watching], bool)
        self._restarting = np.array([event.restarts for event in watching], bool)
        self._parts = np.append(compiled.watched, compiled.watched_rates)
        self._search = EventSearch(self._differences, self._sizes(), directions, are_stops)
        rates = compiled.watched_rates[are_stops[self._has_rate]]
        self._impacts = Impacts(compiled, rates, directions[are_stops].astype(float))
        units = [event.sensor.unit for event in watching if event.sensor and compiled.locks.can_lock]
        self._bands = run.stepper.options.rtol * np.array([compiled.nominal(unit) for unit in units])
        self._declare(declared)
        t = run.stepper.t
        self._next_timed = sum(event.time < t for event in self._timed)
        self.records: list[EventRecord] = []
        self.ended = False
        self.stop: Diagnostic | None = None
        self._search.begin(run.stepper)

    def _sizes(self) -> Array:
        """Return the units of the free coordinates."""
        system = self._compiled.system
        sizes: Array = system.size[: system.n_velocities]
        return sizes

    def _declare(self, declared: list[Event]) -> None:
        self._declared = declared
        self._watching = [event for event in declared if event.sensor is not None]
        self._timed = sorted((e for e in declared if e.sensor is None), key=lambda event: event.time)
        self._values = np.array([event.value for event in self._watching])
        bounces = [event.bounce for event in self._watching]
        self._impacts.restitutions = np.array([bounce.restitution for bounce in bounces if bounce])
        self._search.within = min((e.within for e in self._watching if e.within is not None), default=np.inf)

    def adopt(self, declared: list[Event]) -> None:
        """Use the values and actions of the same events with other parameters of the model.

        Raises
        ------
        UserError
            They are other events: their names, times, directions or stops differ.
        """
        before, after = (
            [(event.name, event.time, event.direction, event.bounce is None) for event in events]
            for events in (self._declared, declared)
        )
        if before != after:
            name = next((b[0] for a, b in zip(before, after, strict=False) if a != b), "")
            raise UserError(
                f"a parameter changes the number, time or direction of events{f', such as {name!r}' if name else ''}; "
                "allowed during a run: other values and actions. Use a parameter that is not tunable"
            )
        self._declare(declared)

    def _differences(self, t: float, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the sensors minus the values that they may cross, and their rates; nan: not known."""
        values, count = np.zeros(len(self._parts)), len(self._watching)
        watch_sensors(t, q, v, self._parts, self._compiled.system.pinned_data, values)
        rates = np.full(count, np.nan)
        rates[self._has_rate] = values[count:]
        return values[:count] - self._values, rates

    def step(self, end: float) -> None:
        """Advance to the communication point at ``end`` (s) with all events before it, or to one that ends the run."""
        run = self._run
        code = OK if self.ended or self.stop else SEQUENCE.begin_step(run, end)
        while code == OK and not self.ended and self.stop is None:
            found = self._advance(end)
            if not run.stepper.status.ok:
                break
            changed = bool(found) and self._act(found)
            if any(event.restarts for event in found) and run.stepper.t < end:
                self._search.restart(run.stepper, end, self._restarting)
                run.q, run.v, run.energy_account = run.stepper.reported
            if run.stepper.t >= end and not found:
                break
            if changed:
                code = SEQUENCE.begin_step(run, end)

    def _advance(self, end: float) -> list[Event]:
        """Advance to the next event or to ``end``, s; return the events there."""
        run, timed = self._run, self._timed[self._next_timed :]
        stepper, slack = run.stepper, EQUAL_TIME_SPACINGS * spacing(end)
        due = timed[0].time if timed and timed[0].time < end - slack else end
        found = [self._watching[k] for k in self._search.advance(stepper, due)]
        run.q, run.v, run.energy_account = stepper.reported
        state = stepper.t, run.q, run.v, run.energy_account
        check_point(run.session, *state, False)
        if stepper.status.ok and timed and stepper.t >= timed[0].time - slack:
            here = [event for event in timed if event.time <= stepper.t + slack]
            self._next_timed += len(here)
            found += here
        return sorted(found, key=lambda event: self._order[event.name])

    def _act(self, found: list[Event]) -> bool:
        """Execute the actions of the events at the reported state; return whether an input or a parameter was set."""
        run, changed = self._run, False
        before = self._sensor_values()
        self._bounce([event for event in found if event.bounce])
        for event in found:
            for action in event.actions:
                if isinstance(action, SetInput | SetParameter):
                    self._setters[type(action)](action.name, action.value)
                    changed = True
                elif isinstance(action, Impulse):
                    self._apply_impulse(action)
                elif isinstance(action, Lock | Release):
                    self.stop = self.stop or self.locked.act(action, event.name)
                    self._search.size = self._sizes()
                elif isinstance(action, EndRun):
                    self.ended = True
        after, t = self._sensor_values(), run.stepper.t
        for event in found:
            if event.sensor is None:
                self.records.append(EventRecord(event.name, t, "", np.nan, np.nan))
            else:
                k = self._places[event.name]
                rises = event.direction > 0 if event.bounce else self._search.sides[k] > 0
                direction = "up" if rises else "down"
                self.records.append(EventRecord(event.name, t, direction, float(before[k]), float(after[k])))
        self._check_rest(found)
        self._check_density(found[0])
        if any(isinstance(action, Lock) for event in found for action in event.actions):
            self._search.leave([self._places[event.name] for event in found if event.sensor], self._bands)
        return changed

    def _bounce(self, found: list[Event]) -> None:
        """Let the sensors of events bounce off their stops."""
        if not found or self.stop is not None:
            return
        run, t = self._run, self._run.stepper.t
        names = ", ".join(repr(event.name) for event in found)
        dv = self._impacts.jump(t, run.q, run.v, np.array([self._stops[event.name] for event in found]))
        if dv is None:
            self.stop = Diagnostic.error(
                "no-inertia",
                f"the bounce of event {names} moves a coordinate without mass at t = {t:.9g} s",
                "Give a mass or inertia to the bodies that move freely",
                time=t,
                subject=found[0].name,
            )
        elif isinstance(dv, int):
            event = next(event for event in found if self._stops[event.name] == dv)
            self.stop = Diagnostic.error(
                "prescribed-bounce",
                f"event {event.name!r} cannot bounce at t = {t:.9g} s: drives, loop-closing joints or other stops "
                "prescribe the rate of its sensor",
                "Use a sensor that can move freely, or remove the Bounce",
                time=t,
                subject=event.name,
            )
        else:
            self._let_jump(dv)

    def _apply_impulse(self, action: Impulse) -> None:
        run, first = self._run, int(self._compiled.data.arrays.bodies["vf"][action.body.index])
        if first < 0:  # a locked joint transmits it
            return
        impulses = np.zeros(len(run.v))
        impulses[first + action.coordinate] = action.value
        dv = velocity_jump(self._compiled, run.stepper.t, run.q, run.v, impulses)
        if dv is None:
            self.stop = Diagnostic.error(
                "no-inertia",
                f"an impulse on the joint of body {action.body.name!r} moves a coordinate without mass at "
                f"t = {run.stepper.t:.9g} s",
                "Give a mass or inertia to the bodies that move freely",
                time=run.stepper.t,
                subject=action.body.name,
            )
            return
        self._let_jump(dv)

    def _let_jump(self, dv: Array) -> None:
        """Let the velocities jump by dv (n,); the change of the energy is work of an impulse."""
        run, session = self._run, self._run.session
        run.dv[:] = dv
        before = energy_at(session, run.stepper.t, run.q, run.v)
        run.stepper.jump(run.dv)
        run.q, run.v, run.energy_account = run.stepper.reported
        account_discontinuity(session, before, run.stepper.t, run.q, run.v)

    def _sensor_values(self) -> Array:
        run = self._run
        found: Array = self._differences(run.stepper.t, run.q, run.v)[0] + self._values
        return found

    def _check_density(self, last: Event) -> None:
        """Stop the run if too many events follow each other in too short a time."""
        if len(self.records) <= MAX_EVENTS:
            return
        t, first = self.records[-1].time, self.records[-1 - MAX_EVENTS].time
        if t - first < MIN_EVENTS_TIME_RATIO * self._run.stepper.options.duration:
            self.stop = Diagnostic.error(
                "too-many-events",
                f"event {last.name!r} is the last of {MAX_EVENTS} events within {t - first:.2g} s at t = {t:.9g} s",
                "Use two events at different values (hysteresis), or let an action change the motion so that the "
                "quantity does not cross the value again at once",
                time=t,
                subject=last.name,
            )

    def _check_rest(self, found: list[Event]) -> None:
        """Stop the run if a quantity remains at its stop: its bounces follow each other in times that tend to zero."""
        shortest = MIN_EVENTS_TIME_RATIO * self._run.stepper.options.duration
        for event in found if self.stop is None else []:
            times = [record.time for record in self.records if event.bounce and record.name == event.name]
            last = np.diff(times[-1 - RESTING_BOUNCES :])
            if len(last) == RESTING_BOUNCES and np.all(last < shortest):
                self.stop = Diagnostic.error(
                    "resting-bounce",
                    f"event {event.name!r} comes to rest at its stop at t = {times[-1]:.9g} s: its last "
                    f"{RESTING_BOUNCES + 1} bounces are within {times[-1] - times[-1 - RESTING_BOUNCES]:.2g} s",
                    "A Bounce does not hold what rests on the stop: use an elastic stop, such as JointStop or "
                    "DistanceStop, or a shorter stop time",
                    time=times[-1],
                    subject=event.name,
                )

    def check_start(self) -> None:
        """Raise UserError if the sensor of a :class:`.Bounce` is beyond its stop."""
        run = self._run
        if not self._stops:
            return
        t, size = run.stepper.t, self._compiled.system.size
        beyond = np.array([e.direction for e in self._watching]) * self._differences(t, run.q, run.v)[0]
        slopes, values = self._impacts.slopes(t, run.q), self._sensor_values()
        for k, event in enumerate(self._watching):
            if event.bounce:
                unit = np.linalg.norm(slopes[self._stops[event.name]] * size)
                if beyond[k] > run.stepper.options.rtol * unit:
                    raise UserError(
                        f"sensor of event {event.name!r} is {values[k]:.9g} at the start; allowed: at "
                        f"{'most' if event.direction > 0 else 'least'} {event.value:g}, since the event is a stop by "
                        "its Bounce. Start on the other side of the stop"
                    )

    def state(self) -> dict[str, Any]:
        """Return what a saved run must contain."""
        records = [[r.name, r.time, r.direction, *(None if isnan(x) else x for x in r[3:])] for r in self.records]
        search = self._search
        limits = {"limit": search.limit if search.limited else 0.0, "limited": search.limited}
        return {
            "sides": search.sides.tolist(),
            "bands": search.bands.tolist(),
            "timed": self._next_timed,
            "ended": self.ended,
            "list": records,
            "locked": self.locked.state(),
        } | limits

    def restore(self, state: dict[str, Any]) -> None:
        """Return to a state of :meth:`state`; the state of the solver is restored afterwards."""
        self.locked.restore(state["locked"])
        self._search.size = self._sizes()
        self._search.sides, self._search.bands = np.array(state["sides"], np.int64), np.array(state["bands"])
        self._search.limit, self._search.limited = state["limit"], state["limited"]
        self._next_timed, self.ended, self.stop = state["timed"], state["ended"], None
        self.records = [EventRecord(*r[:3], *(np.nan if x is None else x for x in r[3:])) for r in state["list"]]
