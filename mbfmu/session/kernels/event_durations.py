"""Events whose quantities must remain beyond their values for a time: kernels of :mod:`mbfmu.session.event_durations`.

They read and change three arrays: ``lasting`` (k,), times for which the sensors must remain beyond their values, s,
zero for other events; ``ways`` (k,), on which side of the value this is (1: above, -1: below); and ``since`` (k,), s,
since when they are there; nan: they are not there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.recursions.dynamics import watch_sensors
from solvers.compiled.kernel import kernel

from .event_points import EventSearch

HAS_OCCURRED = np.inf  # in place of the time since which a quantity is beyond its value


@kernel
def note_duration(durations: Any, k: int, t: float, side: float) -> None:
    """Note since when sensor k is beyond its value, by its side at time t, s; 0: it may go beyond from t on."""
    beyond = durations.ways[k] * side
    if durations.lasting[k] > 0.0 and beyond == 0.0:
        durations.since[k] = t
    elif durations.lasting[k] > 0.0 and beyond > 0.0:
        if np.isnan(durations.since[k]):
            durations.since[k] = t
    else:
        durations.since[k] = np.nan


@kernel
def has_durations(durations: Any) -> bool:
    """Whether an event requires a time."""
    is_any = False
    for k in range(durations.lasting.shape[0]):
        is_any = is_any or durations.lasting[k] > 0.0
    return is_any


@kernel
def update_durations(durations: Any, search: EventSearch, session: Any, t: float, q: Any, v: Any) -> None:
    """Note which sensors are beyond their values at the state (q, v) of time t, s."""
    if not has_durations(durations):
        return
    watch_sensors(t, q, v, search.parts, session.data, search.values)
    for k in range(durations.lasting.shape[0]):
        note_duration(durations, k, t, search.values[k] - search.crossed[k])


@kernel
def next_duration_time(durations: Any) -> float:
    """Time of the next event if no quantity returns before, s; infinite: there is none."""
    found = np.inf
    for k in range(durations.lasting.shape[0]):
        if durations.lasting[k] > 0.0 and not np.isnan(durations.since[k]):
            found = min(found, durations.since[k] + durations.lasting[k])
    return float(found)


@kernel
def end_duration(durations: Any, k: int, t: float) -> bool:
    """Whether event k occurs up to time t, s; it occurs once until its quantity returns."""
    if not durations.lasting[k] > 0.0 or not durations.since[k] + durations.lasting[k] <= t:
        return False
    durations.since[k] = HAS_OCCURRED
    return True
