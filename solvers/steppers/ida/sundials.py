"""IDA by the C functions of SUNDIALS, with kernels for callbacks: between two steps there is no Python.

The library is the one that scikit-sundae brings along and its extension module has loaded; what is relied on is the
interface of SUNDIALS 7 as its headers declare it, in double precision. With another one, and where nothing is compiled,
:mod:`.binding` serves.

A callback of IDA's is a kernel of one signature. It gets vectors as IDA has them, whose entries are :func:`array_at`
their :func:`data_of`, and as the user's data a named tuple that is held (:mod:`solvers.compiled.held`).
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import binding
from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
from sksundae import _cy_common, _cy_ida

from solvers.compiled.held import hold
from solvers.compiled.kernel import COMPILED, callback
from solvers.options import Statistics
from solvers.system import Array

from .loop import FAILURES, go
from .quiet import nowhere

SERIAL = 0  # SUN_COMM_NULL
LEFT = 1  # SUN_PREC_LEFT

FUNCTIONS = {  # what they return and take: a pointer, a whole or a real number
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
    "IDASetLinearSolver": "i ppp",
    "IDASetJacFn": "i pp",
    "IDASetPreconditioner": "i ppp",
    "IDASetJacTimes": "i ppp",
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
IN_C = {"p": ctypes.c_void_p, "i": ctypes.c_int, "d": ctypes.c_double}
IN_KERNELS = {"p": types.int64, "i": types.int32, "d": types.float64}


def serves() -> bool:
    """Whether kernels are compiled, and the library is one whose interface is known."""
    config = _cy_common.config
    known = config["SUNDIALS_FLOAT_TYPE"] == "double" and config["SUNDIALS_INT_TYPE"] == "int"
    return bool(COMPILED and known and config["SUNDIALS_VERSION"].startswith("7.") and _library())


@cache
def _library() -> dict[str, Any]:
    """Return the functions by name; none where one is missing."""
    library = ctypes.PyDLL(_cy_ida.__file__)  # its symbols are those of all it is linked to
    found = {}
    for name, told in FUNCTIONS.items():
        function = getattr(library, name, None)
        if function is None:
            return {}
        function.restype, *function.argtypes = (IN_C[letter] for letter in told.replace(" ", ""))
        found[name] = function
    binding.add_symbol("N_VGetArrayPointer", _address(found["N_VGetArrayPointer"]))
    binding.add_symbol("SUNDenseMatrix_Data", _address(found["SUNDenseMatrix_Data"]))
    return found


def _address(function: Any) -> int:
    return int(ctypes.cast(function, ctypes.c_void_p).value or 0)


def call(name: str, *arguments: Any) -> Any:
    """Call a function of the library; raise MemoryError where it has nothing to return."""
    result = _library()[name](*arguments)
    if FUNCTIONS[name].startswith("p") and not result:
        raise MemoryError(f"{name} of SUNDIALS returned nothing")
    return result


class Foreign(types.WrapperAddressProtocol):
    """A function of the library as kernels call it."""

    def __init__(self, name: str) -> None:
        self._place = _address(_library()[name])
        result, *arguments = (IN_KERNELS[letter] for letter in FUNCTIONS[name].replace(" ", ""))
        self._signature = result(*arguments)

    def __wrapper_address__(self) -> int:
        """Return where it is."""
        return self._place

    def signature(self) -> Any:
        """Return its signature."""
        return self._signature


data_of: Any = types.ExternalFunction("N_VGetArrayPointer", types.voidptr(types.voidptr))
data_of_matrix: Any = types.ExternalFunction("SUNDenseMatrix_Data", types.voidptr(types.voidptr))


def _array_at(_: Any, place: Any, count: Any) -> Any:
    array = types.Array(types.float64, 1, "C")

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        made, eight = context.make_array(array)(context, builder), context.get_constant(types.intp, 8)
        data = builder.bitcast(arguments[0], made.data.type)
        populate_array(made, data=data, shape=[arguments[1]], strides=[eight], itemsize=eight, meminfo=None)
        return made._getvalue()

    return array(types.voidptr, types.int64), generate


array_at: Any = intrinsic(_array_at)  # (address, count): real numbers that lie there, (count,)


class Callbacks(NamedTuple):
    """What IDA calls back; each returns 0.

    With a preconditioner linear systems go to GMRES, else to the dense ``matrix``.
    """

    residual: Callable[..., int]  # (t, y, y', out, data)
    set_up: Callable[..., int] | None = None  # (t, y, y', residual, c_j, data)
    precondition: Callable[..., int] | None = None  # (t, y, y', residual, right, left, c_j, delta, data)
    times: Callable[..., int] | None = None  # (t, y, y', residual, vector, product, c_j, data, scratch, scratch)
    matrix: Callable[..., int] | None = None  # (t, c_j, y, y', residual, out, data, scratch, scratch, scratch)


LETTERS = ("dvvv*", "dvvvd*", "dvvvvvdd*", "dvvvvvd*vv", "ddvvvv*vvv")  # a number, a vector or matrix, the data


@cache
def _compiled(function: Any, letters: str, data: Any) -> Any:
    known = {"d": types.float64, "v": types.voidptr, "*": data}
    return callback(types.int32(*(known[letter] for letter in letters)))(function)


@cache
def _compiled_accept(function: Any, data: Any) -> Any:
    column = types.float64[::1]
    return callback(types.int64(types.float64, column, column, data))(function)


class Calls(NamedTuple):
    """What the loop calls, and what it finds there."""

    solve: Any  # IDASolve
    stop_at: Any  # IDASetStopTime
    stop_nowhere: Any  # IDAClearStopTime
    memory: int  # address of IDA's
    yy: int  # of the vectors it writes
    yp: int
    told: int  # of ``reached``
    reached: Array  # (1,) s
    y: Array  # (N,)
    slopes: Array  # (N,) y'


class DirectIDA:
    """IDA on N unknowns.

    Parameters
    ----------
    callbacks, accept
        See :class:`Callbacks`, :func:`.loop.go`.
    data
        What they are given, held.
    rtol, atol
        Tolerances, the second (N,).
    max_step
        s.
    krylov
        Dimension of GMRES where there is a preconditioner.
    """

    def __init__(
        self, callbacks: Callbacks, accept: Callable[..., int], data: Any, *, rtol: float, atol: Array,
        max_order: int, max_step: float, krylov: int = 5,
    ) -> None:  # fmt: skip
        kind = data._numba_type_
        self._data, self._atol = data, atol
        self._accept = _compiled_accept(accept, kind)
        self._callbacks = Callbacks(
            *(f and _compiled(f, letters, kind) for f, letters in zip(callbacks, LETTERS, strict=True))
        )
        count = len(atol)
        self.y, self.slopes, reached = np.zeros(count), np.zeros(count), np.zeros(1)
        handle = ctypes.c_void_p()
        with nowhere():
            call("SUNContext_Create", SERIAL, ctypes.addressof(handle))
        context = handle.value
        call("SUNContext_ClearErrHandlers", context)
        yy, yp, tol = (call("N_VMake_Serial", count, a.ctypes.data, context) for a in (self.y, self.slopes, atol))
        self._memory = call("IDACreate", context)
        self._options = rtol, tol, max_order, max_step
        c = self._callbacks
        if c.precondition:
            matrix, solver = None, call("SUNLinSol_SPGMR", yy, LEFT, krylov, context)
        else:
            matrix = call("SUNDenseMatrix", count, count, context)
            solver = call("SUNLinSol_Dense", yy, matrix, context)
        self._solver, self._begun = (solver, matrix), False
        calls = Foreign("IDASolve"), Foreign("IDASetStopTime"), Foreign("IDAClearStopTime")
        told = int(reached.ctypes.data)
        self._calls = hold(Calls(*calls, self._memory, yy, yp, told, reached, self.y, self.slopes))
        self._vectors = yy, yp
        self._free = weakref.finalize(self, _free, self._memory, (yy, yp, tol), solver, matrix, context)

    def begin(self, t: float, y: Array, slopes: Array) -> None:
        """Begin a history at t (s) with unknowns and their derivatives (N,)."""
        self.y[:], self.slopes[:] = y, slopes
        if self._begun:
            call("IDAReInit", self._memory, t, *self._vectors)
            return
        memory, c = self._memory, self._callbacks
        rtol, tol, max_order, max_step = self._options
        call("IDAInit", memory, c.residual.address, t, *self._vectors)
        call("IDASetUserData", memory, self._data.address)
        call("IDASVtolerances", memory, rtol, tol)
        call("IDASetLinearSolver", memory, *self._solver)
        if c.matrix:
            call("IDASetJacFn", memory, c.matrix.address)
        if c.precondition:
            call("IDASetPreconditioner", memory, c.set_up.address, c.precondition.address)
        if c.times:
            call("IDASetJacTimes", memory, None, c.times.address)
        call("IDASetMaxOrd", memory, max_order)
        call("IDASetMaxConvFails", memory, FAILURES)
        if np.isfinite(max_step):
            call("IDASetMaxStep", memory, max_step)
        self._begun = True

    def go(self, t: float) -> int:
        """Step until t (s) is passed; see :func:`.loop.go`."""
        return int(go(self._calls, self._accept, self._data, t))

    def interpolate(self, t: float) -> Array:
        """Return the unknowns (N,) at t in the last step."""
        call("IDAGetDky", self._memory, t, 0, self._vectors[0])
        return self.y

    def told(self) -> Statistics:
        """Return what IDA counts since it began last."""
        whole, real = (ctypes.c_long * 4)(), (ctypes.c_double * 4)()
        orders = (ctypes.c_int * 2)()
        at = [ctypes.addressof(a) + k * ctypes.sizeof(a._type_) for a in (whole, orders, real) for k in range(len(a))]
        if self._begun:
            call("IDAGetIntegratorStats", self._memory, *at)
        return Statistics(rejected=whole[3], order=orders[0], step_size=real[1])


def _free(memory: int, vectors: Any, solver: int, matrix: int | None, context: int) -> None:
    handle = ctypes.c_void_p(memory)
    call("IDAFree", ctypes.addressof(handle))
    for made in vectors:
        call("N_VDestroy", made)
    call("SUNLinSolFree", solver)
    if matrix:
        call("SUNMatDestroy", matrix)
    handle.value = context
    call("SUNContext_Free", ctypes.addressof(handle))
