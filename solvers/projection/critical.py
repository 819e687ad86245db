"""The search for critical points, where the constraint Jacobian loses one rank (bifurcation points).

There is a unit left null vector u of the scaled Jacobian: constraint forces u produce no generalized force
(self-stress)::

    J~^T u = 0,   nu~ . u = 0,   Phi~ = g u,   |u| = 1          (units as in :mod:`solvers.projection.workspace`)

in the unknowns q, t, u and the *gap* g, the distance of the loop from one that is singular there. Damped Newton's
method in all unknowns, with the step of minimum norm if it is not unique (redundant constraints, critical
points that form curves).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import (
    apply_Q,
    apply_Qt,
    dot,
    factor_lq,
    length,
    regularize_diagonal,
    scale_to_unit,
    solve_least_norm,
    solve_positive_definite,
)

from .workspace import distance, factor_transposed

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

CRITICAL_DIFFERENCE_STEP = 1e-7  # of differences, in units of size
INVERSE_ITERATIONS = 5  # of the inverse iteration for the left null vector
DAMPING_FACTOR = 0.01  # of the squares of singular values, in what is left of the equations: see find_critical_point
DIFFERENCE_NOISE_RATIO = 1e-8  # singular values of the equations below this part of all are those of the differences
ZERO_SINGULAR_VALUE_RATIO = 1e-6  # below this part of the largest they count as zero
MIN_POSITION_PART = 1e-2  # of a unit vector in q, t, u and g, its part in q and t that counts
MIN_DRIVE_RATE_RATIO = 1e-4  # rate of the drives that counts, in those of the motion
MAX_NEWTON_STEP_LENGTH, MAX_SEARCH_DISTANCE = 0.3, 1.0  # longest Newton step, longest way, in units of size
MAX_NEWTON_STEPS, CRITICAL_POINT_TOLERANCE = 30, 1e-11  # steps, and what they may leave: g is known to its power of 3/2


@kernel
def find_critical_point(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> bool:
    """Newton for the critical point next to q: fills ``work.q_c``, and time and gap of its record.

    If several rows lose their rank at once the point is a double root: relevant directions have singular values as
    small as the square root of the residual, and steps are damped accordingly (Levenberg, Marquardt).
    """
    m, n = eqs.terms.J.shape
    critical, N = work.critical[0], n + m + 2
    find_left_null_vector(eqs.terms, rank, work)
    for i in range(q.shape[0]):
        work.q_c[i] = q[i]
    critical.t, critical.bifurcation_gap, critical.rate = t, 0.0, drive_rate(eqs.terms, work)
    for _ in range(MAX_NEWTON_STEPS):
        critical_residual(eqs, critical.t, work.q_c, work, work.g)
        for i in range(N):
            if not np.isfinite(work.g[i]):
                return False
        off = length(work.g)
        if off < CRITICAL_POINT_TOLERANCE:
            critical.bifurcation_gap += remaining_gap(m, n, work)
            return True
        fill_critical_jacobian(eqs, is_rheonomic(eqs.terms), work)
        if not solve_damped_step(DAMPING_FACTOR * off, work):
            return False
        apply_newton_step(eqs, min(1.0, MAX_NEWTON_STEP_LENGTH / max(length(work.change), 1e-300)), work)
        if not max(distance(work.q_c, q, work), abs(critical.t - t) * work.rate[0]) < MAX_SEARCH_DISTANCE:
            return False
    return False


@kernel
def solve_damped_step(damping: float, work: Workspace) -> bool:
    """work.change = the x that minimizes |K x - g|^2 + damping |x|^2: (K K^T + damping) y = g, x = K^T y; False where
    that has no digits.
    """
    N, trace = work.change.shape[0], 0.0
    for i in range(N):
        for j in range(i + 1):
            work.K_work[i, j] = dot(work.K, i, work.K, j, 0, N)
        trace += work.K_work[i, i]
    for i in range(N):
        work.K_work[i, i] += damping + DIFFERENCE_NOISE_RATIO * DIFFERENCE_NOISE_RATIO * trace
        work.change[i] = 0.0
    if not solve_positive_definite(work.K_work, N, work.g):
        return False
    for i in range(N):
        for j in range(N):
            work.change[j] += work.K[i, j] * work.g[i]
    return True


@kernel
def critical_set_dimension(eqs: Equations, work: Workspace) -> int:
    """Dimension of the critical points in q and t about the one just found, from the null space of its equations."""
    N, n = work.change.shape[0], work.size.shape[0]
    fill_critical_jacobian(eqs, True, work)
    for i in range(N):
        for j in range(N):
            work.K_work[i, j] = work.K[i, j]
    factor_lq(work.K_work, N, N, work.K_tau, work.K_pivots, work.change)
    flat = 0
    while flat < N and abs(work.K_work[flat, flat]) > ZERO_SINGULAR_VALUE_RATIO * abs(work.K_work[0, 0]):
        flat += 1
    for k in range(N - flat):
        for j in range(N):
            work.K[k, j] = 1.0 if j == flat + k else 0.0
        apply_Q(work.K_work, work.K_tau, flat, N, work.K[k])
    factor_lq(work.K, N - flat, n + 1, work.K_tau, work.K_pivots, work.change)
    found = 0
    while found < min(N - flat, n + 1) and abs(work.K[found, found]) > MIN_POSITION_PART:
        found += 1
    return found


@inlined
def is_rheonomic(terms: Terms) -> bool:
    """Whether time moves a constraint."""
    for i in range(terms.nu.shape[0]):
        if terms.nu[i] != 0.0:
            return True
    return False


@inlined
def drive_rate(terms: Terms, work: Workspace) -> float:
    """Unit of time, 1/s: that of the motion, or that of drives which are slower."""
    square = 0.0
    for i in range(terms.nu.shape[0]):
        square += (terms.nu[i] / work.row[i]) ** 2
    return min(work.rate[0], max(MIN_DRIVE_RATE_RATIO * work.rate[0], np.sqrt(square)))


@inlined
def remaining_gap(m: int, n: int, work: Workspace) -> float:
    """What u . (Phi~ - g u) is off."""
    total = 0.0
    for i in range(m):
        total += work.u[i] * work.g[n + 1 + i]
    return total


@kernel
def find_left_null_vector(terms: Terms, rank: int, work: Workspace) -> None:
    """work.u = the left singular vector of the smallest singular value of J~ that is not redundant, from its factors:
    by inverse iteration, which begins with what the last pivot row has for itself.
    """
    m, n = terms.J.shape
    factor_transposed(m, rank, work)
    regularize_diagonal(work.A, rank)
    regularize_diagonal(work.B, rank)
    for j in range(n):
        work.f[j] = 1.0 if j == rank - 1 else 0.0
    apply_Q(work.A, work.tau, rank, n, work.f)
    for _ in range(INVERSE_ITERATIONS):
        apply_Qt(work.A, work.tau, rank, n, work.f)
        solve_least_norm(work.f, m, rank, work.B, work.tau_B, work.pivots_B, work.u)
        scale_to_unit(work.u)
        solve_least_norm(work.u, n, rank, work.A, work.tau, work.pivots, work.f)
        scale_to_unit(work.f)


@kernel
def critical_residual(eqs: Equations, t: float, q: Reals, work: Workspace, g: Reals) -> None:
    """Left side less right side of the equations (N,) at (t, q) with ``work.u`` and the gap; ``terms`` follow."""
    terms, critical = eqs.terms, work.critical[0]
    m, n = terms.J.shape
    eqs.position(t, q, eqs.data, terms)
    for j in range(n):
        g[j] = 0.0
    g[n], g[n + m + 1] = 0.0, -0.5
    for i in range(m):
        scaled = work.u[i] / work.row[i]
        for j in range(n):
            g[j] += scaled * terms.J[i, j] * work.size[j]
        g[n] -= scaled * terms.nu[i] / critical.rate
        g[n + 1 + i] = terms.Phi[i] / work.row[i] - critical.bifurcation_gap * work.u[i]
        g[n + m + 1] += 0.5 * work.u[i] * work.u[i]


@kernel
def fill_critical_jacobian(eqs: Equations, timed: bool, work: Workspace) -> None:
    """work.K (N, N) = derivative of work.g, the last :func:`critical_residual`: by differences where J is
    differentiated; that by time only where ``timed``.
    """
    terms, critical = eqs.terms, work.critical[0]
    m, n = terms.J.shape
    N = n + m + 2
    for k in range(m):
        for i in range(N):
            work.K[i, n + 1 + k] = 0.0
        for j in range(n):
            work.K[j, n + 1 + k] = terms.J[k, j] * (work.size[j] / work.row[k])
        work.K[n, n + 1 + k] = -terms.nu[k] / (work.row[k] * critical.rate)
        work.K[n + 1 + k, n + 1 + k] = -critical.bifurcation_gap
        work.K[N - 1, n + 1 + k] = work.u[k]
    for i in range(N):
        work.K[i, N - 1] = -work.u[i - n - 1] if n < i < N - 1 else 0.0
    for i in range(N):
        work.K[i, n] = 0.0
    for k in range(n + timed):
        for i in range(work.q_c.shape[0]):
            work.q_try[i] = work.q_c[i]
        for i in range(n):
            work.dq[i] = CRITICAL_DIFFERENCE_STEP * work.size[i] if i == k else 0.0
        eqs.retract(work.q_try, work.dq, eqs.data)
        critical_residual(
            eqs,
            critical.t + (CRITICAL_DIFFERENCE_STEP / critical.rate if k == n else 0.0),
            work.q_try,
            work,
            work.g_try,
        )
        for i in range(N):
            work.K[i, k] = (work.g_try[i] - work.g[i]) / CRITICAL_DIFFERENCE_STEP


@inlined
def apply_newton_step(eqs: Equations, part: float, work: Workspace) -> None:
    """Apply a ``part`` of Newton's step."""
    m, n = eqs.terms.J.shape
    critical = work.critical[0]
    for j in range(n):
        work.dq[j] = -part * work.change[j] * work.size[j]
    eqs.retract(work.q_c, work.dq, eqs.data)
    critical.t -= part * work.change[n] / critical.rate
    for i in range(m):
        work.u[i] -= part * work.change[n + 1 + i]
    critical.bifurcation_gap -= part * work.change[n + m + 1]
