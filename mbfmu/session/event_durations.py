"""Events whose quantities must remain beyond their values for a time before they occur."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.events import Event
from solvers.system import Array

from .kernels.event_durations import HAS_OCCURRED, end_duration, next_duration_time, update_durations
from .kernels.event_points import EventSearch


class DurationArrays(NamedTuple):
    """What the kernels of :mod:`.kernels.event_durations` read and change."""

    lasting: Array
    ways: NDArray[np.int64]
    since: Array


class Durations:
    """Since when the quantities of events with sensors are beyond their values.

    Attributes
    ----------
    any
        Whether an event requires a time.
    """

    def __init__(self) -> None:
        self._arrays = DurationArrays(np.zeros(0), np.zeros(0, np.int64), np.zeros(0))
        self.any = False

    def declare(self, events: Sequence[Event]) -> None:
        """Use these events with sensors (k,), which may have other values and times than before."""
        lasting = np.array([event.lasts for event in events], float)
        ways = np.array([event.direction for event in events], np.int64)
        since = self._arrays.since if len(self._arrays.since) == len(events) else np.full(len(events), np.nan)
        self._arrays, self.any = DurationArrays(lasting, ways, since), bool(lasting.any())

    def update(self, search: EventSearch, run: Any) -> None:
        """Note which quantities are beyond their values at the reported state of a run."""
        if self.any:
            update_durations(self._arrays, search, run.session, run.stepper.t, run.q, run.v)

    def next_time(self) -> float:
        """Return the time of the next event if no quantity returns before, s; infinite: there is none."""
        return float(next_duration_time(self._arrays)) if self.any else np.inf

    def take(self, t: float) -> list[int]:
        """Return the numbers of the events that occur up to a time t, s, each once until its quantity returns."""
        return [k for k in range(len(self._arrays.lasting)) if end_duration(self._arrays, k, t)]

    def state(self) -> list[float | str | None]:
        """Return what a saved run must contain: times, "occurred", and None where a quantity is not beyond."""
        texts, since = {True: "occurred", False: None}, self._arrays.since
        return [float(x) if np.isfinite(x) else texts[x == HAS_OCCURRED] for x in since] if self.any else []

    def restore(self, state: Sequence[float | str | None]) -> None:
        """Return to a state of :meth:`state`."""
        for k, x in enumerate(state):
            self._arrays.since[k] = np.nan if x is None else HAS_OCCURRED if x == "occurred" else float(x)
