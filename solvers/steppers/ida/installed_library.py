"""SUNDIALS as scikit-sundae installs it, without an import of that package, which imports most of SciPy (0.3 s)."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

EXTENSION_PACKAGE = "sksundae"
EXTENSION_NAME = "_cy_ida"  # the extension module that is linked to the libraries
CONFIGURATION_FILE = "py_config.pxi"  # lines such as: SUNDIALS_VERSION = "7.9.0"

T = TypeVar("T")


def load_extension(load: Callable[[str], T]) -> T:
    """Return what ``load`` makes of the path of the extension module.

    The package is imported if it is required: on Windows it adds the folder of its libraries to the search path.
    """
    if path := extension_path():
        try:
            return load(path)
        except OSError:
            pass
    return load(str(import_module(f"{EXTENSION_PACKAGE}.{EXTENSION_NAME}").__file__))


def extension_path() -> str:
    """Return the path of the extension module; empty if its package is not a folder with that module."""
    folders = _folders()
    spec = PathFinder.find_spec(EXTENSION_NAME, folders) if folders else None
    return (spec and spec.origin) or ""


def configuration() -> dict[str, str]:
    """Return version and types of numbers of SUNDIALS, by the names of its configuration."""
    for folder in _folders():
        file = Path(folder) / CONFIGURATION_FILE
        if file.is_file():
            return dict(re.findall(r'^(\w+) = "(.*)"', file.read_text("utf-8"), re.MULTILINE))
    return dict(getattr(import_module(f"{EXTENSION_PACKAGE}._cy_common"), "config", {}))


def _folders() -> list[str]:
    """Return the folders of the package, which is not imported."""
    spec = find_spec(EXTENSION_PACKAGE)
    return list(spec.submodule_search_locations or ()) if spec else []
