"""Stops of native FMUs that hold what rests on them, as :class:`mbfmu.session.resting_stops.RestingStops` in Python.

A stop holds the coordinate of a joint by a lock of this joint.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution
from mbfmu.session.kernels.event_points import TIME_ACCURACY_RATIO
from mbfmu.session.kernels.event_search import Search, StepActions
from mbfmu.session.kernels.points import account_discontinuity, energy_at
from mbfmu.session.kernels.pull_search import pull_search_of
from mbfmu.session.resting_stops import NO_ACCELERATION_RATIO
from mbfmu.session.touched_stops import SAME_PLACE_RATIO
from solvers.compiled.kernel import jit_uncached, kernel
from solvers.outcome import OK

from .event_actions import count_event, fill_approach_rates, solve_impacts, stop_by_event
from .event_jumps import JumpKernels, continuation_of, fill_effects, hold_joint, release_joint
from .event_memory import NO_FAILURE
from .resting_memory import RestingMemory
from .touched_stops import fill_units, has_hit

IS_HELD = np.finfo(float).max  # band of a sensor that does not cross its value


class HoldingLimits(NamedTuple):
    """When stops hold, and when they release."""

    shortest_path: float  # of all later bounces together, in units of the tolerance, that is not held
    least_push: float  # force below which a stop releases what it holds


class RestingKernels(NamedTuple):
    """What stops hold; kernels over an instance."""

    release_rested: Any  # (instance): note which stops hold, and release them, before an impact
    release_pulled: Any  # (instance): release those whose force pulls, or whose value has changed
    hold_at_start: Any  # (instance): let stops hold what is at them
    hold_pushed: Any  # (instance): let stops hold that have taken part in an impact, and whose value has not changed
    fill_forces: Any  # (instance): fill the forces by which the stops that hold push at the reported state
    least_force: Any  # (instance) -> N or N m: the least of them


@kernel
def holds_any(resting: RestingMemory) -> bool:
    """Whether a stop holds its sensor."""
    for k in range(resting.held.shape[0]):
        if resting.held[k] == 1:
            return True
    return False


@kernel
def place_resolution(instance: Any, k: int, ratio: float) -> float:
    """Distance from its stop at which sensor k is still at it; ``ratio`` is its part of the tolerance."""
    own = instance.events.locks[instance.resting.locks[k]]
    size, crossed = instance.search.size[own.velocity], abs(instance.search.crossed[k])
    return float(ratio * instance.options[0].rtol * size + SAME_PLACE_RATIO * (size + crossed))


@kernel
def let_leave(instance: Any) -> None:
    """Let the sensors that are chosen leave their stops without an impact by errors of the solver, which may move them
    beyond.
    """
    search, chosen = instance.search, instance.resting.chosen
    fill_approach_rates(instance, instance.v, instance.events.rates)
    for k in range(chosen.shape[0]):
        if chosen[k] == 1:
            beyond = search.directions[k] * (search.values[k] - search.crossed[k])
            search.bands[k] = max(2.0 * beyond, place_resolution(instance, k, TIME_ACCURACY_RATIO))


@kernel
def note_left(instance: Any) -> None:
    """Let the sensors that are chosen, which stops have held, leave their stops."""
    search, resting = instance.search, instance.resting
    fill_approach_rates(instance, instance.v, instance.events.rates)
    for k in range(resting.chosen.shape[0]):
        if resting.chosen[k] == 1:
            # error of the constraint equation; a stop that has moved is not left
            off = abs(search.values[k] - search.crossed[k]) if resting.held_at[k] == search.crossed[k] else 0.0
            search.bands[k] = 2.0 * off + place_resolution(instance, k, 1.0)


@kernel
def choose_free(instance: Any) -> bool:
    """Let the stops that take part be those chosen whose joints are not locked; return whether there are any."""
    events, resting = instance.events, instance.resting
    for k in range(events.hit.shape[0]):
        resting.resting[k] = events.hit[k] = 0
        if resting.chosen[k] == 1 and events.locks[resting.locks[k]].is_locked == 0:
            events.hit[k] = 1
    return has_hit(events)


@kernel
def fill_approach(instance: Any) -> None:
    """Fill the accelerations of sensors towards their stops, and the part of them that may be rounding errors."""
    events, resting, search, a = instance.events, instance.resting, instance.search, instance.a
    largest = 0.0  # acceleration, in units of the coordinates
    for i in range(search.size.shape[0]):
        largest = max(largest, abs(a[i]) / search.size[i])
    for k in range(events.hit.shape[0]):
        if events.hit[k] == 1:
            resting.approach[k] = search.directions[k] * a[events.locks[resting.locks[k]].velocity]
            resting.rounding[k] = NO_ACCELERATION_RATIO * largest * resting.units[k]


@kernel
def find_pressed(instance: Any, shortest_path: float) -> None:
    """Mark the stops, of those that take part, at which sensors rest: see :mod:`mbfmu.session.resting_stops`, and for
    ``shortest_path`` :class:`HoldingLimits`.
    """
    events, resting, rtol = instance.events, instance.resting, instance.options[0].rtol
    count = events.hit.shape[0]
    fill_approach_rates(instance, instance.v, events.rates)
    for k in range(count):
        events.demand[k] = resting.approach[k]
    for i in range(count):
        if events.hit[i] == 0:
            continue
        events.hit[i] = 0
        pressed = resting.approach[i] if solve_impacts(events) < 0 else 0.0
        for j in range(count):
            pressed -= events.effects[i, j] * events.impulses[j] if events.hit[j] == 1 else 0.0
        events.hit[i] = 1
        leaving = events.rates[i]
        ends = max(1.0 - events.values[resting.actions[i]], rtol) * shortest_path * rtol * resting.units[i]
        if pressed > resting.rounding[i] and 2.0 * leaving * leaving <= pressed * ends:
            resting.resting[i] = 1
    for k in range(count):
        events.hit[k] = resting.resting[k]
    is_solved = solve_impacts(events) < 0
    for k in range(count):
        force = events.impulses[k] * events.effects[k, k]
        resting.resting[k] = 1 if is_solved and events.hit[k] == 1 and force > resting.rounding[k] else 0


@kernel
def choose_at_stops(instance: Any) -> None:
    """Choose the stops that can hold at which sensors are."""
    resting, search = instance.resting, instance.search
    fill_approach_rates(instance, instance.v, instance.events.rates)
    for k in range(resting.chosen.shape[0]):
        value, crossed = search.values[k], search.crossed[k]
        is_at = abs(value - crossed) <= SAME_PLACE_RATIO * max(abs(value), abs(crossed))
        resting.chosen[k] = 1 if is_at and resting.locks[k] >= 0 else 0


@kernel
def choose_pushed(instance: Any) -> None:
    """Choose the stops that can hold, have taken part in an impact, and have the value that they had before."""
    resting, search = instance.resting, instance.search
    for k in range(resting.chosen.shape[0]):
        is_same = resting.values[k] == search.crossed[k]
        resting.chosen[k] = 1 if resting.pushed[k] == 1 and is_same and resting.locks[k] >= 0 else 0


@kernel
def would_pull(resting: RestingMemory, least_push: float) -> bool:
    """Whether the force of a stop that holds is less than ``least_push``, by the forces that were filled last."""
    is_any = False
    for k in range(resting.held.shape[0]):
        is_any = is_any or (resting.held[k] == 1 and resting.forces[k] < least_push)
    return is_any


@kernel
def count_released(instance: Any) -> None:
    """Count the releases of the stops that are chosen as events."""
    events, duration = instance.events, instance.options[0].duration
    for k in range(instance.resting.chosen.shape[0]):
        if instance.resting.chosen[k] == 1:
            count_event(events, instance.resting, events.sensed[k], instance.clock[0], duration, True)


def placing_of(push: Any) -> Any:
    """Return a kernel (instance) that moves coordinates that have hit stops exactly there, if they are there within the
    tolerance: importing tools locate impacts to their own accuracy.

    In models with constraints the other coordinates move with them, as by an impulse ``push`` on the coordinate: what
    the constraints require of positions is kept up to the square of this distance.
    """

    @jit_uncached
    def place(instance: Any, k: int) -> None:
        own, dv = instance.events.locks[instance.resting.locks[k]], instance.dv
        gap = instance.search.crossed[k] - instance.search.values[k]
        if instance.lam.shape[0] == 0:
            instance.q[own.position] = instance.search.crossed[k]
        elif push(instance, own.velocity, 1.0) == NO_FAILURE and dv[own.velocity] > 0.0:
            factor = gap / dv[own.velocity]
            for i in range(dv.shape[0]):
                dv[i] *= factor
            instance.eqs.retract(instance.q, dv, instance.eqs.data)

    @jit_uncached
    def place_at_stops(instance: Any) -> None:
        events, resting, search = instance.events, instance.resting, instance.search
        for k in range(resting.locks.shape[0]):
            if resting.locks[k] >= 0 and events.due[events.sensed[k]] == 1:
                fill_approach_rates(instance, instance.v, events.rates)
                off = abs(search.values[k] - search.crossed[k])
                if off <= place_resolution(instance, k, 1.0) + search.bands[k]:
                    place(instance, k)
                    events.beyond[k] = 0

    return place_at_stops


def advance_of(actions: StepActions, search: Search, least_force: Any) -> Any:
    """Return a kernel (instance, end) -> code that advances to the next crossing, the first time at which a stop would
    pull, or to ``end``, s.
    """
    advance_to_pull: Any = jit_uncached(pull_search_of(actions, search, least_force, jit_uncached))
    advance_to_crossing: Any = jit_uncached(search.advance)

    @jit_uncached
    def advance(instance: Any, end: float) -> int:
        if holds_any(instance.resting):
            return int(advance_to_pull(instance, end))
        return int(advance_to_crossing(instance, end))

    return advance


def resting_kernels(
    evaluate: Any, restart: Any, jumps: JumpKernels, let_jump: Any, limits: HoldingLimits
) -> RestingKernels:
    """Return what stops hold in a family.

    Parameters
    ----------
    evaluate
        (instance) -> code: fill accelerations and multipliers at the reported state.
    restart
        (instance): restart the solver.
    jumps
        What events do to the velocities.
    let_jump
        (instance): let the velocities jump.
    limits
        When stops hold, and when they release.
    """
    shortest_path, least_push = limits
    lock, fill_responses = jumps.lock, jumps.fill_responses
    continue_with_other_locks = continuation_of(jumps.adapt, restart)

    @jit_uncached
    def hold(instance: Any, k: int) -> None:
        """Let a stop hold its sensor."""
        events, event = instance.events, instance.events.sensed[k]
        number = instance.resting.locks[k]
        failure = lock(instance, number)
        if failure != NO_FAILURE:
            stop_by_event(events, event, failure)
            return
        let_jump(instance)
        before = energy_at(instance.session, instance.clock[0], instance.q, instance.v)
        instance.q[events.locks[number].position] = instance.search.crossed[k]
        hold_joint(instance, number)
        continue_with_other_locks(instance, event)
        account_discontinuity(instance.session, before, instance.clock[0], instance.q, instance.v)
        instance.resting.held[k], instance.resting.held_at[k] = 1, instance.search.crossed[k]
        instance.search.bands[k] = IS_HELD

    @jit_uncached
    def find_resting(instance: Any) -> None:
        """Mark the stops, of those chosen, that hold what is at them."""
        if not choose_free(instance) or evaluate(instance) != OK:
            return
        fill_units(instance)
        fill_approach(instance)
        if fill_responses(instance) == NO_FAILURE:
            fill_effects(instance.events)
            find_pressed(instance, shortest_path)

    @jit_uncached
    def hold_chosen(instance: Any) -> None:
        let_leave(instance)
        find_resting(instance)
        for k in range(instance.resting.resting.shape[0]):
            if instance.resting.resting[k] == 1 and instance.events.control[0].failure == NO_FAILURE:
                hold(instance, k)

    @jit_uncached
    def release_chosen(instance: Any) -> None:
        resting, last = instance.resting, -1
        for k in range(resting.chosen.shape[0]):
            if resting.chosen[k] == 1:
                release_joint(instance, resting.locks[k])
                resting.held[k], last = 0, k
        if last >= 0:
            continue_with_other_locks(instance, instance.events.sensed[last])
            note_left(instance)

    @jit_uncached
    def release_rested(instance: Any) -> None:
        resting = instance.resting
        for k in range(resting.chosen.shape[0]):
            resting.chosen[k] = resting.rested[k] = resting.held[k]
        release_chosen(instance)

    @jit_uncached
    def fill_forces(instance: Any) -> None:
        """Fill the forces by which the stops that hold push at the reported state."""
        resting, session, t = instance.resting, instance.session, instance.clock[0]
        code = evaluate(instance)
        if code == OK:
            inverse_dynamics_at_solution(t, instance.q, instance.v, instance.a, instance.lam, session.data)
        tau, bodies = session.data.state.tau, session.data.arrays.bodies
        for k in range(resting.held.shape[0]):
            resting.forces[k] = 0.0
            if resting.held[k] == 1 and code == OK:
                effort = tau[bodies[instance.events.locks[resting.locks[k]].body].vi]
                resting.forces[k] = -instance.search.directions[k] * effort

    @jit_uncached
    def least_force(instance: Any) -> float:
        """Return the least force of a stop that holds."""
        least = np.inf
        fill_forces(instance)
        for k in range(instance.resting.held.shape[0]):
            least = min(least, instance.resting.forces[k] if instance.resting.held[k] == 1 else np.inf)
        return float(least)

    @jit_uncached
    def release_pulled(instance: Any) -> None:
        resting = instance.resting
        if not holds_any(resting):
            return
        fill_forces(instance)
        for k in range(resting.chosen.shape[0]):
            has_moved = resting.held_at[k] != instance.search.crossed[k]
            resting.chosen[k] = 1 if resting.held[k] == 1 and (resting.forces[k] < least_push or has_moved) else 0
        release_chosen(instance)
        count_released(instance)

    @jit_uncached
    def hold_at_start(instance: Any) -> None:
        choose_at_stops(instance)
        hold_chosen(instance)

    @jit_uncached
    def hold_pushed(instance: Any) -> None:
        choose_pushed(instance)
        hold_chosen(instance)

    return RestingKernels(release_rested, release_pulled, hold_at_start, hold_pushed, fill_forces, least_force)
