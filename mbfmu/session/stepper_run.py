"""A run of any solver in Python: what :mod:`.kernels.sequence` calls, by the methods of a stepper."""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers import SolverError
from solvers.outcome import OK
from solvers.stepper import Stepper
from solvers.system import Array

from .kernels.sequence import SolverActions, sequence_of


class StepperRun:
    """A run as :class:`.kernels.sequence.Run` declares it, whose reported state is that of a stepper.

    Attributes
    ----------
    stepper
        Solver of the run; another one may take its place.
    error
        Error of the last evaluation that failed; None: none has failed.
    """

    def __init__(self, session: Any, inputs: Any, stepper: Stepper, outputs: int) -> None:
        self.session, self.inputs, self.stepper = session, inputs, stepper
        self.a, self.lam = np.zeros(0), np.zeros(0)
        self.dv, self.out = np.zeros(len(stepper.v)), np.zeros(outputs)
        self.error: SolverError | None = None

    @property
    def clock(self) -> tuple[float]:
        """Time reached, s."""
        return (self.stepper.t,)

    @property
    def q(self) -> Array:
        """Positions (nq,)."""
        return self.stepper.q

    @property
    def v(self) -> Array:
        """Velocities (n,)."""
        return self.stepper.v

    @property
    def energy_account(self) -> Array:
        """Energy account (ACCOUNT_SIZE,)."""
        return self.stepper.energy_account


def _advance(run: StepperRun, end: float) -> int:
    return int(run.stepper.advance(end).code)


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


SEQUENCE = sequence_of(SolverActions(_advance, _evaluate, _continue_at_state, _restart, _jump))
