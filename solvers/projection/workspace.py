"""Scratch of the partitions, and the factors of the constraint Jacobian in the mechanism's own units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, Table, f8, i8
from solvers.inertia import InertiaRecord
from solvers.linalg.dense import factor_lq
from solvers.positions import place_states
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.system import Equations, Terms


class CriticalRecord(Record):
    """A singular configuration that lies ahead or behind."""

    kind: i8  # what the critical point q_c is: solvers.projection.singular.NO_CRITICAL_POINT, BIFURCATION or IMPERFECT
    lost: i8  # number of independent rows that lose their rank there
    set_dimension: i8
    slope: f8  # of the ratio of the pivots by the distance, where it was found; 1 for one row
    bifurcation_gap: f8  # distance of the loop from one that crosses, in units of the rows
    t: f8  # when the drives get there, s
    rate: f8  # 1/s, unit of time of the search
    is_passed: i8  # 1: a step has gone through it
    failed_search_ratio: f8  # ratio of the pivots at the last search that failed


class BranchHistoryRecord(Record):
    """How the loops have moved lately, from which their branch is known."""

    is_frame_known: i8  # is the frame determined
    pivot_ratio: f8  # of the pivots in the last position
    decrease_rate: f8  # 1/s, of it in the last step
    step: f8  # s, that step
    time_to_singular: f8  # s, when it would be zero, or stop, if it continues to decrease


class Workspace(NamedTuple):
    """Units, scratch, and history of the branch; allocated once.

    But for :meth:`memory` nothing in it outlives a call except the factors of the last J.
    """

    size: Array  # (n,)    units of the coordinates
    size_q: Array  # (nq,)   units of the positions
    row: Array  # (m,)    units of the constraints
    in_loops: Array  # (n,)    1 for coordinates that occur in constraints, 0 for others
    states: NDArray[np.int64]  # (k,)    places of first-order states in v: the last ones
    nonholonomic: NDArray[np.int64]  # (k,)    constraints that restrict velocities only: their Phi is zero
    rate: Array  # (2,)    1/s, of the motion, and of the loops' part in it: unit of size a second
    coordinate_rates: Array  # (n,)    1/s, of every coordinate's own part in it; of a first-order state 1
    A: Array  # (m, n)  L, and the reflectors of Q, of J~[pivots] = L Q^T
    tau: Array  # (m,)    of the reflectors
    pivots: NDArray[np.int64]  # (m,)    order of the rows, independent ones first, int64
    pivot: Array  # (m,)    |L_kk|, zero beyond min(m, n)
    T: Array  # (n, n)  rows span the allowed motions, first n - rank
    directions: Array  # (n, n)  allowed motions at the start
    mass: Array  # (n, n)  P^T M P
    momentum: Array  # (1, n)  M times an allowed motion
    f: Array  # (n,)    residual force
    z: Array  # (n,)    reduced acceleration
    b: Array  # (m,)    residual
    dq: Array  # (n,)    correction
    a: Array  # (n,)    acceleration at a neighboring position
    slope: Array  # (n,)    acceleration under evaluation
    q: Array  # (nq,)   position under evaluation
    v: Array  # (n,)    velocity under evaluation
    q_near: Array  # (nq,)   neighboring position
    v_near: Array  # (n,)    neighboring velocity
    B: Array  # (m, m)  factors of L^T
    tau_B: Array  # (m,)
    pivots_B: NDArray[np.int64]  # (m,)  int64
    J_work: Array  # (m, n)  J being eliminated
    D: Array  # (m, m)  dependent columns of J, then their LU factors
    order: NDArray[np.int64]  # (max(m, n),)  row exchanges of D or of mass, int64
    x: Array  # (m,)    solution with D
    lam: Array  # (m,)    multipliers
    rows: NDArray[np.int64]  # (m,)    candidate choice of rows, int64
    columns: NDArray[np.int64]  # (n,)    candidate choice of coordinates, dependent ones first, int64
    critical: Table[CriticalRecord]  # (1,)
    q_c: Array  # (nq,)   critical point
    q_try: Array  # (nq,)   perturbed position
    u: Array  # (m,)    left null vector there
    K: Array  # (N, N)  matrix of its equations, N = n + m + 2
    K_work: Array  # (N, N)  its factors, or those of its square
    K_tau: Array  # (N,)
    K_pivots: NDArray[np.int64]  # (N,)  int64
    g: Array  # (N,)    residual of its equations
    g_try: Array  # (N,)    perturbed residual
    change: Array  # (N,)
    E: Array  # (m, n + 1)  factors of [J~, -nu~], see solvers.projection.block
    E_tau: Array  # (m,)
    E_pivots: NDArray[np.int64]  # (m,)  int64
    C: Array  # (m, n)  factors of J~ at the critical point
    C_work: Array  # (m, n)  J~ where it is compared
    C_tau: Array  # (m,)
    C_pivots: NDArray[np.int64]  # (m,)  int64
    J_last: Array  # (m, n)  J~ in the last good position
    slopes: Array  # (m, n)  its part that is zero in the critical point
    branch_history: Table[BranchHistoryRecord]  # (1,)    the last accepted position
    frame: Array  # (m, n)  factors of J~ there, see solvers.projection.singular
    frame_tau: Array  # (m,)
    frame_pivots: NDArray[np.int64]  # (m,)  int64
    q_last: Array  # (nq,)   the position itself
    nu_last: Array  # (m,)    what the drives did there, in units of the rows
    inertia: Table[InertiaRecord]  # (1,)    how nearly singular the mass matrix is

    @staticmethod
    def allocate(nq: int, n: int, m: int, states: int = 0, nonholonomic: NDArray[np.int64] | None = None) -> Workspace:
        """Return zeroed scratch for ``nq`` positions, ``n`` velocities, the last ``states`` of which are first-order
        states, and ``m`` constraints, units of one; ``nonholonomic`` (k,) are those that restrict velocities only.
        """
        rows_of_velocities = np.zeros(0, np.int64) if nonholonomic is None else nonholonomic.copy()
        z, one = np.zeros, np.ones
        N = n + m + 2 if m else 0
        pivots, pivots_B, order, rows, columns, K_pivots, frame_pivots, E_pivots, C_pivots = (
            np.zeros(k, np.int64) for k in (m, m, max(m, n), m, n, N, m, m, m)
        )
        return Workspace(
            one(n), one(nq), one(m), one(n), place_states(n, states), rows_of_velocities, one(2), one(n),
            z((m, n)), z(m), pivots, z(m), z((n, n)), z((n, n)),
            z((n, n)), z((1, n)), z(n), z(n), z(m), z(n), z(n), z(n), z(nq), z(n), z(nq), z(n), z((m, m)), z(m),
            pivots_B, z((m, n)), z((m, m)), order, z(m), z(m), rows, columns,
            CriticalRecord.zeros(1), z(nq), z(nq), z(m),
            z((N, N)), z((N, N)), z(N), K_pivots, z(N), z(N), z(N), z((m, n + 1)), z(m),
            E_pivots, z((m, n)), z((m, n)), z(m), C_pivots, z((m, n)), z((m, n)), BranchHistoryRecord.zeros(1),
            z((m, n)), z(m), frame_pivots, z(nq), z(m), InertiaRecord.zeros(1),
        )  # fmt: skip

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that a motion cannot go on without."""
        known = (self.row, self.in_loops, self.rate, self.coordinate_rates, self.critical, self.q_c, self.u)
        point = (self.C, self.C_tau, self.C_pivots, self.J_last)
        frame = (self.frame, self.frame_tau, self.frame_pivots)
        return [*known, *point, self.branch_history, *frame, self.q_last, self.nu_last, self.inertia]


@inlined
def count_motions(work: Workspace) -> int:
    """Number of velocities that are not first-order states: the first ones."""
    return work.size.shape[0] - work.states.shape[0]


@inlined
def count_freedom(rank: int, work: Workspace) -> int:
    """Number of degrees of freedom with this rank of the constraints: first-order states are none."""
    return count_motions(work) - rank


@kernel
def factor(terms: Terms, work: Workspace) -> None:
    """Factor the Jacobian held by ``terms``, in units of rows and coordinates."""
    m, n = terms.J.shape[0], count_motions(work)  # no constraint contains a first-order state: zero in J and A
    for i in range(m):
        for j in range(n):
            work.A[i, j] = terms.J[i, j] * (work.size[j] / work.row[i])
    factor_lq(work.A, m, n, work.tau, work.pivots, work.pivot)
    for i in range(m):
        work.pivot[i] = abs(work.A[i, i]) if i < n else 0.0


@inlined
def factor_transposed(m: int, rank: int, work: Workspace) -> None:
    """Factor L^T (rank, m), its columns in the order of the constraints, from the factors of J~."""
    for k in range(rank):
        for i in range(m):
            work.B[k, work.pivots[i]] = work.A[i, k] if i >= k else 0.0
    factor_lq(work.B, rank, m, work.tau_B, work.pivots_B, work.x)


@kernel
def evaluate_and_factor(eqs: Equations, t: float, q: Reals, v: Reals, work: Workspace) -> None:
    """Fill ``terms`` at (t, q, v) and factor their J."""
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)
    factor(eqs.terms, work)


@inlined
def scaled_norm(x: Reals, work: Workspace) -> float:
    """|x|, x (n,) a change of the coordinates in units of their size."""
    square = 0.0
    for i in range(count_motions(work)):
        square += (x[i] / work.size[i]) ** 2
    return np.sqrt(square)


@inlined
def loop_speed(v: Reals, work: Workspace) -> float:
    """|v| of the coordinates that occur in constraints, in units of their size a second."""
    square = 0.0
    for i in range(v.shape[0]):
        square += (work.in_loops[i] * v[i] / work.size[i]) ** 2
    return np.sqrt(square)


@inlined
def distance(q: Reals, other: Reals, work: Workspace) -> float:
    """Distance of two positions (nq,) in units of size."""
    square = 0.0
    for i in range(q.shape[0]):
        square += ((q[i] - other[i]) / work.size_q[i]) ** 2
    return np.sqrt(square)
