"""Integrators by name: Adams PECE on a partition, Radau IIA, ESDIRK, and SUNDIALS IDA."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from solvers.compiled.fingerprint import fingerprint_of_class
from solvers.diagnostics import Diagnostic
from solvers.options import Options
from solvers.stepper import Stepper
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, AnySystem, Array, System, TreeSystem

from .adams.dense import AdamsLUStepper, AdamsStepper, HybridStepper
from .adams.eliminated import EliminatedAdamsStepper
from .adams.tree import TreeAdamsStepper
from .esdirk.eliminated import EliminatedESDIRKStepper
from .esdirk.tree import TreeESDIRKStepper
from .plugins import create_plugin, give_solver, load_plugin, plugin_names
from .radau.dense import RadauStepper


def dense_ida(*arguments: Any) -> Stepper:
    """Return an IDA stepper on a system's matrices; SUNDIALS is loaded only here."""
    from .ida.dense import IDAStepper

    return IDAStepper(*arguments)


def tree_ida(*arguments: Any) -> Stepper:
    """Return an IDA stepper on a tree's recursions; SUNDIALS is loaded only here."""
    from .ida.tree import TreeIDAStepper

    return TreeIDAStepper(*arguments)


def eliminated_ida(*arguments: Any) -> Stepper:
    """Return an IDA stepper on a system with eliminated constraints; SUNDIALS is loaded only here."""
    from .ida.eliminated import EliminatedIDAStepper

    return EliminatedIDAStepper(*arguments)


# implicit methods with eliminated constraints
IMPLICIT_ELIMINATION_SOLVERS: dict[str, Callable[..., Stepper]] = {
    "ida": eliminated_ida,
    "esdirk": EliminatedESDIRKStepper,
}
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
# on those of a large mechanism whose constraints are eliminated along its structure
ELIMINATION_SOLVERS: dict[str, Callable[..., Stepper]] = dict.fromkeys(("adams", "hybrid"), EliminatedAdamsStepper)
MIN_ELIMINATION_COORDINATES = 60  # joint coordinates above which this is cheaper than matrices
MIN_ELIMINATION_CONSTRAINTS = 30  # constraint equations above which implicit solvers eliminate them too
SOLVER_NAMES = tuple(dict.fromkeys((*SOLVERS, *TREE_SOLVERS)))
RESERVED_NAMES = (*SOLVER_NAMES, "auto")  # auto: a simulation takes the solver for its model
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


def has_loops(system: AnySystem) -> bool:
    """Whether constraints restrict coordinates that are free."""
    return system.n > 0 and system.m > 0


def eliminates_constraints(name: str, system: AnySystem) -> bool:
    """Whether this solver integrates a system with its constraints eliminated: a large one with loops."""
    large = max(system.n, system.model_size[0]) > MIN_ELIMINATION_COORDINATES
    return name in ELIMINATION_SOLVERS and large and has_loops(system) and system.elimination is not None


def uses_recursions(name: str, system: AnySystem) -> bool:
    """Whether this solver integrates a system that has matrices by its recursions: a large one without constraints, for
    implicit solvers with a structured tangent.
    """
    if not isinstance(system, System) or system.recursions is None:
        return False
    large = not system.m and system.n > MIN_ELIMINATION_COORDINATES
    return large and (name in UNCONSTRAINED_SOLVERS or (name in TREE_SOLVERS and system.has_tangent))


def recursive_system(system: AnySystem) -> TreeSystem:
    """Return the recursions of a system, see :func:`uses_recursions`."""
    if isinstance(system, TreeSystem):
        return system
    assert isinstance(system, System)  # there is no third kind
    assert system.recursions is not None  # else its matrices are used
    return system.recursions()


def eliminates_implicitly(name: str, system: AnySystem) -> bool:
    """Whether this implicit solver integrates a system with its constraints eliminated: there are many, and forces are
    smooth; for ``esdirk``, which measures errors of meshes at their nodes, there is no mesh.
    """
    meshed = name == "esdirk" and getattr(system, "mesh_length", 0.0) > 0.0
    n, m = max((system.n, system.m), system.model_size)
    many = m > MIN_ELIMINATION_CONSTRAINTS and n > MIN_ELIMINATION_COORDINATES and has_loops(system)
    smooth = not system.nonsmooth_reason and not meshed
    return name in IMPLICIT_ELIMINATION_SOLVERS and many and smooth and hasattr(system.elimination, "tangent")


def drop_unlisted(names: Iterable[str]) -> tuple[str, ...]:
    """Return those solvers that are offered to users."""
    return tuple(name for name in names if name not in UNLISTED_SOLVERS)


def size_limit(name: str) -> int:
    """Return how many coordinates of a large tree a solver that factors dense matrices may be given."""
    return min(MAX_RADAU_COORDINATES, MAX_SOLVER_DENSE_COORDINATES) if name == "radau" else MAX_SOLVER_DENSE_COORDINATES


def solver_names() -> tuple[str, ...]:
    """Return the names of all solvers that are offered to users, with those from outside this package."""
    return (*drop_unlisted(SOLVER_NAMES), *plugin_names(RESERVED_NAMES))


def is_solver(name: str) -> bool:
    """Whether there is a solver of this name, be it from outside this package."""
    return name in SOLVER_NAMES or name in plugin_names(RESERVED_NAMES)


def fingerprint_of_solver(name: str) -> str:
    """Return what distinguishes a solver from outside this package from others of its name; empty for other names."""
    return "" if name in RESERVED_NAMES else fingerprint_of_class(load_plugin(name))


def solver_name(solver: Any) -> Any:
    """Return the name of a solver that is given as a class, by which it is known from then on; else what was given.

    Raises
    ------
    ValueError
        The class is no solver that can be used, or its name is another one's.
    """
    return solver if isinstance(solver, str) else give_solver(solver, RESERVED_NAMES)


def describe_refusal(name: str, system: AnySystem) -> str:
    """Return why a solver cannot integrate a system: its forces, or its size; empty: it can.

    A simulation and an export ask this one function, so what is exported can start. A name that is no solver's, such as
    ``auto``, is not refused here.
    """
    if name not in SOLVER_NAMES:
        return describe_plugin_refusal(name, system) if name in plugin_names(RESERVED_NAMES) else ""
    if system.stiffness_reason and name in UNCONSTRAINED_SOLVERS:
        return describe_stiffness(name, system)
    if name == "adams-lu" and len(system.nonholonomic):
        return _refusal(name, "has no nonholonomic constraints, such as those of rolling wheels; use 'hybrid'")
    if not isinstance(system, TreeSystem):
        is_large = eliminates_implicitly(name, system) or uses_recursions(name, system)
        if system.n and name not in SOLVERS and not is_large:
            return _refusal(
                name,
                f"is for large models only, with more than {MIN_ELIMINATION_COORDINATES} joint coordinates and "
                f"first-order states together and, if there are loops, more than {MIN_ELIMINATION_CONSTRAINTS} "
                "constraint equations, and without flexible bodies (this model: joint coordinates "
                f"{system.n_velocities}, constraint equations {system.m}, first-order states {system.n_states}); use "
                "'ida'",
            )
        needs_matrices = system.n_states and system.m and not (is_large or eliminates_constraints(name, system))
        return describe_large_size(name, system) if needs_matrices else ""
    if name in TREE_SOLVERS or (not system.m and name in UNCONSTRAINED_SOLVERS):
        return ""
    if eliminates_constraints(name, system):
        return ""
    return describe_large_size(name, system)


def describe_plugin_refusal(name: str, system: AnySystem) -> str:
    """As :func:`describe_refusal`, of a solver from outside this package; one that cannot be loaded is refused."""
    try:
        found = load_plugin(name)
    except ValueError as error:
        return str(error)
    if system.stiffness_reason and found.is_explicit:
        return describe_stiffness(name, system)
    return describe_large_size(name, system) if found.needs_matrices and isinstance(system, TreeSystem) else ""


def describe_stiffness(name: str, system: AnySystem) -> str:
    """Return the refusal of an explicit solver for a stiff system."""
    implicit = "'ida' or 'esdirk'" if isinstance(system, TreeSystem) else "'radau' or 'ida'"
    return _refusal(name, f"is explicit, but {system.stiffness_reason}; use {implicit}")


def describe_large_size(name: str, system: AnySystem) -> str:
    """Return the refusal of a solver that needs matrices for a system that is too large for them; empty: it is not."""
    limit, has_matrices = MAX_SOLVER_DENSE_COORDINATES, True
    if isinstance(system, TreeSystem):
        limit, has_matrices = size_limit(name), system.dense is not None
    if has_matrices and system.n <= limit:
        return ""
    others = "" if name == "ida" else "'ida', or "
    return _refusal(
        name,
        f"is given {system.n} joint coordinates and {system.m} constraints; allowed: at most {limit} "
        f"coordinates; use {others}'adams' if the model is not stiff",
    )


def _refusal(name: str, why: str) -> str:
    return str(Diagnostic.error("unsuitable-solver", f"solver {name!r} {why}", subject=name))


def find_plugin_orders(name: str) -> tuple[int, int]:
    """Return the lowest and highest order of a solver from outside this package; any if it is not known."""
    try:
        order = getattr(load_plugin(name), "order", None)
    except (KeyError, ValueError):
        order = None
    return (order, order) if isinstance(order, int) else (1, 12)


def describe_order_refusal(name: str, order: int | None) -> str:
    """Return why a solver cannot be limited to an order; empty: it can, or there is no limit.

    A name that is no solver's, such as ``auto``, is not refused here.
    """
    if order is None:
        return ""
    low, high = ORDER_LIMITS.get(name) or find_plugin_orders(name)
    if low <= order <= high:
        return ""
    allowed = f"{low} to {high}" if low < high else f"{high}"
    return (
        f"max_order is {order}; allowed for solver {name!r}: {allowed}, or 0 for no limit. Change max_order or the "
        "solver"
    )


def stepper(
    name: str,
    system: AnySystem,
    t0: float,
    q0: Array,
    v0: Array,
    options: Options | None = None,
) -> Stepper:
    """Return a stepper by its name.

    A large model is advanced by its recursions if the solver supports this, else by its matrices. Raises ValueError if
    these would be too large, for an order that the solver does not have, and for an unknown name.
    """
    if not is_solver(name):
        raise ValueError(
            f"there is no solver {name!r}; allowed: {', '.join(map(repr, solver_names()))}. Choose another"
        )
    if refused := describe_refusal(name, system) or describe_order_refusal(
        name, options.max_order if options else None
    ):
        raise ValueError(refused)
    arguments: tuple[Any, ...] = t0, q0, v0, options
    if eliminates_constraints(name, system):
        return ELIMINATION_SOLVERS[name](system, *arguments)
    if eliminates_implicitly(name, system):
        return IMPLICIT_ELIMINATION_SOLVERS[name](system, *arguments)
    if uses_recursions(name, system):
        return (UNCONSTRAINED_SOLVERS | TREE_SOLVERS)[name](recursive_system(system), *arguments)
    if not isinstance(system, TreeSystem):
        if not system.n:
            name = "adams"  # IDA takes no empty system, and nothing is integrated
        return SOLVERS[name](system, *arguments) if name in SOLVERS else create_plugin(name, system, *arguments)
    if name not in SOLVER_NAMES and not load_plugin(name).needs_matrices:
        return create_plugin(name, system, *arguments)
    if name in TREE_SOLVERS:
        return TREE_SOLVERS[name](system, *arguments)
    if not system.m and name in UNCONSTRAINED_SOLVERS:
        return UNCONSTRAINED_SOLVERS[name](system, *arguments)
    assert system.dense is not None  # else it is refused
    dense = system.dense()
    return SOLVERS[name](dense, *arguments) if name in SOLVERS else create_plugin(name, dense, *arguments)
