"""IDA by the C functions of SUNDIALS, with kernels for callbacks: between two steps there is no Python.

The library is the one that scikit-sundae installs (:mod:`.installed_library`); what is relied on is the interface of
SUNDIALS 7 as its headers declare it, in double precision. With another one, and where nothing is compiled,
:mod:`.binding` serves.

A callback of IDA's is a kernel of one signature. It gets vectors as IDA has them, whose entries are the
:func:`~solvers.compiled.ffi.array_at` their :func:`vector_data`, and as the user's data a named tuple that is held
(:mod:`solvers.compiled.tuple_pointer`).
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from solvers.compiled.ffi import Library, compile_c_callback, external_function
from solvers.compiled.kernel import COMPILED
from solvers.options import Statistics
from solvers.system import Array

from .calls import (
    CONTEXT,
    FUNCTION_NAMES,
    KRYLOV_DIMENSION,
    LAST_ORDER,
    LAST_STEP,
    LINEAR_TOLERANCE,
    MAX_CJ_CHANGE,
    REJECTED,
    RESIDUAL,
    SIGNATURES,
    begin_history,
    clear_stop,
    count,
    create,
    interpolate,
    release,
    solve,
    stop_at,
)
from .installed_library import configuration, load_extension
from .logging import discard_logs

SUN_COMM_NULL = 0
CONTEXT_SIGNATURES = {  # in the letters of solvers.compiled.ffi
    "SUNContext_Create": "i ip",
    "SUNContext_ClearErrHandlers": "i p",
    "SUNContext_Free": "i p",
    "N_VGetArrayPointer": "p p",
    "SUNDenseMatrix_Data": "p p",
}


@cache
def library() -> Library:
    """Return SUNDIALS, to which the extension module of scikit-sundae is linked."""
    symbols = ("N_VGetArrayPointer", "SUNDenseMatrix_Data")
    return load_extension(lambda path: Library(path, {**SIGNATURES, **CONTEXT_SIGNATURES}, symbols))


@cache
def is_library_supported() -> bool:
    """Whether kernels are compiled, and the library is one whose interface is known."""
    config = configuration()
    known = config.get("SUNDIALS_FLOAT_TYPE") == "double" and config.get("SUNDIALS_INT_TYPE") == "int"
    return bool(COMPILED and known and config["SUNDIALS_VERSION"].startswith("7.") and library().complete)


def call_sundials(name: str, *arguments: Any) -> Any:
    """Call a function of SUNDIALS."""
    return library().call(name, *arguments)


vector_data: Any = external_function("N_VGetArrayPointer")
matrix_data: Any = external_function("SUNDenseMatrix_Data")


class Callbacks(NamedTuple):
    """What IDA calls back; each returns 0.

    With a preconditioner linear systems go to GMRES, else to the dense ``jacobian``.
    """

    residual: Callable[..., int]  # (t, y, y', out, data)
    set_up_preconditioner: Callable[..., int] | None = None  # (t, y, y', residual, c_j, data)
    apply_preconditioner: Callable[..., int] | None = None  # (t, y, y', residual, right, left, c_j, delta, data)
    matvec: Callable[..., int] | None = None  # (t, y, y', residual, vector, product, c_j, data, scratch, scratch)
    jacobian: Callable[..., int] | None = None  # (t, c_j, y, y', residual, out, data, scratch, scratch, scratch)
    error_weights: Callable[..., int] | None = None  # (y, out, data): one over the tolerances of the unknowns


LOOP_CALLS = {"solve": solve, "stop_at": stop_at, "clear_stop": clear_stop}  # hooks of the loop
CALLBACK_SIGNATURES = ("dppp*", "dpppd*", "dpppppdd*", "dpppppd*pp", "ddpppp*ppp", "pp*")  # the data as a star


class DirectIDA:
    """IDA on N unknowns.

    Parameters
    ----------
    callbacks
        See :class:`Callbacks`.
    loop
        Kernel :func:`.loop.step_until` with the calls of :mod:`.calls` and the function that accepts steps.
    data
        What callbacks and ``loop`` are given, pinned.
    progress, counts
        See :func:`.loop.step_until`.
    handle
        IDA with an empty table of addresses, pinned.
    rtol
        Relative tolerance, where none of the callbacks weighs; the absolute ones are those of the handle and may change
        before a history begins.
    max_step
        s.
    krylov
        Dimension of GMRES where there is a preconditioner.
    linear_tolerance
        Residual of its solutions relative to what stops Newton's iteration.
    """

    def __init__(
        self, callbacks: Callbacks, loop: Callable[..., int], data: Any, progress: Any, counts: Array, handle: Any, *,
        rtol: float, max_order: int, max_step: float, krylov: int = KRYLOV_DIMENSION,
        linear_tolerance: float = LINEAR_TOLERANCE,
    ) -> None:  # fmt: skip
        context = ctypes.c_void_p()
        with discard_logs():  # before any kernel is loaded: those name symbols of the library, which this call loads
            call_sundials("SUNContext_Create", SUN_COMM_NULL, ctypes.addressof(context))
        call_sundials("SUNContext_ClearErrHandlers", context.value)
        kind, made = data._numba_type_, list[Any]()
        for given, letters in zip(callbacks, CALLBACK_SIGNATURES, strict=True):
            made.append(None if given is None else compile_c_callback(given, letters, kind))
        self._loop, self._data, self._progress, self._counts, self._handle = loop, data, progress, counts, handle
        self._options, self._linear_tolerance = (rtol, max_order, max_step), linear_tolerance
        own = handle.value
        self.y, self.slopes, self._counters, self._reals = own.y, own.slopes, own.counters, own.reals
        own.words[: len(FUNCTION_NAMES)] = [library().address(name) for name in FUNCTION_NAMES]
        addresses = [callback.address if callback else 0 for callback in made]
        own.words[RESIDUAL : CONTEXT + 1] = [*addresses, data.address, context.value]
        self._free = weakref.finalize(self, _free, handle, context)
        if not create(handle, krylov):
            raise MemoryError("there is no memory for IDA; close other programs, or simulate a smaller model")

    def begin(self, t: float, y: Array, slopes: Array) -> None:
        """Begin a history at t (s) with unknowns and their derivatives (N,), tolerances as they are now."""
        self.y[:], self.slopes[:] = y, slopes
        begin_history(self._handle, t, *self._options, MAX_CJ_CHANGE, self._linear_tolerance)

    def step_until(self, t: float) -> int:
        """Step until t (s) is passed; see :func:`.loop.step_until`."""
        return int(self._loop(self._handle, self._progress, self._counts, self._data, t))

    def interpolate(self, t: float) -> Array:
        """Return the unknowns (N,) at t in the last step; they are not numbers if IDA has no step that contains t."""
        if not interpolate(self._handle, t):
            self.y[:] = np.nan
        return self.y

    def statistics(self) -> Statistics:
        """Return what IDA counts since it began last."""
        count(self._handle)
        rejected, order = int(self._counters[REJECTED]), int(self._counters[LAST_ORDER])
        return Statistics(rejected=rejected, order=order, step_size=float(self._reals[LAST_STEP]))


def _free(handle: Any, context: Any) -> None:
    release(handle)
    call_sundials("SUNContext_Free", ctypes.addressof(context))
