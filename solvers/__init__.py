"""Numerical integration of constrained mechanical systems; knows arrays and callbacks, not bodies."""

from __future__ import annotations

from collections.abc import Callable

from .explicit import AdamsLUStepper, AdamsStepper, HybridStepper
from .stepper import Code, Options, SolverError, Statistics, Status, Stepper, Switching
from .system import Array, System, Terms


def ida_stepper(system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> Stepper:
    """Return an IDA stepper; SUNDIALS is loaded only here."""
    from .ida import IDAStepper

    return IDAStepper(system, t0, q0, v0, options)


SOLVERS: dict[str, Callable[..., Stepper]] = {
    "ida": ida_stepper,
    "adams": AdamsStepper,
    "hybrid": HybridStepper,
    "adams-lu": AdamsLUStepper,
}

__all__ = [
    "SOLVERS",
    "Array",
    "Code",
    "Options",
    "SolverError",
    "Statistics",
    "Status",
    "Stepper",
    "Switching",
    "System",
    "Terms",
]
