"""A run of any solver in Python: what :mod:`.kernels.sequence` calls, by the methods of a stepper."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers import SolverError
from solvers.outcome import OK
from solvers.stepper import Samples, Stepper
from solvers.system import Array

from .kernels.sequence import SolverActions, sampling_of, sequence_of


class StepperRun:
    """A run as :class:`.kernels.sequence.Run` declares it, whose reported state is that of a stepper.

    Attributes
    ----------
    stepper
        Solver of the run; another one may take its place.
    q, v, energy_account
        Its reported state, see :attr:`solvers.Stepper.reported`.
    error
        Error of the last evaluation that failed; None: none has failed.
    samples, ratios
        Motion at the points of the last call of SAMPLE, and how far elements are from their limits there (k,).
    search
        The search for events, pinned, see :class:`.event_search.CrossingSearch`.
    step_begin
        State of the solver at the begin of the last step and the target of the step, s; None: it has a dense output.
    """

    samples: Samples
    ratios: Array
    search: Any
    step_begin: tuple[bytes, float] | None = None

    def __init__(self, session: Any, inputs: Any, stepper: Stepper, outputs: int) -> None:
        self.session, self.inputs, self.stepper = session, inputs, stepper
        self.a, self.lam = np.zeros(0), np.zeros(0)
        self.dv, self.out = np.zeros(len(stepper.v)), np.zeros(outputs)
        self.error: SolverError | None = None

    @property
    def stepper(self) -> Stepper:
        """See the class."""
        return self._stepper

    @stepper.setter
    def stepper(self, replacement: Stepper) -> None:
        self._stepper = replacement
        self.q, self.v, self.energy_account = replacement.reported

    @property
    def clock(self) -> tuple[float]:
        """Time reached, s."""
        return (self._stepper.t,)


def _advance(run: StepperRun, end: float) -> int:
    stepper = run.stepper
    code: int = stepper.advance(end).code
    run.q, run.v, run.energy_account = stepper.reported
    return code


def _evaluate(run: StepperRun) -> int:
    try:
        run.a, run.lam = run.stepper.accelerations()  # the limit along the motion in a singular configuration
    except SolverError as error:
        run.error = error
        return int(error.status.code)
    return OK


def _continue_at_state(run: StepperRun) -> None:
    run.stepper.continue_after_event()


def _restart(run: StepperRun) -> None:
    run.stepper.restart()


def _jump(run: StepperRun) -> None:
    run.stepper.jump(run.dv)
    run.q, run.v, run.energy_account = run.stepper.reported


def _sample(run: StepperRun, times: Array, out: Array) -> Samples:
    found = run.stepper.sample(times, out)
    run.q, run.v, run.energy_account = run.stepper.reported
    return found


# where any stepper leaves the bodies is not known
SEQUENCE = sequence_of(SolverActions(_advance, _evaluate, _continue_at_state, _restart, _jump, False, False))
SAMPLE = sampling_of(SEQUENCE, _sample)
