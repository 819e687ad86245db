"""Stops that sensors touch at events of native FMUs, as :mod:`mbfmu.session.touched_stops` in Python."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.session.touched_stops import SAME_PLACE_RATIO
from solvers.compiled.kernel import kernel

from .event_actions import fill_approach_rates, fill_slopes
from .event_memory import BOUNCE, IMPULSE, LOCK, RELEASE, EventMemory
from .resting_memory import RestingMemory


@kernel
def fill_units(instance: Any) -> None:
    """Fill the slopes of the rates of sensors, and their lengths in units of the coordinates."""
    events, units, size = instance.events, instance.resting.units, instance.search.size
    fill_slopes(instance)
    for k in range(units.shape[0]):
        square = 0.0
        for i in range(size.shape[0]):
            square += (events.slopes[k, i] * size[i]) ** 2
        units[k] = np.sqrt(square)


@kernel
def may_change_velocities(events: EventMemory) -> bool:
    """Whether events that are due may change velocities."""
    is_any = False
    for row in range(events.actions.shape[0]):
        kind = events.actions[row].kind
        is_jump = kind in (BOUNCE, IMPULSE, LOCK, RELEASE)
        is_any = is_any or (is_jump and events.due[events.actions[row].event] == 1)
    return is_any


@kernel
def begin_impacts(instance: Any) -> None:
    """Note the stops that take part in the impacts of the events that are due, before their actions: those that are
    hit, those at which sensors have rested, and those that are touched.
    """
    events, resting, search = instance.events, instance.resting, instance.search
    count, others = resting.held.shape[0], 0
    for k in range(count):
        is_due = resting.actions[k] >= 0 and events.due[events.sensed[k]] == 1
        resting.base[k] = 1 if is_due or resting.rested[k] == 1 else 0
        resting.touched[k], resting.pushed[k], resting.values[k] = 0, 0, search.crossed[k]
        others += 1 if resting.actions[k] >= 0 and resting.base[k] == 0 else 0
    if others == 0:
        return
    fill_units(instance)
    fill_approach_rates(instance, instance.v, events.rates)
    for k in range(count):
        unit, crossed = resting.units[k], search.crossed[k]
        near = instance.options[0].rtol * unit + SAME_PLACE_RATIO * (unit + abs(crossed))
        is_at = abs(search.values[k] - crossed) <= near
        resting.units[k] = unit if unit > 0.0 else 1.0
        resting.rates[k] = events.rates[k] / resting.units[k]
        resting.touched[k] = 1 if is_at and resting.actions[k] >= 0 and resting.base[k] == 0 else 0


@kernel
def begin_second_impact(resting: RestingMemory) -> None:
    """Let the stops that take part after the actions of events be those at which sensors have rested, and those that
    are touched.
    """
    for k in range(resting.base.shape[0]):
        resting.base[k] = resting.rested[k]


@kernel
def mark_taking_part(instance: Any) -> bool:
    """Mark the stops that take part in an impact: ``base``, and those that are touched by slow sensors; return whether
    there are any.
    """
    events, resting, count = instance.events, instance.resting, instance.resting.held.shape[0]
    is_any = False
    for k in range(count):
        events.hit[k], resting.slow[k] = resting.base[k], 0
        is_any = is_any or resting.base[k] == 1 or resting.touched[k] == 1
    if not is_any:
        return False
    fill_approach_rates(instance, instance.v, events.rates)
    towards = 0.0
    for k in range(count):
        if resting.base[k] == 1 or resting.touched[k] == 1:
            unit = resting.units[k] if resting.units[k] > 0.0 else 1.0
            towards = max(towards, events.rates[k] / unit)
    for k in range(count):
        is_slow = towards > 0.0 and abs(resting.rates[k]) <= instance.options[0].rtol * towards
        if resting.touched[k] == 1 and is_slow:
            events.hit[k], resting.slow[k] = 1, 1
    return has_hit(events)


@kernel
def has_hit(events: EventMemory) -> bool:
    """Whether a stop takes part in an impact."""
    for k in range(events.hit.shape[0]):
        if events.hit[k] == 1:
            return True
    return False


@kernel
def leave_out_touched(events: EventMemory, resting: RestingMemory, wrong: int) -> bool:
    """Let a touched stop take no part whose rate cannot be as required, or all touched stops if it is another one that
    cannot; return whether there was any.
    """
    is_any, is_touched = False, resting.slow[wrong] == 1
    for k in range(resting.slow.shape[0]):
        is_any = is_any or resting.slow[k] == 1
        if resting.slow[k] == 1 and (k == wrong or not is_touched):
            events.hit[k], resting.slow[k] = 0, 0
    return is_any


@kernel
def note_pushed(events: EventMemory, resting: RestingMemory) -> None:
    """Note which stops have taken part in an impact."""
    for k in range(resting.pushed.shape[0]):
        resting.pushed[k] = 1 if resting.pushed[k] == 1 or events.hit[k] == 1 else 0
