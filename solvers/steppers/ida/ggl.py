"""The equations that IDA solves, stabilized and regular also in singular configurations, and their Newton matrix.

Gear, Gupta and Leimkuhler's form, in unknowns y = (q, v, lambda, mu)::

    q' - N(q) (v - S J~^T mu) + k (q - unit(q)) = 0      M v' + h + S^-1 J~^T lambda = 0
    R^-1 (J v - nu) - D lambda = 0                       R^-1 Phi - d mu = 0

in units of coordinates and rows, S and R, J~ = R^-1 J S (:mod:`solvers.projection.workspace`); lambda is in units of R.
unit(q) is q with its quaternions normalized; k keeps their length, and its term is zero then. Two small terms
make the form regular if J~ loses rank (eps is the unit roundoff, sigma a singular value):

- d = MU eps / rtol |J~|^2 / rate. mu is zero on the solution, so d has no bias; residuals of positions return
  within d / sigma^2. It bounds the effect of rounding of Phi on v along a direction that loses rank, eps / (sigma^2 + d
  c_j) and not eps / sigma^2: by the tolerance if steps are shorter than MU / rate. It must not be larger: the remainder
  of Phi at a crossing turns v by Phi / sigma^2.
- D = LAMBDA a (1 + A / (FILTER tr A))^-2 / rate with A = J~ J~^T and a = tr J~ M~^-1 J~^T. lambda is not zero on
  the solution and may be unbounded, and D |lambda|^2 is a loss of power. D has the size of a only on rows without
  rank, redundant ones and those that lose it at a crossing, and is negligible on others, however near.

Redundant constraint equations depend on each other only where the constraints are satisfied. A position that is off by
e gives their combinations W^T J~ = O(e), and with D = LAMBDA a alone they act on the motion as friction of the rate
e^2 / LAMBDA: if e has the size of the tolerance, that is too much. So s P, P = W W^T, is added to both terms, in
units of a / rate in D and of |J~|^2 / rate in d; s = e^2 / (FRICTION rtol) makes that friction small, and must not be
larger: what it loses by rounding counts at crossings. W is the left null space of J~ in the last position that was not
singular; it may be out of date, as W^T (J v - nu) is zero on the solution for any W.

Such small terms need a Newton matrix that is no older than the iterate in J and M: with a matrix kept from before a
singular configuration the iteration contracts as the change of sigma to sqrt(sigma^2 + d c_j) and diverges. So J and M
are taken where the residual has just been evaluated, and only K, the derivative of the rest, is kept. IDA's own direct
solvers keep their factors; what serves is its iterative one with an exact preconditioner. The product of matrix and
vector is declared to be the vector, which the preconditioner then takes as solved: one iteration is exact.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import factor_lu, solve_lu
from solvers.projection.workspace import loop_speed
from solvers.system import Array

from .loop import JACOBIANS, N_COUNTERS, NONFINITE_RESIDUALS, RESIDUALS

LAMBDA, FILTER, MU = 1e-10, 1e-13, 1e-2  # see above
LENGTH_RATE = 10.0  # k, in units of the motion's rate


class Unknowns(NamedTuple):
    """Writable copies of what IDA passes, and scratch of residual and solution; N = nq + n + 2 m."""

    y: Array  # (N,)    q, v, lambda, mu
    yp: Array  # (N,)
    res: Array  # (N,)    residual
    beside: Array  # (N,)    residual at a neighbor
    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)    v'
    drift: Array  # (n,)    v - S J~^T mu
    qdot: Array  # (nq,)   N (v - S J~^T mu)
    unit: Array  # (nq,)   q with unit quaternions
    zero: Array  # (n,)
    d: Array  # (2,)    LAMBDA a / rate, d
    usual: Array  # (2,)    these two away from near misses
    redundant: Array  # (2,)    s a / rate, s |J~|^2 / rate: coefficients of P in D and d
    P: Array  # (m, m)  projection onto forces W of redundant constraint equations
    noise: Array  # (1,)    rounding to IDA's relative tolerance
    near: Array  # (1,)    distance at which branches are distinguished, in units of size
    lost: Array  # (1,)    speed that D has taken from the loops in the last singular configuration, in units of theirs
    F: Array  # (m, m)  FILTER tr A + A, its factors
    Dlam: Array  # (m,)    D lambda
    lam: Array  # (m,)    lambda in its own units
    D: Array  # (m, m)  D
    lift: Array  # (2, n)  v less IDA's unknown at ``since``, and the slope of it; see :func:`velocity`
    since: Array  # (1,)    s
    at: Array  # (N,)    where terms were evaluated last
    solved: Array  # (N,)    where the matrix was factored last
    key: Array  # (3,)    t of ``at``; t and c_j of ``solved``
    K: Array  # (N, nq + n)  derivative of the residual by q and v
    N: Array  # (nq, n)  N(q) where K was taken
    matrix: Array  # (N, N)  the Newton matrix in units of rows and columns, its factors
    rows: Array  # (N,)    unit of every residual
    columns: Array  # (N,)    unit of every unknown
    order: NDArray[np.int64]  # (N,) int64
    right: Array  # (N,)
    left: Array  # (N,)
    product: Array  # (N,)    the vector whose product was requested
    asked: Array  # (1,)    whether it was
    counts: Array  # (COUNTS,)  see solvers.steppers.ida.driver

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Unknowns:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        N, z = nq + n + 2 * m, np.zeros
        return Unknowns(
            z(N), z(N), z(N), z(N), z(nq), z(n), z(n), z(n), z(nq), z(nq), z(n), z(2), z(2), z(2), z((m, m)), z(1),
            z(1), z(1), z((m, m)), z(m), z(m), z((m, m)), z((2, n)), z(1), np.full(N, np.nan), np.full(N, np.nan), z(3),
            z((N, nq + n)), z((nq, n)), z((N, N)), z(N), z(N), np.zeros(N, np.int64), z(N), z(N), z(N), z(1),
            z(N_COUNTERS),
        )  # fmt: skip


@kernel
def balance(eqs: Any, t: float, u: Any, work: Any, res: Any) -> None:
    """Residual (N,) at (u.y, u.yp), module docstring; leaves ``terms`` at (q, v)."""
    terms, nq = eqs.terms, u.q.shape[0]
    m, n = terms.J.shape
    lam, mu = nq + n, nq + n + m
    for i in range(nq):
        u.q[i] = u.y[i]
        u.unit[i] = u.y[i]
    for i in range(n):
        u.v[i] = u.y[nq + i]
    drift_rate(eqs, t, u, work)
    eqs.dynamics(t, u.q, u.v, eqs.data, terms)
    if nq == n:
        drift(terms, u, work)
        for i in range(n):
            u.qdot[i] = terms.qdot[i] + u.drift[i] - u.v[i]
    for i in range(nq):
        res[i] = u.yp[i] - u.qdot[i] + LENGTH_RATE * work.rate[0] * (u.q[i] - u.unit[i])
    for i in range(n):
        res[nq + i] = terms.h[i]
        for j in range(n):
            res[nq + i] += terms.M[i, j] * u.yp[nq + j]
        for row in range(m):
            res[nq + i] += terms.J[row, i] * u.y[lam + row] / work.row[row]
    for row in range(m):
        u.Dlam[row] = u.y[lam + row]
    if m > 0:
        apply_filter(u.Dlam, factor_filter(u, work, terms), u, work)
    for row in range(m):
        res[lam + row] = -terms.nu[row]
        for j in range(n):
            res[lam + row] += terms.J[row, j] * u.v[j]
        res[lam + row] = res[lam + row] / work.row[row] - u.Dlam[row]
        res[mu + row] = terms.Phi[row] / work.row[row] - u.d[1] * u.y[mu + row]
        for other in range(m):
            res[lam + row] -= u.redundant[0] * u.P[row, other] * u.y[lam + other]
            res[mu + row] -= u.redundant[1] * u.P[row, other] * u.y[mu + other]


@inlined
def drift(terms: Any, u: Any, work: Any) -> None:
    """v - S J~^T mu from ``terms``."""
    m, n = terms.J.shape
    for i in range(n):
        u.drift[i] = u.v[i]
        for row in range(m):
            u.drift[i] -= work.size[i] ** 2 * terms.J[row, i] / work.row[row] * u.y[u.y.shape[0] - m + row]


@kernel
def drift_rate(eqs: Any, t: float, u: Any, work: Any) -> None:
    """Where q holds quaternions: N (v - S J~^T mu) by a second evaluation, and the unit quaternions."""
    if u.q.shape[0] == u.v.shape[0]:
        return
    eqs.position(t, u.q, eqs.data, eqs.terms)
    drift(eqs.terms, u, work)
    eqs.dynamics(t, u.q, u.drift, eqs.data, eqs.terms)
    for i in range(u.q.shape[0]):
        u.qdot[i] = eqs.terms.qdot[i]
    eqs.retract(u.unit, u.zero, eqs.data)


@kernel
def factor_filter(u: Any, work: Any, terms: Any) -> float:
    """Factor FILTER tr A + A in u.F; return what D is in units of its inverse squared."""
    m, n = terms.J.shape
    trace = 0.0
    for i in range(m):
        for j in range(i + 1):
            u.F[i, j] = 0.0
            for k in range(n):
                u.F[i, j] += terms.J[i, k] * terms.J[j, k] * work.size[k] ** 2
            u.F[i, j] /= work.row[i] * work.row[j]
            u.F[j, i] = u.F[i, j]
        trace += u.F[i, i]
    for i in range(m):
        u.F[i, i] += FILTER * trace
    factor_lu(u.F, m, work.order)
    return u.d[0] * (FILTER * trace) ** 2


@kernel
def apply_filter(x: Any, scale: float, u: Any, work: Any) -> None:
    """x (m,) <- D x, from what :func:`factor_filter` left and returned."""
    m = x.shape[0]
    for i in range(m):
        work.b[i] = scale * x[i]
    solve_lu(u.F, m, work.order, work.b, work.x)
    solve_lu(u.F, m, work.order, work.x, x)


@inlined
def velocity(i: int, t: float, y: Any, u: Any) -> float:
    """v_i at t by IDA's unknowns y, which are velocities minus a ramp.

    v' is discontinuous where a load is. The slope of the ramp changes by the same amount, so that the function that IDA
    differentiates has a tangent there, and its history remains valid.
    """
    return y[u.q.shape[0] + i] + u.lift[0, i] + (t - u.since[0]) * u.lift[1, i]


@kernel
def tie(t: float, a: Any, yp: Any, u: Any) -> None:
    """Begin another ramp at t, with which the velocities' derivatives yp (N,) of IDA go on to accelerations a (n,)."""
    for i in range(a.shape[0]):
        u.lift[0, i] += (t - u.since[0]) * u.lift[1, i]
        u.lift[1, i] = a[i] - yp[u.q.shape[0] + i]
    u.since[0] = t


@kernel
def load(t: float, y: Any, yp: Any, u: Any) -> None:
    """Copy IDA's read-only arrays, the velocities themselves among them."""
    nq, n = u.q.shape[0], u.v.shape[0]
    u.key[0] = t
    for i in range(y.shape[0]):
        u.y[i] = y[i]
        u.yp[i] = yp[i]
        u.at[i] = y[i]
    for i in range(n):
        u.y[nq + i] = velocity(i, t, y, u)
        u.yp[nq + i] += u.lift[1, i]


@kernel
def residual(eqs: Any, t: float, y: Any, yp: Any, res: Any, u: Any, work: Any) -> None:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    load(t, y, yp, u)
    balance(eqs, t, u, work, res)
    u.counts[RESIDUALS] += 1.0
    for i in range(res.shape[0]):
        if not np.isfinite(res[i]):
            u.counts[NONFINITE_RESIDUALS] += 1.0
            return


@kernel
def set_up(eqs: Any, t: float, y: Any, yp: Any, u: Any, work: Any) -> None:
    """u.K: differences in q and v, all columns in one call; u.N. The part of y' is known."""
    nq, n = u.q.shape[0], u.v.shape[0]
    load(t, y, yp, u)
    u.counts[JACOBIANS] += 1.0
    balance(eqs, t, u, work, u.res)
    for j in range(nq + n):
        natural = work.size_q[j] if j < nq else work.size[j - nq] * work.rate[0]
        here = u.y[j]
        step = 1.5e-8 * max(natural, abs(here))
        u.y[j] = here + step
        balance(eqs, t, u, work, u.beside)
        for i in range(y.shape[0]):
            u.K[i, j] = (u.beside[i] - u.res[i]) / step
        u.y[j] = here
    for j in range(n):
        for i in range(n):
            u.v[i] = 1.0 if i == j else 0.0
        eqs.dynamics(t, u.q, u.v, eqs.data, eqs.terms)
        for i in range(nq):
            u.N[i, j] = eqs.terms.qdot[i]
    balance(eqs, t, u, work, u.res)
    u.key[2] = np.nan  # no factors


@kernel
def assemble(eqs: Any, u: Any, work: Any, cj: float) -> None:
    """u.matrix: d res / d y + cj d res / d y', from K and what ``terms`` hold."""
    terms, nq = eqs.terms, u.q.shape[0]
    m, n = terms.J.shape
    lam, mu, N = nq + n, nq + n + m, u.y.shape[0]
    A = u.matrix
    for i in range(N):
        for j in range(N):
            A[i, j] = u.K[i, j] if j < lam else 0.0
    for i in range(nq):
        A[i, i] += cj
    for i in range(n):
        for j in range(n):
            A[nq + i, nq + j] += cj * terms.M[i, j]
    scale = factor_filter(u, work, terms) if m > 0 else 0.0
    for row in range(m):
        for other in range(m):
            u.D[row, other] = 1.0 if row == other else 0.0
        apply_filter(u.D[row], scale, u, work)  # D is symmetric: a row is a column
        for i in range(n):
            entry = terms.J[row, i] / work.row[row]
            A[nq + i, lam + row] = entry
            A[lam + row, nq + i] = entry
            if nq == n:
                A[i, mu + row] = work.size[i] ** 2 * entry
                A[mu + row, i] = entry
            else:
                for k in range(nq):
                    A[k, mu + row] += u.N[k, i] * work.size[i] ** 2 * entry
        for other in range(m):
            A[lam + row, lam + other] = -u.D[row, other] - u.redundant[0] * u.P[row, other]
            A[mu + row, mu + other] = -u.redundant[1] * u.P[row, other]
        A[mu + row, mu + row] -= u.d[1]


@kernel
def solve(eqs: Any, t: float, y: Any, yp: Any, right: Any, left: Any, cj: float, u: Any, work: Any) -> None:
    """The preconditioner: left = matrix^-1 right with J and M of this iterate, or the vector requested before."""
    N = y.shape[0]
    if u.asked[0] == 1.0:
        u.asked[0] = 0.0
        for i in range(N):
            left[i] = u.product[i]
        return
    here, fresh = u.key[0] == t, u.key[1] == t and u.key[2] == cj
    for i in range(N):
        here = here and u.at[i] == y[i]
        fresh = fresh and u.solved[i] == y[i]
    if not fresh:
        if not here:
            load(t, y, yp, u)
            balance(eqs, t, u, work, u.res)
        assemble(eqs, u, work, cj)
        for i in range(N):
            for j in range(N):
                u.matrix[i, j] *= u.columns[j] / u.rows[i]
        factor_lu(u.matrix, N, u.order)
        u.key[1], u.key[2] = t, cj
        for i in range(N):
            u.solved[i] = y[i]
    for i in range(N):
        u.right[i] = right[i] / u.rows[i]
    solve_lu(u.matrix, N, u.order, u.right, u.left)
    for i in range(N):
        left[i] = u.left[i] * u.columns[i]


@kernel
def multiply(vector: Any, product: Any, u: Any) -> None:
    """The product of matrix and vector, for the preconditioner to undo."""
    u.asked[0] = 1.0
    for i in range(vector.shape[0]):
        u.product[i] = vector[i]
        product[i] = vector[i]


@inlined
def taken_by_filter(time: float, terms: Any, u: Any, work: Any) -> float:
    """Speed that D has taken from the loops in this ``time`` (s), in units of theirs: the power of D is lambda .
    D lambda, and D lambda is what velocities leave of their constraints, J v - nu. What moves fast loses little of its
    speed by that.
    """
    power, inertia, looped, speed = 0.0, 0.0, 0.0, loop_speed(u.v, work)
    for i in range(u.v.shape[0]):
        inertia += work.in_loops[i] * terms.M[i, i] * work.size[i] ** 2
        looped += work.in_loops[i]
    for row in range(terms.nu.shape[0]):
        left = -terms.nu[row]
        for i in range(u.v.shape[0]):
            left += terms.J[row, i] * u.v[i]
        power += u.lam[row] * left
    if not inertia > 0.0:
        return 0.0
    lost = np.sqrt(speed * speed + 2.0 * max(0.0, power) * time * looped / inertia) - speed
    return lost / max(work.rate[1], speed)


@inlined
def weak_residual(terms: Any, work: Any) -> float:
    """u . Phi~, u the forces that balance in the critical point."""
    total = 0.0
    for i in range(terms.Phi.shape[0]):
        total += work.u[i] * terms.Phi[i] / work.row[i]
    return total
