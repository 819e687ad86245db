"""Modules from files that are no part of a package: those of users' models."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from types import ModuleType

from mbfmu.util.errors import UserError


def load_module(path: Path) -> ModuleType:
    """Import a file under a name made from its content, so that two files of one name never meet.

    It may import modules of its folder. Raises UserError if it cannot be imported.
    """
    name = f"{path.stem}_{sha256(path.read_bytes()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    module.__dict__["__mbfmu_file__"] = str(path.resolve())  # for other processes and folders
    sys.modules[name] = module
    try:
        with _folder_on_path(path.resolve().parent) as taken:
            spec.loader.exec_module(module)
        module.__dict__["__mbfmu_beside__"] = tuple(sorted(taken))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise UserError(f"model file {str(path)!r} cannot be imported: {type(error).__name__}: {error}") from error
    return module


@contextmanager
def _folder_on_path(folder: Path) -> Iterator[list[str]]:
    """Let what is in a folder be imported, and forget modules from there: others may have others of the same names.

    Yields a list, in which the names of what was forgotten are afterwards. Where the folder is on the path anyway they
    are found without this, and nothing is forgotten.
    """
    before: set[str] = set(sys.modules)
    taken: list[str] = []
    if any(Path(place).resolve() == folder for place in sys.path):
        yield taken
        return
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        yield taken
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            file, own = getattr(sys.modules[name], "__file__", None), hasattr(sys.modules[name], "__mbfmu_file__")
            if file and Path(file).resolve().parent == folder and not own:
                del sys.modules[name]
                taken.append(name)
