"""Stops that are rested on: when a stop holds its sensor, and when it lets it go.

After an impact the rebound has a speed u, and the acceleration that pushes the sensor against the stop is b. The
bounces that follow end within the time 2 u / (b (1 - e)), e is the restitution, and nothing moves in it by more than
2 u^2 / (b (1 - e)) as a result of them. If this is less than the tolerance times the unit of the sensor, the stop
holds; the last impact is without rebound. With e = 1 the bounces do not end: 1 - e is replaced by the tolerance, below
which no bounce is resolved.

The coordinate of a joint is held by locking the joint, see :mod:`.locked_joints`; a position or a distance by a
constraint equation, see :mod:`mbfmu.mechanics.arrays.stop_rows`.

The accelerations a of the stops that come to rest at one time solve the linear complementarity problem of contacts
without friction: a = A p - b >= 0, p >= 0 and p a = 0 (Glocker and Pfeiffer, *Nonlinear Dynamics* 7, 1995, 471-497).
Those with p = 0 do not hold.

The force of a stop that holds is evaluated at points of every step, like the sensors of events. The time at which it
would pull is located to the same accuracy, and the sensor moves freely from there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.events import Event
from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution
from mbfmu.util.diagnostics import Diagnostic
from solvers.outcome import SolverError
from solvers.system import Array

from .event_search import CrossingSearch
from .impulses import Impacts, UndeterminedJumpError, solve_complementarity, velocity_jump
from .kernels.event_points import TIME_ACCURACY_RATIO
from .stepper_run import StepperRun
from .touched_stops import SAME_PLACE_RATIO

if TYPE_CHECKING:
    from .locked_joints import LockedJoints

# Acceleration towards a stop, relative to the largest one, that is none: rounding errors at mass ratios up to 1e5
NO_ACCELERATION_RATIO = 1e5 * np.finfo(float).eps


class RestingStops:
    """The stops of a run whose sensors are coordinates of joints, and which of them hold their joints.

    Parameters
    ----------
    compiled, run
        Mechanism and run.
    search
        Search for the crossings of sensors.
    locked
        Joints that are locked.
    impacts
        Quantities that hit the stops (k,).

    Attributes
    ----------
    held
        Values at which stops hold, by the numbers of these stops.
    """

    def __init__(
        self,
        compiled: CompiledMechanism,
        run: StepperRun,
        search: CrossingSearch,
        locked: LockedJoints,
        impacts: Impacts,
    ) -> None:
        self._compiled, self._run, self._search, self._locked = compiled, run, search, locked
        self._impacts, self._directions, self.held = impacts, impacts.directions, dict[int, float]()
        self._sensors = np.flatnonzero(search.memory.stops)

    def declare(self, events: list[Event]) -> None:
        """Take the events (k,) whose values are the stops."""
        self._events = events
        joints = [-1 if event.holding_joint is None else event.holding_joint for event in events]
        self._joints = np.array(joints, np.int64)
        rows = [self._compiled.locks.stop_number(event.name, self._locked.solves_by_matrices) for event in events]
        self._rows = np.array([-1 if row is None else row for row in rows], np.int64)
        self._restitutions = np.array([event.bounce.restitution for event in events if event.bounce])

    def values(self) -> list[float]:
        """Return the values of the stops (k,)."""
        return [event.value for event in self._events]

    def can_hold(self, stop: int) -> bool:
        """Whether a stop can hold what rests on it."""
        return bool(self._joints[stop] >= 0 or self._rows[stop] >= 0)

    def _resize(self) -> None:
        system = self._compiled.system
        self._search.resize(system.size[: system.n_velocities])

    def hold_resting(self, stops: list[int]) -> Diagnostic | None:
        """Let stops hold what rests on them, of these, at which sensors are at the reported state; return why the run
        cannot continue, None: it can.
        """
        stops = [k for k in stops if self.can_hold(k)]
        self._let_leave(stops)
        for k in self._find_resting(stops):
            event, body = self._events[k], int(self._joints[k])
            if body >= 0:
                reason = self._locked.lock(body, event.name, event.name, event.value)
                if reason is not None:
                    return reason
            else:
                self._locked.hold(int(self._rows[k]), self._stopped(k))
            self._resize()
            self.held[k] = event.value
            self._search.memory.bands[self._sensors[k]] = np.finfo(float).max  # it does not cross its value
        return None

    def _let_leave(self, stops: list[int]) -> None:
        """Let sensors leave these stops without an impact by errors of the solver, which may move them beyond."""
        memory = self._search.memory
        beyond = memory.directions * (self._search.sensor_values() - memory.crossed)
        for k in stops:
            own = self._sensors[k]
            memory.bands[own] = max(2.0 * beyond[own], self._resolution(k, TIME_ACCURACY_RATIO))

    def _resolution(self, stop: int, ratio: float) -> float:
        """Return the distance from a stop at which a sensor is still at it; ``ratio`` is its part of the tolerance."""
        body = int(self._joints[stop])
        size = self._compiled.length if body < 0 else self._compiled.locks.size_of(body)
        rounding = SAME_PLACE_RATIO * (size + abs(self._events[stop].value))
        return float(ratio * self._run.stepper.options.rtol * size + rounding)

    def _stopped(self, stop: int) -> Array:
        """Return the velocities (n,) after an impact on a stop without rebound."""
        run, impacts = self._run, self._impacts
        t, q, v = run.stepper.t, run.q, run.v
        slope, rate = impacts.slopes(t, q)[stop], impacts.rates(t, q, v)[stop]
        try:
            response = velocity_jump(self._compiled, t, q, v, slope)
        except UndeterminedJumpError:
            return v
        effect = slope @ response
        stopped: Array = v - rate / effect * response if effect > 0.0 else v
        return stopped

    def _find_resting(self, stops: list[int]) -> list[int]:
        """Return which of these stops hold what is at them."""
        run, compiled = self._run, self._compiled
        bodies = compiled.data.arrays.bodies
        stops = [k for k in stops if self._joints[k] < 0 or bodies["vf"][self._joints[k]] >= 0]  # not locked by events
        if not stops:
            return []
        t, q, v = run.stepper.t, run.q, run.v
        slopes, leaving = self._impacts.slopes(t, q)[stops], -self._impacts.rates(t, q, v)[stops]
        try:
            a, _ = run.stepper.accelerations()
            responses = velocity_jump(compiled, t, q, v, slopes)
        except (SolverError, UndeterminedJumpError):
            return []
        approach, effects = self._approach(stops, a), slopes @ responses.T
        rtol, size = run.stepper.options.rtol, compiled.system.size
        ends = np.maximum(1.0 - self._restitutions[stops], rtol)
        units = np.linalg.norm(slopes[:, : len(size)] * size, axis=1)
        resolved = rtol * units
        largest = float(np.max(np.abs(a[: len(size)]) / size, initial=0.0))  # acceleration, in units of the coordinates
        rounding = NO_ACCELERATION_RATIO * largest * units
        rests = []
        for i in range(len(stops)):
            others = np.arange(len(stops)) != i
            p = solve_complementarity(effects[np.ix_(others, others)], approach[others])
            pressed = approach[i] - effects[i, others] @ p if p is not None else 0.0
            if pressed > rounding[i] and 2.0 * leaving[i] ** 2 <= pressed * ends[i] * resolved[i]:
                rests.append(i)
        p = solve_complementarity(effects[np.ix_(rests, rests)], approach[rests])
        if p is None:
            return []
        return [stops[i] for i, force in zip(rests, p, strict=True) if force * effects[i, i] > rounding[i]]

    def _approach(self, stops: list[int], a: Array) -> Array:
        """Return the accelerations (k,) of sensors towards their stops, at accelerations a (n,) of the coordinates."""
        run, compiled = self._run, self._compiled
        found = np.zeros(len(stops))
        if any(self._joints[k] < 0 for k in stops):
            J, gamma = compiled.locks.stop_slopes(compiled.system, run.stepper.t, run.q, run.v)
            along = J @ a - gamma
        for i, k in enumerate(stops):
            body = int(self._joints[k])
            found[i] = along[self._rows[k]] if body < 0 else a[compiled.data.arrays.bodies["vf"][body]]
        approach: Array = self._directions[stops] * found
        return approach

    def release(self, stops: list[int]) -> None:
        """Let these stops, which hold, not hold any more."""
        if not stops:
            return
        joints, rows = self._joints[stops], self._rows[stops]
        self._locked.release(joints[joints >= 0].tolist(), rows[joints < 0].tolist())
        held = {k: self.held.pop(k) for k in stops}
        self._resize()
        off = np.abs(self._search.sensor_values() - self._search.memory.crossed)
        for k in stops:
            sensor = self._sensors[k]
            # error of the constraint equation; a stop that has moved is not left
            projected = 2.0 * off[sensor] if held[k] == self._events[k].value else 0.0
            self._search.memory.bands[sensor] = projected + self._resolution(k, 1.0)

    def release_pulled(self) -> list[Event]:
        """Release the stops whose force would pull at the reported state, or which have moved; return their events."""
        if not self.held:
            return []
        pulled = self._forces() < 0.0
        moved = [self._events[k].value != value for k, value in self.held.items()]
        found = [k for k, *reasons in zip(self.held, pulled, moved, strict=True) if any(reasons)]
        self.release(found)
        return [self._events[k] for k in found]

    def _forces(self) -> Array:
        """Return the generalized forces (k,) by which the stops that hold push at the reported state."""
        run, compiled, stops = self._run, self._compiled, list(self.held)
        try:
            a, lam = run.stepper.accelerations()
        except SolverError:
            return np.zeros(len(stops))
        inverse_dynamics_at_solution(run.stepper.t, run.q, run.v, a, lam, compiled.system.pinned_data)
        tau, places, of_rows = (
            compiled.data.state.tau,
            compiled.data.arrays.bodies["vi"],
            compiled.locks.stop_forces(lam),
        )
        joints = [int(self._joints[k]) for k in stops]
        pulls = [
            tau[places[body]] if body >= 0 else -of_rows[compiled.locks.held_stops.index(self._rows[k])]
            for k, body in zip(stops, joints, strict=True)
        ]
        found: Array = -self._directions[stops] * np.array(pulls)
        return found

    def least_force(self) -> float:
        """Return the least force of a stop that holds, at the reported state, N or N m."""
        return float(self._forces().min())

    def advance(self, end: float) -> tuple[list[int], list[Event]]:
        """Advance to the first crossing of a sensor, the first time at which a stop is released, or to ``end``, s.

        Return the numbers of the sensors that cross, and the events whose stops are released.
        """
        found, stepper = self._search.advance_to_pull(end), self._run.stepper
        is_pull = stepper.status.ok and not found and stepper.t < end
        return found, self.release_pulled() if is_pull else []
