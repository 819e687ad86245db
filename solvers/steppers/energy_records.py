"""Energy accounts of the steppers of this package, beyond the row that every stepper reports."""

from __future__ import annotations

from math import inf
from typing import Any

from solvers.energy_account import EXCHANGED_ENERGY, KINETIC_MAX
from solvers.stepper import Stepper

from .compiled_loop import LoopStepper
from .esdirk.tree import TreeESDIRKStepper
from .guard import GuardedStepper
from .ida.driver import IDADriver
from .one_step import OneStepSolver


def kinetic_min(stepper: Stepper) -> float:
    """Return the smallest kinetic energy since the construction of a stepper, J; inf before its first evaluation.

    A user-defined stepper that fills its account without such a record does not report it: then the result is the
    smallest kinetic energy that its account permits, that of a motion without work.
    """
    stepper = stepper.inner if isinstance(stepper, GuardedStepper) else stepper
    record = _record_of(stepper)
    if record is None:
        account = stepper.energy_account
        return float(max(0.0, account[KINETIC_MAX] - account[EXCHANGED_ENERGY]))
    return float(record["kinetic_min"]) if record["check_count"] > 0 else inf


def _record_of(stepper: Stepper) -> Any:
    """Return the record with ACCOUNT_FIELDS; None: the stepper has none."""
    if isinstance(stepper, IDADriver):
        return stepper._energy_record[0]
    if isinstance(stepper, TreeESDIRKStepper):
        return stepper._memory.control[0]
    return stepper._control if isinstance(stepper, (LoopStepper, OneStepSolver)) else None
