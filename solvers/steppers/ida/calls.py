"""The calls of SUNDIALS in their order: kernels over a table of addresses, which Python and native FMUs fill.

Python takes the addresses from the library that scikit-sundae has loaded (:mod:`.sundials`), a native FMU from the
same library in its own folder. What is relied on is the interface of SUNDIALS 7 as its headers declare it, with
numbers in double precision and indices of C's type int.

The process that fills the table creates the context, which it owns, and frees it after :func:`release`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.foreign_call import address_of_array, call_int, call_pointer
from solvers.compiled.kernel import inlined, kernel
from solvers.system import Array

from .loop import IDA_ONE_STEP, MAX_CONVERGENCE_FAILURES

if TYPE_CHECKING:
    pass

SIGNATURES = {  # of the functions that kernels call, in the letters of solvers.compiled.ffi
    "N_VMake_Serial": "p ipp",
    "N_VDestroy": "i p",
    "SUNDenseMatrix": "p iip",
    "SUNMatDestroy": "i p",
    "SUNLinSol_Dense": "p ppp",
    "SUNLinSol_SPGMR": "p piip",
    "SUNLinSolInitialize": "i p",
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
    "IDASetEpsLin": "i pd",
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
FUNCTION_NAMES = tuple(SIGNATURES)
(
    N_V_MAKE_SERIAL, N_V_DESTROY, SUN_DENSE_MATRIX, SUN_MAT_DESTROY, SUN_LIN_SOL_DENSE, SUN_LIN_SOL_SPGMR,
    SUN_LIN_SOL_INITIALIZE, SUN_LIN_SOL_FREE, IDA_CREATE, IDA_INIT, IDA_RE_INIT, IDA_SET_USER_DATA, IDA_SV_TOLERANCES,
    IDA_WF_TOLERANCES, IDA_SET_LINEAR_SOLVER, IDA_SET_JAC_FN, IDA_SET_PRECONDITIONER, IDA_SET_JAC_TIMES,
    IDA_SET_DELTA_CJ_L_SETUP, IDA_SET_EPS_LIN, IDA_SET_MAX_CONV_FAILS, IDA_SET_MAX_STEP, IDA_SET_MAX_ORD,
    IDA_SET_STOP_TIME, IDA_CLEAR_STOP_TIME, IDA_SOLVE, IDA_GET_DKY, IDA_GET_INTEGRATOR_STATS, IDA_FREE,
) = range(len(FUNCTION_NAMES))  # fmt: skip
# What IDA calls back, see solvers.steppers.ida.sundials.Callbacks; then what it is given for them
CALLBACKS = ("residual", "set_up_preconditioner", "apply_preconditioner", "matvec", "jacobian", "error_weights")
RESIDUAL, SET_UP, PRECONDITION, MATVEC, JACOBIAN, ERROR_WEIGHTS, USER_DATA = range(
    len(FUNCTION_NAMES), len(FUNCTION_NAMES) + len(CALLBACKS) + 1
)
OBJECTS = ("context", "memory", "yy", "yp", "tolerances", "matrix", "solver", "is_begun")
CONTEXT, MEMORY, YY, YP, TOLERANCES, MATRIX, SOLVER, IS_BEGUN = range(
    USER_DATA + 1, USER_DATA + 1 + len(OBJECTS)
)  # addresses, 0: none; at last 1: a history has begun
N_WORDS = IS_BEGUN + 1

SUN_PREC_LEFT = np.int32(1)
KRYLOV_DIMENSION = 5
# Residual of a solution by GMRES relative to what stops Newton's iteration: IDA's default, and that with friction that
# sticks. With the default Newton's corrections leave errors along the motions of stiff bristles, which the error test
# refuses: eight wheels that roll took 13 000 steps, and 400 with 1e-3.
LINEAR_TOLERANCE, STICKING_LINEAR_TOLERANCE = 0.05, 1e-3
# A dense matrix is refactored if c_j has changed by this part. With IDA's 0.25 Newton stops as soon as positions
# are good to the tolerance, and the stiffest mode turns what is left in them into a speed that the error test refuses:
# a loaded spring of 1e8 N/m had 97 % of its steps rejected.
MAX_CJ_CHANGE = 0.05
REJECTED, LAST_ORDER = 3, 4  # counters of IDA
N_IDA_COUNTERS, N_REALS = 6, 4
LAST_STEP = 1  # real number that IDA reports with its counters, s


class IDAHandle(NamedTuple):
    """IDA on N unknowns, as kernels call it."""

    words: NDArray[np.int64]  # (N_WORDS,) addresses: of functions, of callbacks, of objects
    counters: NDArray[np.int64]  # (N_IDA_COUNTERS,) of IDA since its history began, filled by :func:`count`
    reals: Array  # (N_REALS,) the same
    reached: Array  # (1,) s, end of IDA's last step
    y: Array  # (N,) unknowns there, or where they were interpolated
    slopes: Array  # (N,) y'
    atol: Array  # (N,) absolute tolerances, if no callback weighs the errors

    @staticmethod
    def allocate(count: int) -> IDAHandle:
        """Return the handle of ``count`` unknowns with an empty table."""
        z, words, counters = np.zeros, np.zeros(N_WORDS, np.int64), np.zeros(N_IDA_COUNTERS, np.int64)
        return IDAHandle(words, counters, z(N_REALS), z(1), z(count), z(count), z(count))


@kernel
def create(ida: IDAHandle, krylov: int) -> bool:
    """Create vectors, memory, matrix and linear solver: GMRES of dimension ``krylov`` if there is a preconditioner,
    else the dense one. Return False if there is no memory for them.
    """
    o, N, context = ida.words, np.int32(ida.y.shape[0]), ida.words[CONTEXT]
    o[YY] = call_pointer(o[N_V_MAKE_SERIAL], (N, address_of_array(ida.y), context))
    o[YP] = call_pointer(o[N_V_MAKE_SERIAL], (N, address_of_array(ida.slopes), context))
    o[TOLERANCES] = call_pointer(o[N_V_MAKE_SERIAL], (N, address_of_array(ida.atol), context))
    o[MEMORY] = call_pointer(o[IDA_CREATE], (context,))
    if o[YY] == 0 or o[YP] == 0 or o[TOLERANCES] == 0 or o[MEMORY] == 0:
        return False
    if o[PRECONDITION] != 0:
        o[SOLVER] = call_pointer(o[SUN_LIN_SOL_SPGMR], (o[YY], SUN_PREC_LEFT, np.int32(krylov), context))
    else:
        o[MATRIX] = call_pointer(o[SUN_DENSE_MATRIX], (N, N, context))
        if o[MATRIX] != 0:
            o[SOLVER] = call_pointer(o[SUN_LIN_SOL_DENSE], (o[YY], o[MATRIX], context))
    return o[SOLVER] != 0


@kernel
def release(ida: IDAHandle) -> None:
    """Free all objects but the context."""
    o = ida.words
    if o[MEMORY] != 0:
        call_int(o[IDA_FREE], (address_of_array(o) + 8 * MEMORY,))
    for vector in (YY, YP, TOLERANCES):
        if o[vector] != 0:
            call_int(o[N_V_DESTROY], (o[vector],))
    if o[SOLVER] != 0:
        call_int(o[SUN_LIN_SOL_FREE], (o[SOLVER],))
    if o[MATRIX] != 0:
        call_int(o[SUN_MAT_DESTROY], (o[MATRIX],))
    for k in range(MEMORY, N_WORDS):
        o[k] = 0


@kernel
def begin_history(
    ida: IDAHandle,
    t: float,
    rtol: float,
    max_order: int,
    max_step: float,
    max_cj_change: float,
    linear_tolerance: float,
) -> bool:
    """Begin a history at t (s) with the unknowns and derivatives in ``ida``; False: SUNDIALS refuses it.

    Order and step (s; infinite: no limit) are limited, and the tolerance of GMRES is set, from the first history on.
    """
    o, memory, failed = ida.words, ida.words[MEMORY], False
    if o[IS_BEGUN] == 1:
        failed |= call_int(o[IDA_RE_INIT], (memory, t, o[YY], o[YP])) != 0
        return not (failed or _set_tolerances(ida, rtol) != 0)
    failed |= call_int(o[IDA_INIT], (memory, o[RESIDUAL], t, o[YY], o[YP])) != 0
    failed |= call_int(o[IDA_SET_USER_DATA], (memory, o[USER_DATA])) != 0
    failed |= _set_tolerances(ida, rtol) != 0
    failed |= call_int(o[IDA_SET_LINEAR_SOLVER], (memory, o[SOLVER], o[MATRIX])) != 0
    if o[JACOBIAN] != 0:
        failed |= call_int(o[IDA_SET_JAC_FN], (memory, o[JACOBIAN])) != 0
    if o[PRECONDITION] != 0:
        failed |= call_int(o[IDA_SET_PRECONDITIONER], (memory, o[SET_UP], o[PRECONDITION])) != 0
        failed |= call_int(o[IDA_SET_EPS_LIN], (memory, linear_tolerance)) != 0
    else:
        failed |= call_int(o[IDA_SET_DELTA_CJ_L_SETUP], (memory, max_cj_change)) != 0
    if o[MATVEC] != 0:
        failed |= call_int(o[IDA_SET_JAC_TIMES], (memory, 0, o[MATVEC])) != 0
    failed |= call_int(o[IDA_SET_MAX_ORD], (memory, np.int32(max_order))) != 0
    failed |= call_int(o[IDA_SET_MAX_CONV_FAILS], (memory, np.int32(MAX_CONVERGENCE_FAILURES))) != 0
    if max_step < np.inf:
        failed |= call_int(o[IDA_SET_MAX_STEP], (memory, max_step)) != 0
    o[IS_BEGUN] = 1
    return not failed


@kernel
def allocate_solver(ida: IDAHandle) -> bool:
    """Let the linear solver allocate its memory, which it does in the first step otherwise; False: there is none."""
    return call_int(ida.words[SUN_LIN_SOL_INITIALIZE], (ida.words[SOLVER],)) == 0


@inlined
def _set_tolerances(ida: Any, rtol: float) -> int:
    o = ida.words
    if o[ERROR_WEIGHTS] != 0:
        flag: int = call_int(o[IDA_WF_TOLERANCES], (o[MEMORY], o[ERROR_WEIGHTS]))
        return flag
    flag = call_int(o[IDA_SV_TOLERANCES], (o[MEMORY], rtol, o[TOLERANCES]))
    return flag


@inlined
def solve(ida: Any, t: float) -> int:
    """Take a step towards t (s); return IDA's status."""
    o = ida.words
    flag: int = call_int(o[IDA_SOLVE], (o[MEMORY], t, address_of_array(ida.reached), o[YY], o[YP], IDA_ONE_STEP))
    return flag


@inlined
def stop_at(ida: Any, t: float) -> None:
    """Stop at t (s) if the next step reaches it."""
    call_int(ida.words[IDA_SET_STOP_TIME], (ida.words[MEMORY], t))


@inlined
def clear_stop(ida: Any) -> None:
    """Remove the stop."""
    call_int(ida.words[IDA_CLEAR_STOP_TIME], (ida.words[MEMORY],))


@kernel
def interpolate(ida: IDAHandle, t: float) -> bool:
    """Put the unknowns at t in the last step into ``ida.y``; False: IDA has no step that contains t."""
    o = ida.words
    flag: int = call_int(o[IDA_GET_DKY], (o[MEMORY], t, np.int32(0), o[YY]))
    return flag == 0


@kernel
def count(ida: IDAHandle) -> None:
    """Put into ``counters`` and ``reals`` what IDA has counted since its history began."""
    o = ida.words
    for k in range(N_IDA_COUNTERS):
        ida.counters[k] = 0
    if o[IS_BEGUN] == 0:
        return
    n, x = address_of_array(ida.counters), address_of_array(ida.reals)  # C's int and long fill the low bytes
    call_int(
        o[IDA_GET_INTEGRATOR_STATS],
        (o[MEMORY], n, n + 8, n + 16, n + 24, n + 32, n + 40, x, x + 8, x + 16, x + 24),
    )
