"""Solvers from outside this package: classes of installed packages, and classes that a program gives.

An installed package registers a class under the entry-point group ``mbfmu.solvers``, whose entry has the name of the
solver. A program gives the class itself, whose name is its attribute ``name``, or that of the class in lower case. A
package is imported when its solver is used, so that an error in it concerns nothing else.
"""

from __future__ import annotations

import sys
import traceback
import warnings
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from solvers.diagnostics import Diagnostic
from solvers.outcome import UserSolverError
from solvers.resolution import ResolutionError
from solvers.stepper import Stepper
from solvers.system import AnySystem

from .one_step import MAX_ORDER, OneStepSolver

SOLVER_ENTRY_POINTS = "mbfmu.solvers"

_given: dict[str, type[Stepper]] = {}  # classes that this process was given, by name


def give_solver(cls: Any, reserved: tuple[str, ...]) -> str:
    """Make the class of a solver known in this process, and return its name; ``reserved`` names are refused.

    A class that is defined again, as in a notebook, takes the place of the one before.

    Raises
    ------
    ValueError
        The object is no class of a solver that can be used, or has a name that is taken, be it by another class that
        was given.
    """
    name = getattr(cls, "name", "") or getattr(cls, "__name__", "").lower()
    require_solver_class(cls, f"solver is {cls!r}")
    if not isinstance(name, str) or not name.isprintable():
        raise ValueError(f"the attribute name of solver {cls.__name__} is {name!r}; allowed: text. Change it")
    earlier = _given.get(name, cls)
    if earlier is not cls and not is_redefinition(earlier, cls):
        raise ValueError(
            Diagnostic.error(
                "broken-solver",
                f"solver {describe_class(cls)} has the name {name!r} of another class that this program uses, "
                f"{describe_class(earlier)}; allowed: one class of a name",
                "Give one of the two another attribute name",
                subject=name,
            )
        )
    if name in reserved or name in installed_solvers():
        raise ValueError(
            f"solver {cls.__name__} has the name {name!r}, which another solver has; give the class another attribute "
            "name"
        )
    _given[name] = cls
    return name


def installed_solvers() -> dict[str, list[EntryPoint]]:
    """Return the entry points of solvers in installed packages by name; nothing is imported."""
    found: dict[str, list[EntryPoint]] = {}
    for point in entry_points(group=SOLVER_ENTRY_POINTS):
        found.setdefault(point.name, []).append(point)
    return found


def plugin_names(reserved: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of all solvers from outside; a warning names the installed ones of a ``reserved`` name, which
    are not among them.
    """
    installed = installed_solvers()
    for name in sorted(installed.keys() & set(reserved)):
        text = Diagnostic.error(
            "broken-solver",
            f"solver {name!r} ({', '.join(map(describe_entry, installed[name]))}) is not used: mbfmu has a solver of "
            "that name",
            "Give the entry point another name, or uninstall the package",
            subject=name,
        )
        warnings.warn(str(text), RuntimeWarning, stacklevel=2)
    return tuple(name for name in dict.fromkeys((*_given, *installed)) if name not in reserved)


def is_given(name: str) -> bool:
    """Whether the class of this name was given to this process, so that no other process can find it."""
    return name in _given


def load_plugin(name: str) -> type[Stepper]:
    """Return the class of a solver from outside.

    Raises
    ------
    ValueError
        The package cannot be imported, has no such class, the class is no solver, or several packages have the name.
    KeyError
        There is no such solver.
    """
    if name in _given:
        return _given[name]
    point, *others = installed_solvers()[name]
    if others:
        told = ", ".join(sorted(describe_entry(one) for one in (point, *others)))
        raise ValueError(
            Diagnostic.error(
                "broken-solver", f"solver {name!r} is in several packages: {told}; allowed: one", "Uninstall the others"
            )
        )
    try:
        found = point.load()
    except Exception as error:
        raise ValueError(
            Diagnostic.parse(
                f"solver {name!r} ({describe_entry(point)}) cannot be loaded: {describe_exception(error)}; repair or "
                "uninstall the package, or use another solver",
                "error",
                "broken-solver",
            )
        ) from error
    require_solver_class(found, f"solver {name!r} ({describe_entry(point)}) is {found!r}")
    return found


class ContractError(ValueError):
    """A solver from outside has returned, or reported as its state, what is not allowed."""


def name_error(name: str, reached: float, error: Exception) -> UserSolverError:
    """Return an error with the name of the solver, for an exception in its own code, which is its ``__cause__``;
    ``reached`` is the time of the last good state, s.
    """
    found = str(error) if isinstance(error, ContractError) else describe_exception(error)
    text = f"solver {name!r} ({describe_origin(name)}) fails after t = {reached:.9g} s with {found}"
    remedy = "Correct the solver, or use another one"
    named = UserSolverError(Diagnostic.error("broken-solver", text, remedy, subject=name, time=reached))
    named.__cause__ = error
    return named


def create_plugin(name: str, system: AnySystem, t0: float, *arguments: Any) -> Stepper:
    """Return a solver from outside at a state; ValueError if it cannot be loaded or created, or its start resolved."""
    cls = load_plugin(name)
    try:
        return cls(system, t0, *arguments)
    except ResolutionError:
        raise
    except Exception as error:
        raise name_error(name, t0, error) from error


def describe_origin(name: str) -> str:
    """Return where the class of a solver from outside is."""
    if name in _given:
        return f"class {describe_class(_given[name])}"
    return ", ".join(map(describe_entry, installed_solvers().get(name, ())))


def describe_class(cls: type) -> str:
    """Return the full name of a class."""
    return f"{cls.__module__}.{cls.__qualname__}"


def is_redefinition(earlier: type, cls: type) -> bool:
    """Whether a class is what the full name of an earlier one leads to now."""
    module = sys.modules.get(cls.__module__)
    return describe_class(earlier) == describe_class(cls) and getattr(module, cls.__qualname__, None) is cls


def describe_entry(point: EntryPoint) -> str:
    """Return where an entry point leads."""
    package = f" of package {point.dist.name!r}" if point.dist else ""
    return f"entry point {point.value!r}{package}"


def describe_exception(error: BaseException) -> str:
    """Return type and message of an exception, and the file and line at which it was raised."""
    at = traceback.extract_tb(error.__traceback__)[-1:]
    where = "".join(f" ({Path(one.filename).name}, line {one.lineno})" for one in at)
    return f"{type(error).__name__}: {error}{where}"


def require_solver_class(found: Any, what: str) -> None:
    """Raise ValueError unless an object is a complete subclass of :class:`solvers.Stepper`."""
    if not (isinstance(found, type) and issubclass(found, Stepper)):
        raise ValueError(
            Diagnostic.error(
                "broken-solver",
                f"{what}; allowed: the name of a solver, or a class derived from solvers.OneStepSolver or "
                "solvers.Stepper",
                "Pass the class itself",
            )
        )
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    if issubclass(found, OneStepSolver) and not hasattr(found, "order"):
        missing.append("order")
    if missing:
        raise ValueError(
            Diagnostic.error(
                "broken-solver",
                f"solver {found.__name__} has no {', '.join(missing)}",
                "Write what the documentation of its base class requires",
                subject=found.__name__,
            )
        )
    if issubclass(found, OneStepSolver):
        require_orders(found)


def require_orders(found: type[OneStepSolver]) -> None:
    """Raise ValueError unless the orders of a one-step method are numbers with which steps can be controlled."""
    order, error_order = found.order, found.error_order
    wrong = ""
    if not isinstance(order, int) or isinstance(order, bool) or not 1 <= order <= MAX_ORDER:
        wrong = f"order {order!r}; allowed: a whole number from 1 to {MAX_ORDER}"
    elif error_order is not None and not (
        isinstance(error_order, int | float) and not isinstance(error_order, bool) and 0.0 < error_order <= MAX_ORDER
    ):
        wrong = f"error_order {error_order!r}; allowed: a number above 0, at most {MAX_ORDER}"
    if wrong:
        raise ValueError(
            Diagnostic.error(
                "broken-solver",
                f"solver {found.__name__} has the {wrong}",
                "Write the order of its formulas",
                subject=found.__name__,
            )
        )
