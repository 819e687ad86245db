"""The progress of a run: advancing, outputs, and what is reported about the run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isnan

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.numbering import Variable
from mbfmu.mechanics.numbers import ascending_times, finite
from mbfmu.util.diagnostics import Diagnostic, without_repeats
from mbfmu.util.errors import UserError
from solvers import Statistics, Status
from solvers.outcome import OK

from .event_record import EventRecord
from .events import RunEvents
from .failure_diagnosis import advise, explain_failure
from .kernels.points import Session
from .run_messages import INPUT_JUMP, UNDETERMINED_FORCES, filled
from .saved_states import SavedStates
from .stepper_run import SAMPLE, SEQUENCE
from .wheel_monitor import State, WheelMonitor

Array = NDArray[np.float64]


class RunProgress(SavedStates):
    """Base of :class:`.Simulation`: it advances, and reads and records outputs."""

    session: Session
    variables: tuple[Variable, ...]
    _out: Array  # outputs of the last call
    _end: float  # s, time that the run is to advance to
    _impulse_is_unknown: NDArray[np.int64]  # (1,) fields of the status of the session
    _supports_jump: NDArray[np.int64]
    _limit_ratio: Array
    _has_supports: bool
    _has_limits: bool
    _wheels: WheelMonitor

    @property
    def discontinuity_work(self) -> float:
        """Work done on the mechanism by jumps of inputs and of tunable parameters, J: work of impulses of supports, and
        changes of potential energy at constant position.
        """
        return float(self.session.status["discontinuity_work"][0])

    @property
    def statistics(self) -> Statistics:
        """Counts of steps, evaluations and other work of the solver so far."""
        return self._events.locked.statistics() if self._events else self.stepper.statistics

    def energy(self) -> float:
        """Kinetic and potential energy at the time reached, J."""
        return self.compiled.energy(self.stepper.t, self.stepper.q, self.stepper.v)

    @property
    def diagnostics(self) -> Sequence[Diagnostic]:
        """Notes and warnings on the model, its start and the run so far, and the error that stopped it."""
        found = [*self._noted, *self.stepper.diagnostics, *self._lost]
        last = self._stop or self._element_monitor.coarse
        return without_repeats([*found, *([last] if last else [])])

    @property
    def _stop(self) -> Diagnostic | None:
        """Why the last :meth:`advance` or :meth:`record` ended early; None: it did not."""
        stepper = self.stepper
        if stepper.status.ok:
            return self._element_monitor.folded or (self._events.stop if self._events else None)
        if self._events and self._events.locked.any:
            return stepper.status.explain(advise(self.compiled, stepper.status))
        return explain_failure(self.compiled, stepper.status, stepper.q, self._end, stepper.starts_singular)

    @property
    def failed(self) -> bool:
        """Whether the last :meth:`advance` or :meth:`record` ended early."""
        return not self.stepper.status.ok or self._stop is not None

    @property
    def inaccurate(self) -> bool:
        """Whether the energy error is larger than the tolerance explains."""
        return bool(self._lost)

    @property
    def failure(self) -> str:
        """Reason why the last :meth:`advance` or :meth:`record` ended early, and advice; empty: it did not."""
        return str(self._stop or "")

    @property
    def events(self) -> tuple[EventRecord, ...]:
        """Events that have occurred, see :meth:`.Mechanism.event`."""
        return tuple(self._events.records) if self._events else ()

    @property
    def ended(self) -> bool:
        """Whether an event has ended the run: :meth:`advance` stays at the time of the event."""
        return self._events is not None and self._events.ended

    def advance(self, t: float) -> Status:
        """Advance to a communication point.

        Parameters
        ----------
        t
            Time of the communication point, s, not before the time reached.

        Returns
        -------
        Status
            Whether the solver has reached t. If it has not, the last good state remains. :attr:`failure` contains the
            reason; it also reports a folded sheet and too many events, which the status does not. If an event ends the
            run (:attr:`ended`), the status is that of the solver there.

        Raises
        ------
        UserError
            t is before the time reached.
        """
        t, run, stepper = finite("the time to advance to", t), self._run, self._run.stepper
        begin = stepper.t
        if t < begin:
            raise UserError(
                f"the time to advance to is {t!r} s, but the simulation has reached {begin!r} s; restore a saved state "
                "to go back"
            )
        self._end = t
        if self._events is None:
            SEQUENCE.step(run, t)
        else:
            self._events.step(t)
        if self._has_supports:
            self._report_support_motions(begin)
        stepper = self.stepper  # after a lock another one
        t, q = stepper.t, stepper.q
        if self.energy_check:
            self.energy_check.describe_state(t, q)
        if self._has_limits:
            self._element_monitor.note(float(self._limit_ratio[0]), t, self._positions)
        if self._wheels.wheels:
            self._note_wheels([(t, q, stepper.v)])
            self._explain_wheels()
        return stepper.status

    def _note_wheels(self, states: Iterable[State]) -> None:
        """Warn once of each wheel that would lift, and of each that would slip."""
        self._note_once(self._wheels.describe(states))

    def _explain_wheels(self) -> None:
        """If the solver has failed, warn of wheels that may be the reason."""
        stepper = self.stepper
        if not stepper.status.ok and len(stepper.v) == self.compiled.system.n:  # else joints are locked
            self.compiled.place_bodies(stepper.t, stepper.q)
            self._note_once(self._wheels.explain_failure(stepper.t))

    def _note_once(self, diagnostics: Iterable[Diagnostic]) -> None:
        for found in diagnostics:
            if not any((found.code, found.subject) == (known.code, known.subject) for known in self._noted):
                self._noted.append(found)

    def _report_support_motions(self, t: float) -> None:
        """Report what is unusual about the support motions that have started at t, s; raise if they cannot start."""
        inputs = self.compiled.inputs
        if self._impulse_is_unknown[0]:
            names = ", ".join(map(repr, inputs.jumping()))
            raise UserError(
                f"the rate of input {names} jumps at t = {t:.9g} s, where the impulse is not determined: "
                f"{self._run.error}"
            ) from self._run.error
        for name, size, unit in inputs.jumped() if self._supports_jump[0] else []:
            if name not in self._reported_jumps:
                self._reported_jumps.add(name)
                values = {"name": name, "t": t, "size": size, "unit": unit}
                self._noted.append(filled(INPUT_JUMP, time=t, subject=name, **values))

    def outputs(self) -> Array:
        """Return the outputs at the time reached.

        Returns
        -------
        Array
            Outputs (k,) in the order of ``variables``; the next call overwrites the array.

        Raises
        ------
        UserError
            The accelerations are not determined.
        """
        if SEQUENCE.read(self._run) != OK:
            raise UserError(f"model {self.model.name!r}: {self._run.error}") from self._run.error
        self._report_undetermined()
        if self._events:
            self._events.locked.add_energies(self._out)
        if self.energy_check:
            self.energy_check.describe_state(self.t, self.stepper.q)
        return self._out

    @property
    def last_outputs(self) -> Array:
        """Outputs of the last call of :meth:`outputs` or :meth:`record`, in the order of ``variables``."""
        return self._out.copy()

    def record(self, times: Array, values: Array) -> int:
        """Advance through several communication points and store the outputs at each.

        Parameters
        ----------
        times
            Times (k,), increasing, s.
        values
            Array (k, outputs) that receives the outputs, one line per time.

        Returns
        -------
        int
            Number of lines written; if it is less than k, :attr:`failure` contains the reason.

        Raises
        ------
        UserError
            The times are not finite numbers that increase from the time reached, or the shape of ``values`` is another
            one.
        """
        times = ascending_times(times)
        if len(times) and times[0] < self.t:
            raise UserError(
                f"times begin at {times[0]} s, but the simulation is at {self.t} s; restore a state to go back"
            )
        if np.shape(values) != (len(times), len(self.variables)):
            wanted = (len(times), len(self.variables))
            raise UserError(f"values have the shape {np.shape(values)}; allowed: {wanted} (times, outputs)")
        if self._events is not None:
            return self._record_each(self._events, times, values)
        done, self._end, rows = 0, float(max(times, default=self._end)), np.ascontiguousarray(values)
        while done < len(times):
            begin, ahead = self.t, times[done:]
            count = SAMPLE(self._run, ahead, rows[done:])
            self._report_support_motions(begin)
            q, ratios = self._run.samples.q, self._run.ratios[: count + 1]
            self._element_monitor.note_samples(ratios, ahead[: len(ratios)], q[: len(ratios)])
            if self._wheels.wheels:
                self._note_wheels(zip(ahead[:count].tolist(), q, self._run.samples.v, strict=False))
                self._explain_wheels()
            if self.energy_check and count:
                self.energy_check.describe(ahead[:count], q[:count])
            done += count
            if self.failed:
                break
        if rows is not values:
            values[:] = rows
        if done:
            self._out[:] = rows[done - 1]
        self._report_undetermined()
        return done

    def _record_each(self, events: RunEvents, times: Array, values: Array) -> int:
        """As :meth:`record`, one point after the other; an event that ends the run before a point ends it, too."""
        for done, t in enumerate(times):
            self.advance(float(t))
            if self.failed or self.t < t:
                return done
            if SEQUENCE.read(self._run) != OK:
                assert self._run.error is not None
                self.stepper.status = self._run.error.status
                return done
            self._report_undetermined()
            events.locked.add_energies(self._out)
            values[done] = self._out
        return len(times)

    def _report_undetermined(self) -> None:
        """Warn once that forces were read at a time at which they are not determined."""
        if isnan(self.stepper.undetermined_at) or self._reported_undetermined or not self.compiled.has_force_outputs:
            return
        self._reported_undetermined, t = True, float(self.stepper.undetermined_at)
        self._noted.append(filled(UNDETERMINED_FORCES, time=t, t=t))
