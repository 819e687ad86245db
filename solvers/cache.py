"""Where machine code is kept between processes.

Numba alone would go on using a cached caller after its callee was edited. So the folder is named by a fingerprint of
all kernel sources, ``mbfmu/<fingerprint>`` under ``NUMBA_CACHE_DIR`` or the user's cache, and every environment with
these sources uses the same one. What is damaged there is compiled anew; where nothing can be written, every process
compiles for itself.
"""

from __future__ import annotations

import os
import pickle
import shutil
import warnings
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache, NullCache, _CacheLocator

HERE = Path(__file__).resolve().parent
FOLDERS = (HERE, HERE.parent / "mbfmu" / "mechanics")  # of the kernels

_listeners: list[Callable[[], None]] = []  # who is to know that compilation has begun
_unwritable: list[str] = []  # what this process has warned of


@cache
def home() -> Path:
    """Return the folder of all machine code of ours."""
    default = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(os.environ.get("NUMBA_CACHE_DIR") or default) / "mbfmu"


@cache
def folder() -> Path:
    """Return the folder that holds the machine code of these sources."""
    fingerprint = sha256()
    for place in FOLDERS:
        for source in sorted(place.rglob("*.py")):
            fingerprint.update(source.relative_to(HERE.parent).as_posix().encode())
            fingerprint.update(source.read_bytes())
    return home() / fingerprint.hexdigest()[:16]


def when_compiling(tell: Callable[[], None]) -> None:
    """Have ``tell`` called as soon as something has to be compiled, once; it takes the place of others."""
    _listeners[:] = [tell]


def size() -> int:
    """Return how much machine code of all our sources, older ones too, takes, in bytes."""
    return sum(file.stat().st_size for file in home().rglob("*") if file.is_file())


def clear() -> None:
    """Remove it."""
    shutil.rmtree(home(), ignore_errors=True)


def tell_listeners() -> None:
    """Tell who waits for it that compilation has begun."""
    while _listeners:
        _listeners.pop()()


class Place(_CacheLocator):
    """The folder of one module, whose functions are told apart by their lines."""

    def __init__(self, function: Any, source: str) -> None:
        self._line = str(function.__code__.co_firstlineno)
        self._stamp = _stamp(source)
        ours = any(Path(source).resolve().is_relative_to(place) for place in FOLDERS)
        other = "" if ours else "-" + sha256(str(Path(source).resolve()).encode()).hexdigest()[:8]
        self._path = str(folder() / (function.__module__ + other))

    def get_cache_path(self) -> str:
        """Return the folder."""
        return self._path

    def get_source_stamp(self) -> str:
        """Return what changes with the source."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name apart."""
        return self._line

    @classmethod
    def from_function(cls, function: Any, source: str) -> Place | None:
        """Return the place of a function; None where it cannot be written."""
        place = cls(function, source)
        try:
            place.ensure_cache_path()
        except OSError:
            return None
        return place


@cache
def _stamp(source: str) -> str:
    return sha256(Path(source).read_bytes()).hexdigest()


class Cache(FunctionCache):
    """The machine code of one function, for every signature."""

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what is kept for a signature; None where nothing is, or it is damaged."""
        try:
            return super().load_overload(signature, context)
        except Exception:  # what is damaged unpickles to anything
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled, where that can be written."""
        tell_listeners()
        try:
            try:
                super().save_overload(signature, compiled)
            except (pickle.UnpicklingError, EOFError):  # the index is damaged
                self.flush()
                super().save_overload(signature, compiled)
        except OSError as error:
            tell(error)


def cache_of(function: Any, kind: type[Cache]) -> Any:
    """Return where the machine code of a function is kept, if anywhere."""
    try:
        return kind(function)
    except RuntimeError as error:  # no place was found
        tell(error)
        return NullCache()


def tell(error: Exception) -> None:
    """Warn, once in a process, that it keeps nothing."""
    if not _unwritable:
        _unwritable.append(str(error))
        warnings.warn(
            f"machine code cannot be kept in {home()}, so every process compiles for minutes; set NUMBA_CACHE_DIR to a "
            "folder that can be written",
            RuntimeWarning,
            stacklevel=2,
        )
