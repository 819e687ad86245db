"""The FMI 2.0 co-simulation slave around any model.

**Errors of the importing tool.** PythonFMU's wrapper gives this class one status to choose, that of fmi2DoStep: fmi2OK
or fmi2Discard. All other calls return fmi2OK, or fmi2Fatal where an exception leaves them. So what a host does wrong (a
call that its state does not allow, a value that is refused, a state that is damaged) is logged at once as an error,
changes nothing, and is the reason why the next step is discarded; what was refused stays the reason until it is given
right. Only where initialization fails, which must not look well, an exception leaves. A lost energy balance is logged
as a warning. The last sentence stands in ``solver.message`` until a step goes well.

A discarded step leaves everything as it was where the step began, and may be tried again, shorter.
"""

from __future__ import annotations

import ctypes
from dataclasses import replace
from math import isfinite, nan
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pythonfmu.enums import Fmi2Status

from mbfmu.modeling.model import Model
from mbfmu.modeling.settings import Settings
from mbfmu.session.serialization import decode_state, encode_state
from mbfmu.session.simulation import Simulation
from mbfmu.util.diagnostics import INACCURATE_CODES, Diagnostic
from mbfmu.util.errors import UserError
from solvers.compiled.cache import when_compiling

from .description import LOG_CATEGORIES, Experiment, Identity, model_description
from .guards import finalize_at_exit, import_once
from .values import Phase, Values, error_text, guarded

Array = NDArray[np.float64]

FMU_STATE_FORMAT = 6
MAX_REPORTED_ERRORS = 5  # errors that are reported one by one
CLOCK_TOLERANCE = 1e-9  # s, or part of the time: so much may a host's clock differ from ours

Key = tuple[str, str, str]


def key_of(diagnostic: Diagnostic) -> Key:
    """Return what a diagnostic has in common with later ones on the same, such as a larger bend."""
    return diagnostic.severity, diagnostic.code, diagnostic.subject


class ModelSlave(Values):
    """One instance of a model in a host. Subclasses, one per FMU, set the class attributes."""

    fmu_guid: ClassVar[str] = ""
    experiment: ClassVar[Experiment]

    log_categories: ClassVar[dict[str, str]] = LOG_CATEGORIES

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.modelName = self.identifier  # by which PythonFMU names files
        self._t0 = 0.0
        self._logged: set[Key] = set()  # what is in the log of the simulation
        with when_compiling(self._log_compiling):
            self.declare(self.model.compile())
        finalize_at_exit(self.resources, self.identifier)
        import_once(self.resources)

    def _log_compiling(self) -> None:
        text = "compiling; this takes up to three minutes, once per machine"
        self._print(text)
        self.log(text, Fmi2Status.ok, "logAll")

    def to_xml(self, _options: dict[str, str] | None = None) -> Any:
        """Return the model description."""
        model = self.model
        who = {"name": model.name, "identifier": self.identifier, "guid": self.fmu_guid}
        identity = Identity(**who, description=model.title(), tool="PythonFMU")
        return model_description(identity, self.experiment, self.variables, self.log_categories)

    # ---- life of an instance ------------------------------------------------------------------------------------

    @guarded
    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Note the start time, and the host's tolerance unless the parameter was set."""
        if self._phase is not Phase.INSTANTIATED:
            self._report_protocol_error("fmi2SetupExperiment was called after the initialization; allowed: before it")
            return
        if not isfinite(start_time):
            self._reject_value("experiment", f"the start time is {start_time!r}; allowed: a finite number")
            return
        if stop_time is not None and not stop_time >= start_time:
            self._reject_value(
                "experiment",
                f"the stop time is {stop_time!r} s; allowed: not before the start time of {start_time!r} s",
            )
            return
        self._rejected.pop("experiment", None)
        self._t0 = start_time
        reference = self._settings["tolerance"]
        if tolerance and reference not in self._changed_references:
            if wrong := self._describe_invalid(self.variables[reference], tolerance):
                self._reject_value("experiment", wrong)
                return
            self._buffer[reference] = tolerance

    @guarded
    def _refresh(self) -> None:
        self._buffer[self._outputs] = nan
        if self._phase is Phase.INITIALIZING:
            self._start_simulation()
        elif self._phase is Phase.RUNNING:  # an input changes accelerations and forces at once
            self._apply_changes()
        if self.simulation is not None:
            self._buffer[self._outputs] = self.simulation.outputs()
            self._outputs_valid = True

    @guarded
    def enter_initialization_mode(self) -> None:
        """Outputs may be read from now on: the model is started whenever one is."""
        if self._phase is not Phase.INSTANTIATED:
            self._report_protocol_error(
                f"fmi2EnterInitializationMode is not allowed while the FMU is {self._phase.name.lower()}"
            )
            return
        self._phase, self._outputs_valid = Phase.INITIALIZING, False

    def exit_initialization_mode(self) -> None:
        """Build, assemble and start the model from the parameters as they are now."""
        if self._phase is not Phase.INITIALIZING:
            self._report_protocol_error(
                f"fmi2ExitInitializationMode is not allowed while the FMU is {self._phase.name.lower()}"
            )
            return
        try:
            if self._rejected:  # other errors of the importing tool are reported by its first step
                raise UserError("; ".join(self._rejected.values()))
            if not self._outputs_valid:
                self._start_simulation()
                assert self.simulation is not None
                self._buffer[self._outputs] = self.simulation.outputs()
            self._logged = {key for key in self._logged if key[0] == "note"}  # warnings are those of each run
            self._log_new()
        except Exception as error:
            self._phase, self.simulation = Phase.FAILED, None
            self.fail(error_text(error))
            self._keep_alive()
            raise
        self._phase, self._outputs_valid = Phase.RUNNING, True
        self._changed_references.clear()

    def _keep_alive(self) -> None:
        """Have references for those that the wrapper drops when an exception leaves, and drops again in the end."""
        for dropped in (self, type(self), self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(dropped))

    def _start_simulation(self) -> None:
        """Start a simulation from the values as they are."""
        self.simulation = None
        given = {k: float(self._buffer[r]) for k, r in enumerate(self._inputs) if r in self._changed_references}
        settings = self._settings_of(self._buffer)
        self.simulation = self._new_simulation(self._model_of(self._buffer), settings, self._t0, given)
        for reference, variable in zip(self._inputs, self.simulation.compiled.inputs.variables, strict=True):
            if reference not in self._changed_references:  # it starts where the parameters put it
                self._buffer[reference] = variable.start

    def _new_simulation(
        self, model: Model, settings: Settings, t0: float, inputs: dict[int, float], *, begins: bool = True
    ) -> Simulation:
        with when_compiling(self._log_compiling):
            return Simulation(model, settings, t0, inputs, begins=begins)

    def _settings_of(self, values: Array) -> Settings:
        return Settings(**{name: self.variables[r].value_of(values[r].item()) for name, r in self._settings.items()})

    def _model_of(self, values: Array) -> Model:
        given = {name: self.variables[r].value_of(values[r].item()) for r, name in self._parameters.items()}
        return self.model.with_values(given)

    @guarded
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance by a communication step; False (fmi2Discard) on failure, with the reason in the log."""
        self._raise_rejected()
        simulation = self._simulation_for_step(current_time, step_size)
        self._apply_changes()
        if step_size == 0.0:
            self.message = self._balance_message()
            return True
        checkpoint = simulation.checkpoint()
        try:
            simulation.advance(max(simulation.t, current_time + step_size))  # the host's clock may be a little slow
            if simulation.failed:
                raise UserError(simulation.failure)
            if simulation.ended:
                last = simulation.events[-1]
                raise UserError(f"event {last.name!r} ends the run at t = {last.time:.9g} s; step to this time at most")
        except Exception:
            simulation.rollback(checkpoint)
            raise
        self._outputs_valid, self.message = False, self._balance_message()
        self._log_new()
        return True

    def _simulation_for_step(self, t: float, step: float) -> Simulation:
        """Return the simulation where a step from t may be made; else say why not."""
        if self._phase is not Phase.RUNNING or self.simulation is None:
            reason = self.message if self._phase is Phase.FAILED else ""
            raise UserError(reason or f"a step is not allowed while the FMU is {self._phase.name.lower()}", "fmi-call")
        if not (isfinite(t) and step >= 0.0 and isfinite(step)):
            raise UserError(
                f"a step from {t!r} s by {step!r} s was requested; allowed: finite times, and a step size that is not "
                "negative",
                "fmi-call",
            )
        here = self.simulation.t
        if not abs(t - here) <= CLOCK_TOLERANCE * max(1.0, abs(here)):
            raise UserError(
                f"a step from {t!r} s was requested, but the FMU has reached {here!r} s; continue from this time, or "
                "restore an FMU state saved at the other time",
                "fmi-call",
            )
        return self.simulation

    def _balance_message(self) -> str:
        """Return the warning that the energy error is too large; empty: it is not."""
        found = self.simulation.diagnostics if self.simulation is not None and self.simulation.inaccurate else ()
        return next((str(d) for d in found if d.code in INACCURATE_CODES), "")

    def _log_new(self) -> None:
        """Log the notes and warnings that are not in the log; print that the energy error is too large."""
        assert self.simulation is not None
        found = {key_of(d): d for d in reversed(self.simulation.diagnostics)}
        for d in (found[key] for key in reversed(found) if key not in self._logged):
            if d.severity == "note":
                self.log(str(d), Fmi2Status.ok, "logAll")
            else:
                self.log(str(d), Fmi2Status.warning, "logStatusWarning")
            if d.code in INACCURATE_CODES:
                self._print(str(d))
        self._logged = set(found)

    def _apply_changes(self) -> None:
        """Let what was set reach the simulation, in the order of :mod:`mbfmu.session.kernels.sequence`."""
        simulation = self.simulation
        assert simulation is not None
        if not self._changed_references:
            return
        parameters = [r for r in sorted(self._changed_references) if r in self._parameters]
        if parameters:  # others may have been changed by events
            given = {self._parameters[r]: self.variables[r].value_of(self._buffer[r].item()) for r in parameters}
            simulation.retune(simulation.model.with_values(given))
        for index, reference in enumerate(self._inputs):
            if reference in self._changed_references:
                simulation.set_input(index, float(self._buffer[reference]))
        self._changed_references.clear()
        self._outputs_valid = False

    def _raise_rejected(self) -> None:
        made = [f"{text} ({n} times)" if n > 1 else text for text, n in self._protocol_errors.items()]
        left = f"{len(made) - MAX_REPORTED_ERRORS} other errors" if len(made) > MAX_REPORTED_ERRORS else ""
        reasons = [*self._rejected.values(), *made[:MAX_REPORTED_ERRORS], *filter(None, [left])]
        self._protocol_errors.clear()
        if reasons:
            raise UserError("; ".join(reasons))

    def terminate(self) -> None:
        """Do nothing but end: all memory is Python's."""
        self._phase = Phase.TERMINATED

    # ---- FMU state ----------------------------------------------------------------------------------------------

    def _get_fmu_state(self) -> bytes:
        header = {
            "format": FMU_STATE_FORMAT,
            "values": self._buffer.tolist(),
            "changed": sorted(self._changed_references),
            "t0": self._t0,
            "phase": self._phase.name,
            "message": self.message,
        }
        return encode_state(self._state_key, header, self.simulation.save() if self.simulation else b"")

    @property
    def _state_key(self) -> str:
        return f"{self.fmu_guid} {FMU_STATE_FORMAT}"

    def _set_fmu_state(self, state: bytes) -> None:
        """Take up a state; a bad one changes nothing, and no step is made until a good one is given."""
        try:
            self._restore_instance(*decode_state(self._state_key, state))
        except Exception as error:
            self._reject_value("FMU state", f"the FMU state cannot be restored: {error_text(error)}")

    def _restore_instance(self, head: dict[str, Any], body: bytes) -> None:
        """Restore an instance; a simulation that differs in fixed parameters is rebuilt, without a steady state."""
        values, t0, simulation = np.array(head["values"]), head["t0"], None
        if body:
            model, settings = self._model_of(values), self._settings_of(values)
            simulation = self.simulation if self._is_same_model(model, settings) else None
            if simulation is None:
                simulation = self._new_simulation(
                    model, replace(settings, start_at_equilibrium=False), t0, {}, begins=False
                )
                self._logged |= set(map(key_of, simulation.diagnostics))  # the instance that was saved has logged them
            simulation.restore(body)
        self.simulation, self._t0, self._buffer[:] = simulation, t0, values
        self._changed_references, self._phase, self.message = (
            set(head["changed"]),
            Phase[head["phase"]],
            head["message"],
        )
        self._rejected.clear()
        self._protocol_errors.clear()
        self._outputs_valid = False

    def _is_same_model(self, model: Model, settings: Settings) -> bool:
        """Whether the simulation is of such a model, but for what is tunable, and settings."""
        here = self.simulation
        if here is None:
            return False
        alike = replace(here.settings, start_at_equilibrium=settings.start_at_equilibrium) == settings
        return alike and here.model.with_values(tunable(model)) == model

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)


def tunable(model: Model) -> dict[str, Any]:
    """Return the values of a model's parameters that may change."""
    return {p.name: getattr(model, p.name) for p in model.parameters() if p.tunable}
