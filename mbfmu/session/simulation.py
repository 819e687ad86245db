"""A run of a model in Python: behind direct runs, and behind FMUs that call Python."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.arrays.given_inputs import GivenInputs
from mbfmu.mechanics.events import SetInput, SetParameter
from mbfmu.mechanics.numbers import finite
from mbfmu.modeling.model import Model, as_model
from mbfmu.modeling.settings import AUTO, Settings
from mbfmu.modeling.variables import ENERGY_OUTPUTS, require_unique
from mbfmu.steady.equilibrium import build_problem, find_state, report_unstable
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import COMPILED
from solvers.compiled.tuple_pointer import pin
from solvers.steppers import SOLVERS, eliminates_implicitly
from solvers.steppers.guard import GuardedStepper

from .element_monitor import ElementMonitor
from .energy_check import EnergyCheck
from .events import RunEvents, Setters
from .failure_diagnosis import explain_rates, find_undetermined_rates, free_rates
from .kept_starts import KeptStart, MemoryImage, Start
from .kernels.points import Session, begin_session
from .locked_joints import LockedJoints
from .run_messages import SINGULAR_START, describe_earlier_events, filled
from .run_progress import RunProgress
from .solver_selection import SolverChoice, limit_order, select_solver
from .step_count import StepCountCheck
from .stepper_run import StepperRun
from .tolerances import describe_coarse, describe_loose, describe_sticking
from .warmup import MAX_WARMUP_STEPS, compile_kernels
from .wheel_monitor import WheelMonitor

__all__ = ["Settings", "Simulation"]

Array = NDArray[np.float64]

_compiled: set[tuple[type, bool]] = set()  # kinds of runs whose kernels this process has compiled


class Simulation(RunProgress):
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
    kept
        Compiled mechanism of the model, with what an earlier run with the same arguments has found about its start.

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
        kept: KeptStart | None = None,
    ) -> None:
        self.model = model_given = as_model(model)
        self.settings = settings = settings.for_model(model_given)
        self._given_inputs = given_inputs
        if not isinstance(inputs or {}, Mapping):
            raise UserError(f"inputs are {inputs!r}; allowed: values by the names or the numbers of inputs")
        own = kept or KeptStart(model_given.compile(given_inputs), given_inputs)
        self.compiled, is_repeated = own.compiled, own.start is not None
        if settings.input_interpolation == "linear" and not is_repeated:
            self.compiled.inputs.extrapolate()
        known = enumerate(self.compiled.inputs.variables)
        self._inputs: dict[Hashable, int] = {key: k for k, v in known for key in (v.name, k)}
        if own.start is None:
            own.remember_start(self._find_start(inputs or {}, t0, begins, duration))
        else:
            own.restore_before_solver()
        assert own.start is not None
        q, v, self.solver_choice, self._options, self.steady_state, found = own.start
        self.start = q, v
        self.step_count_check = StepCountCheck(self._copy_compiled, self._options, self._report_step_count)
        self.report: Callable[[Diagnostic], None] | None = None
        self.variables = (*self.compiled.outputs, *ENERGY_OUTPUTS)
        require_unique(["time", *(v.name for v in (*self.compiled.inputs.variables, *self.variables))])
        monitored = self.compiled.monitored
        self.session = Session.allocate(self.compiled.system.pinned_data, self.compiled.inputs.own, monitored)
        self._pinned = pin(self.session)
        self._session_arrays = [*self.session.memory(), *self.session.inputs.values(), *self.compiled.histories]
        self._impulse_is_unknown, self._supports_jump, self._limit_ratio = (
            self.session.status[name] for name in ("unknown", "jumps", "limit_ratio")
        )
        self._run = StepperRun(self._pinned, self.compiled.inputs.pinned, self._stepper(t0, q, v), len(self.variables))
        self._out = self._run.out
        self._has_supports, self._has_limits = bool(self.compiled.inputs.own.supports.size), bool(monitored.size)
        self._reported_jumps: set[str] = set()  # names of inputs
        if is_repeated:
            own.restore_diagnosed()
        else:
            own.remember_diagnostics(self._start_diagnostics(t0, *found))
        self._noted = list(own.noted)
        self._noted_at_start = len(self._noted)
        how = settings.energy_check, self.stepper.freedom, settings.tolerance
        sizes = float(self.compiled.system.rate), float(self.compiled.length)
        state = self.t, self.stepper.q, self.stepper.v
        begin_session(self._pinned, *state, int(self.stepper.status.code), *how, *sizes)
        is_checked = bool(self.session.balance["is_checked"][0])
        self.energy_check = EnergyCheck(self.compiled, self.session.status) if is_checked else None
        self._element_monitor = ElementMonitor(self.compiled, float(self._limit_ratio[0]), t0, self.stepper.q)
        self._reported_undetermined, self._end = False, t0
        self._wheels = WheelMonitor(self.compiled, settings.tolerance)
        self._note_wheels([(t0, q, v)])
        self._events = self._create_events()
        self._check_actions()
        if self._events and begins:
            self._events.check_start()
            self._start_events(self._events)
        self._warm_up(t0, q, v)

    def _create_events(self) -> RunEvents | None:
        """Return the events and the sampled blocks of the run; None if the mechanism has none."""
        if not (self.compiled.mechanism.events or self.compiled.mechanism.sampled):
            return None
        solver, system = self.solver_choice.solver, self.compiled.system
        by_matrices = solver in SOLVERS and not eliminates_implicitly(solver, system)
        locked = LockedJoints(self.compiled, self._run, self._stepper, self._noted.append, by_matrices)
        setters: Setters = {SetInput: self.set_input, SetParameter: self._set_parameter}
        return RunEvents(self.compiled, self._run, setters, locked)

    def _find_start(self, inputs: Mapping[Any, Any], t0: float, begins: bool, duration: float | None) -> Start:
        """Close the loops, or find the steady state in which the run starts, and select the solver."""
        settings, steady_state, unstable = self.settings, None, list[Diagnostic]()
        given = self._starts(inputs, t0)
        if settings.start_at_equilibrium:  # whose time is zero; the drives are where they are at the start time
            steady_state = find_state(build_problem(self.model, self._compile_held(inputs, given)))
            unstable = report_unstable(steady_state)
        self.compiled.inputs.begin(t0, given)
        q, v = (steady_state.q, steady_state.v) if steady_state else self.compiled.assemble(t0)
        start_warnings = self.compiled.check_start(t0, q) if begins else []
        if duration is not None and finite("duration", duration) < 0.0:
            raise UserError(f"duration is {duration!r}; allowed: at least 0 s (0: the stop time of the model)")
        options, choice = settings.options(duration or self.model.stop_time), SolverChoice(settings.solver)
        if settings.solver == AUTO:
            choice = select_solver(self.compiled, [(t0, q, v)], options)
        options, limited = limit_order(self.compiled, choice.solver, (t0, q, v), options)
        return Start(q, v, choice, options, steady_state, (unstable, start_warnings, limited))

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
        found += describe_earlier_events(self.compiled.mechanism.events, t)
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

    def _start_events(self, events: RunEvents) -> None:
        """Execute the events of the start time."""
        events.start()

    def _warm_up(self, t0: float, q: Array, v: Array) -> None:
        """Have everything compiled that a run calls, once in a process for each kind of run."""
        solver = self.stepper.inner if isinstance(self.stepper, GuardedStepper) else self.stepper
        kind = (type(solver), self.compiled.system.m > 0)
        if kind in _compiled or not COMPILED:
            return
        options = replace(self._options, max_steps=MAX_WARMUP_STEPS)
        q, v = self.compiled.locks.free_coordinates(q, v)
        memory = MemoryImage([array for array in self.compiled.data.state if isinstance(array, np.ndarray)])
        with self.compiled.histories_kept():
            if compile_kernels(self._created_stepper(t0, q, v, options), self.compiled, len(self._out)):
                _compiled.add(kind)
        memory.restore()  # the first run in a process is as any other

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Refuse to be copied or pickled, as its stepper does."""
        raise TypeError("a simulation cannot be copied or pickled: make another of the same model, and restore(save())")


class UnstartedSimulation(Simulation):
    """A simulation that is not to run: nothing is compiled for that, and its arrays are as they are at the start."""

    def _warm_up(self, *_: Any) -> None:
        """Do nothing."""

    def _start_events(self, events: RunEvents) -> None:
        """Do nothing."""
