"""How kernels, callbacks and record arrays are made.

A *kernel* is a closed compiled function: scalar loops, no allocation, no exceptions, no Python objects,
out-parameters last. A solver receives the functions of a system as kernels or as callbacks. It is compiled for the
kernels of mechanisms once, whether Python or a native FMU runs it. A *callback* is a kernel with a fixed signature that
is called by its address. Numba types it by signature only, so that a solver that is compiled once serves the callbacks
of any user.

With ``NUMBA_DISABLE_JIT=1`` everything here is plain Python, for coverage and debugging.
"""

from __future__ import annotations

import dis
from collections.abc import Callable
from functools import lru_cache
from types import CodeType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import types as types  # noqa: PLC0414  # of signatures of callbacks
from numba.core import sigutils
from numpy.typing import NDArray

from .symbols import Callback, Inlined, Kernel, SystemKernel

F = TypeVar("F", bound=Callable[..., Any])

_config: Any = numba.config

COMPILED: bool = not _config.DISABLE_JIT

# No kernel allocates or keeps an array, so none counts references: the counting costs more than most kernels do.
_OPTIONS: dict[str, Any] = {"boundscheck": None, "error_model": "numpy", "_nrt": False, "no_cpython_wrapper": True}


def kernel(function: F) -> F:
    """Compile a function on its first call and keep the machine code on disk.

    Parameters
    ----------
    function
        Function that uses no other Python objects than kernels, constants and its arguments. It must not allocate
        arrays.

    Returns
    -------
    function
        Compiled function; with ``NUMBA_DISABLE_JIT=1`` the function itself.
    """
    return _dispatcher(Kernel, function) if COMPILED else function


def concurrent_kernel(function: F) -> F:
    """Compile a kernel during whose calls from Python other threads of Python run."""
    return _dispatcher(Kernel, function, nogil=True) if COMPILED else function


def system_kernel(function: F) -> F:
    """Compile a kernel that solvers receive as a function of a system, see :class:`.symbols.SystemKernel`."""
    return _dispatcher(SystemKernel, function) if COMPILED else function


def inlined(function: F) -> F:
    """Compile a small kernel into its callers: handing it many arrays would cost more than its work."""
    return _dispatcher(Inlined, function, forceinline=True) if COMPILED else function


def _dispatcher(kind: type[Inlined], function: F, **options: Any) -> F:
    dispatcher = kind(function, targetoptions={"nopython": True, "no_cfunc_wrapper": True, **_OPTIONS, **options})
    dispatcher.enable_caching()
    return cast(F, dispatcher)


def callback(signature: Any) -> Callable[[F], F]:
    """Compile a function for one signature, so that it can be passed to a kernel as an argument."""

    def compile_(function: F) -> F:
        if not COMPILED:
            return function
        dispatcher = Callback(function, sigutils.normalize_signature(signature), {}, dict(_OPTIONS))
        dispatcher.enable_caching()
        dispatcher.compile()
        return cast(F, dispatcher)

    return compile_


def records(count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``count`` zeroed records whose fields kernels reach as attributes (``bodies[i].mass``)."""
    array = np.zeros(count, dtype)
    return array if COMPILED else array.view(np.recarray)


def jit_uncached(function: F) -> F:
    """Compile a function as a kernel without storing the code: one that is defined at run time."""
    if not COMPILED:
        return function
    return cast(F, Kernel(function, targetoptions={"nopython": True, "no_cfunc_wrapper": True, **_OPTIONS}))


def bounds_checked(function: Any) -> Any:
    """Return a kernel, for this process alone, that raises IndexError where an index is outside an array."""
    if not COMPILED:
        return function
    options = {"nopython": True, "no_cfunc_wrapper": True, **_OPTIONS, "boundscheck": True}
    return Kernel(getattr(function, "py_func", function), targetoptions=options)


def is_kernel(function: Any) -> bool:
    """Whether a function is compiled, so that kernels can call it."""
    return isinstance(function, Inlined)


def has_raise(function: Any) -> bool:
    """Whether a kernel, or a function to be compiled, contains a ``raise`` or an ``assert``."""
    code = getattr(getattr(function, "py_func", function), "__code__", None)
    return code is not None and _has_raise(code)


@lru_cache(maxsize=1024)  # a mesh asks for the same few kernels hundreds of times
def _has_raise(code: CodeType) -> bool:
    return any(step.opname == "RAISE_VARARGS" for step in dis.get_instructions(code))
