"""Models by name: those that installed packages register, and those in files."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from mbfmu.util.errors import UserError, suggest

from .model import Model
from .modules import load_module
from .parameters import declared

ENTRY_POINT_GROUP = "mbfmu.models"


def models() -> dict[str, type[Model]]:
    """Return all models registered under the entry-point group ``mbfmu.models``.

    Returns
    -------
    dict[str, type[Model]]
        Classes of the models, by name.
    """
    found = {}
    for point in entry_points(group=ENTRY_POINT_GROUP):
        found[point.name] = _model_class(point.load(), f"entry point {point.name!r}")
    return found


def find(reference: str) -> type[Model]:
    """Return the model of a registered name or of a Python file.

    Parameters
    ----------
    reference
        Name of a registered model; path of a Python file and class: ``path/to/file.py:Class``, where the class may be
        left out if the file has one model; or module and class: ``my_package.my_module:Class``.

    Returns
    -------
    type[Model]
        Class of the model; ``find("fourbar")(crank_mass=2.0)`` is a model.

    Raises
    ------
    UserError
        No such model, file, module or class.
    """
    if ".py" in reference:
        path, _, name = reference.rpartition(":") if ".py:" in reference else (reference, "", "")
        return load(Path(path), name)
    if ":" in reference:
        return _imported(reference)
    points = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    if reference not in points:
        raise UserError(
            f"unknown model {reference!r}{suggest(reference, points)} (or name a file: my_model.py:MyModel)"
        )
    return _model_class(points[reference].load(), f"entry point {reference!r}")


def reference_of(cls: type[Model]) -> str:
    """Return what :func:`find` finds a model by in another process; empty: it does not, as for a class of a script."""
    module = sys.modules.get(cls.__module__)
    if module is None or cls.__module__ == "__main__" or "." in cls.__qualname__:
        return ""
    file = getattr(module, "__mbfmu_file__", None)
    return f"{file or cls.__module__}:{cls.__qualname__}"


def at_defaults(cls: type[Model]) -> Model:
    """Return the model with the defaults of all its parameters."""
    declared(cls)  # type: ignore[arg-type]  # reports errors of the declaration first
    try:
        return cls()
    except TypeError as error:
        raise UserError(
            f"model {cls.__name__} has a parameter without default: {error}; give each parameter a default"
        ) from error


def load(path: Path, name: str = "") -> type[Model]:
    """Return a model class from a file; ``name`` may be left out where the file has one model."""
    try:
        there = path.is_file()
    except OSError:  # no name of a file
        there = False
    if not there:
        raise UserError(f"model file {str(path)!r} does not exist")
    module = load_module(path)
    own = {
        k: v
        for k, v in vars(module).items()
        if isinstance(v, type) and issubclass(v, Model) and v.__module__ == module.__name__
    }
    if not name and len(own) == 1:
        return next(iter(own.values()))
    if name not in own:
        raise UserError(f"{str(path)!r} has no model {name!r}; it has: {', '.join(own) or 'none'}")
    return own[name]


def _imported(reference: str) -> type[Model]:
    """Return the model of an importable module and a class."""
    module, _, name = reference.partition(":")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise UserError(
            f"model {reference!r} cannot be imported: {error}; allowed: module and class, as in my_package.my_module:"
            "MyModel, or a file, as in my_model.py:MyModel"
        ) from error
    return _model_class(found, f"{reference!r}")


def _model_class(found: Any, what: str) -> type[Model]:
    if not (isinstance(found, type) and issubclass(found, Model)):
        raise UserError(f"{what} is {found!r}, which is not a subclass of mbfmu.modeling.model.Model")
    return found
