"""Steady states of a mechanism with dense matrices; see :mod:`.newton`.

The Jacobian K is exact: the recursions run on complex numbers, and a perturbation i e of one coordinate leaves the
derivative in the imaginary part, with no difference that could cancel (Squire and Trapp 1998). So the system given is
the complex twin of a mechanism's. Corrections of coordinates are in units of their size, residuals of constraints in
units of the rows, and forces, multipliers among them, in what makes the largest entry of the stiffness one.

K may be singular for a harmless reason: a coordinate on which nothing depends, such as the angle of a free spindle.
K is eliminated with full pivoting and what is left undetermined stays where it was; a force that nothing can balance
is left over, and then there is no steady state.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.dense import factor_full_pivot, solve_full_pivot
from solvers.linalg.svd import decompose, pseudo_inverse_transposed
from solvers.system import Array, Equations, System

from .newton import (
    ASTRAY,
    CONVERGED,
    FARTHEST,
    FOUND,
    ITERATIONS,
    LEAST_DAMPING,
    NO_PROGRESS,
    NOT_FINITE,
    SINGULAR,
    UNDETERMINED,
    EquilibriumSolver,
    Outcome,
    Unknowns,
)

EPSILON = 1e-30  # of the complex step; its square must be negligible
PIVOT = 1e-12  # pivot of K relative to the first, below which an unknown is undetermined
BALANCED, FLOOR = 1e-9, 1e-13  # residual left by the last correction: of what acts in its row, and of the stiffest
SINGULAR_POSITION = 1e-7  # a singular value of J~ below which cut-joint forces are not determined, relative to the
# largest in a generic position: in a singular one they may all be zero
NULL = 1e-10  # singular value of K relative to the largest, below which its direction is null
INDEPENDENT = 1e-8  # relative pivot of an independent constraint


class Scratch(NamedTuple):
    """Allocated once. N = n + rank unknowns."""

    size: Array  # (n,) units of the coordinates
    row: Array  # (rank,) units of the independent constraints
    largest: Array  # (1,) singular value of J~ in general position
    q: NDArray[Any]  # (nq,) complex: perturbed position
    v: NDArray[Any]  # (n,)  complex: velocity of the steady motion
    dq: NDArray[Any]  # (n,)  complex: perturbation
    q_try: Array  # (nq,)
    lam_try: Array  # (rank,)
    moved: Array  # (n,) since a pseudo-transient step began
    moved_try: Array  # (n,)
    f: Array  # (N,)   residuals
    K: Array  # (N, N) df/dz
    z: Array  # (N,)   correction
    z_next: Array  # (N,)
    LU: Array  # (N, N) factors of K, fully pivoted
    order: NDArray[np.int64]  # (N,) of its rows
    columns: NDArray[np.int64]  # (N,)
    rank: NDArray[np.int64]  # (1,)
    J: Array  # (rank, n) the independent rows of J = Phi_q, in units
    A: Array  # (n, rank) scratch of its decomposition
    pivots: NDArray[np.int64]  # (rank,)
    U: Array  # (n, n)
    sigma: Array  # (rank,)
    W: Array  # (rank, rank)

    @staticmethod
    def allocate(nq: int, size: Array, row: Array) -> Scratch:
        """Return zeroed scratch for this number of positions and these units of coordinates and constraints."""
        n, rank, z = len(size), len(row), np.zeros
        N = n + rank
        return Scratch(
            size, row, np.ones(1), z(nq, complex), z(n, complex), z(n, complex), z(nq), z(rank), z(n), z(n), z(N),
            z((N, N)), z(N), z(N), z((N, N)), z(N, np.int64), z(N, np.int64), z(1, np.int64), z((rank, n)),
            z((n, rank)), z(rank, np.int64), z((n, n)), z(rank), z((rank, rank)),
        )  # fmt: skip


@kernel
def linearize(
    eqs: Any, t: float, q: Any, lam: Any, moved: Any, rows: Any, c2: float, mass: float, scale: float, s: Any
) -> None:
    """s.f and s.K at (q, lam), c2 M moved among the forces; one evaluation a coordinate. ``scale`` is an energy.

    In K the mass matrix is taken ``mass`` times.
    """
    n, rank, terms = s.v.shape[0], rows.shape[0], eqs.terms
    for k in range(n):
        for i in range(q.shape[0]):
            s.q[i] = q[i]
        for i in range(n):
            s.dq[i] = 0.0
        s.dq[k] = EPSILON * 1j
        eqs.retract(s.q, s.dq, eqs.data)
        eqs.dynamics(t, s.q, s.v, eqs.data, terms)
        for i in range(n):
            balance = terms.h[i]
            for r in range(rank):
                balance += terms.J[rows[r], i] * lam[r]
            if mass != 0.0:
                for j in range(n):
                    balance += terms.M[i, j] * (c2 * moved[j] + mass * s.dq[j])
            s.f[i] = balance.real * s.size[i] / scale
            s.K[i, k] = balance.imag / EPSILON * s.size[i] * s.size[k] / scale
        for r in range(rank):
            s.f[n + r] = terms.Phi[rows[r]].real / s.row[r]
            s.K[n + r, k] = terms.Phi[rows[r]].imag / EPSILON * s.size[k] / s.row[r]
    for r in range(rank):
        for i in range(n):
            s.K[i, n + r] = terms.J[rows[r], i].real * s.size[i] / s.row[r]
        for other in range(rank):
            s.K[n + other, n + r] = 0.0


@kernel
def correction(s: Any, z: Any) -> float:
    """z with K z = -f by the factors at hand; return the length of its coordinates, which multipliers follow."""
    N, square = z.shape[0], 0.0
    solve_full_pivot(s.LU, N, s.rank[0], s.order, s.columns, s.f, z)
    for i in range(N):
        z[i] = -z[i]
    for i in range(s.v.shape[0]):
        square += z[i] * z[i]
    return np.sqrt(square)


@kernel
def balanced(lam: Any, scale: float, s: Any) -> bool:
    """Whether s.f is small against what s.K and the multipliers do in each row; where they do nothing, zero."""
    n, N = s.v.shape[0], s.f.shape[0]
    for i in range(N):
        acts = 0.0 if i < n else 1.0
        for k in range(N):
            if i < n and k < n:
                acts += abs(s.K[i, k])
            elif i < n:
                acts += abs(s.K[i, k] * lam[k - n] * s.row[k - n] / scale)
        if abs(s.f[i]) > BALANCED * acts + FLOOR:
            return False
    return True


@kernel
def stiffness(s: Any) -> float:
    """Largest entry of the force rows of K, or 1."""
    n, largest = s.v.shape[0], 0.0
    for i in range(n):
        for k in range(n):
            largest = max(largest, abs(s.K[i, k]))
    return largest if largest > 0.0 and np.isfinite(largest) else 1.0


@kernel
def move(eqs: Any, q: Any, lam: Any, damping: float, scale: float, s: Any) -> None:
    """s.q_try, s.lam_try, s.moved_try = (q, lam) and s.moved, changed by ``damping`` times the correction s.z."""
    n = s.v.shape[0]
    for i in range(q.shape[0]):
        s.q[i] = q[i]
    for i in range(n):
        step = damping * s.size[i] * s.z[i]
        s.dq[i], s.moved_try[i] = step, s.moved[i] + step
    eqs.retract(s.q, s.dq, eqs.data)
    for i in range(q.shape[0]):
        s.q_try[i] = s.q[i].real
    for r in range(lam.shape[0]):
        s.lam_try[r] = lam[r] + damping * scale / s.row[r] * s.z[n + r]


@kernel
def take(q: Any, lam: Any, s: Any) -> None:
    """Accept the trial state."""
    for i in range(q.shape[0]):
        q[i] = s.q_try[i]
    for r in range(lam.shape[0]):
        lam[r] = s.lam_try[r]
    for i in range(s.moved.shape[0]):
        s.moved[i] = s.moved_try[i]


@kernel
def factor(s: Any) -> bool:
    """Eliminate K; False where it or f is not finite."""
    N = s.z.shape[0]
    for i in range(N):
        if not np.isfinite(s.f[i]):
            return False
        for j in range(N):
            if not np.isfinite(s.K[i, j]):
                return False
            s.LU[i, j] = s.K[i, j]
    s.rank[0] = factor_full_pivot(s.LU, N, N, PIVOT, s.order, s.columns)
    return True


@kernel
def evaluate(eqs: Any, t: float, q: Any, v: Any) -> None:
    """The terms at (t, q, v), called from Python."""
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)


@kernel
def constraint_forces(rows: Any, terms: Any, s: Any, lam: Any) -> bool:
    """lam (rank,): multipliers of least residual with the ``terms`` at hand; return whether J~ has its full rank."""
    n, rank = s.v.shape[0], rows.shape[0]
    for r in range(rank):
        for i in range(n):
            s.J[r, i] = terms.J[rows[r], i].real * s.size[i] / s.row[r]
    decompose(s.J, rank, n, s.A, s.pivots, s.U, s.sigma, s.W)
    for i in range(n):
        s.f[i] = -terms.h[i].real * s.size[i]
    count = 0
    while count < rank and s.sigma[count] > SINGULAR_POSITION * s.largest[0]:
        count += 1
    pseudo_inverse_transposed(s.f, rank, n, count, s.U, s.sigma, s.W, lam)
    for r in range(rank):
        lam[r] /= s.row[r]
    return count == rank


@kernel
def newton(eqs: Any, t: float, q: Any, lam: Any, rows: Any, c2: float, mass: float, s: Any, report: Any) -> int:
    """Solve f = 0 from (q, lam), in place, or a pseudo-transient step; report: Jacobians factored."""
    n = s.v.shape[0]
    for i in range(n):
        s.moved[i] = 0.0
    linearize(eqs, t, q, lam, s.moved, rows, c2, mass, 1.0, s)
    scale = stiffness(s)
    for i in range(n):
        s.f[i] /= scale
        for k in range(n):
            s.K[i, k] /= scale
    damping, first = 1.0, True
    for _ in range(ITERATIONS):
        report[0] += 1.0
        if not factor(s):
            return NOT_FINITE
        size = correction(s, s.z)
        if size <= CONVERGED:
            move(eqs, q, lam, 1.0, scale, s)
            take(q, lam, s)
            linearize(eqs, t, q, lam, s.moved, rows, c2, mass, scale, s)
            if not balanced(lam, scale, s):
                return SINGULAR
            return FOUND if constraint_forces(rows, eqs.terms, s, s.lam_try) else UNDETERMINED
        if first:  # what is farther may be another state
            damping, first = min(1.0, FARTHEST / size), False
        while True:
            move(eqs, q, lam, damping, scale, s)
            linearize(eqs, t, s.q_try, s.lam_try, s.moved_try, rows, c2, mass, scale, s)
            after = correction(s, s.z_next)
            if after <= (1.0 - 0.25 * damping) * size:
                break
            damping *= 0.5
            if damping < LEAST_DAMPING:
                return NO_PROGRESS
        take(q, lam, s)
        damping = min(1.0, 2.0 * damping)
    return NO_PROGRESS


class DenseEquilibriumSolver(EquilibriumSolver):
    """Newton for one mechanism.

    Parameters
    ----------
    system
        The complex twin of a mechanism's system.
    q
        A closed position (nq,) in general position, where the independent constraints are separated from redundant
        ones. If a row is zero there too, the mechanism cannot leave a singular configuration.
    v
        Velocities (n,) of the steady motion: zero but for cyclic coordinates.
    """

    def __init__(self, system: System, t: float, q: Array, v: Array) -> None:
        super().__init__(system)
        self.system = system
        self._terms = system.allocate_terms(complex)
        self._eqs = Equations.of(system, self._terms)
        self.rows = self._independent(t, q)
        scratch = Scratch.allocate(system.nq, system.size, system.row_size[self.rows])
        scratch.v[:] = v
        scaled = self._terms.J.real[self.rows] * system.size / scratch.row[:, np.newaxis]
        scratch.largest[:] = np.linalg.norm(scaled, 2) if scaled.size else 1.0
        self._v, self._lam, self._moved, self._K = scratch.v, scratch.lam_try, scratch.moved, scratch.K
        self._scratch, self._held_terms = pin(scratch), pin(self._terms)

    def _independent(self, t: float, q: Array) -> NDArray[np.int64]:
        n, m = self.system.n, self.system.m
        self.system.fill(t, q.astype(complex), np.zeros(n, complex), self._terms)
        rows, columns = np.zeros(m, np.int64), np.zeros(n, np.int64)
        scaled = self._terms.J.real * self.system.size / self.system.row_size[:, np.newaxis]
        self._stuck = bool((np.abs(scaled).max(axis=1, initial=0.0) < SINGULAR_POSITION).any())
        rank = factor_full_pivot(scaled, m, n, INDEPENDENT, rows, columns)
        return np.sort(rows[:rank])

    def run_trial(self, q: Array) -> None:
        """See the base."""
        self.solve(0.0, q)

    def residual(self, t: float, q: Array, lam: Array) -> tuple[Array, Array]:
        """See the base."""
        T = self._terms
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return T.h.real + T.J.real.T @ lam, T.Phi.real.copy()

    def jacobian(self, t: float, q: Array, lam: Array) -> Array:
        """Return K (N, N) at q and the multipliers of ``rows``, in units; forces in J, and so are multipliers."""
        self._moved[:] = 0.0
        linearize(self._eqs, t, q, lam, self._moved, self.rows, 0.0, 0.0, 1.0, self._scratch)
        return self._K.copy()

    def count_null_directions(self, q: Array, lam: Array, coordinates: NDArray[np.int64]) -> int:
        """Return in how many directions, by which these coordinates (numbers) change, K of a steady state is null."""
        K, n = self.jacobian(0.0, q, lam[self.rows]), self.system.n
        K[:n, :n] /= float(np.abs(K[:n, :n]).max(initial=0.0)) or 1.0
        if not np.isfinite(K).all():
            return 0
        sigma, Vt = np.linalg.svd(K)[1:]
        null = Vt[sigma <= NULL * sigma.max(initial=0.0)][:, coordinates]
        return int(np.linalg.matrix_rank(null, tol=np.sqrt(NULL))) if null.size else 0

    def singular(self, t: float, q: Array) -> bool:
        """See the base."""
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return self._stuck or not constraint_forces(self.rows, self._held_terms, self._scratch, self._lam)

    def _balancing(self, t: float, q: Array) -> Array:
        """Return those that leave the least residual force."""
        evaluate(self._eqs, t, q.astype(complex), self._v)
        lam = np.zeros(len(self.rows))
        constraint_forces(self.rows, self._held_terms, self._scratch, lam)
        return lam

    def _accelerate(self, t: float, q: Array) -> Array:
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return np.asarray(np.linalg.lstsq(self._terms.M.real, -self._terms.h.real, rcond=None)[0], float)

    def _newton(self, t: float, at: Unknowns, c2: float, mass: float) -> tuple[Outcome, Unknowns, Array, int]:
        found, report = Unknowns(at.q.copy(), at.lam.copy()), np.zeros(1)
        outcome = Outcome(newton(self._eqs, t, *found, self.rows, c2, mass, self._scratch, report))
        return outcome, found, self._moved.copy(), int(report[0])

    def _strayed(self, moved: Array) -> bool:
        return bool(np.abs(moved / self._size).max(initial=0.0) > ASTRAY)

    def _all(self, lam: Array) -> Array:
        full = np.zeros(self.system.m)
        full[self.rows] = lam
        return full
