"""Projection partitioning: motion tangent to the constraints, also through singular configurations.

Nonholonomic rows have Phi = 0, so that corrections of the position are motions that they allow: a wheel is moved onto
its plane without slip. The change is of the order of the tolerance, and J may be factored once for both levels.

Coordinates are measured in units S of their size, constraints in units R of their rows (the largest they have been), so
that radians and meters are comparable: J~ = R^-1 J S. With J~ = L Q^T (:func:`solvers.linalg.dense.factor_lq`) the
first ``rank`` columns of Q span the constraint normals and the others the motions the constraints allow, P = S Q_2::

    v' = J^+ gamma + P (P^T M P)^-1 P^T (-h - M J^+ gamma)       (projection, paper eq. 9-13)
    q <- q (+) -J^+ Phi,   v <- v - J^+ (J v - nu)               (Gauss-Newton, velocity correction)

First-order states follow the velocities in v. Their part of M is the unit matrix and no constraint contains them, so
that their rates are -h: P^T M P is formed and factored of the velocities alone.

M itself is never factored, so bodies without mass are fine while P^T M P is positive definite. ``rank`` is the *normal
rank*, the rank in generic positions; rows that are redundant everywhere are beyond it, and
are identified at every position.

**Singular configurations.** If the diagonal entry of L number ``rank`` is below ``SINGULAR_PIVOT_RATIO`` times the
first, J nearly loses rank. This is either a *crossing* (bifurcation), where it loses rank on the way and a second
branch of the motion crosses, or a *near miss* (imperfect bifurcation), where the branches part just before they meet
and the motion turns sharply.
:mod:`.singular` distinguishes the two. Near a miss the equations above are valid. At a crossing a truncation of J
causes an error O(1) of v', and without truncation there is a division by zero. But the motion has a continuous tangent
e = v/|v|, and with it v' has a limit. It is interpolated along the branch from both sides of the crossing, which lies
at s = c, with regular accelerations only and v(s) = P P^T v + J^+ nu, e and |v| without the coordinates on which no
constraint depends::

    v' = sum_k l_k(-c/d) a(c + k d) + O(d^4),   k = -2, -1, 1, 2,   a(s) at q(s) = close(q (+) s e)

Constraints that depend on time are evaluated at t + s/|v|. Loads are those of t, and coordinates on which no
constraint depends are not changed: both may go through many periods on the way, or move much farther
than the loops.

Without velocity there is no tangent, and the branch cannot be determined.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import (
    apply_Q,
    apply_Qt,
    dot,
    pivot_ratio,
    rank_at,
    solve_least_norm,
    solve_positive_definite,
    solve_transposed_basic,
)
from solvers.outcome import NO_MASS, NOT_CLOSED, NOT_FINITE, OK, UNDECIDABLE

from .critical import is_rheonomic
from .singular import BIFURCATION, SINGULAR_PIVOT_RATIO, classify_singularity
from .workspace import (
    count_freedom,
    count_motions,
    distance,
    evaluate_and_factor,
    factor,
    factor_transposed,
    loop_speed,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

# speed, in units of size and rate, below which there is no tangent; see UNRESOLVED_PIVOT_RATIO
MIN_TANGENT_SPEED = 1e-9
UNRESOLVED_PIVOT_RATIO = 1e-7  # ratio below which the smallest pivot has no accurate digits after squaring
# a pivot up to this multiple of SINGULAR_PIVOT_RATIO is zero at a crossing together with a smaller one
PIVOT_CLUSTER_FACTOR = 10.0
LIMIT_NODE_DISTANCE = 1e-2  # d of the limit, in units of size
MAX_PROJECTION_CORRECTIONS = 12  # Gauss-Newton corrections of a position
CORRECTION_TOLERANCE = 1e-7  # a correction this small is the last: the next one would be its square
CHORD_CONTRACTION_LIMIT = 0.1  # part that a correction by the factors of the prediction must leave at most
CORRECTION_ROUNDING = 1e-14  # a correction this small is rounding
RESIDUAL_TOLERANCE = 1e-8  # residual that a closed position must not have in any row, in units of the rows


@kernel
def effective_rank(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> int:
    """How many pivot rows can be divided by; ``terms`` and factors belong to (t, q).

    Rows that lose their rank at a crossing are left out, because they would be divided by nearly zero. If there are
    several, all of them are: closing one and not another would give the velocity of a branch that does not exist.
    """
    if rank_at(work.pivot, rank, SINGULAR_PIVOT_RATIO) == rank:
        return rank
    if classify_singularity(eqs, t, q, rank, work) == BIFURCATION:
        several = work.critical[0].lost > 1
        return max(
            rank_at(work.pivot, rank, PIVOT_CLUSTER_FACTOR * SINGULAR_PIVOT_RATIO),
            rank - work.critical[0].lost if several else 0,
        )
    return rank_at(work.pivot, rank, UNRESOLVED_PIVOT_RATIO)


@inlined
def is_near_bifurcation(rank: int, work: Workspace) -> bool:
    """Whether a known crossing is so near that pivots which are zero there are small."""
    return (
        work.critical[0].kind == BIFURCATION
        and rank_at(work.pivot, rank, PIVOT_CLUSTER_FACTOR * SINGULAR_PIVOT_RATIO) < rank
    )


@inlined
def solve_position_correction(terms: Terms, rank: int, work: Workspace) -> float:
    """work.dq = -J^+ Phi with the first ``rank`` pivot rows; return its largest entry in units of size."""
    for i in range(terms.Phi.shape[0]):
        work.b[i] = terms.Phi[i] / work.row[i]
    solve_least_norm(work.b, terms.J.shape[1], rank, work.A, work.tau, work.pivots, work.dq)
    largest = 0.0
    for i in range(work.dq.shape[0]):
        largest = max(largest, abs(work.dq[i]))
        work.dq[i] *= -work.size[i]
    return largest


@inlined
def violates_constraints(terms: Terms, work: Workspace) -> bool:
    """Whether some row, dependent ones included, has a residual."""
    for i in range(terms.Phi.shape[0]):
        if not abs(terms.Phi[i]) <= RESIDUAL_TOLERANCE * work.row[i]:
            return True
    return False


@kernel
def project_position(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> bool:
    """Project q onto Phi(t, q) = 0 along the constraint normals, in place; False if it does not converge.

    Leaves Phi, J and nu at the result, and the factors of a J nearby.
    """
    eqs.position(t, q, eqs.data, eqs.terms)
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        factor(eqs.terms, work)
        trust = effective_rank(eqs, t, q, rank, work)
        largest = correct_position(eqs, t, q, trust, work)
        if largest <= CORRECTION_TOLERANCE:
            return trust < rank or not violates_constraints(eqs.terms, work)
    return False


@inlined
def correct_position(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> float:
    """One Gauss-Newton correction of q in place, with the factors of the J of ``terms``; return its size."""
    largest = solve_position_correction(eqs.terms, rank, work)
    if not np.isfinite(largest):
        return np.inf
    eqs.retract(q, work.dq, eqs.data)
    eqs.position(t, q, eqs.data, eqs.terms)
    return largest


@kernel
def project_velocity(v: Reals, terms: Terms, rank: int, work: Workspace) -> None:
    """Subtract from v its violation of J v = nu in the first ``rank`` pivot rows of the factored J, in place."""
    m, n = terms.J.shape
    for i in range(m):
        work.b[i] = -terms.nu[i]
        for j in range(n):
            work.b[i] += terms.J[i, j] * v[j]
        work.b[i] /= work.row[i]
    solve_least_norm(work.b, n, rank, work.A, work.tau, work.pivots, work.dq)
    for i in range(n):
        v[i] -= work.size[i] * work.dq[i]


@kernel
def project(eqs: Equations, t: float, q: Reals, v: Reals, rank: int, work: Workspace) -> int:
    """Project (q, v) onto the constraints, in place; leave ``terms`` and the factors of J at the result."""
    if not project_position(eqs, t, q, rank, work):
        return NOT_CLOSED
    factor(eqs.terms, work)
    project_velocity(v, eqs.terms, effective_rank(eqs, t, q, rank, work), work)
    eqs.motion(t, q, v, eqs.data, eqs.terms)
    return OK


@kernel
def project_with_frozen_jacobian(
    eqs: Equations, t: float, q: Reals, v: Reals, near: Reals, rank: int, slight: float, work: Workspace
) -> int:
    """As :func:`project`, with ``terms`` and the factors of J at the prediction ``near`` (simplified Newton).

    The factors are used again until the correction is below ``slight``, since new factors cost more. J is refactored
    only if the contraction is worse than ``CHORD_CONTRACTION_LIMIT``. v' depends on the residual by the inverse square
    of the smallest pivot.
    """
    n = v.shape[0]
    if eqs.terms.Phi.shape[0] == 0:
        for i in range(n):
            work.dq[i] = 0.0
        eqs.retract(q, work.dq, eqs.data)
        eqs.dynamics(t, q, v, eqs.data, eqs.terms)
        return OK
    if rank == 0 or rank_at(work.pivot, rank, SINGULAR_PIVOT_RATIO) < rank:
        return project(eqs, t, q, v, rank, work)
    if q.shape[0] == n:
        for i in range(eqs.terms.Phi.shape[0]):
            for j in range(n):
                eqs.terms.Phi[i] += eqs.terms.J[i, j] * (q[j] - near[j])
        for k in range(work.nonholonomic.shape[0]):
            eqs.terms.Phi[work.nonholonomic[k]] = 0.0
        solve_position_correction(eqs.terms, rank, work)
    else:
        for i in range(n):
            work.dq[i] = 0.0
    eqs.retract(q, work.dq, eqs.data)  # quaternions to unit length, too
    eqs.position(t, q, eqs.data, eqs.terms)
    rest = solve_position_correction(eqs.terms, rank, work)
    while not rest <= max(slight * pivot_ratio(work.pivot, rank) ** 2, CORRECTION_ROUNDING):
        eqs.retract(q, work.dq, eqs.data)
        eqs.position(t, q, eqs.data, eqs.terms)
        before, rest = rest, solve_position_correction(eqs.terms, rank, work)
        if not rest <= CHORD_CONTRACTION_LIMIT * before:
            return project(eqs, t, q, v, rank, work)
    if rank < eqs.terms.Phi.shape[0] and violates_constraints(eqs.terms, work):  # dependent rows may contradict
        return project(eqs, t, q, v, rank, work)
    project_velocity(v, eqs.terms, rank, work)
    eqs.motion(t, q, v, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return OK


@kernel
def fill_tangent_basis(rank: int, work: Workspace) -> None:
    """Fill the first rows of ``work.T`` with a basis of the motions that the factored constraints allow: P."""
    n = work.T.shape[1]
    for k in range(count_freedom(rank, work)):
        tangent = work.T[k]
        for i in range(n):
            tangent[i] = 1.0 if i == rank + k else 0.0
        apply_Q(work.A, work.tau, rank, n, tangent)
        for i in range(n):
            tangent[i] *= work.size[i]


@kernel
def add_tangent_acceleration(terms: Terms, rank: int, work: Workspace, a: Reals) -> bool:
    """a <- a + P z, where P^T (M a + h) = 0 and the columns of P are the first rows of ``work.T``; -h of states."""
    n, freedom = count_motions(work), count_freedom(rank, work)
    for i in range(n, a.shape[0]):
        a[i] = -terms.h[i]
    for i in range(n):
        work.f[i] = -terms.h[i]
        for j in range(n):
            work.f[i] -= terms.M[i, j] * a[j]
    for k in range(freedom):
        for i in range(n):
            work.momentum[0, i] = dot(terms.M, i, work.T, k, 0, n)
        for low in range(k + 1):
            work.mass[k, low] = dot(work.T, low, work.momentum, 0, 0, n)
        work.z[k] = 0.0
        for i in range(n):
            work.z[k] += work.T[k, i] * work.f[i]
    if not solve_positive_definite(work.mass, freedom, work.z):
        return False
    for k in range(freedom):
        for i in range(n):
            a[i] += work.T[k, i] * work.z[k]
    return True


@kernel
def evaluate_regular_acceleration(terms: Terms, rank: int, work: Workspace, a: Reals) -> int:
    """v' away from singular configurations, from ``terms`` and the factors of their J."""
    m, n = terms.J.shape
    for i in range(m):
        work.b[i] = terms.gamma[i] / work.row[i]
    solve_least_norm(work.b, n, rank, work.A, work.tau, work.pivots, a)
    for i in range(n):
        a[i] *= work.size[i]
    fill_tangent_basis(rank, work)
    if not add_tangent_acceleration(terms, rank, work, a):
        return NO_MASS
    for i in range(n):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@kernel
def evaluate_acceleration(eqs: Equations, t: float, q: Reals, v: Reals, rank: int, work: Workspace, a: Reals) -> int:
    """v' anywhere; ``terms`` and the factors of J belong to (t, q, v) and do so again afterwards."""
    for i in range(v.shape[0]):
        if not np.isfinite(eqs.terms.h[i]):
            return NOT_FINITE
    if rank_at(work.pivot, rank, SINGULAR_PIVOT_RATIO) == rank:
        return evaluate_regular_acceleration(eqs.terms, rank, work, a)
    crossing = classify_singularity(eqs, t, q, rank, work) == BIFURCATION
    if not crossing or not loop_speed(v, work) > MIN_TANGENT_SPEED * work.rate[1]:
        resolved = rank_at(work.pivot, rank, UNRESOLVED_PIVOT_RATIO) == rank
        return evaluate_regular_acceleration(eqs.terms, rank, work, a) if resolved else UNDECIDABLE
    code = limit_at_bifurcation(eqs, t, q, v, False, rank, work, a)
    evaluate_and_factor(eqs, t, q, v, work)
    return code


@inlined
def retract_along(eqs: Equations, q: Reals, v: Reals, along: float, work: Workspace) -> None:
    """work.q_near = the position a time ``along`` of the loops' part of v from q."""
    for i in range(q.shape[0]):
        work.q_near[i] = q[i]
    for i in range(v.shape[0]):
        work.dq[i] = along * v[i] * work.in_loops[i]
    eqs.retract(work.q_near, work.dq, eqs.data)


@kernel
def arclength_to_bifurcation(eqs: Equations, q: Reals, v: Reals, work: Workspace) -> float:
    """Signed distance along v from q to where the crossing lies nearest."""
    speed = loop_speed(v, work)
    retract_along(eqs, q, v, -LIMIT_NODE_DISTANCE / speed, work)
    behind = distance(work.q_c, work.q_near, work)
    retract_along(eqs, q, v, LIMIT_NODE_DISTANCE / speed, work)
    before = distance(work.q_c, work.q_near, work)
    return (behind * behind - before * before) / (4.0 * LIMIT_NODE_DISTANCE)


@kernel
def project_neighbor(
    eqs: Equations, t: float, q: Reals, v: Reals, along: float, timed: bool, rank: int, work: Workspace
) -> bool:
    """Closed state (work.q_near, work.v_near) at a signed distance ``along`` v from q, with its terms and factors.
    Where constraints are ``timed`` they are those of the time when the motion gets there, inertia and loads those of t.
    False where it cannot be closed. No row is left out.
    """
    speed = loop_speed(v, work)
    retract_along(eqs, q, v, along / speed, work)
    for i in range(v.shape[0]):
        work.v_near[i] = v[i]
    after = t + along / speed if timed else t
    eqs.position(after, work.q_near, eqs.data, eqs.terms)
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        factor(eqs.terms, work)
        if correct_position(eqs, after, work.q_near, rank, work) <= CORRECTION_TOLERANCE:
            factor(eqs.terms, work)
            project_velocity(work.v_near, eqs.terms, rank, work)
            eqs.motion(after, work.q_near, work.v_near, eqs.data, eqs.terms)
            if timed:
                freeze_loads(eqs, t, work)
            return True
    return False


@inlined
def freeze_loads(eqs: Equations, t: float, work: Workspace) -> None:
    """Evaluate inertia and loads of a neighbor at time t; its gamma remains that of the neighbor's time."""
    for i in range(work.x.shape[0]):
        work.x[i] = eqs.terms.gamma[i]
    eqs.dynamics(t, work.q_near, work.v_near, eqs.data, eqs.terms)
    for i in range(work.x.shape[0]):
        eqs.terms.gamma[i] = work.x[i]


@kernel
def limit_at_bifurcation(
    eqs: Equations, t: float, q: Reals, v: Reals, velocity: bool, rank: int, work: Workspace, out: Reals
) -> int:
    """``out`` = v', or v on the branch, near a crossing, from both sides of it (module docstring)."""
    for i in range(v.shape[0]):
        out[i] = 0.0
    arclength = arclength_to_bifurcation(eqs, q, v, work)
    step = max(LIMIT_NODE_DISTANCE, abs(arclength))
    x = -arclength / step
    timed = is_rheonomic(eqs.terms)
    for node in (-2, -1, 1, 2):
        weight = lagrange_polynomial(node, x)
        if weight == 0.0:  # q is a node itself
            continue
        if not project_neighbor(eqs, t, q, v, arclength + node * step, timed, rank, work):
            return NOT_CLOSED
        if not velocity:
            code = evaluate_regular_acceleration(eqs.terms, rank, work, work.a)
            if code != OK:
                return code
        for i in range(v.shape[0]):
            out[i] += weight * (work.v_near[i] if velocity else work.a[i])
    return OK


@inlined
def lagrange_polynomial(node: int, x: float) -> float:
    """The cubic that is one at ``node`` and zero at the others of -2, -1, 1, 2."""
    if abs(node) == 1:
        return (4.0 - x * x) * (1.0 + node * x) / 6.0
    return (x * x - 1.0) * (2.0 + 0.5 * node * x) / 12.0


@kernel
def evaluate_multipliers(terms: Terms, rank: int, work: Workspace, a: Reals, lam: Reals) -> None:
    """Shortest lambda, in units of the rows, with J^T lambda = -(M a + h) in the directions of ``rank`` pivot rows, as
    far as they are resolved; ``terms`` and factors belong together.

    Near a crossing no row is left out, as for v': forces may be unbounded there, and their effect on
    a drive is their product with a lever arm that goes to zero.
    """
    m, n = terms.J.shape
    rank, moving = rank_at(work.pivot, rank, UNRESOLVED_PIVOT_RATIO), count_motions(work)
    for i in range(moving):
        work.f[i] = -terms.h[i]
        for j in range(moving):
            work.f[i] -= terms.M[i, j] * a[j]
        work.f[i] *= work.size[i]
    for i in range(moving, n):
        work.f[i] = 0.0
    if rank == m:
        solve_transposed_basic(work.f, m, n, rank, work.A, work.tau, work.pivots, lam)
    else:
        solve_transposed_shortest(m, n, rank, work, lam)
    for i in range(m):
        lam[i] /= work.row[i]


@kernel
def solve_transposed_shortest(m: int, n: int, rank: int, work: Workspace, y: Reals) -> None:
    """Shortest y (m,) with J~^T y = work.f, where rows depend on each other: L^T y = Q^T f by factors of L^T."""
    apply_Qt(work.A, work.tau, rank, n, work.f)
    factor_transposed(m, rank, work)
    solve_least_norm(work.f, m, rank, work.B, work.tau_B, work.pivots_B, y)
