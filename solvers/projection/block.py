"""The search for critical points where several independent rows lose their rank at once, as in linkages of equal loops.

Left null vectors (self-stresses) are not unique there, so they are no unknowns of Newton's method: they follow
from the position. With the factors of the present rows and time as a further coordinate (units as in
:mod:`.workspace`)::

    [J~, -nu~] = L Q^T,  L = [[L_11, 0], [L_21, L_22]],  U^T = [-L_21 L_11^-1, I],  U^T [J~, -nu~] Q_2 = L_22

the k rows of L_22 that are not redundant are zero in the critical point, and Phi~ lies in the span of U. Their
number is determined from the largest gap in the diagonal of L in each step. One force u = U c, with fixed c without
symmetry, represents all of them: if every entry of L_22 is zero so is c^T L_22; the converse is examined at the end.
The derivative of c^T L_22 in the directions Q_2 is square and symmetric. If it does not have full rank, as along curves
of critical points, the step of minimum norm is used.

The point may also lie in a surface of critical points in which fewer rows are zero, for example if a slab on
two folding legs lies flat and each leg may rotate by itself. Then the search ends in one of those, and one combination
of rows is zero along curves. In that case a second search keeps the number of rows and uses several combinations c, by
the method of Gauss and Newton.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.linalg.dense import (
    apply_Q,
    apply_Qt,
    factor_lq,
    length,
    pivot_ratio,
    rank_at,
    solve_least_norm,
    solve_positive_definite,
)

from .critical import (
    CRITICAL_DIFFERENCE_STEP,
    CRITICAL_POINT_TOLERANCE,
    MAX_NEWTON_STEPS,
    ZERO_SINGULAR_VALUE_RATIO,
    drive_rate,
    is_rheonomic,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace
    from solvers.system import Equations, Terms

PIVOT_FLOOR_RATIO = 1e-10  # part of the first pivot: those below are alike
MIN_PIVOT_GAP = 3.0  # least ratio of two successive pivots that separates equations without rank from the others
MAX_EXTRAPOLATION_STEPS = 10.0  # longest distance ahead to the loss of rank, in lengths of the last step
CLOSURE_WEIGHT = 100.0  # factor by which Phi~ must lie better in the span of U than L_22 must be zero
MAX_SEARCH_STEP, MAX_COORDINATE_DISTANCE = 0.3, 1.0  # longest step and way of any coordinate, in units of size
# distance of the critical points of several equations below which they are one: a gap of its square
COINCIDENT_SOLUTION_TOLERANCE = 1e-6
MAX_ROW_COMBINATIONS = 3  # of rows without rank, if their number is kept


@kernel
def find_block_critical_point(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> int:
    """Newton for the critical point next to q in which several rows lose their rank, started by
    :func:`start_block_search`: fills ``work.q_c``, ``work.u`` and in its record time, gap, and the dimension of the
    critical points about it.

    The gap is |Phi~| there, and u its direction if it is not rounding. Return the number of rows that keep their
    rank; 0: no point was found.
    """
    critical, p, before = work.critical[0], work.size.shape[0] + 1, np.inf
    for _ in range(MAX_NEWTON_STEPS):
        eqs.position(critical.t, work.q_c, eqs.data, eqs.terms)
        regular = factor_block(eqs.terms, rank, work)
        if regular in (0, rank):
            return 0
        combine_null_vectors(regular, 0, work)
        off = fill_block_residual(eqs.terms, regular, work)
        if not off < np.inf or not fill_block_hessian(eqs, work):
            return 0
        if has_converged(off, before):
            record_block_point(eqs, p - regular - factor_reduced_hessian(regular, work), work)
            return regular
        before = off
        if not solve_closing_step(regular, work) or not apply_block_step(eqs, solve_block_step(regular, work), work):
            return 0
        if not max_coordinate_distance(q, t, work) < MAX_COORDINATE_DISTANCE:
            return 0
    return 0


@kernel
def find_critical_point_of_rank(eqs: Equations, t: float, q: Reals, regular: int, rank: int, work: Workspace) -> int:
    """As :func:`find_block_critical_point` for a point in which ``regular`` rows keep their rank, independent of its
    neighborhood.
    """
    critical, p, before = work.critical[0], work.size.shape[0] + 1 - regular, np.inf
    for _ in range(MAX_NEWTON_STEPS):
        eqs.position(critical.t, work.q_c, eqs.data, eqs.terms)
        factor_block(eqs.terms, rank, work)
        if not abs(work.E[regular - 1, regular - 1]) > 0.0:
            return 0
        for i in range(p):
            work.z[i] = 0.0
            for k in range(p):
                work.K_work[i, k] = 0.0
        combine_null_vectors(regular, 0, work)
        off = fill_block_residual(eqs.terms, regular, work)
        if not off < np.inf or not solve_closing_step(regular, work):
            return 0
        for combination in range(min(MAX_ROW_COMBINATIONS, rank - regular)):
            combine_null_vectors(regular, combination, work)
            fill_block_residual(eqs.terms, regular, work)
            if not fill_block_hessian(eqs, work):
                return 0
            add_squares(regular, work)
        factor_lq(work.K_work, p, p, work.K_tau, work.K_pivots, work.change)
        for i in range(p):
            work.change[i] = abs(work.K_work[i, i])
        full = rank_at(work.change, p, ZERO_SINGULAR_VALUE_RATIO * ZERO_SINGULAR_VALUE_RATIO)
        if has_converged(off, before):
            record_block_point(eqs, p - full, work)
            return regular
        before = off
        solve_least_norm(work.z, p, full, work.K_work, work.K_tau, work.K_pivots, work.g)
        if (
            not apply_block_step(eqs, assemble_step(regular, work), work)
            or not max_coordinate_distance(q, t, work) < MAX_COORDINATE_DISTANCE
        ):
            return 0
    return 0


@inlined
def has_converged(off: float, before: float) -> bool:
    """Whether the point is found: equations that lose their rank within ALIKE of each other leave a residual."""
    return off < CRITICAL_POINT_TOLERANCE or COINCIDENT_SOLUTION_TOLERANCE > off > 0.5 * before


@kernel
def add_squares(regular: int, work: Workspace) -> None:
    """Add H^T H to work.K_work and H^T r to work.z: H the part of work.K in the directions Q_2, r the residual."""
    p = work.size.shape[0] + 1 - regular
    for i in range(p):
        rest = reduced_residual(i, regular, work)
        for k in range(p):
            work.z[k] += work.K[regular + k, regular + i] * rest
            for other in range(p):
                work.K_work[k, other] += work.K[regular + k, regular + i] * work.K[regular + other, regular + i]


@inlined
def reduced_residual(i: int, regular: int, work: Workspace) -> float:
    """What a step in the directions Q_2 is to change entry i of c^T L_22 by, after the step that closes."""
    rest = -work.g[regular + i]
    for k in range(regular):
        rest -= work.K[k, regular + i] * work.lam[k]
    return rest


@kernel
def start_block_search(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> int:
    """Start the search at q or where the smallest pivot is zero on the line through the last accepted position,
    between the two or beyond one of them: where the gap in the pivots is widest. Return the number of rows that keep
    their rank there, 0: no gap.

    ``terms`` and factors belong to (t, q); terms move.
    """
    critical, widest, best = work.critical[0], 0.0, 0
    critical.t, critical.rate = t, drive_rate(eqs.terms, work)
    known, now, last = work.branch_history[0].is_frame_known == 1, pivot_ratio(work.pivot, rank), 0.0
    if known:
        last = abs(work.frame[rank - 1, rank - 1] / work.frame[0, 0])
    for trial in range(3 if known else 1):
        part = 0.0
        if trial == 1:
            part = -now / max(now + last, 1e-300)
        elif trial == 2:
            part = now / (last - now) if last != now else np.inf
        if abs(part) > MAX_EXTRAPOLATION_STEPS:
            continue
        for i in range(q.shape[0]):
            work.q_try[i] = q[i] + part * (q[i] - work.q_last[i])
        for i in range(work.size.shape[0]):
            work.dq[i] = 0.0
        eqs.retract(work.q_try, work.dq, eqs.data)
        eqs.position(t, work.q_try, eqs.data, eqs.terms)
        regular = factor_block(eqs.terms, rank, work)
        gap = pivot_gap(work.E, regular) if regular > 0 else 0.0
        if gap > widest or trial == 0:
            widest, best = gap, regular
            for i in range(q.shape[0]):
                work.q_c[i] = work.q_try[i]
    return best


@kernel
def factor_block(terms: Terms, rank: int, work: Workspace) -> int:
    """Factor [J~, -nu~] in ``work.E``; return the number of rows that keep their rank, 0 if there is no gap."""
    m, n = terms.J.shape
    for i in range(m):
        for j in range(n):
            work.E[i, j] = terms.J[i, j] * (work.size[j] / work.row[i])
        work.E[i, n] = -terms.nu[i] / (work.row[i] * work.critical[0].rate)
    factor_lq(work.E, m, n + 1, work.E_tau, work.E_pivots, work.x)
    return count_regular(work.E, rank)


@inlined
def count_regular(L: Reals, rank: int) -> int:
    """How many of the first ``rank`` diagonal entries of L come before the largest gap; 0: there is none."""
    widest, regular = MIN_PIVOT_GAP, 0
    for r in range(1, rank):
        gap = pivot_gap(L, r)
        if gap > widest:
            widest, regular = gap, r
    return regular


@inlined
def pivot_gap(L: Reals, r: int) -> float:
    """Ratio of pivots number r and r + 1."""
    return abs(L[r - 1, r - 1]) / max(abs(L[r, r]), PIVOT_FLOOR_RATIO * abs(L[0, 0]))


@inlined
def row_weight(row: int, combination: int) -> float:
    """Entry of c for a row: positive, and no two alike."""
    return 1.0 + 0.5 * np.sin((7.3 + 2.9 * combination) * (row + 1.0))


@inlined
def combine_null_vectors(regular: int, combination: int, work: Workspace) -> None:
    """work.u = U c / |U c|."""
    m = work.u.shape[0]
    for k in range(regular):
        work.x[k] = 0.0
        for i in range(regular, m):
            work.x[k] -= work.E[i, k] * row_weight(work.E_pivots[i], combination)
    for back in range(regular):
        k = regular - 1 - back
        for i in range(k + 1, regular):
            work.x[k] -= work.E[i, k] * work.x[i]
        work.x[k] /= work.E[k, k]
    square = 0.0
    for i in range(m):
        entry = work.x[i] if i < regular else row_weight(work.E_pivots[i], combination)
        work.u[work.E_pivots[i]] = entry
        square += entry * entry
    for i in range(m):
        work.u[i] /= np.sqrt(square)


@kernel
def fill_block_residual(terms: Terms, regular: int, work: Workspace) -> float:
    """Fill work.g = Q^T [J~, -nu~]^T u and work.b = L_1^T Phi~, which must be zero; return the largest entry,
    of L_22 all entries, of b a multiple, as the gap has the digits of Phi~.
    """
    m, n = terms.J.shape
    off = 0.0
    for k in range(n + 1):
        work.g[k] = 0.0
        for i in range(max(k, regular), m):
            work.g[k] += work.u[work.E_pivots[i]] * work.E[i, k] if k >= regular else 0.0
            if k >= regular:
                off = max(off, abs(work.E[i, k]))
    for k in range(regular):
        work.b[k] = 0.0
        for i in range(k, m):
            row = work.E_pivots[i]
            work.b[k] += work.E[i, k] * terms.Phi[row] / work.row[row]
        off = max(off, CLOSURE_WEIGHT * abs(work.b[k]))
    return off


@kernel
def fill_block_hessian(eqs: Equations, work: Workspace) -> bool:
    """work.K (n + 1, n + 1) = Q^T H Q, H the derivative of [J~, -nu~]^T u by q and t with u fixed, by differences."""
    m, n = eqs.terms.J.shape
    critical, timed = work.critical[0], is_rheonomic(eqs.terms)
    fill_transposed_product(eqs.terms, work, work.change)
    for k in range(n + 1):
        if k == n and not timed:
            for i in range(n + 1):
                work.K[k, i] = 0.0
            continue
        for i in range(work.q_c.shape[0]):
            work.q_try[i] = work.q_c[i]
        for i in range(n):
            work.dq[i] = CRITICAL_DIFFERENCE_STEP * work.size[i] if i == k else 0.0
        eqs.retract(work.q_try, work.dq, eqs.data)
        eqs.position(
            critical.t + (CRITICAL_DIFFERENCE_STEP / critical.rate if k == n else 0.0), work.q_try, eqs.data, eqs.terms
        )
        fill_transposed_product(eqs.terms, work, work.g_try)
        for i in range(n + 1):
            work.K[k, i] = (work.g_try[i] - work.change[i]) / CRITICAL_DIFFERENCE_STEP
            if not np.isfinite(work.K[k, i]):
                return False
    for k in range(n + 1):
        apply_Qt(work.E, work.E_tau, min(m, n + 1), n + 1, work.K[k])
    for i in range(n + 1):
        for k in range(n + 1):
            work.g_try[k] = work.K[k, i]
        apply_Qt(work.E, work.E_tau, min(m, n + 1), n + 1, work.g_try)
        for k in range(n + 1):
            work.K[k, i] = work.g_try[k]
    eqs.position(critical.t, work.q_c, eqs.data, eqs.terms)
    return True


@inlined
def fill_transposed_product(terms: Terms, work: Workspace, f: Reals) -> None:
    """f[:n + 1] = [J~, -nu~]^T u."""
    m, n = terms.J.shape
    for j in range(n + 1):
        f[j] = 0.0
    for i in range(m):
        scaled = work.u[i] / work.row[i]
        for j in range(n):
            f[j] += scaled * terms.J[i, j] * work.size[j]
        f[n] -= scaled * terms.nu[i] / work.critical[0].rate


@kernel
def factor_reduced_hessian(regular: int, work: Workspace) -> int:
    """Factor the part of work.K in the directions Q_2 in ``work.K_work``; return its rank."""
    p = work.size.shape[0] + 1 - regular
    for i in range(p):
        for k in range(p):
            work.K_work[i, k] = work.K[regular + k, regular + i]
    factor_lq(work.K_work, p, p, work.K_tau, work.K_pivots, work.change)
    for i in range(p):
        work.change[i] = abs(work.K_work[i, i])
    return rank_at(work.change, p, ZERO_SINGULAR_VALUE_RATIO)


@kernel
def solve_closing_step(regular: int, work: Workspace) -> bool:
    """work.lam[:regular] = the shortest step that closes the regular rows."""
    m = work.row.shape[0]
    for i in range(regular):
        for k in range(i + 1):
            work.B[i, k] = 0.0
            for row in range(i, m):
                work.B[i, k] += work.E[row, i] * work.E[row, k]
        work.lam[i] = -work.b[i]
    return solve_positive_definite(work.B, regular, work.lam)


@kernel
def solve_block_step(regular: int, work: Workspace) -> float:
    """work.change[:n + 1] = Newton's step in q and t: the shortest that closes the regular rows, and in the
    directions Q_2 that for c^T L_22 = 0. Return its largest entry.
    """
    p = work.size.shape[0] + 1 - regular
    full = factor_reduced_hessian(regular, work)
    for i in range(p):
        work.g_try[i] = reduced_residual(i, regular, work)
    solve_least_norm(work.g_try, p, full, work.K_work, work.K_tau, work.K_pivots, work.g)
    return assemble_step(regular, work)


@kernel
def assemble_step(regular: int, work: Workspace) -> float:
    """work.change[:n + 1] = the step in q and t from its parts work.lam and work.g; return its largest entry."""
    n, m, largest = work.size.shape[0], work.row.shape[0], 0.0
    for i in range(n + 1):
        work.change[i] = work.lam[i] if i < regular else work.g[i - regular]
    apply_Q(work.E, work.E_tau, min(m, n + 1), n + 1, work.change)
    for i in range(n + 1):
        if not np.isfinite(work.change[i]):
            return np.inf
        largest = max(largest, abs(work.change[i]))
    return largest


@kernel
def apply_block_step(eqs: Equations, largest: float, work: Workspace) -> bool:
    """Apply Newton's step, or a part of it; False if it is not finite."""
    n = work.size.shape[0]
    if not largest < np.inf:
        return False
    part = min(1.0, MAX_SEARCH_STEP / max(largest, 1e-300))
    for i in range(n):
        work.dq[i] = part * work.change[i] * work.size[i]
    eqs.retract(work.q_c, work.dq, eqs.data)
    change: Any = work.change[n]
    work.critical[0].t += part * change / work.critical[0].rate
    return True


@inlined
def max_coordinate_distance(q: Reals, t: float, work: Workspace) -> float:
    """Largest distance of any coordinate from (t, q), in units of size."""
    far = abs(work.critical[0].t - t) * work.rate[0]
    for i in range(q.shape[0]):
        far = max(far, abs(work.q_c[i] - q[i]) / work.size_q[i])
    return far


@kernel
def record_block_point(eqs: Equations, spread: int, work: Workspace) -> None:
    """Record gap, left null vector and dimension of the point found, with its ``terms``."""
    critical = work.critical[0]
    critical.set_dimension = spread
    for i in range(work.row.shape[0]):
        work.b[i] = eqs.terms.Phi[i] / work.row[i]
    critical.bifurcation_gap = length(work.b)
    if critical.bifurcation_gap > CRITICAL_POINT_TOLERANCE:
        for i in range(work.row.shape[0]):
            work.u[i] = work.b[i] / critical.bifurcation_gap
