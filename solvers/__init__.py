"""Numerical integration of constrained mechanical systems by arrays and callbacks, independent of bodies."""

from __future__ import annotations

from .options import Options, Statistics, Switching
from .outcome import Code, SolverError, Status
from .stepper import Stepper
from .steppers import SOLVERS, stepper
from .steppers.one_step import OneStepSolver
from .system import AnySystem, Array, System, Terms

__all__ = [
    "SOLVERS",
    "AnySystem",
    "Array",
    "Code",
    "OneStepSolver",
    "Options",
    "SolverError",
    "Statistics",
    "Status",
    "Stepper",
    "Switching",
    "System",
    "Terms",
    "stepper",
]
