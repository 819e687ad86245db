"""Events whose quantities must remain beyond their values for a time before they occur."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbfmu.mechanics.events import Event
from solvers.system import Array

HAS_OCCURRED = np.inf  # in place of the time since which a quantity is beyond its value


class Durations:
    """Since when the quantities of events with sensors are beyond their values.

    Attributes
    ----------
    any
        Whether an event needs a time.
    """

    def __init__(self) -> None:
        self._events: Sequence[Event] = ()
        self._since = np.zeros(0)  # (k,) s; nan: the quantity is not beyond its value
        self.any = False

    def declare(self, events: Sequence[Event]) -> None:
        """Use these events with sensors (k,), which may have other values and times than before."""
        self._events, self.any = events, any(event.lasts for event in events)
        if len(self._since) != len(events):
            self._since = np.full(len(events), np.nan)

    def update(self, t: float, values: Array) -> None:
        """Note which quantities (k,) are beyond their values at a time t, s."""
        for k, event in enumerate(self._events if self.any else ()):
            is_beyond = event.lasts > 0.0 and event.direction * (values[k] - event.value) > 0.0
            if not is_beyond:
                self._since[k] = np.nan
            elif np.isnan(self._since[k]):
                self._since[k] = t

    def _times(self) -> Array:
        """Return the times (k,) at which the events occur if their quantities remain, s; infinite: they do not."""
        lasting = np.array([event.lasts for event in self._events])
        return np.where(np.isnan(self._since), np.inf, self._since + lasting)

    def next_time(self) -> float:
        """Return the time of the next event if no quantity returns before, s; infinite: there is none."""
        return float(np.min(self._times(), initial=np.inf)) if self.any else np.inf

    def take(self, t: float) -> list[int]:
        """Return the numbers of the events that occur up to a time t, s, each once until its quantity returns."""
        found = np.flatnonzero(self._times() <= t)
        self._since[found] = HAS_OCCURRED
        return [int(k) for k in found]

    def state(self) -> list[float | str | None]:
        """Return what a saved run must contain: times, "occurred", and None where a quantity is not beyond."""
        texts = {True: "occurred", False: None}
        return [float(x) if np.isfinite(x) else texts[x == HAS_OCCURRED] for x in self._since] if self.any else []

    def restore(self, state: Sequence[float | str | None]) -> None:
        """Return to a state of :meth:`state`."""
        for k, x in enumerate(state):
            self._since[k] = np.nan if x is None else HAS_OCCURRED if x == "occurred" else float(x)
