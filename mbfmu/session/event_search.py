"""The search for events in a run of any solver in Python, see :mod:`.kernels.event_search`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.narrow_parts import MIN_STEPS_AFTER_RESTART
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.outcome import OK, Code, Status
from solvers.system import Array

from .kernels.event_points import EventSearch
from .kernels.event_search import StepActions, search_of
from .kernels.pull_search import pull_search_of
from .stepper_run import StepperRun

MAX_TRIAL_STEPS = 32  # of a trial that finds this event: the first ones after a restart are short


def _take_step(run: StepperRun, end: float, longest: float) -> int:
    stepper = run.stepper
    stepper.step_limit = longest
    saved = None if stepper.has_dense_output else stepper.save()
    code: int = stepper.advance_one_step(end).code
    run.step_begin = None if saved is None or stepper.has_dense_output else (saved, end)
    run.q, run.v, run.energy_account = stepper.reported
    return code


def _report(run: StepperRun, t: float) -> int:
    code: int = run.stepper.return_to(t, run.step_begin[0] if run.step_begin else None).code
    run.q, run.v, run.energy_account = run.stepper.reported
    return code


def _return_to_end(run: StepperRun, t: float) -> int:
    if run.step_begin is None:
        return _report(run, t)
    saved, target = run.step_begin  # the same step again
    run.stepper.restore(saved)
    code: int = run.stepper.advance_one_step(target).code
    run.q, run.v, run.energy_account = run.stepper.reported
    return code


def _is_dense(run: StepperRun) -> bool:
    return run.stepper.has_dense_output


def _tolerance(run: StepperRun) -> float:
    return run.stepper.options.rtol


def _max_steps(run: StepperRun) -> int:
    return run.stepper.options.max_steps


ACTIONS = StepActions(_take_step, _report, _return_to_end, _is_dense, _tolerance, _max_steps)
SEARCH = search_of(ACTIONS)


class CrossingSearch:
    """The search for the crossings of the sensors of one run.

    Parameters
    ----------
    run
        Run, whose ``search`` it becomes.
    memory
        What the search reads and changes.
    least_force
        (run) -> N or N m: the least force of a stop that holds its sensor, at the reported state.

    Attributes
    ----------
    memory
        The same; its arrays may be changed between steps.
    """

    def __init__(self, run: StepperRun, memory: EventSearch, least_force: Callable[[StepperRun], float]) -> None:
        self._run, self._advance_to_pull = run, pull_search_of(ACTIONS, SEARCH, least_force)
        self._take(memory)

    def _take(self, memory: EventSearch) -> None:
        self.memory, self._run.search = memory, pin(memory)

    def resize(self, size: Array) -> None:
        """Take the units (n,) of the coordinates that are free now."""
        if len(size) != len(self.memory.size) or not np.array_equal(size, self.memory.size):
            self._take(self.memory._replace(size=size.copy()))

    def sensor_values(self) -> Array:
        """Return the sensors (k,) at the reported state."""
        run, memory = self._run, self.memory
        watch_sensors(run.stepper.t, run.q, run.v, memory.parts, unpin(run.session).data, memory.values)
        return memory.values[: len(memory.crossed)].copy()

    def begin(self) -> None:
        """Note the sides at the reported state, at which nothing is a crossing."""
        SEARCH.begin(self._run)

    def find_jumped(self) -> list[int]:
        """Return the numbers of the sensors that cross their values by a jump of the reported state since then."""
        return self._found() if SEARCH.find_jumped(self._run) else []

    def advance(self, end: float) -> list[int]:
        """Advance to the first crossing before or at ``end`` (s), or to it; return the numbers of the sensors that
        cross there. The status of the stepper contains why neither is reached.
        """
        return self._result(SEARCH.advance(self._run, end))

    def advance_to_pull(self, end: float) -> list[int]:
        """As :meth:`advance`, at most to the first time at which a stop that holds would pull."""
        return self._result(self._advance_to_pull(self._run, end))

    def _result(self, code: int) -> list[int]:
        stepper = self._run.stepper
        if code == Code.MAX_STEPS and stepper.status.ok:
            stepper.status = Status(Code.MAX_STEPS, stepper.t, stepper.fallback_solvers)
        return self._found() if stepper.status.ok else []

    def _found(self) -> list[int]:
        return [int(k) for k in np.flatnonzero(self.memory.found)]

    def leave(self, sensors: list[int], bands: Array) -> None:
        """Let these sensors leave their values without a crossing from distances up to ``bands`` (k,), as at a start.

        A quantity that rests at its value has rounding errors of any sign.
        """
        for k in sensors:
            if not self.memory.stops[k]:
                self.memory.sides[k], self.memory.bands[k] = 0, bands[k]

    def restart(self, end: float, restarting: NDArray[np.bool_]) -> None:
        """Restart the solver, and limit its steps so that several lead to the next crossing of sensors at which it
        restarts (k,), or to ``end``, s. A trial shows when that is.
        """
        run, stepper, memory, control = self._run, self._run.stepper, self.memory, self.memory.control[0]
        stepper.restart()
        control["limited"], begin, saved, taken = 0, stepper.t, stepper.save(), 0
        sides, bands, found = memory.sides.copy(), memory.bands.copy(), list[int]()
        self.begin()
        while stepper.t < end and taken < MAX_TRIAL_STEPS and not restarting[found].any():
            if SEARCH.step(run, end, np.inf) != OK:
                break
            taken += 1
            found = self._found()
            if found:
                self.begin()
        if taken < MAX_TRIAL_STEPS and stepper.t > begin:
            control["limit"] = (stepper.t - begin) / MIN_STEPS_AFTER_RESTART
            control["limited"] = taken + MIN_STEPS_AFTER_RESTART
        stepper.restore(saved)
        stepper.status = Status(Code.OK, begin, stepper.fallback_solvers)
        memory.sides[:], memory.bands[:] = sides, bands
        run.q, run.v, run.energy_account = stepper.reported


def search_memory(compiled: CompiledMechanism) -> EventSearch:
    """Return what the search for the crossings of the events of a mechanism reads and changes."""
    watching = [event for event in compiled.mechanism.events if event.sensor is not None]
    has_rate = np.array([e.sensor is not None and e.sensor.rate_sensor() is not None for e in watching], bool)
    places = np.where(has_rate, len(watching) + np.cumsum(has_rate) - 1, -1).astype(np.int64)
    directions = np.array([0 if event.lasts else event.direction for event in watching], np.int64)
    stops = np.array([event.bounce is not None for event in watching], np.int64)
    parts, system = np.append(compiled.watched, compiled.watched_rates), compiled.system
    return EventSearch.allocate(parts, places, directions, stops, system.size[: system.n_velocities].copy())
