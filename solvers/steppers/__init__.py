"""Integrators by name: Adams PECE on a partition, Radau IIA, and SUNDIALS IDA."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from solvers.codes import coded
from solvers.options import Options
from solvers.stepper import Stepper
from solvers.system import MAX_DENSE_COORDINATES, AnySystem, Array, TreeSystem

from .adams.dense import AdamsLUStepper, AdamsStepper, HybridStepper
from .adams.tree import TreeAdamsStepper
from .esdirk.tree import TreeESDIRKStepper
from .radau.dense import RadauStepper


def dense_ida(*arguments: Any) -> Stepper:
    """Return an IDA stepper on a system's matrices; SUNDIALS is loaded only here."""
    from .ida.dense import IDAStepper

    return IDAStepper(*arguments)


def tree_ida(*arguments: Any) -> Stepper:
    """Return an IDA stepper on a tree's recursions; SUNDIALS is loaded only here."""
    from .ida.tree import TreeIDAStepper

    return TreeIDAStepper(*arguments)


SOLVERS: dict[str, Callable[..., Stepper]] = {  # on a system's matrices
    "ida": dense_ida,
    "adams": AdamsStepper,
    "hybrid": HybridStepper,
    "adams-lu": AdamsLUStepper,
    "radau": RadauStepper,
}
TREE_SOLVERS: dict[str, Callable[..., Stepper]] = {  # on a tree's recursions, with constraints or without
    "ida": tree_ida,
    "esdirk": TreeESDIRKStepper,
}
# on those of a tree without constraints: there is nothing to partition
UNCONSTRAINED_SOLVERS: dict[str, Callable[..., Stepper]] = dict.fromkeys(
    ("adams", "hybrid", "adams-lu"), TreeAdamsStepper
)
SOLVER_NAMES = tuple(dict.fromkeys((*SOLVERS, *TREE_SOLVERS)))
UNLISTED_SOLVERS = ("adams-lu",)  # accepted by name, for comparison with a paper; in no list of solvers for users
ORDER_LIMITS = {  # lowest and highest order that a run can be limited to; one number: the method has this order
    "ida": (1, 5),
    "adams": (1, 12),
    "hybrid": (1, 12),
    "adams-lu": (1, 12),
    "radau": (5, 5),
    "esdirk": (3, 3),
}
# joint coordinates; a Newton matrix of that size takes seconds, and its time grows with more than the third power
MAX_RADAU_COORDINATES = 200


def drop_unlisted(names: Iterable[str]) -> tuple[str, ...]:
    """Return those solvers that are offered to users."""
    return tuple(name for name in names if name not in UNLISTED_SOLVERS)


def size_limit(name: str) -> int:
    """Return how many coordinates of a large tree a solver that factors dense matrices may be given."""
    return min(MAX_RADAU_COORDINATES, MAX_DENSE_COORDINATES) if name == "radau" else MAX_DENSE_COORDINATES


def describe_refusal(name: str, system: AnySystem) -> str:
    """Return why a solver cannot integrate a system: its forces, or its size; empty: it can.

    A simulation and an export ask this one function, so what is exported can start. A name that is no solver's, such as
    ``auto``, is not refused here.
    """
    if name not in SOLVER_NAMES:
        return ""
    large = isinstance(system, TreeSystem)
    if system.stiffness_reason and name in UNCONSTRAINED_SOLVERS:
        implicit = "'ida' or 'esdirk'" if large else "'radau' or 'ida'"
        return coded("unsuitable-solver", f"solver {name!r} is explicit, but {system.stiffness_reason}; use {implicit}")
    if not isinstance(system, TreeSystem):
        if system.n and name not in SOLVERS:
            return coded(
                "unsuitable-solver",
                f"solver {name!r} is for large models only, and this model has {system.n} joint coordinates; use "
                "'radau'",
            )
        return ""
    if name in TREE_SOLVERS or (not system.m and name in UNCONSTRAINED_SOLVERS):
        return ""
    if system.dense is None or system.n > size_limit(name):
        return coded(
            "unsuitable-solver",
            f"solver {name!r} is given {system.n} joint coordinates and {system.m} constraints; allowed: at most "
            f"{size_limit(name)} coordinates; use 'ida'",
        )
    return ""


def describe_order_refusal(name: str, order: int | None) -> str:
    """Return why a solver cannot be limited to an order; empty: it can, or there is no limit.

    A name that is no solver's, such as ``auto``, is not refused here.
    """
    low, high = ORDER_LIMITS.get(name, (1, 12))
    if order is None or low <= order <= high:
        return ""
    allowed = f"{low} to {high}" if low < high else f"{high}"
    return (
        f"max_order is {order}; allowed for solver {name!r}: {allowed}, or 0 for no limit. Change max_order or the "
        "solver"
    )


def stepper(name: str, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> Stepper:
    """Return a stepper by its name.

    A large model is advanced by its recursions if the solver supports this, else by its matrices. Raises ValueError
    if these would be too large, for an order that the solver does not have, and for an unknown name.
    """
    if name not in SOLVER_NAMES:
        raise ValueError(f"there is no solver {name!r}; allowed: {', '.join(map(repr, drop_unlisted(SOLVER_NAMES)))}")
    if refused := describe_refusal(name, system) or describe_order_refusal(
        name, options.max_order if options else None
    ):
        raise ValueError(refused)
    arguments: tuple[Any, ...] = t0, q0, v0, options
    if not isinstance(system, TreeSystem):
        if not system.n:
            name = "adams"  # IDA takes no empty system, and nothing is integrated
        return SOLVERS[name](system, *arguments)
    if name in TREE_SOLVERS:
        return TREE_SOLVERS[name](system, *arguments)
    if not system.m and name in UNCONSTRAINED_SOLVERS:
        return UNCONSTRAINED_SOLVERS[name](system, *arguments)
    assert system.dense is not None  # else it is refused
    return SOLVERS[name](system.dense(), *arguments)
