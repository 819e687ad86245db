"""Events of a run: their search, their actions and their list."""

from __future__ import annotations

from collections.abc import Callable
from math import isnan
from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.events import Bounce, EndRun, Event, Impulse, Lock, Release, SetInput, SetParameter
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from solvers.outcome import OK
from solvers.resolution import spacing
from solvers.system import Array

from .event_durations import Durations
from .event_record import EventRecord
from .event_search import CrossingSearch, search_memory
from .impulses import Impacts, UndeterminedJumpError, velocity_jump
from .kernels.points import account_discontinuity, check_point, energy_at
from .locked_joints import LockedJoints
from .resting_stops import RestingStops
from .run_messages import (
    MAX_EVENTS,
    PRESCRIBED_BOUNCE,
    RESTING_BOUNCE,
    RESTING_BOUNCES,
    TOO_MANY_EVENTS,
    filled,
)
from .sampled_blocks import EQUAL_TIME_SPACINGS, SampledBlocks
from .stepper_run import SEQUENCE, StepperRun
from .touched_stops import SAME_PLACE_RATIO, TouchedStops

JUMPS = Bounce | Impulse | Lock | Release  # actions that may change velocities
MIN_EVENTS_TIME_RATIO = 1e-6  # MAX_EVENTS events need at least this part of the duration of the run

Setters = dict[type, Callable[[str, Any], None]]  # by the class of the action: sets a value by its name


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
        self._restarting = np.array([event.restarts and not event.lasts for event in watching], bool)
        self._durations = Durations()
        memory = search_memory(compiled)
        self._search = CrossingSearch(run, memory, lambda _: self._resting.least_force())
        are_stops = memory.stops == 1
        rates = memory.parts[memory.rate_places[are_stops]]
        towards = memory.directions[are_stops].astype(float)
        self._impacts = Impacts(compiled, rates, towards)
        self._resting = RestingStops(compiled, run, self._search, locked, self._impacts)
        self._touched = TouchedStops(compiled, run, self._search, self._impacts)
        turns = any(isinstance(action, Lock | Impulse) for event in declared for action in event.actions)
        units = [event.sensor.unit for event in watching if event.sensor and turns]
        self._bands = run.stepper.options.rtol * np.array([compiled.nominal(unit) for unit in units])
        self._samples = SampledBlocks(compiled, run)
        self._declare(declared)
        t = run.stepper.t
        self._next_timed = sum(event.time < t for event in self._timed)
        self.records: list[EventRecord] = []
        self.ended = self._restarts_next = False
        self.stop: Diagnostic | None = None
        self._search.begin()
        self._durations.update(self._search.memory, run)

    def _sizes(self) -> Array:
        """Return the units of the free coordinates."""
        system = self._compiled.system
        sizes: Array = system.size[: system.n_velocities]
        return sizes

    def _declare(self, declared: list[Event]) -> None:
        self._declared = declared
        self._watching = [event for event in declared if event.sensor is not None]
        self._timed = sorted((e for e in declared if e.sensor is None), key=lambda event: event.time)
        memory = self._search.memory
        memory.crossed[:] = [event.value for event in self._watching]
        self._durations.declare(self._watching)
        bounces = [event.bounce for event in self._watching]
        self._impacts.restitutions = np.array([bounce.restitution for bounce in bounces if bounce])
        self._resting.declare([event for event in self._watching if event.bounce])
        memory.control["within"] = min((e.within for e in self._watching if e.within is not None), default=np.inf)

    def adopt(self, mechanism: Mechanism) -> None:
        """Use the values and actions of the same events, and sampled blocks, with other parameters of the model.

        Raises
        ------
        UserError
            They are other events: their names, times, directions or stops differ; or other periods.
        """
        declared = mechanism.events
        before, after = (
            [(event.name, event.time, event.direction, event.bounce is None, event.lasts > 0.0) for event in events]
            for events in (self._declared, declared)
        )
        if before != after:
            name = next((b[0] for a, b in zip(before, after, strict=False) if a != b), "")
            raise UserError(
                f"a parameter changes the number, time or direction of events{f', such as {name!r}' if name else ''}; "
                "allowed during a run: other values and actions. Use a parameter that is not tunable"
            )
        self._samples.adopt(mechanism.sampled)
        self._declare(declared)

    def start(self) -> None:
        """Execute the events of the start time, before the first outputs."""
        here = [event for event in self._timed[self._next_timed :] if event.time == self._run.stepper.t]
        self._next_timed += len(here)
        if here:
            self._act(sorted(here, key=lambda event: self._order[event.name]))
        self._restarts_next = any(event.restarts for event in here)
        self._hold_at_start()
        self._sample()

    def _hold_at_start(self) -> None:
        """Let stops hold what rests on them at the start."""
        values, crossed = self._search.sensor_values(), self._search.memory.crossed
        is_at = np.abs(values - crossed) <= SAME_PLACE_RATIO * np.maximum(np.abs(values), np.abs(crossed))
        stops = [self._stops[event.name] for k, event in enumerate(self._watching) if event.bounce and is_at[k]]
        self.stop = self.stop or self._resting.hold_resting(stops)

    def _note_released(self, events: list[Event]) -> None:
        """List the events whose stops have released what rested on them."""
        values, t = self._search.sensor_values(), self._run.stepper.t
        for event in events:
            value = float(values[self._places[event.name]])
            self.records.append(EventRecord(event.name, t, "down" if event.direction > 0 else "up", value, value))
            self._check_density(event)

    def _sample(self) -> bool:
        """Take the samples of the time reached; return whether there are any."""
        jump = self._samples.jump() if self.stop is None else None
        if jump is not None:
            self._search.begin()
            self._let_jump(jump)
            self._durations.update(self._search.memory, self._run)
        return jump is not None

    def step(self, end: float) -> None:
        """Advance to the communication point at ``end`` (s) with all events before it, or to one that ends the run."""
        run = self._run
        self._note_released(self._resting.release_pulled())
        self._restart(end)
        code = OK if self.ended or self.stop else SEQUENCE.begin_step(run, end)
        while code == OK and not self.ended and self.stop is None:
            found = self._advance(end)
            if not run.stepper.status.ok:
                break
            changed = self._act_on(found)
            sampled = self._sample() if not self.ended else False
            if sampled:
                changed = self._act_on(self._watched(self._search.find_jumped())) or changed
            self._restart(end)
            if run.stepper.t >= end and not found and not sampled:
                break
            if changed:
                code = SEQUENCE.begin_step(run, end)

    def _act_on(self, found: list[Event]) -> bool:
        """Execute these events, and release stops that would pull; return whether an input or a parameter was set."""
        changed = bool(found) and self._act(found)
        self._note_released(self._resting.release_pulled())
        self._restarts_next = self._restarts_next or any(event.restarts for event in found)
        return changed

    def _watched(self, crossed: list[int]) -> list[Event]:
        """Return the events that occur where these sensors cross their values, in the order of their declaration."""
        return [event for event in (self._watching[k] for k in crossed) if not event.lasts]

    def _restart(self, end: float) -> None:
        """Restart the solver if an event requires it, before the next step: after a communication point in the next
        one.
        """
        if self._restarts_next and self._run.stepper.t < end:
            self._restarts_next = False
            self._search.restart(end, self._restarting)

    def _advance(self, end: float) -> list[Event]:
        """Advance to the next event or to ``end``, s; return the events there."""
        run, timed = self._run, self._timed[self._next_timed :]
        stepper = run.stepper
        first = min(timed[0].time if timed else np.inf, self._samples.next_time(), self._durations.next_time())
        due = first if first < end - EQUAL_TIME_SPACINGS * spacing(end) else end
        if self._resting.held:
            crossed, released = self._resting.advance(due)
            self._note_released(released)
            stepper = run.stepper
        else:
            crossed = self._search.advance(due)
        found, slack = self._watched(crossed), EQUAL_TIME_SPACINGS * spacing(stepper.t)
        state = stepper.t, run.q, run.v, run.energy_account
        check_point(run.session, *state, False)
        if stepper.status.ok and timed and stepper.t >= timed[0].time - slack:
            here = [event for event in timed if event.time <= stepper.t + slack]
            self._next_timed += len(here)
            found += here
        if stepper.status.ok and self._durations.any:
            self._durations.update(self._search.memory, run)
            found += [self._watching[k] for k in self._durations.take(stepper.t + slack)]
        return sorted(found, key=lambda event: self._order[event.name])

    def _act(self, found: list[Event]) -> bool:
        """Execute the actions of the events at the reported state; return whether an input or a parameter was set."""
        run, changed = self._run, False
        before = self._search.sensor_values()
        changes_rates = any(isinstance(action, JUMPS) for event in found for action in event.actions)
        rested = list(self._resting.held) if changes_rates else []
        self._resting.release(rested)
        hit = [self._stops[event.name] for event in found if event.bounce]
        hit += [k for k in rested if k not in hit]
        places, pushed = self._resting.values(), list[int]()
        if changes_rates:
            self._touched.note(hit)
            pushed = self._bounce(hit, found)
        for event in found:
            for action in event.actions:
                if isinstance(action, SetInput | SetParameter):
                    self._setters[type(action)](action.name, action.value)
                    changed = True
                elif isinstance(action, Impulse):
                    self._apply_impulse(action, event)
                elif isinstance(action, Lock | Release):
                    self.stop = self.stop or self.locked.act(action, event.name)
                    self._search.resize(self._sizes())
                elif isinstance(action, EndRun):
                    self.ended = True
        if changes_rates:
            pushed += self._bounce(rested, found)
        at_value = [k for k, value in enumerate(self._resting.values()) if k in pushed and value == places[k]]
        self.stop = self.stop or self._resting.hold_resting(at_value)
        after, t = self._search.sensor_values(), run.stepper.t
        for event in (own for own in found if own.is_listed):
            if event.sensor is None:
                self.records.append(EventRecord(event.name, t, "", np.nan, np.nan))
            else:
                k = self._places[event.name]
                is_given = event.bounce or event.lasts
                rises = event.direction > 0 if is_given else self._search.memory.sides[k] > 0
                direction = "up" if rises else "down"
                self.records.append(EventRecord(event.name, t, direction, float(before[k]), float(after[k])))
        self._durations.update(self._search.memory, run)
        self._check_rest(found)
        self._check_density(found[0])
        if any(isinstance(action, Lock | Impulse) for event in found for action in event.actions):
            self._search.leave([self._places[event.name] for event in found if event.sensor], self._bands)
        return changed

    def _bounce(self, stops: list[int], found: list[Event]) -> list[int]:
        """Let sensors bounce off these stops, at the events that are found; return them with those that are touched."""
        if self.stop is not None:
            return stops
        try:
            dv, pushed = self._touched.jump(stops)
        except UndeterminedJumpError as error:
            self._stop_at(found[0], error.reason)
            return stops
        if isinstance(dv, int):
            self._stop_at(next(e for e in self._watching if self._stops.get(e.name) == dv), PRESCRIBED_BOUNCE)
        elif pushed:
            self._let_jump(dv)
        return pushed

    def _apply_impulse(self, action: Impulse, event: Event) -> None:
        run, first = self._run, int(self._compiled.data.arrays.bodies["vf"][action.body.index])
        if first < 0:  # a locked joint transmits it
            return
        impulses = np.zeros(len(run.v))
        impulses[first + action.coordinate] = action.value
        try:
            self._let_jump(velocity_jump(self._compiled, run.stepper.t, run.q, run.v, impulses))
        except UndeterminedJumpError as error:
            self._stop_at(event, error.reason)

    def _stop_at(self, event: Event, reason: Diagnostic, **values: float) -> None:
        """Stop the run at an event, unless it is stopped already; ``reason`` is a template of :mod:`.run_messages`."""
        t = self._run.stepper.t
        self.stop = self.stop or filled(reason, time=t, subject=event.name, name=event.name, t=t, **values)

    def _let_jump(self, dv: Array) -> None:
        """Let the velocities jump by dv (n,); the change of the energy is work of an impulse."""
        run, session = self._run, self._run.session
        run.dv[:] = dv
        before = energy_at(session, run.stepper.t, run.q, run.v)
        run.stepper.jump(run.dv)
        run.q, run.v, run.energy_account = run.stepper.reported
        account_discontinuity(session, before, run.stepper.t, run.q, run.v)

    def _check_density(self, last: Event) -> None:
        """Stop the run if too many events follow each other in too short a time."""
        count = MAX_EVENTS
        if last.bounce and last.bounce.restitution < 1.0 and self._resting.can_hold(self._stops[last.name]):
            count = int(MAX_EVENTS / (1.0 - last.bounce.restitution))  # bounces until they are not resolved
        if len(self.records) <= count:
            return
        t, first = self.records[-1].time, self.records[-1 - count].time
        if t - first < MIN_EVENTS_TIME_RATIO * self._run.stepper.options.duration:
            self._stop_at(last, TOO_MANY_EVENTS, within=t - first)

    def _check_rest(self, found: list[Event]) -> None:
        """Stop the run if a quantity remains at its stop: its bounces follow each other in times that tend to zero."""
        shortest = MIN_EVENTS_TIME_RATIO * self._run.stepper.options.duration
        for event in found if self.stop is None else []:
            is_repeated = event.bounce and not self._resting.can_hold(self._stops[event.name])
            times = [record.time for record in self.records if is_repeated and record.name == event.name]
            last = np.diff(times[-1 - RESTING_BOUNCES :])
            if len(last) == RESTING_BOUNCES and np.all(last < shortest):
                self._stop_at(event, RESTING_BOUNCE, within=times[-1] - times[-1 - RESTING_BOUNCES])

    def check_start(self) -> None:
        """Raise UserError if the sensor of a :class:`.Bounce` is beyond its stop."""
        run = self._run
        if not self._stops:
            return
        t, size = run.stepper.t, self._compiled.system.size
        slopes, values, memory = self._impacts.slopes(t, run.q), self._search.sensor_values(), self._search.memory
        beyond = memory.directions * (values - memory.crossed)
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
        memory, control = self._search.memory, self._search.memory.control[0]
        limited = int(control["limited"])
        limits = {"limit": float(control["limit"]) if limited else 0.0, "limited": limited}
        return {
            "sides": memory.sides.tolist(),
            "bands": memory.bands.tolist(),
            "timed": self._next_timed,
            "ended": self.ended,
            "restarts": self._restarts_next,
            "since": self._durations.state(),
            "list": records,
            "locked": self.locked.state(),
            "resting": [[stop, value] for stop, value in self._resting.held.items()],
            "samples": self._samples.counts.tolist(),
        } | limits

    def restore(self, state: dict[str, Any]) -> None:
        """Return to a state of :meth:`state`; the state of the solver is restored afterwards."""
        self.locked.restore(state["locked"])
        self._resting.held = dict(state["resting"])
        self._search.resize(self._sizes())
        memory, control = self._search.memory, self._search.memory.control[0]
        memory.sides[:], memory.bands[:] = state["sides"], state["bands"]
        control["limit"], control["limited"] = state["limit"], state["limited"]
        self._samples.counts[:] = state["samples"]
        self._next_timed, self.ended, self.stop = state["timed"], state["ended"], None
        self._restarts_next = state["restarts"]
        self._durations.restore(state["since"])
        self.records = [EventRecord(*r[:3], *(np.nan if x is None else x for x in r[3:])) for r in state["list"]]
