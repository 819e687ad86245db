"""What IDA is given in tree form: residual and preconditioner; the equations are in :mod:`.tree`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.template import specialize
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.inertia import tolerance_factor, update_tree_growth
from solvers.outcome import OK
from solvers.positions import Positions, as_motion, as_slope
from solvers.system import Array

from . import loop
from .dense_callbacks import RTOL_EXPONENT
from .loop import NONFINITE_RESIDUALS, RESIDUALS, STEPS
from .sundials import LOOP_CALLS, vector_data

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

KRYLOV_STEP_SIZE = 1e-20  # of an imaginary step


class Scratch(NamedTuple):
    """Writable copies of what IDA passes, and scratch; N = nq + n + 2 m."""

    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    lam: Array  # (m,)
    qdot: Array  # (nq,)
    unit: Array  # (nq,) q with unit quaternions
    slope: Array  # (nq,)
    zero: Array  # (n,)
    tau: Array  # (n,)
    res_motion: Array  # (n,) first residual as a motion
    load: Array  # (n,)
    dtheta: Array  # (n,) dtheta
    right: Array  # (2 m,)
    multipliers: Array  # (2 m,) dmu, dlambda

    @staticmethod
    def allocate(nq: int, n: int, m: int, scalar: type = float) -> Scratch:
        """Return zeroed arrays."""
        sizes = nq, n, n, m, nq, nq, nq, n, n, n, n, n, 2 * m, 2 * m
        return Scratch(*(np.zeros(size, scalar) for size in sizes))


class Reduced(NamedTuple):
    """The equations that are left for the constraints, taken with the tangent; see :mod:`.tree`."""

    c: Array  # (1,) 1/s
    d: Array  # (2, m) d0 and d1
    metric: Array  # (n,) S^2
    J: Array  # (m, n)
    A: Array  # (n, m)
    X: Array  # (n, m)
    inverse: Array  # (2 m, 2 m) of their matrix


class UserData(NamedTuple):
    """What IDA's callbacks and its loop are given."""

    inverse: Any
    retract: Any
    position: Any
    power: Any
    evaluate_energy_bound: Any
    data: Any
    terms: Any
    positions: Positions
    solve_one: Any
    inertia_one: Any
    tangent: Any
    scratch: Any
    reduced: Any
    length_rate: float  # k
    n_unknowns: int  # N
    energy_record: NDArray[Any]
    scales: Any
    counts: Array
    progress: NDArray[Any]
    tolerances: Array  # (3, N) relative, absolute, the largest; where they are weighed
    complex_step: Any  # where products are requested
    inertia_parts: Any
    growth: Any  # solvers.inertia.Growth


class ComplexStep(NamedTuple):
    """Arguments of :func:`residual` with an imaginary step of the unknowns, and these."""

    inverse: Any
    position: Any
    retract: Any
    data: Any
    terms: Any
    positions: Positions
    scratch: Any
    reduced: Any
    length_rate: float
    counts: Array
    y: Array  # (N,) complex, these three
    slopes: Array
    res: Array


@inlined
def copy_unknowns(y: Reals, slopes: Reals, user_data: Any) -> None:
    """Copy IDA's arrays."""
    scratch = user_data.scratch
    nq, n = scratch.q.shape[0], scratch.v.shape[0]
    for i in range(nq):
        scratch.q[i] = y[i]
    for i in range(n):
        scratch.v[i], scratch.a[i] = y[nq + i], slopes[nq + i]
    for row in range(scratch.lam.shape[0]):
        scratch.lam[row] = y[nq + n + row]


@kernel
def residual(t: float, y: Reals, slopes: Reals, res: Reals, user_data: Any) -> None:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    scratch, d, metric, terms = user_data.scratch, user_data.reduced.d, user_data.reduced.metric, user_data.terms
    nq, n, m = scratch.q.shape[0], scratch.v.shape[0], scratch.lam.shape[0]
    user_data.counts[RESIDUALS] += 1.0
    copy_unknowns(y, slopes, user_data)
    if m > 0:
        user_data.position(t, scratch.q, user_data.data, terms)
    user_data.inverse(t, scratch.q, scratch.v, scratch.a, scratch.lam, user_data.data, scratch.qdot, scratch.tau)
    for i in range(nq):
        scratch.unit[i] = scratch.q[i]
    user_data.retract(scratch.unit, scratch.zero, user_data.data)
    for i in range(nq):
        res[i] = slopes[i] - scratch.qdot[i] + user_data.length_rate * (scratch.q[i] - scratch.unit[i])
    finite = True
    for i in range(n):
        res[nq + i] = scratch.tau[i]
        finite = finite and np.isfinite(scratch.tau[i])
    if not finite:
        user_data.counts[NONFINITE_RESIDUALS] += 1.0
    if m == 0:
        return
    for i in range(n):
        scratch.load[i] = 0.0
        for row in range(m):
            scratch.load[i] += metric[i] * terms.J[row, i] * y[nq + n + m + row]
    as_slope(scratch.q, scratch.load, user_data.positions, scratch.slope)
    for i in range(nq):
        res[i] += scratch.slope[i]
    for row in range(m):
        speed = -terms.nu[row]
        for i in range(n):
            speed += terms.J[row, i] * scratch.v[i]
        res[nq + n + row] = speed - d[0, row] * scratch.lam[row]
        res[nq + n + m + row] = terms.Phi[row] - d[1, row] * y[nq + n + m + row]


@kernel
def multiply_matrix(t: float, y: Reals, slopes: Reals, x: Reals, c: float, out: Reals, user_data: UserData) -> None:
    """out (N,) <- (dF/dy + c dF/dy') x of the residual F, exactly."""
    e = user_data.complex_step
    for i in range(out.shape[0]):
        e.y[i], e.slopes[i] = y[i] + KRYLOV_STEP_SIZE * x[i] * 1j, slopes[i] + KRYLOV_STEP_SIZE * c * x[i] * 1j
    residual(t, e.y, e.slopes, e.res, e)
    for i in range(out.shape[0]):
        out[i] = e.res[i].imag / KRYLOV_STEP_SIZE


@kernel
def set_error_weights(y: Reals, out: Reals, user_data: UserData) -> None:
    """out (N,) <- one over the tolerances of the unknowns."""
    finer = tolerance_factor(user_data.tolerances[0, 0], RTOL_EXPONENT, user_data.growth)
    for i in range(out.shape[0]):
        out[i] = 1.0 / (
            finer * min(user_data.tolerances[0, i] * abs(y[i]) + user_data.tolerances[1, i], user_data.tolerances[2, i])
        )


@kernel
def apply_preconditioner(y: Reals, r: Reals, z: Reals, user_data: UserData) -> None:
    """z (N,) <- the solution for the residual r, by the tangent as it was factored last."""
    scratch, reduced, c, positions = user_data.scratch, user_data.reduced, user_data.reduced.c[0], user_data.positions
    nq, n, m = scratch.q.shape[0], scratch.v.shape[0], scratch.lam.shape[0]
    as_motion(y, r, positions, scratch.res_motion)
    user_data.inertia_one(scratch.res_motion, user_data.tangent, scratch.load)
    for i in range(n):
        scratch.load[i] = r[nq + i] + c * scratch.load[i]
    user_data.solve_one(scratch.load, user_data.tangent, scratch.dtheta)
    for row in range(m):
        scratch.right[row], scratch.right[m + row] = r[nq + n + row] - c * r[nq + n + m + row], r[nq + n + m + row]
        for i in range(n):
            scratch.right[row] += reduced.J[row, i] * scratch.res_motion[i]
            scratch.right[m + row] -= reduced.J[row, i] * scratch.dtheta[i]
    for row in range(2 * m):
        scratch.multipliers[row] = 0.0
        for other in range(2 * m):
            scratch.multipliers[row] += reduced.inverse[row, other] * scratch.right[other]
    for row in range(m):
        z[nq + n + m + row], z[nq + n + row] = scratch.multipliers[row], scratch.multipliers[m + row]
        for i in range(n):
            scratch.dtheta[i] -= (
                reduced.X[i, row] * scratch.multipliers[row] + reduced.A[i, row] * scratch.multipliers[m + row]
            )
            scratch.res_motion[i] -= reduced.metric[i] * reduced.J[row, i] * scratch.multipliers[row]
    as_slope(y, scratch.dtheta, positions, z)
    for k in range(positions.turning.shape[0]):  # and the quaternions' length
        first, along = positions.turning[k, 0], 0.0
        for i in range(first, first + 4):
            along += y[i] * r[i] / (c + user_data.length_rate)
        for i in range(first, first + 4):
            z[i] += along * y[i]
    for i in range(n):
        z[nq + i] = c * scratch.dtheta[i] - scratch.res_motion[i]


@kernel
def record_energy(t: float, y: Reals, slopes: Any, user_data: UserData) -> None:
    """Record the energy after a step of IDA to (t, y, y'); see :mod:`solvers.energy_account`."""
    record, scratch, done = user_data.energy_record[0], user_data.scratch, 0.0
    copy_unknowns(y, slopes, user_data)
    if energy_check_scheduled(record):
        for row in range(scratch.lam.shape[0]):
            scratch.right[row] = 0.0
        user_data.inverse(
            t, scratch.q, scratch.v, scratch.zero, scratch.right, user_data.data, scratch.qdot, scratch.tau
        )
        update_energy_bound(user_data.evaluate_energy_bound, user_data.data, record, user_data.scales)
    if user_data.progress[0].works == 1:
        user_data.inverse(t, scratch.q, scratch.v, scratch.a, scratch.lam, user_data.data, scratch.qdot, scratch.tau)
        done = user_data.power(t, scratch.q, scratch.v, scratch.a, scratch.lam, user_data.data)
    record_step(user_data.energy_record, t, done)


@kernel
def accept_step(t: float, y: Reals, slopes: Any, user_data: UserData) -> int:
    """Accept IDA's step to (t, y)."""
    user_data.counts[STEPS] += 1.0
    user_data.progress[0].t_reached = t
    if user_data.growth.inertia[0].watched == 1:  # where Newton's last correction began
        user_data.inertia_parts(user_data.data, user_data.growth.parts)
        update_tree_growth(t, user_data.growth.parts, user_data.scratch.v, user_data.growth)
    if user_data.progress[0].energy_check == 1:
        record_energy(t, y, slopes, user_data)
    return OK


step_until = specialize(loop.step_until, __name__, {**LOOP_CALLS, "accept": accept_step})


def call_residual(t: float, y: Any, slopes: Any, out: Any, user_data: Any) -> int:
    """As IDA calls it."""
    n = user_data.n_unknowns
    residual(t, array_at(vector_data(y), n), array_at(vector_data(slopes), n), array_at(vector_data(out), n), user_data)
    return 0


def call_matvec(
    t: float, y: Any, slopes: Any, _res: Any, x: Any, product: Any, cj: float, user_data: Any, _one: Any, _two: Any
) -> int:
    """As IDA calls it."""
    n = user_data.n_unknowns
    vectors = array_at(vector_data(y), n), array_at(vector_data(slopes), n), array_at(vector_data(x), n)
    multiply_matrix(t, vectors[0], vectors[1], vectors[2], cj, array_at(vector_data(product), n), user_data)
    return 0


def call_error_weights(y: Any, out: Any, user_data: Any) -> int:
    """As IDA calls it."""
    n = user_data.n_unknowns
    set_error_weights(array_at(vector_data(y), n), array_at(vector_data(out), n), user_data)
    return 0


def call_preconditioner(
    _t: float, y: Any, _slopes: Any, _res: Any, right: Any, left: Any, _cj: float, _delta: float, user_data: Any
) -> int:
    """As IDA calls it."""
    n = user_data.n_unknowns
    apply_preconditioner(
        array_at(vector_data(y), n), array_at(vector_data(right), n), array_at(vector_data(left), n), user_data
    )
    return 0
