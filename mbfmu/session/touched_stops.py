"""Stops that sensors touch: they take part in the impacts of other stops, if there is a force between them or not.

Bodies that lie on each other in free fall are an example: no force presses them together, so that no stop holds. An
impact at one stop and then at the next one would give other velocities than an impact at both, which is what an
arbitrarily small force between the bodies leads to.

A stop is touched if its sensor is at its value within the tolerance, in the unit of the sensor, and its rate before the
event is less than the tolerance times the largest rate towards a stop in the impact, both in units of their sensors. In
the linear complementarity problem of :meth:`.impulses.Impacts.jump` it is one of the stops that are hit: its rate after
the impact is not towards the stop. The unit of a sensor is the length of its slope, in units of the coordinates.

What is needed are the values, rates and slopes of all stops at the event, and :func:`.impulses.velocity_jump`.
"""

from __future__ import annotations

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from solvers.system import Array

from .event_search import CrossingSearch
from .impulses import Impacts
from .stepper_run import StepperRun

SAME_PLACE_RATIO = 16.0 * np.finfo(float).eps  # relative difference of a sensor and its stop that is none


class TouchedStops:
    """The stops of a run that sensors touch at an event.

    Parameters
    ----------
    compiled, run
        Mechanism and run.
    search
        Search for the crossings of sensors.
    impacts
        Quantities that hit the stops (k,).
    """

    def __init__(self, compiled: CompiledMechanism, run: StepperRun, search: CrossingSearch, impacts: Impacts) -> None:
        self._compiled, self._run, self._search, self._impacts = compiled, run, search, impacts
        self._sensors = np.flatnonzero(search.memory.stops)
        self._units = self._rates = np.ones(len(self._sensors))
        self._touched: list[int] = []

    def note(self, others: list[int]) -> None:
        """Note the stops that are touched at the reported state, before the actions of an event.

        ``others`` are the stops that are hit or hold: they take part in any case.
        """
        self._touched = []
        if len(others) == len(self._sensors):
            return
        run, size = self._run, self._compiled.system.size
        t, q, v = run.stepper.t, run.q, run.v
        units = np.linalg.norm(self._impacts.slopes(t, q)[:, : len(size)] * size, axis=1)
        crossed = self._search.memory.crossed[self._sensors]
        off = np.abs(self._search.sensor_values()[self._sensors] - crossed)
        is_at = off <= run.stepper.options.rtol * units + SAME_PLACE_RATIO * (units + np.abs(crossed))
        self._units = np.where(units > 0.0, units, 1.0)
        self._rates = self._impacts.rates(t, q, v) / self._units
        self._touched = [int(k) for k in np.flatnonzero(is_at) if k not in others]

    def jump(self, stops: list[int]) -> tuple[Array | int, list[int]]:
        """Return the jump of the velocities (n,) in an impact at ``stops``, and these with the touched stops.

        A touched stop takes no part if the rates that all stops require contradict each other with it. For a number in
        place of the jump, and for errors, see :meth:`.impulses.Impacts.jump`.
        """
        t, q, v = self._run.stepper.t, self._run.q, self._run.v
        slow: list[int] = []
        if self._touched:
            towards = (self._impacts.rates(t, q, v) / self._units)[[*stops, *self._touched]].max()
            limit = self._run.stepper.options.rtol * towards
            slow = [k for k in self._touched if towards > 0.0 and abs(self._rates[k]) <= limit]
        while stops or slow:
            found = self._impacts.jump(t, q, v, np.array([*stops, *slow]))
            if not (isinstance(found, int) and slow):
                return found, [*stops, *slow]
            slow = [k for k in slow if k != found] if found in slow else []
        return np.zeros(len(v)), []
