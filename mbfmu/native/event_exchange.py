"""Events in model exchange: event indicators, and what an event of the importing tool changes.

An indicator is a sensor minus the value that it may cross; while a stop holds a sensor, it is the force of the stop.
The importing tool locates its change of sign. In event mode the FMU compares it with the side that the sensor had
before, and executes the actions. Stops hold what rests on them from then on, as in co-simulation. A sensor that is on
the other side of its value at a completed step, and a stop that would pull, require event mode, too, so that importing
tools without a search for changes of sign do not miss events.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mbfmu.mechanics.arrays.input_kernels import start_input
from mbfmu.session.kernels.event_durations import note_duration, update_durations
from mbfmu.session.kernels.event_points import (
    BEGIN,
    HERE,
    VALUES,
    EventSearch,
    clear_found,
    fill_point,
    mark_crossed,
    note_sides,
    side_of,
)
from mbfmu.session.kernels.points import account_discontinuity, energy_at
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.outcome import OK

from .event_actions import (
    begin_events,
    check_stops,
    collect_due,
    end_if_requested,
    next_event_time,
    note_free_sensors,
    record_bounces_beyond,
    record_events,
    release_sides,
    stop_by_event,
)
from .event_jumps import hold_joint, jump_kernels, release_joint
from .event_memory import (
    EVENT_FAILED,
    EVENT_REQUESTED_CODE,
    IMPULSE,
    LOCK,
    NO_FAILURE,
    NO_ROW,
    PARAMETER_CODE,
    RELEASE,
    RUN_ENDED_CODE,
    SET_INPUT,
    SET_PARAMETER,
)
from .exchange_memory import NEXT_EVENT, pack_states
from .exchange_times import begin_evaluation
from .resting_memory import RestingMemory
from .resting_stops import HoldingLimits, holds_any, placing_of, resting_kernels, would_pull
from .sampled_blocks import begin_samples, fill_sample_jump, next_sample_time
from .touched_stops import begin_impacts, begin_second_impact, may_change_velocities

# Importing tools do not locate bounces that are shorter than their first step after an event, in which coordinates move
# by several tolerances; they take a zero of an indicator for a change of sign
LIMITS = HoldingLimits(shortest_path=100.0, least_push=np.finfo(float).tiny)
SAME_TIME_RATIO = 1e-9  # of times, relative or s: so much may the clock of an importing tool differ


@kernel
def mark_crossings(search: EventSearch, resting: RestingMemory) -> bool:
    """Mark the sensors that have crossed their values at HERE, or are at their values; return whether there are any.

    A stop is hit by a sensor that moves towards it, and that it does not hold.
    """
    count, is_any = search.sides.shape[0], False
    for k in range(count):
        value, side, direction = search.points[HERE, VALUES + k], search.sides[k], search.directions[k]
        is_over = side != 0 and side * value <= 0.0 and direction * side <= 0
        if search.stops[k] == 1:
            is_over = is_over and direction * search.points[HERE, VALUES + count + k] > 0.0
            is_over = is_over and direction * value >= search.bands[k] and resting.held[k] == 0
        search.found[k] = 1 if is_over else 0
        is_any = is_any or is_over
    return is_any


@kernel
def take_sides(search: EventSearch) -> None:
    """Let sensors that were at their values be on the other side of them, and note the sides of all at HERE."""
    for k in range(search.sides.shape[0]):
        if search.found[k] == 1 and search.stops[k] == 0:
            search.sides[k] = -search.sides[k]
    note_sides(search, HERE)


@kernel
def indicate_stops(search: EventSearch, resting: RestingMemory) -> None:
    """Let the indicators of stops that hold be their forces, and those of stops that sensors leave be negative only
    beyond the band in which they may be.
    """
    for k in range(search.sides.shape[0]):
        if resting.held[k] == 1:
            search.points[HERE, VALUES + k] = -search.directions[k] * resting.forces[k]
        elif search.stops[k] == 1:
            search.points[HERE, VALUES + k] -= search.directions[k] * search.bands[k]


@kernel
def do_not_restart(instance: Any) -> None:
    """In place of the restart of a solver: the importing tool integrates."""


@kernel
def note_sides_of_durations(instance: Any, t: float) -> None:
    """Note which sensors are beyond their values at t, s, by their sides; those that have just crossed are at the other
    side.
    """
    search = instance.search
    for k in range(search.sides.shape[0]):
        side = -search.sides[k] if search.found[k] == 1 else search.sides[k]
        if side == 0:  # it began at its value, and no step has been completed since
            side = side_of(search, HERE, k)
        note_duration(instance.events, k, t, float(side))


@kernel
def find_next_time(instance: Any) -> None:
    """Let the time of the next event be that of an event of a given time or of a sample, if this is earlier."""
    times = instance.exchange.times
    own = min(next_event_time(instance.events), next_sample_time(instance.sampled))
    times[NEXT_EVENT] = min(times[NEXT_EVENT], own)


def event_exchange_entries(family: Any, formulation: Any, update: Callable[..., int]) -> dict[str, Callable[..., int]]:
    """Return the entry points of model exchange of models with events; all take an instance and a time, s.

    ``update`` is the entry point ``exchange_update``, which updates at an event.
    """
    project_at, keep, restore = formulation.project, formulation.keep, formulation.restore
    update_at = jit_uncached(update)
    jumps, least_push = jump_kernels(family.jumps), LIMITS.least_push
    _, bounce, push, lock, adapt = jumps

    @jit_uncached
    def report_projection(instance: Any) -> None:
        """Let the reported positions and velocities be P(x)."""
        work = instance.work
        for i in range(work.q.shape[0]):
            instance.q[i] = work.q[i]
        for i in range(work.v.shape[0]):
            instance.v[i] = work.v[i]

    @jit_uncached
    def let_jump(instance: Any) -> None:
        """Let the velocities jump by ``dv``; the change of the energy is work of an impulse."""
        session, t, q, v = instance.session, instance.clock[0], instance.q, instance.v
        before = energy_at(session, t, q, v)
        for i in range(instance.dv.shape[0]):
            v[i] += instance.dv[i]
        account_discontinuity(session, before, t, q, v)

    place_at_stops = placing_of(push)
    resting = resting_kernels(family.evaluate, do_not_restart, jumps, let_jump, LIMITS)
    release_rested, release_pulled, hold_at_start, hold_pushed, fill_forces, _ = resting

    @jit_uncached
    def evaluate(instance: Any, t: float) -> int:
        """Evaluate the sensors at (t, P(x)), and the forces of the stops that hold."""
        evaluated, work = begin_evaluation(instance, t), instance.work
        keep(instance)
        code: int = project_at(instance, evaluated)
        if code == OK:
            fill_point(instance.search, instance.session, evaluated, work.q, work.v, HERE)
        if code == OK and holds_any(instance.resting):
            report_projection(instance)
            instance.clock[0] = evaluated
            fill_forces(instance)
            instance.clock[0] = t
        restore(instance)
        return code

    @jit_uncached
    def report_projected(instance: Any, t: float) -> int:
        """Let the reported state be (t, P(x))."""
        code: int = evaluate(instance, t)
        report_projection(instance)
        instance.clock[0] = t
        return code

    @jit_uncached
    def release(instance: Any, t: float) -> None:
        """Release the stops that would pull."""
        if holds_any(instance.resting):
            release_pulled(instance)
            fill_point(instance.search, instance.session, t, instance.q, instance.v, HERE)

    @jit_uncached
    def execute(instance: Any, row: int) -> int:
        """Execute one action; return a code."""
        events, control, failure = instance.events, instance.events.control[0], NO_FAILURE
        action = events.actions[row]
        if action.kind == SET_INPUT:
            start_input(instance.inputs, action.place, events.values[row], instance.clock[0])
        elif action.kind == SET_PARAMETER:
            control.row, control.parameter, control.value = row + 1, action.place, events.values[row]
            return PARAMETER_CODE
        elif action.kind == IMPULSE:
            failure = push(instance, action.place, events.values[row])
            if failure == NO_FAILURE:
                let_jump(instance)
        elif action.kind == LOCK and events.locks[action.place].is_locked == 0:
            failure = lock(instance, action.place)
            if failure == NO_FAILURE:
                let_jump(instance)
                hold_joint(instance, action.place)
                failure = adapt(instance)
        elif action.kind == RELEASE:
            failure = release_joint(instance, action.place)
            if failure == NO_FAILURE:
                failure = adapt(instance)
        if failure != NO_FAILURE:
            stop_by_event(events, action.event, failure)
        return OK

    @jit_uncached
    def act(instance: Any) -> int:
        """Execute the actions of the events that are due, or the remaining ones after a parameter was set."""
        events, control, code = instance.events, instance.events.control[0], OK
        first = max(control.row, 0)
        if control.row == NO_ROW:
            instance.resting.changes[0] = 1 if may_change_velocities(events) else 0
            if instance.resting.changes[0] == 1:
                release_rested(instance)
                place_at_stops(instance)
                begin_impacts(instance)
                if bounce(instance):
                    let_jump(instance)
        control.row = NO_ROW
        for row in range(first, events.actions.shape[0]):
            if events.due[events.actions[row].event] == 1 and code == OK and control.failure == NO_FAILURE:
                code = execute(instance, row)
        if code == OK:
            if instance.resting.changes[0] == 1 and control.failure == NO_FAILURE:
                begin_second_impact(instance.resting)
                if bounce(instance):
                    let_jump(instance)
                hold_pushed(instance)
            end_if_requested(events)
            record_events(events, instance.resting, instance.clock[0], instance.options[0].duration, True)
            record_bounces_beyond(events, instance.search)
        return code

    @jit_uncached
    def act_on_samples(instance: Any, t: float) -> int:
        """Let the states jump by ``dv``, and execute the events of sensors that cross by it; return a code."""
        events, search, code = instance.events, instance.search, OK
        release_sides(events, search, instance.options[0].rtol)
        take_sides(search)
        fill_point(search, instance.session, t, instance.q, instance.v, HERE)
        note_sides(search, HERE)
        clear_found(search)
        let_jump(instance)
        fill_point(search, instance.session, t, instance.q, instance.v, HERE)
        if mark_crossed(search):
            collect_due(events, search, t, 0.0)
            code = act(instance)
            clear_found(search)
        return code

    def events_exchange_start(instance: Any, t: float) -> int:
        """Begin at the reported state of time t, s."""
        begin_events(instance.events, t)
        begin_samples(instance.sampled, t)
        fill_point(instance.search, instance.session, t, instance.q, instance.v, BEGIN)
        note_sides(instance.search, BEGIN)
        update_durations(instance.events, instance.search, instance.session, t, instance.q, instance.v)
        if not check_stops(instance):
            return EVENT_FAILED
        hold_at_start(instance)
        pack_states(instance.q, instance.v, instance.exchange)
        return OK if instance.events.control[0].failure == NO_FAILURE else EVENT_FAILED

    def events_exchange_report(instance: Any, t: float) -> int:
        """Evaluate the event indicators at the reported state of co-simulation."""
        fill_point(instance.search, instance.session, t, instance.q, instance.v, HERE)
        return OK

    def events_exchange_indicate(instance: Any, t: float) -> int:
        """Evaluate the event indicators at (t, x)."""
        code: int = evaluate(instance, t)
        indicate_stops(instance.search, instance.resting)
        return code

    def events_exchange_accept(instance: Any, t: float) -> int:
        """EVENT_REQUESTED_CODE if an event is at the end of a completed step, else note on which sides sensors are."""
        code: int = evaluate(instance, t)
        if code == OK:
            note_free_sensors(instance.events, instance.search, instance.options[0].rtol)
            if instance.events.control[0].failure != NO_FAILURE:
                return EVENT_REQUESTED_CODE  # in which the failure is reported
        if code == OK and (
            mark_crossings(instance.search, instance.resting) or would_pull(instance.resting, least_push)
        ):
            return EVENT_REQUESTED_CODE
        if code == OK:
            note_sides(instance.search, HERE)
        return code

    def events_exchange_update(instance: Any, t: float) -> int:
        """Execute the actions of the events at (t, x), and update; RUN_ENDED_CODE if one of them ends the run.

        After PARAMETER_CODE the update continues when it is called again.
        """
        events, search, control = instance.events, instance.search, instance.events.control[0]
        code: int = report_projected(instance, t)
        if code != OK:
            return code
        is_event = control.row != NO_ROW
        if not is_event:
            note_free_sensors(events, search, instance.options[0].rtol)
            release(instance, t)
            mark_crossings(search, instance.resting)
            note_sides_of_durations(instance, t)
            is_event = collect_due(events, search, t, SAME_TIME_RATIO * max(1.0, abs(t)))
        if is_event:
            code = act(instance)
            pack_states(instance.q, instance.v, instance.exchange)
        if code != OK:
            return code
        if control.failure != NO_FAILURE:
            return EVENT_FAILED
        if control.ended == 0 and fill_sample_jump(instance, SAME_TIME_RATIO * max(1.0, abs(t))):
            code = act_on_samples(instance, t)
        release(instance, t)
        pack_states(instance.q, instance.v, instance.exchange)
        if code != OK:
            return code
        if control.failure != NO_FAILURE:
            return EVENT_FAILED
        release_sides(events, search, instance.options[0].rtol)
        take_sides(search)
        code = update_at(instance, t)
        if code == OK:
            code = evaluate(instance, t)
        if code == OK:
            note_sides(search, HERE)
            clear_found(search)
            note_sides_of_durations(instance, t)
            find_next_time(instance)
        return RUN_ENDED_CODE if code == OK and control.ended == 1 else code

    found = events_exchange_start, events_exchange_report, events_exchange_indicate, events_exchange_accept
    return {function.__name__: function for function in (*found, events_exchange_update)}
