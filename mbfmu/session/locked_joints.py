"""Joints that events lock and release in a run: a solver that starts at the event with the coordinates that are free.

The velocities jump so that the rate of the coordinate becomes zero, see :class:`mbfmu.mechanics.events.Lock`. Until the
next lock or release a new solver integrates the equations of :mod:`mbfmu.mechanics.arrays.joint_locks`. Its energy
account begins there, so that the energy balance is checked for each of these parts of the run. The energy error that
is read is the sum over the parts, and the energy throughput is that of the whole run: the range of the kinetic energy
over all parts, and the sum of the work in either direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from math import inf
from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.events import Lock, Release
from mbfmu.util.diagnostics import Diagnostic
from solvers import Statistics
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.energy_account import EXCHANGED_ENERGY, KINETIC_MAX, WORK
from solvers.stepper import Stepper
from solvers.steppers.energy_records import kinetic_min
from solvers.system import Array

from .impulses import LOCK_PIVOT_RATIO, UndeterminedJumpError, velocity_jump
from .kernels.points import account_discontinuity, energy_at
from .run_messages import filled
from .stepper_run import StepperRun

COUNTERS_OF_LAST_STEP = {"order", "step_size"}
LARGEST_VALUE_COUNTERS = {"coarser", "rate_growth"}  # counters that are largest values
MakeStepper = Callable[[float, Array, Array], Stepper]  # (t, q, v): the solver of the run at a state


class LockedJoints:
    """The locked joints of one run.

    Parameters
    ----------
    compiled, run
        Mechanism and run; their system and their solver are replaced at each lock and release.
    make_stepper
        Returns a solver of the present system at a state.
    note
        Receives what a solver that is replaced has reported.
    solves_by_matrices
        Whether the solver can hold sensors at stops by constraint equations in models of any size.
    """

    def __init__(
        self,
        compiled: CompiledMechanism,
        run: StepperRun,
        make_stepper: MakeStepper,
        note: Callable[[Diagnostic], None],
        solves_by_matrices: bool,
    ) -> None:
        self.solves_by_matrices = solves_by_matrices
        self._compiled, self._run, self._make_stepper, self._note = compiled, run, make_stepper, note
        self._session = run.session
        self._balance = unpin(run.session).balance[0]
        self._is_checked = bool(self._balance["is_checked"])
        # time, positions and velocities, of locked joints too, where the present solver has started
        self._begin = run.stepper.t, run.stepper.q, run.stepper.v
        self._energies = np.array([0.0, 0.0, -inf, inf])  # of the parts before, see _energies_so_far
        self._counts = Statistics()  # of the solvers before

    @property
    def any(self) -> bool:
        """Whether a joint is locked."""
        return bool(self._compiled.locks.held or self._compiled.locks.held_stops)

    def act(self, action: Lock | Release, event: str) -> Diagnostic | None:
        """Lock or release a joint; return why the run cannot continue, None: it can."""
        held, body = self._compiled.locks.held, action.joint.index
        if isinstance(action, Lock):
            return None if body in held else self.lock(body, action.joint.name, event)
        t = self._run.stepper.t
        if body not in held:
            return Diagnostic.error(
                "not-locked",
                f"event {event!r} releases the joint {action.joint.name!r} at t = {t:.9g} s, which is not locked",
                "Release a joint only after a Lock of this joint, or change the order of the events",
                time=t,
                subject=event,
            )
        self.release([body])
        return None

    def release(self, bodies: Sequence[int], stops: Sequence[int] = ()) -> None:
        """Release the joints of these bodies, which are locked, and sensors at these stops, which hold them."""
        locks = self._compiled.locks
        held = {body: value for body, value in locks.held.items() if body not in bodies}
        self._continue_with(held, self._run.v, tuple(k for k in locks.held_stops if k not in stops))

    def hold(self, stop: int, v: Array) -> None:
        """Hold the sensor of a stop, by its constraint equation, from the velocities v (n,) on, at which it rests."""
        locks = self._compiled.locks
        self._continue_with(locks.held, v, tuple(sorted((*locks.held_stops, stop))))

    def lock(self, number: int, name: str, event: str, value: float | None = None) -> Diagnostic | None:
        """Lock the joint of a body, which is not locked; return why the run cannot continue, None: it can.

        ``value`` is where its coordinate is, but for the error of the solver; None: it remains at its present value.
        """
        run, compiled = self._run, self._compiled
        t, q, v = run.stepper.t, run.q, run.v
        body = compiled.data.arrays.bodies[number]
        k, unit = int(body["vf"]), np.zeros(len(v))
        unit[k] = 1.0
        try:
            response = velocity_jump(compiled, t, q, v, unit, LOCK_PIVOT_RATIO)
        except UndeterminedJumpError as error:
            return filled(error.reason, time=t, subject=event, name=event, t=t)
        if response[k] > 0.0:
            v = v - v[k] / response[k] * response
        elif compiled.locks.is_driven and abs(v[k]) > run.stepper.options.rtol * compiled.system.size[k]:
            return Diagnostic.error(
                "prescribed-lock",
                f"event {event!r} cannot lock the joint {name!r} at t = {t:.9g} s: drives prescribe its rate",
                "Lock a joint that can move freely, or stop the drive",
                time=t,
                subject=name,
            )
        held = compiled.locks.held | {number: float(q[int(body["qf"])]) if value is None else value}
        self._continue_with(held, v, compiled.locks.held_stops)
        return None

    def _continue_with(self, held: dict[int, float], v: Array, stops: tuple[int, ...]) -> None:
        """Continue with these joints locked, and sensors held at these stops, from the reported positions, with
        velocities v (n,).
        """
        run, locks, old = self._run, self._compiled.locks, self._run.stepper
        session, t = run.session, old.t
        before = energy_at(session, t, run.q, run.v)
        if self._balance["is_checked"]:
            error = before - self._balance["reference_energy"] - run.energy_account[WORK]
            self._energies = self._energies_so_far(error)
        self._counts = added(self._counts, old.statistics)
        for diagnostic in old.diagnostics:
            self._note(diagnostic)
        q, v = locks.all_coordinates(run.q, v)
        self._continue_at(held, stops, t, q, v)
        account_discontinuity(session, before, t, run.q, run.v)
        balance, freedom = self._balance, run.stepper.freedom
        balance["reference_energy"], balance["last_passage_energy"] = energy_at(session, t, run.q, run.v), 0.0
        balance["is_checked"] = self._is_checked and freedom > 0
        balance["has_one_freedom"] = freedom == 1 and not locks.is_driven

    def _continue_at(self, held: dict[int, float], stops: tuple[int, ...], t: float, q: Array, v: Array) -> None:
        """Start a solver with these joints locked, and sensors held at these stops, at all positions and velocities,
        (nq,) and (n,).
        """
        run, locks, self._begin = self._run, self._compiled.locks, (t, q, v)
        self._compiled.system = system = locks.lock(held, stops, t, q)
        # data of stops that hold have further constraint equations
        run.session = pin(unpin(self._session)._replace(data=system.pinned_data)) if stops else self._session
        run.stepper = self._make_stepper(t, *locks.free_coordinates(q, v))
        run.dv = np.zeros(len(run.v))

    def lock_copy(self, compiled: CompiledMechanism) -> None:
        """Lock the joints of another compiled mechanism of the same model as they are locked now."""
        t, q, _ = self._begin
        locks = self._compiled.locks
        compiled.system = compiled.locks.lock(locks.held, locks.held_stops, t, q)

    def add_energies(self, out: Array) -> None:
        """Add the energies of earlier parts to the energies that the outputs end in, J."""
        if self._is_checked and self._compiled.locks.can_lock:
            is_checked = self._balance["is_checked"]
            error, work, largest, smallest = self._energies_so_far(out[-2]) if is_checked else self._energies
            out[-2:] = error, work + max(0.0, largest - smallest)

    def _energies_so_far(self, error: float) -> Array:
        """Return the energy error, the total variation of the work, and the largest and smallest kinetic energy, J, of
        all parts until now; ``error`` is the energy error of the present part.
        """
        account, smallest = self._run.energy_account, kinetic_min(self._run.stepper)
        before, largest = self._energies, account[KINETIC_MAX]
        # nothing has been done before the first evaluation
        work = 0.0 if smallest == inf else account[EXCHANGED_ENERGY] - (largest - smallest)
        return np.array([before[0] + error, before[1] + work, max(before[2], largest), min(before[3], smallest)])

    def statistics(self) -> Statistics:
        """Return the counters of all solvers so far."""
        now = self._run.stepper.statistics
        return added(self._counts, now) if self._compiled.locks.can_lock else now

    def state(self) -> dict[str, Any]:
        """Return what a saved run must contain; empty: no event locks a joint."""
        if not self._compiled.locks.can_lock:
            return {}
        t, q, v = self._begin
        return {
            "held": [[body, value] for body, value in self._compiled.locks.held.items()],
            "stops": list(self._compiled.locks.held_stops),
            "begin": [t, q.tolist(), v.tolist()],
            "energies": self._energies.tolist(),
            "counts": asdict(self._counts),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Return to a state of :meth:`state`, with a solver of its system, whose own state is to be restored."""
        if not state:
            return
        held, stops, (t, *motion) = dict(state["held"]), tuple(state["stops"]), state["begin"]
        q, v = map(np.array, motion)
        locks = self._compiled.locks
        if t != self._begin[0] or held != locks.held or stops != locks.held_stops:
            self._continue_at(held, stops, t, q, v)
        self._energies, self._counts = np.array(state["energies"]), Statistics(**state["counts"])


def added(before: Statistics, now: Statistics) -> Statistics:
    """Return the counters of a run whose first solvers have counted ``before``, and its present one ``now``."""
    first, last = asdict(before), asdict(now)
    others = COUNTERS_OF_LAST_STEP | LARGEST_VALUE_COUNTERS | {"rate_growth_at"}
    sums = {name: first[name] + x for name, x in last.items() if name not in others}
    largest = {name: max(first[name], last[name]) for name in LARGEST_VALUE_COUNTERS}
    at = (now if now.rate_growth >= before.rate_growth else before).rate_growth_at
    return replace(now, **sums, **largest, rate_growth_at=at)
