"""A run of a model in Python: behind direct runs, and behind FMUs that call Python."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, replace
from math import isnan, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.given_inputs import GivenInputs
from mbfmu.mechanics.events import SetInput, SetParameter
from mbfmu.mechanics.numbers import ascending_times, finite
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.settings import AUTO, Settings
from mbfmu.modeling.variables import ENERGY_OUTPUTS, require_unique
from mbfmu.steady.equilibrium import build_problem, find_state, report_unstable
from mbfmu.steady.state import Equilibrium
from mbfmu.util.diagnostics import Diagnosed, Diagnostic, from_saved, without_repeats
from mbfmu.util.errors import UserError, short
from solvers import Options, Statistics, Status, stepper
from solvers.compiled.kernel import COMPILED
from solvers.compiled.tuple_pointer import pin
from solvers.outcome import OK
from solvers.stepper import ResolutionError, Stepper, pack, unpack
from solvers.steppers import SOLVER_NAMES, fingerprint_of_solver
from solvers.steppers.guard import GuardedStepper

from .element_monitor import ElementMonitor, Furthest
from .energy_check import EnergyCheck
from .events import EventRecord, RunEvents, Setters
from .failure_diagnosis import advise, explain_failure, explain_rates, find_undetermined_rates, free_rates
from .kernels.points import Session, begin_session
from .locked_joints import LockedJoints
from .run_messages import INPUT_JUMP, SINGULAR_START, UNDETERMINED_FORCES, filled
from .serialization import decode_state, encode_state
from .solver_selection import SolverChoice, limit_order, select_solver
from .step_count import StepCountCheck
from .stepper_run import SAMPLE, SEQUENCE, StepperRun
from .tolerances import describe_coarse, describe_loose, describe_sticking
from .warmup import MAX_WARMUP_STEPS, compile_kernels

__all__ = ["Settings", "Simulation"]

Array = NDArray[np.float64]

_compiled: set[tuple[type, bool]] = set()  # kinds of runs whose kernels this process has compiled


class Checkpoint(NamedTuple):
    """State that a simulation can be rolled back to."""

    stepper: bytes  # state of the stepper, with history and counters
    session: bytes  # state of the inputs and of the energy check
    lost: tuple[Diagnostic, ...]  # what the energy check has found
    furthest: Furthest
    noted: int  # number of diagnostics that were noted
    reported_jumps: frozenset[str]  # names of inputs
    reported_undetermined: bool
    model: Model  # with the parameters of that time
    events: dict[str, Any]  # that have occurred; empty: the model has none


class Simulation(Diagnosed):
    """Simulation of a model that is advanced step by step, with inputs and parameters that change between steps.

    Parameters
    ----------
    model
        Model, or a mechanism without a model.
    settings
        Solver, tolerance and other settings of the run; those not given are the defaults, with the solver and the
        tolerance of the model.
    t0
        Start time, s.
    begins
        Whether the model is checked for contacts at the start; False for a run that continues another one.
    inputs
        Values of inputs, by name or number, that differ from their start. A support that is moved by them starts with
        this position and rate, and the bodies connected to it move with it: start velocities are relative.
    given_inputs
        Inputs given for the whole run as functions of time or tables, see :mod:`mbfmu.mechanics.arrays.given_inputs`.
    duration
        Time of the whole run, s; if it is not given or 0, the stop time of the model. It is the time scale of a
        start at rest if no force, drive or rate gives another one.

    Attributes
    ----------
    solver_choice
        Solver in use and the reason: that of the settings, or the one that ``auto`` has chosen.
    start
        Positions (nq,) and velocities (n,) at the start, with closed loops.
    steady_state
        The steady state in which the simulation starts; None: it does not start in one.
    session
        State of the run besides its solver: energy balance and what was detected at communication points.
    step_count_check
        Check of the number of steps; its ``end`` is the end of the run, s, if that is known.
    report
        Function that receives a diagnostic about the computing time at once, while :meth:`advance` continues.
    variables
        What :meth:`outputs` returns: the compiled mechanism's outputs, then those of the energy check (NaN if it is
        off, or if no degree of freedom is free).

    Raises
    ------
    UserError
        The model cannot be built, assembled or balanced with these parameters.
    """

    def __init__(
        self,
        model: Model | Mechanism,
        settings: Settings,
        t0: float = 0.0,
        inputs: Mapping[int, float] | Mapping[str, float] | None = None,
        *,
        begins: bool = True,
        given_inputs: GivenInputs | None = None,
        duration: float | None = None,
    ) -> None:
        self.model = model_given = as_model(model)
        self.settings = settings = settings.for_model(model_given)
        self._given_inputs = given_inputs
        self.compiled = model_given.compile(given_inputs)
        if settings.input_interpolation == "linear":
            self.compiled.inputs.extrapolate()
        known = enumerate(self.compiled.inputs.variables)
        self._inputs: dict[Hashable, int] = {key: k for k, v in known for key in (v.name, k)}
        if not isinstance(inputs or {}, Mapping):
            raise UserError(f"inputs are {inputs!r}; allowed: values by the names or the numbers of inputs")
        given, unstable = self._starts(inputs or {}, t0), list[Diagnostic]()
        self.steady_state: Equilibrium | None = None
        if settings.start_at_equilibrium:  # whose time is zero; the drives are where they are at the start time
            self.steady_state = found = find_state(build_problem(model_given, self._compile_held(inputs or {}, given)))
            unstable = report_unstable(found)
        self.compiled.inputs.begin(t0, given)
        q, v = (found.q, found.v) if self.steady_state else self.compiled.assemble(t0)
        start_warnings = self.compiled.check_start(t0, q) if begins else []
        self.start, is_auto = (q, v), settings.solver == AUTO
        if duration is not None and finite("duration", duration) < 0.0:
            raise UserError(f"duration is {duration!r}; allowed: at least 0 s (0: the stop time of the model)")
        options = settings.options(duration or model_given.stop_time)
        self.solver_choice = (
            select_solver(self.compiled, [(t0, q, v)], options) if is_auto else SolverChoice(settings.solver)
        )
        self._options, limited = limit_order(self.compiled, self.solver_choice.solver, (t0, q, v), options)
        self.step_count_check = StepCountCheck(self._copy_compiled, self._options, self._report_step_count)
        self.report: Callable[[Diagnostic], None] | None = None
        self.variables = (*self.compiled.outputs, *ENERGY_OUTPUTS)
        require_unique(["time", *(v.name for v in (*self.compiled.inputs.variables, *self.variables))])
        own = self.compiled.inputs.own, self.compiled.monitored
        self.session = Session.allocate(self.compiled.system.pinned_data, *own)
        self._pinned = pin(self.session)
        self._session_arrays = [*self.session.memory(), *self.session.inputs.values()]
        self._impulse_is_unknown, self._supports_jump, self._limit_ratio = (
            self.session.status[name] for name in ("unknown", "jumps", "limit_ratio")
        )
        self._run = StepperRun(self._pinned, self.compiled.inputs.pinned, self._stepper(t0, q, v), len(self.variables))
        self._out = self._run.out
        self._has_supports, self._has_limits = bool(self.compiled.inputs.own.supports.size), bool(own[1].size)
        self._reported_jumps: set[str] = set()  # names of inputs
        self._noted = self._start_diagnostics(t0, unstable, start_warnings, limited)
        self._noted_at_start = len(self._noted)
        how = settings.energy_check, self.stepper.freedom, settings.tolerance
        sizes = float(self.compiled.system.rate), float(self.compiled.length)
        state = self.t, self.stepper.q, self.stepper.v
        begin_session(self._pinned, *state, int(self.stepper.status.code), *how, *sizes)
        is_checked = bool(self.session.balance["is_checked"][0])
        self.energy_check = EnergyCheck(self.compiled, self.session.status) if is_checked else None
        self._element_monitor = ElementMonitor(self.compiled, float(self._limit_ratio[0]), t0, self.stepper.q)
        self._reported_undetermined, self._end = False, t0
        setters: Setters = {SetInput: self.set_input, SetParameter: self._set_parameter}
        self._events: RunEvents | None = None
        if self.compiled.mechanism.events:
            locked = LockedJoints(self.compiled, self._run, self._stepper, self._noted.append)
            self._events = RunEvents(self.compiled, self._run, setters, locked)
        self._check_actions()
        if self._events and begins:
            self._events.check_start()
        self._warm_up(t0, q, v)

    def _start_diagnostics(
        self, t: float, unstable: list[Diagnostic], start_warnings: list[Diagnostic], limited: list[Diagnostic]
    ) -> list[Diagnostic]:
        """Return the notes and warnings on the model, the solver and the start."""
        (q, v), settings, found = self.start, self.settings, self.solver_choice.diagnostics
        if self.compiled.system.has_matrices and self.compiled.system.m:
            rank = self.compiled.system.n_velocities - self.stepper.freedom
            if off := explain_rates(self.compiled, t, q, v, rank, settings.tolerance):
                raise UserError(f"model {self.model.name!r}: {off}", "singular-start")
        if self.stepper.starts_singular and (names := find_undetermined_rates(self.compiled, t, q)):
            found.append(filled(SINGULAR_START, time=t, **free_rates(names)))
        found += [*unstable, *self.compiled.explain_lock(t, q, self.stepper.freedom), *self.compiled.rounding]
        if not settings.start_at_equilibrium:
            found += self.compiled.assembly.changes(q, v, settings.tolerance)
        found += describe_loose(self.compiled, settings.tolerance)
        found += describe_coarse(self.compiled, settings.tolerance, self.stepper.freedom)
        found += describe_sticking(self.compiled, self.solver_choice.solver, settings.tolerance)
        found += [*limited, *start_warnings, *self.compiled.coincident(t, q), *self.compiled.describe_assumed_length()]
        known = {diagnostic.code for diagnostic in found}
        return [*found, *(note for note in self.compiled.assembly.notes(t, q) if note.code not in known)]

    def _starts(self, inputs: Mapping[Any, Any], t0: float) -> dict[int, float]:
        """Return the values of inputs at the start by their numbers, without those that are signals in this run."""
        given = dict(inputs)
        if self._given_inputs:
            for name in self._given_inputs.unused:
                self._input(name)  # raises
            given |= {held.name: held.value(t0) for held in self._given_inputs.held}
        checked = {key: finite(f"input {key!r}", value) for key, value in given.items()}
        signals = self._given_inputs.replaced if self._given_inputs else set()
        return {self._input(key): value for key, value in checked.items() if key not in signals}

    def _compile_held(self, inputs: Mapping[Any, Any], given: dict[int, float]) -> CompiledMechanism:
        """Return a compiled mechanism whose inputs are all held at their values at the start, to look for a steady
        state in.
        """
        compiled = self.model.compile()  # whose signals are held too
        if self._given_inputs:
            known = {v.name: k for k, v in enumerate(compiled.inputs.variables)}
            given = {known[name]: float(value) for name, value in {**inputs, **self._given_inputs.starts()}.items()}
        compiled.inputs.begin(0.0, given)
        return compiled

    def _stepper(self, t: float, q: Array, v: Array) -> Stepper:
        """Return the solver that was chosen, at a state."""
        try:
            created = self._created_stepper(t, q, v, self._options)
            self.step_count_check.attach(created)
            return created
        except ValueError as error:
            reason = str(error)
            if t == 0.0 and isinstance(error, ResolutionError) and error.of_time:  # only NaN is not resolved there
                text = "rates or accelerations at the start are too large for floating-point numbers"
                remedy = "Reduce gravity, forces, stiffness or velocities, or increase masses and lengths"
                reason = str(Diagnostic.error("clock-resolution", text, remedy))
            raise UserError(f"model {self.model.name!r}: {reason}") from error

    def _created_stepper(self, t: float, q: Array, v: Array, options: Options) -> Stepper:
        """Return the solver that was chosen, at a state; one from outside the package is guarded."""
        name, system = self.solver_choice.solver, self.compiled.system
        created = stepper(name, system, t, q, v, options)
        return created if name in SOLVER_NAMES else GuardedStepper(name, created, system, t, q, v)

    def _check_actions(self) -> None:
        """Refuse events that set an input or a parameter which does not exist, or to a value that is not allowed."""
        for event in self.compiled.mechanism.events:
            for action in event.actions:
                if isinstance(action, SetInput):
                    self.compiled.inputs.checked(self._input(action.name), action.value)
                elif isinstance(action, SetParameter):
                    self._adopt_compiled(self._compile_tuned(self.model.with_values({action.name: action.value})))
                    self._adopt_compiled(self.model.compile(self._given_inputs))

    def _copy_compiled(self) -> CompiledMechanism:
        """Return another compiled mechanism of the same model, whose inputs are what they are now."""
        compiled = self.model.compile(self._given_inputs)
        if self.settings.input_interpolation == "linear":
            compiled.inputs.extrapolate()
        compiled.inputs.restore(self.compiled.inputs.state())
        if self._events and self._events.locked.any:
            self._events.locked.lock_copy(compiled)
        return compiled

    def _report_step_count(self, found: Diagnostic) -> None:
        self._noted.append(found)
        if self.report is not None:
            self.report(found)

    def _warm_up(self, t0: float, q: Array, v: Array) -> None:
        """Have everything compiled that a run calls, once in a process for each kind of run."""
        solver = self.stepper.inner if isinstance(self.stepper, GuardedStepper) else self.stepper
        kind = (type(solver), self.compiled.system.m > 0)
        if kind in _compiled or not COMPILED:
            return
        options = replace(self._options, max_steps=MAX_WARMUP_STEPS)
        if compile_kernels(self._created_stepper(t0, q, v, options), self.compiled, len(self._out)):
            _compiled.add(kind)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Refuse to be copied or pickled, as its stepper does."""
        raise TypeError("a simulation cannot be copied or pickled: make another of the same model, and restore(save())")

    @property
    def stepper(self) -> Stepper:
        """Solver at work."""
        return self._run.stepper

    @stepper.setter
    def stepper(self, replacement: Stepper) -> None:
        self._run.stepper = replacement

    @property
    def discontinuity_work(self) -> float:
        """Work done on the mechanism by jumps of inputs and of tunable parameters, J: work of impulses of supports, and
        changes of potential energy at constant position.
        """
        return float(self.session.status["discontinuity_work"][0])

    @property
    def t(self) -> float:
        """Time reached, s."""
        return float(self.stepper.t)

    @property
    def _positions(self) -> Array:
        """Positions (nq,) at the time reached, without locked joints."""
        locks, (q, v, _) = self.compiled.locks, self.stepper.reported
        return locks.all_coordinates(q, v)[0]

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
    def _lost(self) -> tuple[Diagnostic, ...]:
        """Warning that the energy balance is violated; empty: it is not."""
        return self.energy_check.found if self.energy_check else ()

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
        return stepper.status

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

    def _input(self, key: int | str) -> int:
        """Return the number of an input."""
        index = self._inputs.get(key) if isinstance(key, Hashable) else None
        if index is None:
            if self._given_inputs and key in self._given_inputs.replaced:
                raise UserError(
                    f"input {key!r} is given for the whole run, as a function of time or by points; it cannot be set "
                    "during the run"
                )
            names = ", ".join(repr(name) for name in self._inputs if isinstance(name, str))
            raise UserError(f"there is no input {key!r}; this model has {names or 'none'}")
        return index

    def set_input(self, key: int | str, value: float, rate: float | None = None) -> None:
        """Set an input at the time reached.

        The input of a load is held or extrapolated from this time on, according to the settings. The input of a driven
        joint is its position or rate at the time reached. During the next communication step the joint moves to the
        position that is extrapolated to the end of this step, see :mod:`mbfmu.mechanics.arrays.support_motion`.

        Parameters
        ----------
        key
            Name or number of the input.
        value
            Value in the unit of the input.
        rate
            Time derivative of the input, in its unit per second, with which it continues until it is set again. None:
            it is held or extrapolated.

        Raises
        ------
        UserError
            There is no such input, it is given for the whole run, or a number is not finite. A rate is given for a
            component of gravity, or for an input that has another input as its rate or is that one.
        """
        index, inputs = self._input(key), self.compiled.inputs
        if rate is not None and not inputs.takes_rate(index):
            raise UserError(
                f"a rate was given for input {key!r}, which is a component of gravity, or has an input for its rate or "
                "is that input; set the input of the rate instead, or only the value"
            )
        given = nan if rate is None else finite(f"rate of input {key!r}", rate)
        SEQUENCE.set_input(self._run, index, inputs.checked(index, value), given)

    def retune(self, model: Model) -> None:
        """Change tunable parameters at the time reached.

        Parameters
        ----------
        model
            Model of the same class, with the new values.

        Raises
        ------
        UserError
            A parameter that is not tunable differs, or the structure would change.
        """
        if type(model) is not type(self.model):
            raise UserError(f"the model with new parameters is {short(model)}; allowed: a {type(self.model).__name__}")
        compiled = self._compile_tuned(model)
        SEQUENCE.note_energy(self._run)
        self._adopt_compiled(compiled)
        SEQUENCE.retune(self._run)
        self.model = model

    def _compile_tuned(self, model: Model) -> CompiledMechanism:
        """Return the compiled mechanism of a model that differs from the present one in tunable parameters alone."""
        for p in model.parameters():
            before, after = getattr(self.model, p.name), getattr(model, p.name)
            if before != after and not (p.varies(before) and p.varies(after)):
                why = f", from {before!r} to {after!r}" if p.tunable else ": it is not tunable"
                raise UserError(f"parameter {p.name!r} cannot change during a run{why}")
        return model.compile(self._given_inputs)

    def _adopt_compiled(self, compiled: CompiledMechanism) -> None:
        """Take the numbers of a compiled mechanism of the same structure, those of its events included."""
        if self._events:
            self._events.adopt(compiled.mechanism.events)
        self.compiled.adopt(compiled)

    def _set_parameter(self, name: str, value: Any) -> None:
        """Set a parameter at the time reached."""
        self.retune(self.model.with_values({name: value}))

    def checkpoint(self) -> Checkpoint:
        """Return a checkpoint of the present state for :meth:`rollback`; it costs less than :meth:`save`."""
        session, place = pack(self._session_arrays), self.stepper.save()
        reported = len(self._noted), frozenset(self._reported_jumps), self._reported_undetermined
        events = self._events.state() if self._events else {}
        return Checkpoint(place, session, self._lost, self._element_monitor.furthest, *reported, self.model, events)

    def rollback(self, checkpoint: Checkpoint) -> None:
        """Return to a checkpoint and discard everything after it, values of inputs and of parameters among it.

        Solvers that keep their history in arrays continue bit for bit as if the discarded advance had not been tried.
        ``ida``, whose history is inside SUNDIALS, is reinitialized at the state of the checkpoint.

        Parameters
        ----------
        checkpoint
            Checkpoint of this simulation.

        Raises
        ------
        UserError
            It is no checkpoint.
        """
        if not isinstance(checkpoint, Checkpoint):
            raise UserError(f"checkpoint is {checkpoint!r}; allowed: what checkpoint() of this simulation returned")
        if self._adopt(checkpoint.model):
            self.stepper.restart()  # the equations have changed
        if self._events:
            self._events.restore(checkpoint.events)
        self.stepper.restore(checkpoint.stepper)
        del self._noted[checkpoint.noted :]
        self._reported_jumps = set(checkpoint.reported_jumps)
        self._reported_undetermined = checkpoint.reported_undetermined
        self._element_monitor.rewind(checkpoint.furthest)
        self._restore_session(checkpoint.session, checkpoint.lost)

    def _adopt(self, model: Model) -> bool:
        """Take the parameters of a model; return whether they differ from the present ones."""
        differs = model != self.model
        if differs:
            self._adopt_compiled(model.compile(self._given_inputs))
            self.model = model
        return differs

    def _restore_session(self, session: bytes, lost: tuple[Diagnostic, ...]) -> None:
        """Restore the arrays of the session, and the message on the violation that they contain."""
        unpack(session, self._session_arrays)
        if self.energy_check:
            self.energy_check.found = lost

    @property
    def _state_key(self) -> str:
        """Model and settings that a simulation must have in common with this one to restore its states."""
        fixed = {p.name: getattr(self.model, p.name) for p in self.model.parameters() if not p.tunable}
        how = self.settings
        solver = how.solver, fingerprint_of_solver(how.solver)
        return json.dumps([self.model.name, fixed, *solver, how.tolerance, how.energy_check, how.input_interpolation])

    def save(self) -> bytes:
        """Return the whole state.

        Returns
        -------
        bytes
            State of solver, inputs and tunable parameters, for :meth:`restore` in this or another process.
        """
        changed = {p.name: getattr(self.model, p.name) for p in self.model.parameters() if p.tunable}
        head: dict[str, Any] = {"parameters": changed, "session": pack(self._session_arrays).hex()}
        head |= {
            "lost": [asdict(found) for found in self._lost],
            "bent": self._element_monitor.state(),
            "pick": self.solver_choice,
        }
        if self._events:
            head["events"] = self._events.state()
        return encode_state(self._state_key, head, self.stepper.save())

    def restore(self, state: bytes) -> None:
        """Continue from a state that a simulation of the same model and settings has saved.

        Messages on the run until now are discarded, but for those on the start and the energy balance of the state.

        Parameters
        ----------
        state
            State from :meth:`save`.

        Raises
        ------
        UserError
            The state is damaged, or of another model or other settings; nothing has changed then.
        """
        head, body = decode_state(self._state_key, state)
        self._adopt(self.model.with_values(head["parameters"]))
        self._restore_session(bytes.fromhex(head["session"]), from_saved(head["lost"]))
        previous, self.solver_choice = self.solver_choice, SolverChoice(*head["pick"])
        if self._events:
            self._events.restore(head["events"])
        if self.solver_choice.solver != previous.solver:  # auto takes another one at other parameters
            self.stepper = self._stepper(self.t, self.stepper.q, self.stepper.v)
        self.stepper.restart()  # the equations may have changed
        self.stepper.restore(body)
        self._element_monitor.restore(head["bent"], self.t, self._positions)
        del self._noted[self._noted_at_start :]
        self._reported_jumps, self._reported_undetermined = set(), False


class UnstartedSimulation(Simulation):
    """A simulation that is not to run: nothing is compiled for that, and its arrays are as they are at the start."""

    def _warm_up(self, *_: Any) -> None:
        """Do nothing."""
