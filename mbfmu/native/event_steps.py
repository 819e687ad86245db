"""Communication steps of native FMUs whose models have events: as :class:`mbfmu.session.events.RunEvents` in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from mbfmu.mechanics.recursions.dynamics import input_step_limit
from mbfmu.session.kernels.event_search import StepActions, search_of
from mbfmu.session.kernels.points import account_discontinuity, check_point, energy_at
from mbfmu.session.kernels.sequence import Sequence, SolverActions
from mbfmu.session.sampled_blocks import EQUAL_TIME_SPACINGS
from solvers.compiled.kernel import inlined, jit_uncached, kernel
from solvers.energy_account import WORK
from solvers.outcome import MAX_STEPS, OK
from solvers.resolution import spacing

from .event_actions import (
    begin_events,
    check_stops,
    collect_due,
    end_if_requested,
    next_event_time,
    record_events,
    release_sides,
    stop_by_event,
)
from .event_jumps import NO_JUMPS, hold_joint, jump_kernels, release_joint
from .event_memory import EVENT_FAILED, IMPULSE, LOCK, NO_FAILURE, RELEASE, RUN_ENDED_CODE, SET_INPUT
from .sampled_blocks import begin_samples, fill_sample_jump, next_sample_time


class StepKernels(NamedTuple):
    """What a family has for steps that are examined; kernels over an instance."""

    is_dense: Any  # (instance) -> bool: whether any time of the last step, or of the next one, can be reported again
    own_time: Any  # (instance) -> float: time that the solver has reached itself, s


@kernel
def is_always_dense(instance: Any) -> bool:
    """Of solvers all of whose steps have a dense output."""
    return True


@kernel
def is_adams_dense(instance: Any) -> bool:
    """As :attr:`solvers.steppers.adams.method.AdamsMethod.has_dense_output`."""
    control = instance.given.memory.control[0]
    return bool(control.is_projected == 0 and not (control.start == 1 and control.rk_steps > 0))


@kernel
def control_time(instance: Any) -> float:
    """Of solvers with the step loop of :mod:`solvers.steppers.step_loop`."""
    return float(instance.given.memory.control[0].t)


@kernel
def ida_time(instance: Any) -> float:
    """As :attr:`solvers.steppers.ida.driver.IDADriver.own_time`."""
    progress = instance.given.memory.progress[0]
    return float(instance.clock[0] if progress.is_pending == 1 else progress.t_reached)


ADAMS_STEPS = StepKernels(is_adams_dense, control_time)
ONE_STEP_STEPS = StepKernels(is_always_dense, control_time)
IDA_STEPS = StepKernels(is_always_dense, ida_time)


@inlined
def copy_words(source: Any, target: Any) -> None:
    """Copy all words of a state."""
    for i in range(source.shape[0]):
        target[i] = source[i]


def step_actions(family: Any, solver: SolverActions) -> StepActions:
    """Return what a solver of a family does in the search for events, as kernels."""
    is_dense, own_time = family.steps
    advance_reported, limit_method, restored = family.loop.advance_reported, family.method.limit_step, family.restore

    @jit_uncached
    def advance_to(instance: Any, t: float) -> int:
        """Advance to t, s, or report the state of this time in the last step."""
        status = instance.session.status[0]
        code: int = advance_reported(instance.given, t)
        status.code = code
        instance.clock[0] = t if code == OK else own_time(instance)
        return code

    @jit_uncached
    def advance_to_accepted(instance: Any, t: float) -> int:
        """Advance towards t (s) until the solver has taken a step."""
        settings, begin, taken = instance.given.settings[0], instance.clock[0], 0
        allowed = settings.max_steps
        settings.max_steps = 1
        code: int = advance_to(instance, t)
        while code == MAX_STEPS and not own_time(instance) > begin and taken < allowed:  # the step was rejected
            taken += 1
            code = advance_to(instance, t)
        settings.max_steps = allowed
        if code == MAX_STEPS and own_time(instance) > begin:
            code = advance_to(instance, own_time(instance))
        return code

    @jit_uncached
    def advance_one_step(instance: Any, end: float, longest: float) -> int:
        own, t = instance.given, instance.clock[0]
        limit, until = input_step_limit(t, instance.eqs.data)
        limit = min(limit, instance.options[0].max_step, longest)
        limit_method(own.memory, own.settings, t, own.q, own.v, own.energy_account[WORK], limit)
        target, reached = min(end, until), own_time(instance)
        if reached > t:
            return int(advance_to(instance, min(reached, target)))
        return int(advance_to_accepted(instance, target))

    @jit_uncached
    def take_step(instance: Any, end: float, longest: float) -> int:
        kept = instance.step_begin
        kept.is_kept[0] = 0 if is_dense(instance) else 1
        if kept.is_kept[0] == 1:
            copy_words(kept.state, kept.copy)
            kept.target[0] = end
        code: int = advance_one_step(instance, end, longest)
        if is_dense(instance):
            kept.is_kept[0] = 0
        return code

    @jit_uncached
    def report(instance: Any, t: float) -> int:
        kept = instance.step_begin
        if kept.is_kept[0] == 0:
            return int(advance_to(instance, t))
        copy_words(kept.copy, kept.state)
        restored(instance.given, instance.options)
        code: int = solver.advance(instance, t)
        return code

    @jit_uncached
    def return_to_end(instance: Any, t: float) -> int:
        kept = instance.step_begin
        if kept.is_kept[0] == 0:
            return int(advance_to(instance, t))
        copy_words(kept.copy, kept.state)
        restored(instance.given, instance.options)
        return int(advance_one_step(instance, kept.target[0], float("inf")))

    @jit_uncached
    def tolerance(instance: Any) -> float:
        return float(instance.options[0].rtol)

    @jit_uncached
    def max_steps(instance: Any) -> int:
        return int(instance.options[0].max_steps)

    return StepActions(take_step, report, return_to_end, is_dense, tolerance, max_steps)


def event_entries(family: Any, solver: SolverActions, sequence: Sequence) -> dict[str, Callable[..., int]]:
    """Return the entry points of models with events by their names; all take an instance and a time, s."""
    search, jump, restart = search_of(step_actions(family, solver), jit_uncached), solver.jump, solver.restart
    makes_jumps = family.jumps is not None
    bounce, push, lock = jump_kernels(family.jumps) if family.jumps else NO_JUMPS
    begin_search, advance = jit_uncached(search.begin), jit_uncached(search.advance)
    begin_step, set_input = jit_uncached(sequence.begin_step), jit_uncached(sequence.set_input)

    @jit_uncached
    def let_jump(instance: Any) -> None:
        """Let the velocities jump by ``dv``; the change of the energy is work of an impulse."""
        t, q, v = instance.clock[0], instance.q, instance.v
        before = energy_at(instance.session, t, q, v)
        jump(instance)
        account_discontinuity(instance.session, before, t, q, v)

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
        restart(instance)

    @jit_uncached
    def unlock_joint(instance: Any, event: int, place: int) -> None:
        failure = release_joint(instance, place)
        if failure == NO_FAILURE:
            restart(instance)
        else:
            stop_by_event(instance.events, event, failure)

    @jit_uncached
    def act(instance: Any) -> int:
        """Execute the actions of the events that are due."""
        events, control, code = instance.events, instance.events.control[0], OK
        if bounce(instance):
            let_jump(instance)
        control.changed = 0
        for row in range(events.actions.shape[0]):
            action = events.actions[row]
            if events.due[action.event] == 0 or code != OK or control.failure != NO_FAILURE:
                continue
            if action.kind == SET_INPUT:
                code = set_input(instance, action.place, events.values[row], float("nan"))
                control.changed = 1
            elif action.kind == IMPULSE:
                apply_impulse(instance, action.event, action.place, events.values[row])
            elif action.kind == LOCK:
                lock_joint(instance, action.event, action.place)
            elif action.kind == RELEASE:
                unlock_joint(instance, action.event, action.place)
        release_sides(events, instance.search, instance.options[0].rtol)
        end_if_requested(events)
        record_events(events, instance.search, instance.clock[0], instance.options[0].duration)
        if code == OK and control.failure != NO_FAILURE:
            return EVENT_FAILED
        return code

    @jit_uncached
    def sample(instance: Any) -> bool:
        """Take the samples of the time reached; return whether there are any."""
        is_any: bool = fill_sample_jump(instance, EQUAL_TIME_SPACINGS * spacing(instance.clock[0]))
        if is_any:
            let_jump(instance)
        return is_any

    def events_begin(instance: Any, t: float) -> int:
        """Begin at the reported state of time t (s), with the events of this time."""
        begin_events(instance.events, t)
        begin_samples(instance.sampled, t)
        begin_search(instance)
        if makes_jumps and not check_stops(instance):
            return EVENT_FAILED
        code: int = act(instance) if collect_due(instance.events, instance.search, t, 0.0) else OK
        if code == OK and instance.events.control[0].ended == 0:
            sample(instance)
        return code

    def events_step(instance: Any, end: float) -> int:
        """Advance to the communication point at ``end`` (s) with all events before it, or to one that ends the run."""
        events, control, slack = instance.events, instance.events.control[0], EQUAL_TIME_SPACINGS * spacing(end)
        code: int = begin_step(instance, end) if control.ended == 0 else OK
        while code == OK and control.ended == 0:
            due = min(next_event_time(events), next_sample_time(instance.sampled))
            code = advance(instance, due if due < end - slack else end)
            account = instance.energy_account
            check_point(instance.session, instance.clock[0], instance.q, instance.v, account, False)
            if code != OK:
                break
            is_event = collect_due(events, instance.search, instance.clock[0], slack)
            control.changed = 0
            code = act(instance) if is_event else OK
            is_sample = code == OK and control.ended == 0 and sample(instance)
            if not is_event and not is_sample and instance.clock[0] >= end:
                break
            if code == OK and control.changed == 1 and control.ended == 0:
                code = begin_step(instance, end)
        return RUN_ENDED_CODE if code == OK and control.ended == 1 else code

    return {"events_begin": events_begin, "events_step": events_step}
