"""Communication steps of native FMUs whose models have events: as :class:`mbfmu.session.events.RunEvents` in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from mbfmu.mechanics.narrow_parts import MIN_STEPS_AFTER_RESTART
from mbfmu.session.event_search import MAX_TRIAL_STEPS
from mbfmu.session.kernels.event_durations import update_durations
from mbfmu.session.kernels.event_search import Search, StepActions, search_of
from mbfmu.session.kernels.points import account_discontinuity, check_point, energy_at
from mbfmu.session.kernels.sequence import Sequence, SolverActions
from mbfmu.session.sampled_blocks import EQUAL_TIME_SPACINGS
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.outcome import OK
from solvers.resolution import spacing

from .event_actions import (
    begin_events,
    check_stops,
    collect_due,
    end_if_requested,
    is_restart_found,
    next_event_time,
    record_events,
    release_sides,
    stop_by_event,
)
from .event_jumps import continuation_of, hold_joint, jump_kernels, release_joint
from .event_memory import (
    EVENT_FAILED,
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
from .resting_stops import HoldingLimits, advance_of, resting_kernels
from .sampled_blocks import begin_samples, fill_sample_jump, next_sample_time
from .solver_steps import copy_words, step_actions
from .touched_stops import begin_impacts, begin_second_impact, may_change_velocities


class Execution(NamedTuple):
    """What happens at events; kernels over an instance."""

    act: Any  # (instance) -> code: the actions of the events that are due; PARAMETER_CODE: call it again afterwards
    sample: Any  # (instance) -> bool: take the samples of the time reached; whether there are any
    release: Any  # (instance) -> code: release the stops that would pull
    hold_first: Any  # (instance) -> code: let stops hold what rests on them at the start
    advance: Any  # (instance, end) -> code: advance to the next crossing, release of a stop, or to ``end``, s


def execution_of(
    family: Any, solver: SolverActions, sequence: Sequence, actions: StepActions, search: Search
) -> Execution:
    """Return what happens at the events of a family."""
    jump, restart, jumps = solver.jump, solver.restart, jump_kernels(family.jumps)
    _, bounce, push, lock, adapt = jumps
    continue_with_other_locks = continuation_of(adapt, restart)
    set_input, begin_search = jit_uncached(sequence.set_input), jit_uncached(search.begin)

    @jit_uncached
    def let_jump(instance: Any) -> None:
        """Let the velocities jump by ``dv``; the change of the energy is work of an impulse."""
        t, q, v = instance.clock[0], instance.q, instance.v
        before = energy_at(instance.session, t, q, v)
        jump(instance)
        account_discontinuity(instance.session, before, t, q, v)

    resting = resting_kernels(solver.evaluate, restart, jumps, let_jump, HoldingLimits(1.0, 0.0))
    release_rested, release_pulled, hold_at_start, hold_pushed, _, least_force = resting

    @jit_uncached
    def apply_impulse(instance: Any, event: int, place: int, value: float) -> None:
        failure = push(instance, place, value)
        if failure == NO_FAILURE:
            let_jump(instance)
        else:
            stop_by_event(instance.events, event, failure)

    @jit_uncached
    def lock_joint(instance: Any, event: int, place: int) -> None:
        if instance.events.locks[place].is_locked == 1:
            return
        failure = lock(instance, place)
        if failure != NO_FAILURE:
            stop_by_event(instance.events, event, failure)
            return
        let_jump(instance)
        hold_joint(instance, place)
        continue_with_other_locks(instance, event)

    @jit_uncached
    def unlock_joint(instance: Any, event: int, place: int) -> None:
        failure = release_joint(instance, place)
        if failure == NO_FAILURE:
            continue_with_other_locks(instance, event)
        else:
            stop_by_event(instance.events, event, failure)

    @jit_uncached
    def execute(instance: Any, row: int) -> int:
        """Execute one action; return a code."""
        events, control, code = instance.events, instance.events.control[0], OK
        action = events.actions[row]
        if action.kind == SET_INPUT:
            code = set_input(instance, action.place, events.values[row], float("nan"))
            control.changed = 1
        elif action.kind == SET_PARAMETER:
            control.row, control.parameter, control.value = row + 1, action.place, events.values[row]
            control.changed, code = 1, PARAMETER_CODE
        elif action.kind == IMPULSE:
            apply_impulse(instance, action.event, action.place, events.values[row])
        elif action.kind == LOCK:
            lock_joint(instance, action.event, action.place)
        elif action.kind == RELEASE:
            unlock_joint(instance, action.event, action.place)
        return code

    @jit_uncached
    def act(instance: Any) -> int:
        """Execute the actions of the events that are due, or the remaining ones after a parameter was set."""
        events, control, code = instance.events, instance.events.control[0], OK
        first = control.row
        if first == NO_ROW:
            control.changed, first = 0, 0
            instance.resting.changes[0] = 1 if may_change_velocities(events) else 0
            if instance.resting.changes[0] == 1:
                release_rested(instance)
                begin_impacts(instance)
                if bounce(instance):
                    let_jump(instance)
        control.row = NO_ROW
        for row in range(first, events.actions.shape[0]):
            if events.due[events.actions[row].event] == 1 and code == OK and control.failure == NO_FAILURE:
                code = execute(instance, row)
        if code == PARAMETER_CODE:
            return code
        if code == OK and instance.resting.changes[0] == 1 and control.failure == NO_FAILURE:
            begin_second_impact(instance.resting)
            if bounce(instance):
                let_jump(instance)
            hold_pushed(instance)
        release_sides(events, instance.search, instance.options[0].rtol)
        end_if_requested(events)
        record_events(events, instance.resting, instance.clock[0], instance.options[0].duration, True)
        note_durations(instance)
        if code == OK and control.failure != NO_FAILURE:
            return EVENT_FAILED
        return code

    @jit_uncached
    def sample(instance: Any) -> bool:
        """Take the samples of the time reached; return whether there are any."""
        is_any: bool = fill_sample_jump(instance, EQUAL_TIME_SPACINGS * spacing(instance.clock[0]))
        if is_any:
            begin_search(instance)
            let_jump(instance)
            note_durations(instance)
        return is_any

    @jit_uncached
    def release(instance: Any) -> int:
        release_pulled(instance)
        return OK if instance.events.control[0].failure == NO_FAILURE else EVENT_FAILED

    @jit_uncached
    def hold_first(instance: Any) -> int:
        hold_at_start(instance)
        return OK if instance.events.control[0].failure == NO_FAILURE else EVENT_FAILED

    return Execution(act, sample, release, hold_first, advance_of(actions, search, least_force))


@kernel
def note_durations(instance: Any) -> None:
    """Note which sensors are beyond their values at the reported state."""
    update_durations(instance.events, instance.search, instance.session, instance.clock[0], instance.q, instance.v)


def restart_of(family: Any, solver: SolverActions, search: Search) -> Any:
    """Return a kernel over an instance and an end (s) that restarts the solver before a short force, as
    :meth:`mbfmu.session.event_search.CrossingSearch.restart` does in Python.
    """
    restart, restored = solver.restart, family.restore
    begin_search, step = jit_uncached(search.begin), jit_uncached(search.step)

    @jit_uncached
    def restart_in_steps(instance: Any, end: float) -> None:
        """Restart, and limit the next steps by a trial of the way to the next event that restarts, or to ``end``, s."""
        own, kept, taken, is_over = instance.search, instance.step_begin, 0, False
        restart(instance)
        control, begin = own.control[0], instance.clock[0]
        control.limited = 0
        copy_words(kept.state, kept.trial)
        for k in range(own.sides.shape[0]):
            kept.sides[k], kept.bands[k] = own.sides[k], own.bands[k]
        begin_search(instance)
        while instance.clock[0] < end and taken < MAX_TRIAL_STEPS and not is_over:
            if step(instance, end, float("inf")) != OK:
                break
            taken += 1
            is_over = is_restart_found(instance.events, own)
            if not is_over:
                begin_search(instance)
        if taken < MAX_TRIAL_STEPS and instance.clock[0] > begin:
            control.limit = (instance.clock[0] - begin) / MIN_STEPS_AFTER_RESTART
            control.limited = taken + MIN_STEPS_AFTER_RESTART
        copy_words(kept.trial, kept.state)
        restored(instance.given, instance.options)
        kept.is_kept[0], instance.session.status[0].code = 0, OK
        for k in range(own.sides.shape[0]):
            own.sides[k], own.bands[k] = kept.sides[k], kept.bands[k]

    return restart_in_steps


def event_entries(family: Any, solver: SolverActions, sequence: Sequence) -> dict[str, Callable[..., int]]:
    """Return the entry points of models with events by their names; all take an instance and a time, s."""
    actions = step_actions(family, solver)
    search = search_of(actions, jit_uncached)
    begin_search, find_jumped = jit_uncached(search.begin), jit_uncached(search.find_jumped)
    begin_step = jit_uncached(sequence.begin_step)
    act, sample, release, hold_first, advance = execution_of(family, solver, sequence, actions, search)
    restart_in_steps = restart_of(family, solver, search)

    @jit_uncached
    def advance_to_event(instance: Any, end: float) -> int:
        """Advance to the next event or sample before ``end`` (s), or to it."""
        due = min(next_event_time(instance.events), next_sample_time(instance.sampled))
        code: int = advance(instance, due if due < end - EQUAL_TIME_SPACINGS * spacing(end) else end)
        account = instance.energy_account
        check_point(instance.session, instance.clock[0], instance.q, instance.v, account, False)
        if code == OK:
            note_durations(instance)
        return code

    def events_begin(instance: Any, t: float) -> int:
        """Begin at the reported state of time t (s), with the events of this time; continue after PARAMETER_CODE."""
        control = instance.events.control[0]
        is_event = control.row != NO_ROW
        if not is_event:
            begin_events(instance.events, t)
            begin_samples(instance.sampled, t)
            begin_search(instance)
            note_durations(instance)
            if not check_stops(instance):
                return EVENT_FAILED
            is_event = collect_due(instance.events, instance.search, t, 0.0)
        code: int = act(instance) if is_event else OK
        if code == OK:
            code = hold_first(instance)
        if code == OK and control.ended == 0:
            sample(instance)
        return code

    def events_step(instance: Any, end: float) -> int:
        """Advance to the communication point at ``end`` (s) with all events before it, or to one that ends the run.

        After PARAMETER_CODE the step continues when it is called again.
        """
        control = instance.events.control[0]
        is_interrupted, is_jumped = control.row != NO_ROW, False
        code: int = OK
        if control.ended == 0 and not is_interrupted:
            code = release(instance)
            code = begin_step(instance, end) if code == OK else code
        while code == OK and control.ended == 0:
            if not is_interrupted and not is_jumped:
                if control.restarts == 1 and instance.clock[0] < end:
                    control.restarts = 0
                    restart_in_steps(instance, end)
                code = advance_to_event(instance, end)
                control.changed = 0
            if code != OK:
                break
            t = instance.clock[0]
            slack = EQUAL_TIME_SPACINGS * spacing(t)
            is_event = is_interrupted or collect_due(instance.events, instance.search, t, slack)
            is_interrupted = False
            code = act(instance) if is_event else OK
            code = release(instance) if code == OK else code
            is_sample = code == OK and control.ended == 0 and sample(instance)
            is_jumped = is_sample and find_jumped(instance)
            code = release(instance) if is_sample else code
            if not is_event and not is_sample and instance.clock[0] >= end:
                break
            if code == OK and control.changed == 1 and control.ended == 0:
                code = begin_step(instance, end)
        return RUN_ENDED_CODE if code == OK and control.ended == 1 else code

    return {"events_begin": events_begin, "events_step": events_step}
