"""The one place that knows numba: how kernels, callbacks and record arrays are made.

A *kernel* is a closed compiled function: scalar loops, no allocation, no exceptions, no Python objects,
out-parameters last. A *callback* is a kernel with a fixed signature that a solver receives as an argument;
numba types it by signature only, so the solver compiles once, is cached, and serves every system.

Machine code is cached in a folder named by a fingerprint of all kernel sources: numba alone would go on using a
cached caller after its callee was edited. The folder is ``mbfmu/<fingerprint>`` under ``NUMBA_CACHE_DIR`` or the
user's cache.

With ``NUMBA_DISABLE_JIT=1`` everything here is plain Python, for coverage and debugging.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])

_config: Any = numba.config

COMPILED: bool = not _config.DISABLE_JIT

# No kernel allocates or keeps an array, so none counts references: the counting costs more than most kernels do.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}


@cache
def cache_folder() -> Path:
    """Return the folder that holds the machine code of these sources."""
    here = Path(__file__).resolve().parent
    fingerprint = sha256()
    for folder in (here, here.parent / "mbfmu" / "mechanics"):
        for source in sorted(folder.rglob("*.py")):
            fingerprint.update(source.relative_to(here.parent).as_posix().encode())
            fingerprint.update(source.read_bytes())
    default = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or default)
    return base / "mbfmu" / fingerprint.hexdigest()[:16]


def cold() -> bool:
    """Whether nothing of these sources has been compiled on this machine."""
    folder = cache_folder()
    return COMPILED and not (folder.is_dir() and any(folder.iterdir()))


@contextmanager
def _cached_here() -> Iterator[None]:
    """Let numba choose our folder while it sets up one function's cache, and leave other packages theirs."""
    before = _config.CACHE_DIR
    _config.CACHE_DIR = str(cache_folder())
    try:
        yield
    finally:
        _config.CACHE_DIR = before


def kernel(function: F) -> F:
    """Compile a closed function on first use and keep the machine code on disk."""
    with _cached_here():
        return cast(F, numba.njit(**_OPTIONS)(function))


def inlined(function: F) -> F:
    """Compile a small kernel into its callers: handing it many arrays would cost more than its work."""
    with _cached_here():
        return cast(F, numba.njit(**_OPTIONS, forceinline=True)(function))


def callback(signature: Any) -> Callable[[F], F]:
    """Compile a function for one signature, so that it can be passed to a kernel as an argument."""

    def compile_(function: F) -> F:
        if not COMPILED:
            return function
        with _cached_here():
            return cast(F, numba.cfunc(signature, **_OPTIONS)(function))

    return compile_


def records(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``count`` zeroed records whose fields kernels reach as attributes (``bodies[i].mass``)."""
    array = np.zeros(count, dtype)
    return array if COMPILED else array.view(np.recarray)
