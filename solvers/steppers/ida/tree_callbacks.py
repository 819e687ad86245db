"""What IDA is given of a large tree: residual and preconditioner; the equations are in :mod:`.tree`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.ffi import array_at
from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, record_step, update_energy_bound
from solvers.inertia import tolerance_factor, update_tree_growth
from solvers.outcome import OK
from solvers.positions import Positions, as_motion, as_slope
from solvers.system import Array

from .dense_callbacks import RTOL_EXPONENT
from .loop import NONFINITE_RESIDUALS, RESIDUALS, STEPS
from .sundials import data_of

COMPLEX_STEP = 1e-20  # of an imaginary step


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
    g: Array  # (n,) first residual as a motion
    load: Array  # (n,)
    turn: Array  # (n,) dtheta
    right: Array  # (2 m,)
    both: Array  # (2 m,) dmu, dlambda

    @staticmethod
    def allocate(nq: int, n: int, m: int, scalar: type = float) -> Scratch:
        """Return zeroed arrays."""
        sizes = nq, n, n, m, nq, nq, nq, n, n, n, n, n, 2 * m, 2 * m
        return Scratch(*(np.zeros(size, scalar) for size in sizes))


class Reduced(NamedTuple):
    """The equations that are left for the constraints, taken with the tangent; see :mod:`.tree`."""

    c: Array  # (1,) 1/s
    d: Array  # (2, m) d0 and d1
    J: Array  # (m, n)
    A: Array  # (n, m)
    X: Array  # (n, m)
    inverse: Array  # (2 m, 2 m) of their matrix


class Given(NamedTuple):
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
    unknowns: int  # N
    book: NDArray[Any]
    scales: Any
    counts: Array
    course: NDArray[Any]
    tolerances: Array  # (3, N) relative, absolute, the largest; where they are weighed
    stepped: Any  # where products are requested
    inertia_parts: Any
    growth: Any  # solvers.inertia.Growth


class Imaginary(NamedTuple):
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
def load(y: Any, slopes: Any, g: Any) -> None:
    """Copy IDA's arrays."""
    s = g.scratch
    nq, n = s.q.shape[0], s.v.shape[0]
    for i in range(nq):
        s.q[i] = y[i]
    for i in range(n):
        s.v[i], s.a[i] = y[nq + i], slopes[nq + i]
    for row in range(s.lam.shape[0]):
        s.lam[row] = y[nq + n + row]


@kernel
def residual(t: float, y: Any, slopes: Any, res: Any, g: Any) -> None:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    s, d, terms = g.scratch, g.reduced.d, g.terms
    nq, n, m = s.q.shape[0], s.v.shape[0], s.lam.shape[0]
    g.counts[RESIDUALS] += 1.0
    load(y, slopes, g)
    if m > 0:
        g.position(t, s.q, g.data, terms)
    g.inverse(t, s.q, s.v, s.a, s.lam, g.data, s.qdot, s.tau)
    for i in range(nq):
        s.unit[i] = s.q[i]
    g.retract(s.unit, s.zero, g.data)
    for i in range(nq):
        res[i] = slopes[i] - s.qdot[i] + g.length_rate * (s.q[i] - s.unit[i])
    finite = True
    for i in range(n):
        res[nq + i] = s.tau[i]
        finite = finite and np.isfinite(s.tau[i])
    if not finite:
        g.counts[NONFINITE_RESIDUALS] += 1.0
    if m == 0:
        return
    for i in range(n):
        s.load[i] = 0.0
        for row in range(m):
            s.load[i] += terms.J[row, i] * y[nq + n + m + row]
    as_slope(s.q, s.load, g.positions, s.slope)
    for i in range(nq):
        res[i] += s.slope[i]
    for row in range(m):
        speed = -terms.nu[row]
        for i in range(n):
            speed += terms.J[row, i] * s.v[i]
        res[nq + n + row] = speed - d[0, row] * s.lam[row]
        res[nq + n + m + row] = terms.Phi[row] - d[1, row] * y[nq + n + m + row]


@kernel
def times(t: float, y: Any, slopes: Any, x: Any, c: float, out: Any, g: Any) -> None:
    """out (N,) <- (dF/dy + c dF/dy') x of the residual F, exactly."""
    e = g.stepped
    for i in range(out.shape[0]):
        e.y[i], e.slopes[i] = y[i] + COMPLEX_STEP * x[i] * 1j, slopes[i] + COMPLEX_STEP * c * x[i] * 1j
    residual(t, e.y, e.slopes, e.res, e)
    for i in range(out.shape[0]):
        out[i] = e.res[i].imag / COMPLEX_STEP


@kernel
def weigh(y: Any, out: Any, g: Any) -> None:
    """out (N,) <- one over the tolerances of the unknowns."""
    finer = tolerance_factor(g.tolerances[0, 0], RTOL_EXPONENT, g.growth)
    for i in range(out.shape[0]):
        out[i] = 1.0 / (finer * min(g.tolerances[0, i] * abs(y[i]) + g.tolerances[1, i], g.tolerances[2, i]))


@kernel
def precondition(y: Any, r: Any, z: Any, g: Any) -> None:
    """z (N,) <- the solution for the residual r, by the tangent as it was factored last."""
    s, R, c, p = g.scratch, g.reduced, g.reduced.c[0], g.positions
    nq, n, m = s.q.shape[0], s.v.shape[0], s.lam.shape[0]
    as_motion(y, r, p, s.g)
    g.inertia_one(s.g, g.tangent, s.load)
    for i in range(n):
        s.load[i] = r[nq + i] + c * s.load[i]
    g.solve_one(s.load, g.tangent, s.turn)
    for row in range(m):
        s.right[row], s.right[m + row] = r[nq + n + row] - c * r[nq + n + m + row], r[nq + n + m + row]
        for i in range(n):
            s.right[row] += R.J[row, i] * s.g[i]
            s.right[m + row] -= R.J[row, i] * s.turn[i]
    for row in range(2 * m):
        s.both[row] = 0.0
        for other in range(2 * m):
            s.both[row] += R.inverse[row, other] * s.right[other]
    for row in range(m):
        z[nq + n + m + row], z[nq + n + row] = s.both[row], s.both[m + row]
        for i in range(n):
            s.turn[i] -= R.X[i, row] * s.both[row] + R.A[i, row] * s.both[m + row]
            s.g[i] -= R.J[row, i] * s.both[row]
    as_slope(y, s.turn, p, z)
    for k in range(p.turning.shape[0]):  # and the quaternions' length
        first, along = p.turning[k, 0], 0.0
        for i in range(first, first + 4):
            along += y[i] * r[i] / (c + g.length_rate)
        for i in range(first, first + 4):
            z[i] += along * y[i]
    for i in range(n):
        z[nq + i] = c * s.turn[i] - s.g[i]


@kernel
def note(t: float, y: Any, slopes: Any, g: Any) -> None:
    """Book a step of IDA's to (t, y, y'); see :mod:`solvers.energy_account`."""
    c, s, done = g.book[0], g.scratch, 0.0
    load(y, slopes, g)
    if energy_check_scheduled(c):
        for row in range(s.lam.shape[0]):
            s.right[row] = 0.0
        g.inverse(t, s.q, s.v, s.zero, s.right, g.data, s.qdot, s.tau)
        update_energy_bound(g.evaluate_energy_bound, g.data, c, g.scales)
    if g.course[0].works == 1:
        g.inverse(t, s.q, s.v, s.a, s.lam, g.data, s.qdot, s.tau)
        done = g.power(t, s.q, s.v, s.a, s.lam, g.data)
    record_step(g.book, t, done)


@kernel
def accept(t: float, y: Any, slopes: Any, g: Any) -> int:
    """Accept IDA's step to (t, y)."""
    g.counts[STEPS] += 1.0
    g.course[0].passed = t
    if g.growth.inertia[0].watched == 1:  # where Newton's last correction began
        g.inertia_parts(g.data, g.growth.parts)
        update_tree_growth(t, g.growth.parts, g.scratch.v, g.growth)
    if g.course[0].energy_check == 1:
        note(t, y, slopes, g)
    return OK


def call_accept(t: float, y: Any, slopes: Any, g: Any) -> int:
    """As the loop calls it."""
    return accept(t, y, slopes, g)


def call_residual(t: float, y: Any, slopes: Any, out: Any, g: Any) -> int:
    """As IDA calls it."""
    n = g.unknowns
    residual(t, array_at(data_of(y), n), array_at(data_of(slopes), n), array_at(data_of(out), n), g)
    return 0


def call_times(
    t: float, y: Any, slopes: Any, _res: Any, x: Any, product: Any, cj: float, g: Any, _one: Any, _two: Any
) -> int:
    """As IDA calls it."""
    n = g.unknowns
    given = array_at(data_of(y), n), array_at(data_of(slopes), n), array_at(data_of(x), n)
    times(t, given[0], given[1], given[2], cj, array_at(data_of(product), n), g)
    return 0


def call_weigh(y: Any, out: Any, g: Any) -> int:
    """As IDA calls it."""
    n = g.unknowns
    weigh(array_at(data_of(y), n), array_at(data_of(out), n), g)
    return 0


def call_precondition(
    _t: float, y: Any, _slopes: Any, _res: Any, right: Any, left: Any, _cj: float, _delta: float, g: Any
) -> int:
    """As IDA calls it."""
    n = g.unknowns
    precondition(array_at(data_of(y), n), array_at(data_of(right), n), array_at(data_of(left), n), g)
    return 0
