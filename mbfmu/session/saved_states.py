"""States of a run that it returns to: checkpoints in memory, and saved states for other processes."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.modeling.model import Model
from mbfmu.modeling.settings import Settings
from mbfmu.util.diagnostics import Diagnostic, from_saved
from mbfmu.util.errors import UserError
from solvers import Options, stepper
from solvers.resolution import ResolutionError
from solvers.stepper import Stepper, pack, unpack
from solvers.steppers import SOLVER_NAMES, fingerprint_of_solver
from solvers.steppers.guard import GuardedStepper

from .element_monitor import ElementMonitor, Furthest
from .energy_check import EnergyCheck
from .inputs_and_parameters import InputsAndParameters
from .serialization import decode_state, encode_state
from .solver_selection import SolverChoice
from .step_count import StepCountCheck

Array = NDArray[np.float64]


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


class SavedStates(InputsAndParameters):
    """Base of :class:`.Simulation`: its solver, and the states that it can return to."""

    settings: Settings
    solver_choice: SolverChoice
    step_count_check: StepCountCheck
    energy_check: EnergyCheck | None
    _options: Options
    _session_arrays: list[NDArray[Any]]
    _element_monitor: ElementMonitor
    _noted: list[Diagnostic]
    _noted_at_start: int
    _reported_jumps: set[str]  # names of inputs
    _reported_undetermined: bool

    @property
    def stepper(self) -> Stepper:
        """Solver at work."""
        return self._run.stepper

    @stepper.setter
    def stepper(self, replacement: Stepper) -> None:
        self._run.stepper = replacement

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
    def _lost(self) -> tuple[Diagnostic, ...]:
        """Warning that the energy balance is violated; empty: it is not."""
        return self.energy_check.found if self.energy_check else ()

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
        fixed |= self.model.other_values()
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
