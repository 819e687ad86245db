"""Files of machine code, one for each function and types of its arguments.

Numba keeps an index of the files of each function, in which the types are pickled: reading it takes longer than loading
the code, and of two processes that add a file one loses it. Here the name of a file has a hash of all that it
depends on.
"""

from __future__ import annotations

import os
import pickle
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from numba.core import types
from numba.core.serialize import dumps


def name_of_type(kind: Any) -> str:
    """Return the name of a type, which is the same in every process; numba's name of a kernel has its address."""
    function = kind.dispatcher.py_func if isinstance(kind, types.Dispatcher) else None
    if function is None or "<locals>" in function.__qualname__:
        return str(kind)
    return f"type({function.__module__}.{function.__qualname__})"


def hash_of(arguments: Iterable[Any], *others: Any) -> str:
    """Return a hash of types of arguments and of other things (hexadecimal digits)."""
    return sha256(repr(([name_of_type(kind) for kind in arguments], others)).encode()).hexdigest()


class CodeFiles:
    """The files of the machine code of one function, by hashes of what they depend on."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._name = folder, name

    def load(self, key: str) -> Any:
        """Return what has been stored; None if there is nothing."""
        try:
            return pickle.loads(self._path(key).read_bytes())
        except FileNotFoundError:
            return None

    def save(self, key: str, data: Any) -> None:
        """Store data as a whole, or not at all if OSError is raised."""
        path, written = self._path(key), dumps(data)  # type: ignore[no-untyped-call]
        descriptor, unfinished = tempfile.mkstemp(prefix=f"{path.name}.tmp.", dir=self._folder)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(written)
            Path(unfinished).replace(path)
        except OSError:
            with suppress(OSError):
                Path(unfinished).unlink()
            raise

    def _path(self, key: str) -> Path:
        return self._folder / f"{self._name}.{key[:16]}.nbc"
