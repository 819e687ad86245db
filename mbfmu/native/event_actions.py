"""Actions of the events of a native FMU: kernels over an instance, as :mod:`mbfmu.session.events` in Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.recursions.dynamics import watch_sensors
from mbfmu.session.events import MIN_EVENTS_TIME_RATIO
from mbfmu.session.impulses import CONTRADICTION
from mbfmu.session.kernels.event_durations import end_duration, next_duration_time
from mbfmu.session.kernels.event_points import BEGIN, HERE, VALUES, EventSearch
from mbfmu.session.run_messages import MAX_EVENTS, RESTING_BOUNCES
from solvers.compiled.kernel import kernel

from .event_memory import (
    BEYOND,
    BOUNCE,
    END_RUN,
    IMPULSE,
    LOCK,
    NO_FAILURE,
    NO_ROW,
    RESTART,
    RESTING,
    TOO_MANY,
    EventMemory,
)
from .resting_memory import RestingMemory

MAX_IMPACT_SWEEPS = 10_000  # of the impulses of several stops that are hit at one time
IMPACT_TOLERANCE = 1e-14  # change of the impulses in a sweep, relative to the largest


@kernel
def begin_events(events: EventMemory, t: float) -> None:
    """Begin at t, s: events of times before do not occur."""
    control = events.control[0]
    control.ended, control.failure, control.count, control.changed = 0, NO_FAILURE, 0, 0
    control.first = t
    control.row, control.restarts = NO_ROW, 0
    for k in range(events.since.shape[0]):
        events.since[k] = np.nan
    for k in range(events.parameters.shape[0]):
        events.parameters[k] = np.nan
    for k in range(events.times.shape[0]):
        events.done[k] = 1 if events.times[k] < t else 0
    for k in range(events.bounces.shape[0]):
        events.beyond[k] = 0
        for i in range(events.bounces.shape[1]):
            events.bounces[k, i] = -np.inf


@kernel
def next_event_time(events: EventMemory) -> float:
    """Time of the next event of a given time, or of one that requires a time, s; infinite: there is none."""
    found = next_duration_time(events)
    for k in range(events.times.shape[0]):
        if events.done[k] == 0:
            found = min(found, events.times[k])
    return float(found)


@kernel
def collect_due(events: EventMemory, search: EventSearch, t: float, slack: float) -> bool:
    """Collect the events at the reported state of time t (s): crossings, and times up to ``slack`` (s) later."""
    is_any = False
    for k in range(events.due.shape[0]):
        events.due[k] = 0
    for k in range(events.sensed.shape[0]):
        if (search.found[k] == 1 and events.lasting[k] == 0.0) or end_duration(events, k, t + slack):
            events.due[events.sensed[k]], is_any = 1, True
    for k in range(events.times.shape[0]):
        if events.done[k] == 0 and events.times[k] <= t + slack:
            events.done[k], events.due[events.timed[k]], is_any = 1, 1, True
    return is_any


@kernel
def stop_by_event(events: EventMemory, event: int, failure: int) -> None:
    """Note that an event stops the run with an error; the first one is reported."""
    control = events.control[0]
    if control.failure == NO_FAILURE:
        control.failure, control.event = failure, event


@kernel
def end_by_event(events: EventMemory, event: int) -> None:
    """Note that an event ends the run."""
    control = events.control[0]
    if control.ended == 0:
        control.ended, control.event = 1, event


@kernel
def count_event(
    events: EventMemory, resting: RestingMemory, event: int, t: float, duration: float, holds: bool
) -> None:
    """Count an event at time t, s, and stop the run if too many occur in a time that is short compared with the
    duration of the run, s. ``holds``: stops hold what rests on them after the bounces that are resolved.
    """
    control, shortest, limit = events.control[0], MIN_EVENTS_TIME_RATIO * duration, float(MAX_EVENTS)
    for k in range(events.sensed.shape[0]):
        if events.sensed[k] == event and resting.locks[k] >= 0 and holds:
            restitution = events.values[resting.actions[k]]
            limit = MAX_EVENTS / (1.0 - restitution) if restitution < 1.0 else limit
    if t - control.first >= shortest:
        control.first, control.count = t, 0
    control.count += 1
    if control.count > limit:
        control.within = t - control.first
        stop_by_event(events, event, TOO_MANY)


@kernel
def record_events(events: EventMemory, resting: RestingMemory, t: float, duration: float, holds: bool) -> None:
    """Record the events that are due, and stop the run if too many follow each other, or if a sensor rests at a stop
    that does not hold it. ``holds``: others hold.
    """
    shortest, control = MIN_EVENTS_TIME_RATIO * duration, events.control[0]
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        if events.due[action.event] == 0 or action.kind != BOUNCE:
            continue
        times, is_short = events.bounces[action.place], not (holds and resting.locks[action.place] >= 0)
        for i in range(RESTING_BOUNCES):
            times[i] = times[i + 1]
        times[RESTING_BOUNCES] = t
        for i in range(RESTING_BOUNCES):
            is_short = is_short and times[i + 1] - times[i] < shortest
        if is_short:
            control.within = times[RESTING_BOUNCES] - times[0]
            stop_by_event(events, action.event, RESTING)
    for event in range(events.due.shape[0]):
        if events.due[event] == 1:
            count_event(events, resting, event, t, duration, holds)


@kernel
def note_free_sensors(events: EventMemory, search: EventSearch, rtol: float) -> None:
    """Note which sensors are before their stops at HERE. Stop the run if one has bounced, has not been before its stop
    since, and is deeper beyond it now: the importing tool has stepped over its last bounces, and it would sink.
    """
    for k in range(events.beyond.shape[0]):
        depth = search.directions[k] * search.points[HERE, VALUES + k]
        if depth < 0.0:
            events.beyond[k] = 0
        elif events.beyond[k] > 0 and depth > events.depths[k] + rtol * events.nominals[k]:
            stop_at_rest(events, k, events.sensed[k])


@kernel
def record_bounces_beyond(events: EventMemory, search: EventSearch) -> None:
    """Stop the run if a sensor bounces repeatedly without being before its stop in between.

    In model exchange the importing tool chooses the steps, which can be much longer than the last bounces.
    """
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        if events.due[action.event] == 0 or action.kind != BOUNCE:
            continue
        k = action.place
        events.beyond[k] += 1
        events.depths[k] = max(0.0, search.directions[k] * search.points[HERE, VALUES + k])
        if events.beyond[k] > RESTING_BOUNCES:
            stop_at_rest(events, k, action.event)


@kernel
def stop_at_rest(events: EventMemory, k: int, event: int) -> None:
    """Stop the run by the event of a sensor that comes to rest at its stop."""
    first, times = RESTING_BOUNCES, events.bounces[k]
    while first > 0 and times[first - 1] > -np.inf:
        first -= 1
    events.control[0].within = times[RESTING_BOUNCES] - times[first]
    stop_by_event(events, event, RESTING)


@kernel
def fill_approach_rates(instance: Any, v: Any, rates: Any) -> None:
    """Fill the rates (k,) of sensors towards their stops at velocities v (n,)."""
    search = instance.search
    watch_sensors(instance.clock[0], instance.q, v, search.parts, instance.session.data, search.values)
    for k in range(rates.shape[0]):
        place = search.rate_places[k]
        rates[k] = search.directions[k] * search.values[place] if place >= 0 else 0.0


@kernel
def fill_slopes(instance: Any) -> None:
    """Fill the slopes of the rates of sensors towards their stops, which are linear in the velocities."""
    events, v = instance.events, instance.events.impulse
    for i in range(v.shape[0]):
        v[i] = 0.0
    fill_approach_rates(instance, v, events.rates)
    for i in range(v.shape[0]):
        v[i] = 1.0
        fill_approach_rates(instance, v, events.demand)
        v[i] = 0.0
        for k in range(events.rates.shape[0]):
            events.slopes[k, i] = events.demand[k] - events.rates[k]


@kernel
def check_stops(instance: Any) -> bool:
    """Whether no sensor is beyond its stop at the start; else the run is stopped."""
    events, search, is_right = instance.events, instance.search, True
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        if action.kind != BOUNCE:
            continue
        fill_slopes(instance)
        square, k = 0.0, action.place
        for i in range(search.size.shape[0]):
            square += (events.slopes[k, i] * search.size[i]) ** 2
        if search.directions[k] * search.points[BEGIN, VALUES + k] > instance.options[0].rtol * np.sqrt(square):
            stop_by_event(events, action.event, BEYOND)
            is_right = False
    return is_right


@kernel
def solve_impacts(events: EventMemory) -> int:
    """Find the impulses p >= 0 (k,) with E p >= d and p (E p - d) = 0 of the stops that are hit; return a sensor whose
    demand d cannot be met, or -1.

    E is symmetric and positive semidefinite. Each sweep solves one equation after the other (projected Gauss-Seidel
    iteration: Cottle, Pang and Stone, *The Linear Complementarity Problem*, 2009, section 5.3); one stop needs one.
    """
    p, count = events.impulses, events.hit.shape[0]
    for k in range(count):
        p[k] = 0.0
        if events.hit[k] == 1 and events.demand[k] > 0.0 and not events.effects[k, k] > 0.0:
            return k
    change, largest, sweeps = 1.0, 0.0, 0
    while change > IMPACT_TOLERANCE * largest and sweeps < MAX_IMPACT_SWEEPS:
        change, largest = 0.0, 0.0
        sweeps += 1
        for k in range(count):
            if events.hit[k] == 0 or not events.effects[k, k] > 0.0:
                continue
            rest = events.demand[k]
            for j in range(count):
                rest -= events.effects[k, j] * p[j] if events.hit[j] == 1 else 0.0
            root = np.sqrt(events.effects[k, k])
            before = p[k]
            p[k] = max(0.0, p[k] + rest / events.effects[k, k])
            change, largest = max(change, root * abs(p[k] - before)), max(largest, root * p[k])
    for k in range(count):
        if events.hit[k] == 1:
            rest = events.demand[k]
            for j in range(count):
                rest -= events.effects[k, j] * p[j] if events.hit[j] == 1 else 0.0
            if rest > np.sqrt(CONTRADICTION) * max(abs(events.demand[k]), np.sqrt(events.effects[k, k]) * largest):
                return k
    return -1


@kernel
def end_if_requested(events: EventMemory) -> None:
    """Note that the run ends, or the solver restarts, if one of the events that are due requests it."""
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        if action.kind == END_RUN and events.due[action.event] == 1:
            end_by_event(events, action.event)
        elif action.kind == RESTART and events.due[action.event] == 1:
            events.control[0].restarts = 1


@kernel
def is_restart_found(events: EventMemory, search: EventSearch) -> bool:
    """Whether the search has found the crossing of an event that restarts the solver."""
    is_any = False
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        for k in range(events.sensed.shape[0] if action.kind == RESTART else 0):
            is_crossing = search.found[k] == 1 and events.lasting[k] == 0.0
            is_any = is_any or (events.sensed[k] == action.event and is_crossing)
    return is_any


@kernel
def release_sides(events: EventMemory, search: EventSearch, rtol: float) -> None:
    """Let the sensors of events that lock a joint or apply an impulse leave their values without a crossing, as at a
    start: a quantity that rests or turns back at its value has rounding errors of any sign.
    """
    is_any = False
    for row in range(events.actions.shape[0]):
        action = events.actions[row]
        is_any = is_any or (action.kind in (LOCK, IMPULSE) and events.due[action.event] == 1)
    for k in range(events.sensed.shape[0] if is_any else 0):
        if events.due[events.sensed[k]] == 1 and search.stops[k] == 0:
            search.found[k], search.sides[k], search.bands[k] = 0, 0, rtol * events.nominals[k]
