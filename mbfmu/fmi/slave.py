"""The FMI 2.0 co-simulation slave around any model.

PythonFMU turns an exception that leaves a callback into fmi2Fatal and then frees what it should not, so none may: a
failure is logged, printed to stderr, kept in ``solver.message``, and makes every step return fmi2Discard; the last good
state stays. A lost energy balance is told in the same places, as a warning: the wrapper cannot return fmi2Warning, so
the step returns fmi2OK.
"""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from pythonfmu import DefaultExperiment
from pythonfmu.enums import Fmi2Status

import mbfmu
from mbfmu.errors import UserError
from mbfmu.mechanics.numbers import finite
from mbfmu.model import Model, Parameter
from mbfmu.simulation import Settings, Simulation

from .guards import finalize_at_exit
from .interface import Interface

STATE_FORMAT = 2


def guarded(callback: Callable[..., Any]) -> Callable[..., Any]:
    """Let no exception escape a callback."""

    @functools.wraps(callback)
    def safe(self: ModelSlave, *args: Any) -> Any:
        try:
            return callback(self, *args)
        except Exception as error:
            self.fail(error if isinstance(error, UserError) else f"{type(error).__name__}: {error}")
            return False

    return safe


class ModelSlave(Interface):
    """One instance of a model in a host. Subclasses, one per FMU, set the class attributes."""

    identifier: ClassVar[str] = "model"
    fmu_guid: ClassVar[str] = ""

    log_categories: ClassVar[dict[str, str]] = {
        "logStatusWarning": "something unusual that does not stop the run",
        "logStatusError": "a failure: what happened, where, and what to try",
        "logAll": "everything",
    }

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.modelName = self.identifier
        self.guid = self.fmu_guid
        self.version = mbfmu.__version__
        self.author = "mbfmu"
        self.description = self.model.title()
        self.default_experiment = DefaultExperiment(
            start_time=0.0,
            stop_time=self.model.stop_time,
            step_size=self.model.output_interval,
            tolerance=self.settings.tolerance,
        )
        self._t0 = 0.0
        self._refused: dict[str, str] = {}  # variable -> why its last value was not taken
        self._changed: set[int] = set()  # value references of inputs and parameters set since the last step
        self._remarked = 0  # how many of the simulation's remarks are in the log
        self._coarse = False  # that a grid is too coarse is in the log
        self._fresh = True  # outputs are those of the present state
        self._told: list[str] = []  # of the loops, in the log
        self.register(self.model.build().compile())
        finalize_at_exit(self.resources, self.identifier)

    # ---- values -------------------------------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return real values; outputs are evaluated once a step, when first asked for."""
        if not self._fresh:
            self._refresh()
        values: list[float] = self._buffer[vrs].tolist()
        return values

    @guarded
    def _refresh(self) -> None:
        assert self.simulation is not None
        self._buffer[self._outputs] = self.simulation.outputs()
        self._fresh = True

    @guarded
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Take real values; one that is not finite is refused, and the next step fails unless it is set anew."""
        for reference, value in zip(vrs, values, strict=True):
            self._take(reference, self.vars[reference].name, value)

    def _take(self, reference: int, name: str, value: float) -> None:
        if not np.isfinite(value):
            self._refused[name] = f"{name!r} was set to {value!r}; allowed: a finite number"
            self._report(self._refused[name])
            return
        self._refused.pop(name, None)
        same = self._buffer[reference] == value and reference not in self._motions  # a support may have moved since
        if not same or self.simulation is None:
            self._buffer[reference] = value
            self._changed.add(reference)

    # ---- life of an instance ------------------------------------------------------------------------------------

    @guarded
    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Note the start time, and the host's tolerance unless the parameter was set."""
        self._t0 = finite("the start time", start_time)
        reference = self.setting_reference("tolerance")
        if tolerance and reference not in self._changed:
            self._buffer[reference] = tolerance

    @guarded
    def exit_initialization_mode(self) -> None:
        """Build, assemble and start the model from the parameters as they are now."""
        self._raise_refused()
        model = self._model_now()
        given = {k: float(self._buffer[r]) for k, r in enumerate(self._inputs) if r in self._changed}
        self.simulation = Simulation(model, self._settings_now(), self._t0, given)
        for reference, variable in zip(self._inputs, self.simulation.plant.inputs.variables, strict=True):
            if reference not in self._changed:  # it starts where the parameters put it
                self._buffer[reference] = variable.start
        self._changed.clear()
        self._refresh()
        self._tell_loops()

    def _tell_loops(self) -> None:
        """Log what is void or redundant in the loops, unless it was: restoring a state starts the model anew."""
        assert self.simulation is not None
        told, self._told = self._told, self.simulation.loops()
        if told != self._told:
            for line in self._told:
                self.log(line, Fmi2Status.ok, "logAll")

    def _settings_now(self) -> Settings:
        values: dict[str, Any] = dict(self._texts)
        for name, reference in self._settings.items():
            kind = type(getattr(self.settings, name))
            values[name] = kind(self._buffer[reference])
        return Settings(**values)

    def _model_now(self) -> Model:
        return self.model.with_values({p.name: self._value(r, p) for r, p in self._parameters.items()})

    def _value(self, reference: int, declared: Parameter) -> Any:
        value = self._buffer[reference].item()
        return bool(value) if isinstance(declared.default, bool) else value

    @guarded
    def do_step(self, current_time: float, step_size: float) -> bool:
        """Advance by a communication step; False (fmi2Discard) on failure, with the reason in the log."""
        if self.simulation is None:
            self._report(self.message or "the model was not started")
            return False
        self._raise_refused()
        self._apply_changes()
        if step_size == 0.0:
            return True
        self.simulation.advance(current_time + step_size)
        self._fresh = False
        for text in self.simulation.remarks[self._remarked :]:
            self._warn(text)
        self._remarked = len(self.simulation.remarks)
        if self.simulation.failure:
            self.fail(self.simulation.failure)
            return False
        self._warn_of_motion()
        return True

    def _warn_of_motion(self) -> None:
        """Say once each that the energy balance is lost, which hosts can read too, and that a grid is too coarse."""
        assert self.simulation is not None
        if self.simulation.verdict and not self.message:
            self.message = self.simulation.verdict
            self._print(self.message)
            self._warn(self.message)
        if self.simulation.coarse and not self._coarse:
            self._coarse = True
            self._warn(self.simulation.coarse)

    def _warn(self, text: str) -> None:
        self.log(text, Fmi2Status.warning, "logStatusWarning")

    def _apply_changes(self) -> None:
        simulation = self.simulation
        assert simulation is not None
        if not self._changed:
            return
        if any(reference in self._parameters for reference in self._changed):
            simulation.retune(self._model_now())
        for index, reference in enumerate(self._inputs):
            if reference in self._changed:
                simulation.set_input(index, float(self._buffer[reference]))
        self._changed.clear()
        self._fresh = False

    def _raise_refused(self) -> None:
        if self._refused:
            raise UserError("; ".join(self._refused.values()))

    @guarded
    def terminate(self) -> None:
        """Say how far cells have bent at the worst; nothing to release, all memory is Python's."""
        if self.simulation is not None and self.simulation.coarse and not self.simulation.failure:
            self._print(f"warning: {self.simulation.coarse}")

    # ---- failures -----------------------------------------------------------------------------------------------

    def fail(self, reason: object) -> None:
        """Keep the reason where a host can read it."""
        self.message = str(reason)
        self._report(self.message)

    def _report(self, text: str) -> None:
        self._print(text)
        self.log(text, Fmi2Status.error, "logStatusError")

    def _print(self, text: str) -> None:
        print(f"{self.identifier} ({self.instance_name}): {text}", file=sys.stderr)  # noqa: T201

    # ---- FMU state ----------------------------------------------------------------------------------------------

    @guarded
    def _get_fmu_state(self) -> bytes:
        head = {
            "format": STATE_FORMAT,
            "guid": self.fmu_guid,
            "values": self._buffer.tolist(),
            "texts": self._texts,
            "changed": sorted(self._changed),
            "t0": self._t0,
            "started": self.simulation is not None,
        }
        text = json.dumps(head).encode()
        body = self.simulation.save() if self.simulation else b""
        return len(text).to_bytes(8, "little") + text + body

    @guarded
    def _set_fmu_state(self, state: bytes) -> None:
        split = 8 + int.from_bytes(state[:8], "little")
        head = json.loads(state[8:split])
        if head["format"] != STATE_FORMAT or head["guid"] != self.fmu_guid:
            raise UserError("the FMU state was saved by another FMU or another version; it cannot be restored here")
        self._buffer[:] = head["values"]
        self._texts.update(head["texts"])
        self._t0 = head["t0"]
        self._changed.clear()
        self._refused.clear()
        self.message = ""
        self.simulation, self._remarked = None, 0
        if head["started"]:
            self.exit_initialization_mode()
            assert self.simulation is not None
            self.simulation.restore(state[split:])
            self._buffer[:] = head["values"]  # of which the start took what is the model's
            self._fresh = False
        self._changed = set(head["changed"])

    @staticmethod
    def _fmu_state_to_bytes(state: bytes) -> bytes:
        return state

    @staticmethod
    def _fmu_state_from_bytes(state: bytes) -> bytes:
        return bytes(state)
