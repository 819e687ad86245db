"""IDA by the C functions of SUNDIALS, with kernels for callbacks: between two steps there is no Python.

The library is the one that scikit-sundae brings along and its extension module has loaded; what is relied on is the
interface of SUNDIALS 7 as its headers declare it, in double precision. With another one, and where nothing is compiled,
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
from sksundae import _cy_common, _cy_ida

from solvers.compiled.ffi import Library, compile_c_callback, external_function
from solvers.compiled.kernel import COMPILED, callback, types
from solvers.compiled.tuple_pointer import pin
from solvers.options import Statistics
from solvers.system import Array

from .logging import discard_logs
from .loop import MAX_CONVERGENCE_FAILURES, step_until

SUN_COMM_NULL = 0
SUN_PREC_LEFT = 1
# A dense matrix is refactored if c_j has changed by this part. With IDA's 0.25 Newton stops as soon as positions
# are good to the tolerance, and the stiffest mode turns what is left in them into a speed that the error test refuses:
# a loaded spring of 1e8 N/m had 97 % of its steps rejected.
MAX_CJ_CHANGE = 0.05

SIGNATURES = {  # in the letters of solvers.compiled.ffi
    "SUNContext_Create": "i ip",
    "SUNContext_ClearErrHandlers": "i p",
    "SUNContext_Free": "i p",
    "N_VMake_Serial": "p ipp",
    "N_VGetArrayPointer": "p p",
    "N_VDestroy": "i p",
    "SUNDenseMatrix": "p iip",
    "SUNDenseMatrix_Data": "p p",
    "SUNMatDestroy": "i p",
    "SUNLinSol_Dense": "p ppp",
    "SUNLinSol_SPGMR": "p piip",
    "SUNLinSolFree": "i p",
    "IDACreate": "p p",
    "IDAInit": "i ppdpp",
    "IDAReInit": "i pdpp",
    "IDASetUserData": "i pp",
    "IDASVtolerances": "i pdp",
    "IDAWFtolerances": "i pp",
    "IDASetLinearSolver": "i ppp",
    "IDASetJacFn": "i pp",
    "IDASetPreconditioner": "i ppp",
    "IDASetJacTimes": "i ppp",
    "IDASetDeltaCjLSetup": "i pd",
    "IDASetMaxConvFails": "i pi",
    "IDASetMaxStep": "i pd",
    "IDASetMaxOrd": "i pi",
    "IDASetStopTime": "i pd",
    "IDAClearStopTime": "i p",
    "IDASolve": "i pdpppi",
    "IDAGetDky": "i pdip",
    "IDAGetIntegratorStats": "i " + "p" * 11,
    "IDAFree": "i p",
}


@cache
def library() -> Library:
    """Return SUNDIALS as the extension module of scikit-sundae has loaded it."""
    return Library(_cy_ida.__file__, SIGNATURES, ("N_VGetArrayPointer", "SUNDenseMatrix_Data"))


def is_library_supported() -> bool:
    """Whether kernels are compiled, and the library is one whose interface is known."""
    config = getattr(_cy_common, "config", {})
    known = config.get("SUNDIALS_FLOAT_TYPE") == "double" and config.get("SUNDIALS_INT_TYPE") == "int"
    return bool(COMPILED and known and config["SUNDIALS_VERSION"].startswith("7.") and library().complete)


def call_sundials(name: str, *arguments: Any) -> Any:
    """Call a function of SUNDIALS."""
    return library().call(name, *arguments)


vector_data: Any = external_function("N_VGetArrayPointer")
matrix_data: Any = external_function("SUNDenseMatrix_Data")


SETUP_FUNCTION = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_double, *(ctypes.c_void_p,) * 3, ctypes.c_double, ctypes.c_void_p
)


class PythonSetup:
    """A set-up of the preconditioner in Python, as IDA calls it; an exception is stored and raised later."""

    raised: BaseException | None = None

    def __init__(self, function: Callable[..., int], count: int) -> None:
        def set_up(t: float, y: int, slopes: int, res: int, cj: float, _data: int) -> int:
            arrays = (
                np.ctypeslib.as_array((ctypes.c_double * count).from_address(call_sundials("N_VGetArrayPointer", v)))
                for v in (y, slopes, res)
            )
            try:
                return function(t, *arrays, cj)
            except BaseException as error:  # nothing goes through C
                self.raised = error
                return -1

        self._function = SETUP_FUNCTION(set_up)
        self.address = ctypes.cast(self._function, ctypes.c_void_p).value

    def raise_again(self) -> None:
        """Raise what the function has raised."""
        if self.raised is not None:
            error, self.raised = self.raised, None
            raise error


class Callbacks(NamedTuple):
    """What IDA calls back; each returns 0.

    With a preconditioner linear systems go to GMRES, else to the dense ``jacobian``.
    """

    residual: Callable[..., int]  # (t, y, y', out, data)
    set_up_preconditioner: Callable[..., int] | PythonSetup | None = None  # (t, y, y', residual, c_j, data)
    apply_preconditioner: Callable[..., int] | None = None  # (t, y, y', residual, right, left, c_j, delta, data)
    matvec: Callable[..., int] | None = None  # (t, y, y', residual, vector, product, c_j, data, scratch, scratch)
    jacobian: Callable[..., int] | None = None  # (t, c_j, y, y', residual, out, data, scratch, scratch, scratch)
    error_weights: Callable[..., int] | None = None  # (y, out, data): one over the tolerances of the unknowns


CALLBACK_SIGNATURES = ("dppp*", "dpppd*", "dpppppdd*", "dpppppd*pp", "ddpppp*ppp", "pp*")  # the data as a star


@cache
def _compiled_accept(function: Any, data: Any) -> Any:
    column = types.float64[::1]
    return callback(types.int64(types.float64, column, column, data))(function)


class IDAHandle(NamedTuple):
    """IDA as the loop uses it: functions of the library, addresses, and results."""

    solve: Any  # IDASolve
    stop_at: Any  # IDASetStopTime
    clear_stop: Any  # IDAClearStopTime
    accept: Any  # function that accepts its steps
    memory: int  # address of IDA's
    yy: int  # of the vectors it writes
    yp: int
    reached_address: int  # of ``reached``
    reached: Array  # (1,) s
    y: Array  # (N,)
    slopes: Array  # (N,) y'


class DirectIDA:
    """IDA on N unknowns.

    Parameters
    ----------
    callbacks, accept
        See :class:`Callbacks`, :func:`.loop.step_until`.
    data
        What they are given, held.
    rtol, atol
        Tolerances, where none of the callbacks weighs; the second, an array (N,), may change before a history begins.
    max_step
        s.
    krylov
        Dimension of GMRES where there is a preconditioner.
    """

    def __init__(
        self, callbacks: Callbacks, accept: Callable[..., int], data: Any, *, rtol: float, atol: Array,
        max_order: int, max_step: float, krylov: int = 5,
    ) -> None:  # fmt: skip
        handle = ctypes.c_void_p()
        with discard_logs():  # before any kernel is loaded: those name symbols of the library, which this call loads
            call_sundials("SUNContext_Create", SUN_COMM_NULL, ctypes.addressof(handle))
        context = handle.value
        call_sundials("SUNContext_ClearErrHandlers", context)
        kind = data._numba_type_
        self._data, self._atol = data, atol
        count = len(atol)
        made = (
            compile_c_callback(given, letters, kind) if given and not isinstance(given, PythonSetup) else given
            for given, letters in zip(callbacks, CALLBACK_SIGNATURES, strict=True)
        )
        self._callbacks: Any = Callbacks._make(made)
        self.y, self.slopes, reached = np.zeros(count), np.zeros(count), np.zeros(1)
        yy, yp, tol = (
            call_sundials("N_VMake_Serial", count, a.ctypes.data, context) for a in (self.y, self.slopes, atol)
        )
        self._memory = call_sundials("IDACreate", context)
        self._options = rtol, tol, max_order, max_step
        callbacks = self._callbacks
        if callbacks.apply_preconditioner:
            matrix, solver = None, call_sundials("SUNLinSol_SPGMR", yy, SUN_PREC_LEFT, krylov, context)
        else:
            matrix = call_sundials("SUNDenseMatrix", count, count, context)
            solver = call_sundials("SUNLinSol_Dense", yy, matrix, context)
        self._solver, self._begun = (solver, matrix), False
        solve, stop_at, clear_stop = map(library().value, ("IDASolve", "IDASetStopTime", "IDAClearStopTime"))
        reached_address = int(reached.ctypes.data)
        called = solve, stop_at, clear_stop, _compiled_accept(accept, kind)
        self._handle = pin(IDAHandle(*called, self._memory, yy, yp, reached_address, reached, self.y, self.slopes))
        self._vectors = yy, yp
        self._free = weakref.finalize(self, _free, self._memory, (yy, yp, tol), solver, matrix, context)

    def begin(self, t: float, y: Array, slopes: Array) -> None:
        """Begin a history at t (s) with unknowns and their derivatives (N,), tolerances as they are now."""
        self.y[:], self.slopes[:] = y, slopes
        if self._begun:
            call_sundials("IDAReInit", self._memory, t, *self._vectors)
            self._set_tolerances()
            return
        memory, callbacks = self._memory, self._callbacks
        max_order, max_step = self._options[2:]
        call_sundials("IDAInit", memory, callbacks.residual.address, t, *self._vectors)
        call_sundials("IDASetUserData", memory, self._data.address)
        self._set_tolerances()
        call_sundials("IDASetLinearSolver", memory, *self._solver)
        if callbacks.jacobian:
            call_sundials("IDASetJacFn", memory, callbacks.jacobian.address)
        if not callbacks.apply_preconditioner:
            call_sundials("IDASetDeltaCjLSetup", memory, MAX_CJ_CHANGE)
        if callbacks.apply_preconditioner:
            call_sundials(
                "IDASetPreconditioner",
                memory,
                callbacks.set_up_preconditioner.address,
                callbacks.apply_preconditioner.address,
            )
        if callbacks.matvec:
            call_sundials("IDASetJacTimes", memory, None, callbacks.matvec.address)
        call_sundials("IDASetMaxOrd", memory, max_order)
        call_sundials("IDASetMaxConvFails", memory, MAX_CONVERGENCE_FAILURES)
        if np.isfinite(max_step):
            call_sundials("IDASetMaxStep", memory, max_step)
        self._begun = True

    def _set_tolerances(self) -> None:
        if self._callbacks.error_weights:
            call_sundials("IDAWFtolerances", self._memory, self._callbacks.error_weights.address)
        else:
            call_sundials("IDASVtolerances", self._memory, *self._options[:2])

    def step_until(self, t: float) -> int:
        """Step until t (s) is passed; see :func:`.loop.step_until`."""
        code = step_until(self._handle, self._data, t)
        if isinstance(self._callbacks.set_up_preconditioner, PythonSetup):
            self._callbacks.set_up_preconditioner.raise_again()
        return int(code)

    def interpolate(self, t: float) -> Array:
        """Return the unknowns (N,) at t in the last step; they are not numbers if IDA has no step that contains t."""
        if call_sundials("IDAGetDky", self._memory, t, 0, self._vectors[0]) != 0:
            self.y[:] = np.nan
        return self.y

    def statistics(self) -> Statistics:
        """Return what IDA counts since it began last."""
        whole, real = (ctypes.c_long * 4)(), (ctypes.c_double * 4)()
        orders = (ctypes.c_int * 2)()
        at = [ctypes.addressof(a) + k * ctypes.sizeof(a._type_) for a in (whole, orders, real) for k in range(len(a))]
        if self._begun:
            call_sundials("IDAGetIntegratorStats", self._memory, *at)
        return Statistics(rejected=whole[3], order=orders[0], step_size=real[1])


def _free(memory: int, vectors: Any, solver: int, matrix: int | None, context: Any) -> None:
    handle = ctypes.c_void_p(memory)
    call_sundials("IDAFree", ctypes.addressof(handle))
    for made in vectors:
        call_sundials("N_VDestroy", made)
    call_sundials("SUNLinSolFree", solver)
    if matrix:
        call_sundials("SUNMatDestroy", matrix)
    handle.value = context
    call_sundials("SUNContext_Free", ctypes.addressof(handle))
