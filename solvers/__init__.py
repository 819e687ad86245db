"""Numerical integration of constrained mechanical systems; knows arrays and callbacks, not bodies."""

from __future__ import annotations

from collections.abc import Callable

from .adams_tree import TreeAdamsStepper
from .explicit import AdamsLUStepper, AdamsStepper, HybridStepper
from .stepper import Code, Options, SolverError, Statistics, Status, Stepper, Switching
from .system import AnySystem, Array, System, Terms


def ida_stepper(system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> Stepper:
    """Return an IDA stepper; SUNDIALS is loaded only here."""
    from .ida import IDAStepper

    return IDAStepper(system, t0, q0, v0, options)


def stepper(name: str, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> Stepper:
    """Return a stepper by its name; on a large tree without constraints there is nothing to partition.

    Raises ValueError where a large tree has constraints and the solver is not ``ida``.
    """
    if isinstance(system, System):
        name = name if system.n else "adams"  # IDA takes no empty system, and nothing is integrated
        return SOLVERS[name](system, t0, q0, v0, options)
    if name == "ida":
        from .ida_tree import TreeIDAStepper

        return TreeIDAStepper(system, t0, q0, v0, options)
    if system.m:
        raise ValueError(
            f"solver {name!r} is given {system.n} coordinates under {system.m} constraints; so many are for 'ida', or "
            "for a tree without cut joints"
        )
    return TreeAdamsStepper(system, t0, q0, v0, options)


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
    "stepper",
]
