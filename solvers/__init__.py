"""Numerical integration of constrained mechanical systems; knows arrays and callbacks, not bodies."""

from __future__ import annotations

from collections.abc import Callable

from .adams_tree import TreeAdamsStepper
from .explicit import AdamsLUStepper, AdamsStepper, HybridStepper
from .options import Options, Statistics, Switching
from .outcome import Code, SolverError, Status
from .stepper import Stepper
from .system import AnySystem, Array, System, Terms

LARGEST_DENSE = 1000  # coordinates of a mechanism with loops whose matrices the partitions factor


def ida_stepper(system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> Stepper:
    """Return an IDA stepper; SUNDIALS is loaded only here."""
    from .ida import IDAStepper

    return IDAStepper(system, t0, q0, v0, options)


def stepper(name: str, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> Stepper:
    """Return a stepper by its name; on a large tree without constraints there is nothing to partition.

    With constraints the partitions take a large tree's dense terms. Raises ValueError where these would be too large,
    and for a name that is none.
    """
    if name not in SOLVERS:
        raise ValueError(f"there is no solver {name!r}; allowed: {', '.join(map(repr, SOLVERS))}")
    if isinstance(system, System):
        name = name if system.n else "adams"  # IDA takes no empty system, and nothing is integrated
        return SOLVERS[name](system, t0, q0, v0, options)
    if name == "ida":
        from .ida_tree import TreeIDAStepper

        return TreeIDAStepper(system, t0, q0, v0, options)
    if system.m:
        if system.dense is None or system.n > LARGEST_DENSE:
            raise ValueError(
                f"solver {name!r} is given {system.n} coordinates under {system.m} constraints; allowed: "
                f"{LARGEST_DENSE}; take 'ida'"
            )
        return SOLVERS[name](system.dense(), t0, q0, v0, options)
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
