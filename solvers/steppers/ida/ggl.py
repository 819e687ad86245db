"""The equations that IDA solves, stabilized and regular also in singular configurations, and their Newton matrix.

Gear, Gupta and Leimkuhler's form, in unknowns y = (q, v, lambda, mu)::

    q' - N(q) (v - S J~^T mu) + k (q - unit(q)) = 0      M v' + h + S^-1 J~^T lambda = 0
    R^-1 (J v - nu) - D lambda = 0                       R^-1 Phi - d mu = 0

in units of coordinates and rows, S and R, J~ = R^-1 J S (:mod:`solvers.projection.workspace`); lambda is in units of R.
unit(q) is q with its quaternions normalized; k keeps their length, and its term is zero then. Two small terms
make the form regular if J~ loses rank (eps is the unit roundoff, sigma a singular value):

- d = c_mu eps / rtol |J~|^2 / rate. mu is zero on the solution, so d has no bias; residuals of positions return
  within d / sigma^2. It bounds the effect of rounding of Phi on v along a direction that loses rank, eps / (sigma^2 + d
  c_j) and not eps / sigma^2: by the tolerance if steps are shorter than c_mu / rate. It must not be larger: the
  remainder of Phi at a crossing turns v by Phi / sigma^2.
- D = c_lambda a (1 + A / (c_f tr A))^-2 / rate with A = J~ J~^T and a = tr J~ M~^-1 J~^T. lambda is not zero on
  the solution and may be unbounded, and D |lambda|^2 is a loss of power. D has the size of a only on rows without
  rank, redundant ones and those that lose it at a crossing, and is negligible on others, however near.

Of nonholonomic constraints Phi is zero, and so is mu: they do not correct positions.

Redundant constraint equations depend on each other only where the constraints are satisfied. A position that is off by
e gives their combinations W^T J~ = O(e), and with D = c_lambda a alone they act on the motion as friction of the rate
e^2 / c_lambda: if e has the size of the tolerance, that is too much. So s P, P = W W^T, is added to both terms, in
units of a / rate in D and of |J~|^2 / rate in d; s = e^2 / (REDUNDANCY_FRICTION rtol) makes that friction small, and
must not be larger: what it loses by rounding counts at crossings. W is the left null space of J~ in the last position
that was not singular; it may be out of date, as W^T (J v - nu) is zero on the solution for any W.

Such small terms need a Newton matrix that is no older than the iterate in J and M: with a matrix kept from before a
singular configuration the iteration contracts as the change of sigma to sqrt(sigma^2 + d c_j) and diverges. So J and M
are taken where the residual has just been evaluated, and only K, the derivative of the rest, is kept. IDA's own direct
solvers keep their factors; what serves is its iterative one with an exact preconditioner. The product of matrix and
vector is declared to be the vector, which the preconditioner then takes as solved: one iteration is exact.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import factor_lu, solve_lu
from solvers.positions import has_quaternions
from solvers.projection.workspace import count_motions, loop_speed
from solvers.system import Array

from .loop import JACOBIANS, N_COUNTERS, NONFINITE_RESIDUALS, RESIDUALS

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

MULTIPLIER_REGULARIZATION, FILTER_RATIO, POSITION_REGULARIZATION = 1e-10, 1e-13, 1e-2  # c_lambda, c_f, c_mu
QUATERNION_LENGTH_RATE = 10.0  # k, in units of the motion's rate


class Unknowns(NamedTuple):
    """Writable copies of what IDA passes, and scratch of residual and solution; N = nq + n + 2 m."""

    y: Array  # (N,)    q, v, lambda, mu
    yp: Array  # (N,)
    res: Array  # (N,)    residual
    res_perturbed: Array  # (N,)    residual at a neighbor
    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)    v'
    corrected_velocity: Array  # (n,)    v - S J~^T mu
    qdot: Array  # (nq,)   N (v - S J~^T mu)
    unit: Array  # (nq,)   q with unit quaternions
    zero: Array  # (n,)
    d: Array  # (2,)    c_lambda a / rate, d
    d_default: Array  # (2,)    these two away from near misses
    d_redundant: Array  # (2,)    s a / rate, s |J~|^2 / rate: coefficients of P in D and d
    P: Array  # (m, m)  projection onto forces W of redundant constraint equations
    rounding: Array  # (1,)    rounding to IDA's relative tolerance
    branch_distance: Array  # (1,)    distance at which branches are distinguished, in units of size
    speed_loss: (
        Array  # (1,)    speed that D has taken from the loops in the last singular configuration, in units of theirs
    )
    F: Array  # (m, m)  c_f tr A + A, its factors
    Dlam: Array  # (m,)    D lambda
    lam: Array  # (m,)    lambda in its own units
    D: Array  # (m, m)  D
    velocity_shift: Array  # (2, n)  v less IDA's unknown at ``shift_start``, and its slope; see :func:`velocity`
    shift_start: Array  # (1,)    s
    evaluated_at: Array  # (N,)    where terms were evaluated last
    factored_at: Array  # (N,)    where the matrix was factored last
    factor_key: Array  # (3,)    t of ``evaluated_at``; t and c_j of ``factored_at``
    K: Array  # (N, nq + n)  derivative of the residual by q and v
    N: Array  # (nq, n)  N(q) where K was taken
    matrix: Array  # (N, N)  the Newton matrix in units of rows and columns, its factors
    rows: Array  # (N,)    unit of every residual
    columns: Array  # (N,)    unit of every unknown
    order: NDArray[np.int64]  # (N,) int64
    right: Array  # (N,)
    left: Array  # (N,)
    pending_vector: Array  # (N,)    the vector whose product was requested
    is_pending: Array  # (1,)    whether it was
    counts: Array  # (N_COUNTERS,)  see solvers.steppers.ida.loop
    J_scratch: Array  # (n, m)  scratch of the singular values of J~
    inertia: Array  # (n, n)  M~ + ..., its factors, where the regularization is set

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Unknowns:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        N, z = nq + n + 2 * m, np.zeros
        return Unknowns(
            z(N), z(N), z(N), z(N), z(nq), z(n), z(n), z(n), z(nq), z(nq), z(n), z(2), z(2), z(2), z((m, m)), z(1),
            z(1), z(1), z((m, m)), z(m), z(m), z((m, m)), z((2, n)), z(1), np.full(N, np.nan), np.full(N, np.nan), z(3),
            z((N, nq + n)), z((nq, n)), z((N, N)), z(N), z(N), np.zeros(N, np.int64), z(N), z(N), z(N), z(1),
            z(N_COUNTERS), z((n, m)), z((n, n)),
        )  # fmt: skip


@kernel
def evaluate_residual(eqs: Equations, t: float, unknowns: Unknowns, work: Workspace, res: Reals) -> None:
    """Residual (N,) at (unknowns.y, unknowns.yp), module docstring; leaves ``terms`` at (q, v)."""
    terms, nq = eqs.terms, unknowns.q.shape[0]
    m, n = terms.J.shape
    lam, mu = nq + n, nq + n + m
    for i in range(nq):
        unknowns.q[i] = unknowns.y[i]
        unknowns.unit[i] = unknowns.y[i]
    for i in range(n):
        unknowns.v[i] = unknowns.y[nq + i]
    correct_rates(eqs, t, unknowns, work)
    eqs.dynamics(t, unknowns.q, unknowns.v, eqs.data, terms)
    if not has_quaternions(nq, n, work.states):
        correct_velocity(terms, unknowns, work)
        for i in range(nq):
            unknowns.qdot[i] = terms.qdot[i] + unknowns.corrected_velocity[i] - unknowns.v[i]
    for i in range(nq):
        res[i] = (
            unknowns.yp[i]
            - unknowns.qdot[i]
            + QUATERNION_LENGTH_RATE * work.rate[0] * (unknowns.q[i] - unknowns.unit[i])
        )
    for i in range(n):
        res[nq + i] = terms.h[i]
        for j in range(n):
            res[nq + i] += terms.M[i, j] * unknowns.yp[nq + j]
        for row in range(m):
            res[nq + i] += terms.J[row, i] * unknowns.y[lam + row] / work.row[row]
    for row in range(m):
        unknowns.Dlam[row] = unknowns.y[lam + row]
    if m > 0:
        apply_filter(unknowns.Dlam, factor_filter(unknowns, work, terms), unknowns, work)
    for row in range(m):
        res[lam + row] = -terms.nu[row]
        for j in range(n):
            res[lam + row] += terms.J[row, j] * unknowns.v[j]
        res[lam + row] = res[lam + row] / work.row[row] - unknowns.Dlam[row]
        res[mu + row] = terms.Phi[row] / work.row[row] - unknowns.d[1] * unknowns.y[mu + row]
        for other in range(m):
            res[lam + row] -= unknowns.d_redundant[0] * unknowns.P[row, other] * unknowns.y[lam + other]
            res[mu + row] -= unknowns.d_redundant[1] * unknowns.P[row, other] * unknowns.y[mu + other]


@inlined
def correct_velocity(terms: Terms, unknowns: Unknowns, work: Any) -> None:
    """v - S J~^T mu from ``terms``."""
    m, n = terms.J.shape
    for i in range(n):
        unknowns.corrected_velocity[i] = unknowns.v[i]
        for row in range(m):
            unknowns.corrected_velocity[i] -= (
                work.size[i] ** 2 * terms.J[row, i] / work.row[row] * unknowns.y[unknowns.y.shape[0] - m + row]
            )


@kernel
def correct_rates(eqs: Equations, t: float, unknowns: Unknowns, work: Any) -> None:
    """Where q holds quaternions: N (v - S J~^T mu) by a second evaluation, and the unit quaternions."""
    if not has_quaternions(unknowns.q.shape[0], unknowns.v.shape[0], work.states):
        return
    eqs.position(t, unknowns.q, eqs.data, eqs.terms)
    correct_velocity(eqs.terms, unknowns, work)
    eqs.dynamics(t, unknowns.q, unknowns.corrected_velocity, eqs.data, eqs.terms)
    for i in range(unknowns.q.shape[0]):
        unknowns.qdot[i] = eqs.terms.qdot[i]
    eqs.retract(unknowns.unit, unknowns.zero, eqs.data)


@kernel
def factor_filter(unknowns: Unknowns, work: Any, terms: Terms) -> float:
    """Factor c_f tr A + A in unknowns.F; return what D is in units of its inverse squared."""
    m, n = terms.J.shape
    trace = 0.0
    for i in range(m):
        for j in range(i + 1):
            unknowns.F[i, j] = 0.0
            for k in range(n):
                unknowns.F[i, j] += terms.J[i, k] * terms.J[j, k] * work.size[k] ** 2
            unknowns.F[i, j] /= work.row[i] * work.row[j]
            unknowns.F[j, i] = unknowns.F[i, j]
        trace += unknowns.F[i, i]
    for i in range(m):
        unknowns.F[i, i] += FILTER_RATIO * trace
    factor_lu(unknowns.F, m, work.order)
    return unknowns.d[0] * (FILTER_RATIO * trace) ** 2


@kernel
def apply_filter(x: Any, scale: float, unknowns: Any, work: Any) -> None:
    """x (m,) <- D x, from what :func:`factor_filter` left and returned."""
    m = x.shape[0]
    for i in range(m):
        work.b[i] = scale * x[i]
    solve_lu(unknowns.F, m, work.order, work.b, work.x)
    solve_lu(unknowns.F, m, work.order, work.x, x)


@inlined
def velocity(i: int, t: float, y: Reals, unknowns: Unknowns) -> float:
    """Velocity v_i(t) = y_i + shift_0i + (t - shift_start) shift_1i from IDA's unknowns y.

    v' is discontinuous where a load is. The slope of the shift changes by the same amount there, so that IDA's unknowns
    are differentiable, and its history remains valid.
    """
    return (
        y[unknowns.q.shape[0] + i]
        + unknowns.velocity_shift[0, i]
        + (t - unknowns.shift_start[0]) * unknowns.velocity_shift[1, i]
    )


@kernel
def update_velocity_shift(t: float, a: Reals, yp: Reals, unknowns: Unknowns) -> None:
    """Change the slope of the shift at t, so that IDA's derivatives yp (N,) continue as accelerations a (n,)."""
    for i in range(a.shape[0]):
        unknowns.velocity_shift[0, i] += (t - unknowns.shift_start[0]) * unknowns.velocity_shift[1, i]
        unknowns.velocity_shift[1, i] = a[i] - yp[unknowns.q.shape[0] + i]
    unknowns.shift_start[0] = t


@kernel
def copy_unknowns(t: float, y: Reals, yp: Reals, unknowns: Unknowns) -> None:
    """Copy IDA's read-only arrays, the velocities themselves among them."""
    nq, n = unknowns.q.shape[0], unknowns.v.shape[0]
    unknowns.factor_key[0] = t
    for i in range(y.shape[0]):
        unknowns.y[i] = y[i]
        unknowns.yp[i] = yp[i]
        unknowns.evaluated_at[i] = y[i]
    for i in range(n):
        unknowns.y[nq + i] = velocity(i, t, y, unknowns)
        unknowns.yp[nq + i] += unknowns.velocity_shift[1, i]


@kernel
def residual(eqs: Any, t: float, y: Reals, yp: Reals, res: Reals, unknowns: Unknowns, work: Any) -> None:
    """IDA's residual function; what is not finite IDA takes as a sign to cut the step."""
    copy_unknowns(t, y, yp, unknowns)
    evaluate_residual(eqs, t, unknowns, work, res)
    unknowns.counts[RESIDUALS] += 1.0
    for i in range(res.shape[0]):
        if not np.isfinite(res[i]):
            unknowns.counts[NONFINITE_RESIDUALS] += 1.0
            return


@inlined
def unit_of_velocity(i: int, work: Any) -> float:
    """Unit of velocity i: that of its coordinate times the rate of the motion, or the nominal value of a state."""
    return work.size[i] * work.rate[0] if i < count_motions(work) else work.size[i]


@kernel
def set_up_preconditioner(eqs: Equations, t: float, y: Reals, yp: Reals, unknowns: Unknowns, work: Any) -> None:
    """unknowns.K: differences in q and v, all columns in one call; unknowns.N. The part of y' is known."""
    nq, n = unknowns.q.shape[0], unknowns.v.shape[0]
    copy_unknowns(t, y, yp, unknowns)
    unknowns.counts[JACOBIANS] += 1.0
    evaluate_residual(eqs, t, unknowns, work, unknowns.res)
    for j in range(nq + n):
        natural = work.size_q[j] if j < nq else unit_of_velocity(j - nq, work)
        here = unknowns.y[j]
        step = 1.5e-8 * max(natural, abs(here))
        unknowns.y[j] = here + step
        evaluate_residual(eqs, t, unknowns, work, unknowns.res_perturbed)
        for i in range(y.shape[0]):
            unknowns.K[i, j] = (unknowns.res_perturbed[i] - unknowns.res[i]) / step
        unknowns.y[j] = here
    for j in range(n):
        for i in range(n):
            unknowns.v[i] = 1.0 if i == j else 0.0
        eqs.dynamics(t, unknowns.q, unknowns.v, eqs.data, eqs.terms)
        for i in range(nq):
            unknowns.N[i, j] = eqs.terms.qdot[i]
    evaluate_residual(eqs, t, unknowns, work, unknowns.res)
    unknowns.factor_key[2] = np.nan  # no factors


@kernel
def assemble_matrix(eqs: Equations, unknowns: Unknowns, work: Any, cj: float) -> None:
    """unknowns.matrix: d res / d y + cj d res / d y', from K and what ``terms`` hold."""
    terms, nq = eqs.terms, unknowns.q.shape[0]
    m, n = terms.J.shape
    lam, mu, N = nq + n, nq + n + m, unknowns.y.shape[0]
    A, turns = unknowns.matrix, has_quaternions(nq, n, work.states)
    for i in range(N):
        for j in range(N):
            A[i, j] = unknowns.K[i, j] if j < lam else 0.0
    for i in range(nq):
        A[i, i] += cj
    for i in range(n):
        for j in range(n):
            A[nq + i, nq + j] += cj * terms.M[i, j]
    scale = factor_filter(unknowns, work, terms) if m > 0 else 0.0
    for row in range(m):
        for other in range(m):
            unknowns.D[row, other] = 1.0 if row == other else 0.0
        apply_filter(unknowns.D[row], scale, unknowns, work)  # D is symmetric: a row is a column
        for i in range(n):
            entry = terms.J[row, i] / work.row[row]
            A[nq + i, lam + row] = entry
            A[lam + row, nq + i] = entry
            if not turns and i < nq:
                A[i, mu + row] = work.size[i] ** 2 * entry
                A[mu + row, i] = entry
            elif turns:
                for k in range(nq):
                    A[k, mu + row] += unknowns.N[k, i] * work.size[i] ** 2 * entry
        for other in range(m):
            A[lam + row, lam + other] = -unknowns.D[row, other] - unknowns.d_redundant[0] * unknowns.P[row, other]
            A[mu + row, mu + other] = -unknowns.d_redundant[1] * unknowns.P[row, other]
        A[mu + row, mu + row] -= unknowns.d[1]
    for k in range(work.nonholonomic.shape[0]):  # mu = 0
        for i in range(lam):
            A[mu + work.nonholonomic[k], i] = 0.0


@kernel
def apply_preconditioner(
    eqs: Any, t: float, y: Reals, yp: Reals, right: Any, left: Any, cj: float, unknowns: Any, work: Any
) -> None:
    """The preconditioner: left = matrix^-1 right with J and M of this iterate, or the vector requested before."""
    N = y.shape[0]
    if unknowns.is_pending[0] == 1.0:
        unknowns.is_pending[0] = 0.0
        for i in range(N):
            left[i] = unknowns.pending_vector[i]
        return
    here, fresh = unknowns.factor_key[0] == t, unknowns.factor_key[1] == t and unknowns.factor_key[2] == cj
    for i in range(N):
        here = here and unknowns.evaluated_at[i] == y[i]
        fresh = fresh and unknowns.factored_at[i] == y[i]
    if not fresh:
        if not here:
            copy_unknowns(t, y, yp, unknowns)
            evaluate_residual(eqs, t, unknowns, work, unknowns.res)
        assemble_matrix(eqs, unknowns, work, cj)
        for i in range(N):
            for j in range(N):
                unknowns.matrix[i, j] *= unknowns.columns[j] / unknowns.rows[i]
        factor_lu(unknowns.matrix, N, unknowns.order)
        unknowns.factor_key[1], unknowns.factor_key[2] = t, cj
        for i in range(N):
            unknowns.factored_at[i] = y[i]
    for i in range(N):
        unknowns.right[i] = right[i] / unknowns.rows[i]
    solve_lu(unknowns.matrix, N, unknowns.order, unknowns.right, unknowns.left)
    for i in range(N):
        left[i] = unknowns.left[i] * unknowns.columns[i]


@kernel
def matvec_passthrough(vector: Reals, product: Any, unknowns: Unknowns) -> None:
    """The product of matrix and vector, for the preconditioner to undo."""
    unknowns.is_pending[0] = 1.0
    for i in range(vector.shape[0]):
        unknowns.pending_vector[i] = vector[i]
        product[i] = vector[i]


@inlined
def filter_speed_loss(time: float, terms: Terms, unknowns: Unknowns, work: Any) -> float:
    """Speed that D has taken from the loops in this ``time`` (s), in units of theirs: the power of D is lambda .
    D lambda, and D lambda is what velocities leave of their constraints, J v - nu. What moves fast loses little of its
    speed by that.
    """
    power, inertia, looped, speed = 0.0, 0.0, 0.0, loop_speed(unknowns.v, work)
    for i in range(unknowns.v.shape[0]):
        inertia += work.in_loops[i] * terms.M[i, i] * work.size[i] ** 2
        looped += work.in_loops[i]
    for row in range(terms.nu.shape[0]):
        left = -terms.nu[row]
        for i in range(unknowns.v.shape[0]):
            left += terms.J[row, i] * unknowns.v[i]
        power += unknowns.lam[row] * left
    if not inertia > 0.0:
        return 0.0
    lost = np.sqrt(speed * speed + 2.0 * max(0.0, power) * time * looped / inertia) - speed
    return lost / max(work.rate[1], speed)


@inlined
def self_stress_residual(terms: Terms, work: Workspace) -> float:
    """null . Phi~, with the left null vector of J~ at the critical point: self-stress, forces without resultant."""
    total = 0.0
    for i in range(terms.Phi.shape[0]):
        total += work.u[i] * terms.Phi[i] / work.row[i]
    return total
