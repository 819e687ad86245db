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

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.template import specialize
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.dense import factor_full_pivot, solve_full_pivot
from solvers.linalg.svd import decompose, pseudo_inverse_transposed
from solvers.projection.products import PRODUCT_STEP_SIZE
from solvers.system import Array, Equations, System

from .newton import (
    EQUILIBRIUM_NEWTON_TOLERANCE,
    FOUND,
    MAX_EQUILIBRIUM_ITERATIONS,
    MAX_FIRST_STEP,
    MAX_STATE_DISTANCE,
    MIN_DAMPING,
    NO_PROGRESS,
    NOT_FINITE,
    SINGULAR,
    UNDETERMINED,
    EquilibriumSolver,
    Outcome,
    Unknowns,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals
    from solvers.system import Terms

UNDETERMINED_PIVOT_RATIO = 1e-12  # pivot of K relative to the first, below which an unknown is undetermined
# residual left by the last correction: of what acts in its row, and of the stiffest
BALANCE_TOLERANCE, BALANCE_FLOOR = 1e-9, 1e-13
SINGULAR_VALUE_RATIO = 1e-7  # a singular value of J~ below which cut-joint forces are not determined, relative to the
# largest in a generic position: in a singular one they may all be zero
NULL_SINGULAR_RATIO = 1e-10  # singular value of K relative to the largest, below which its direction is null
INDEPENDENT_PIVOT_RATIO = 1e-8  # relative pivot of an independent constraint


class NewtonScratch(NamedTuple):
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
    ahead: Array  # (N,) f at a neighbor, for differences; else empty
    cyclic: NDArray[np.int64]  # (n,) 1: all differences along the coordinate are zero; else empty
    nonholonomic: NDArray[np.int64]  # (k,) places of nonholonomic rows among the independent ones
    # of first-order states that are positions, see :mod:`.differences`; else empty
    weights: Array  # (k,) of their equations
    holding: Array  # (k,) weights of z - z0 = 0 for those that keep their start value; zero: others
    held_values: Array  # (k,) z0

    @staticmethod
    def allocate(nq: int, size: Array, row: Array, nonholonomic: NDArray[np.int64] | None = None) -> NewtonScratch:
        """Return zeroed scratch for this number of positions, these units of coordinates and constraints, and places
        (k,) of nonholonomic constraints.
        """
        rows = np.zeros(0, np.int64) if nonholonomic is None else nonholonomic
        n, rank, z = len(size), len(row), np.zeros
        N = n + rank
        return NewtonScratch(
            size, row, np.ones(1), z(nq, complex), z(n, complex), z(n, complex), z(nq), z(rank), z(n), z(n), z(N),
            z((N, N)), z(N), z(N), z((N, N)), z(N, np.int64), z(N, np.int64), z(1, np.int64), z((rank, n)),
            z((n, rank)), z(rank, np.int64), z((n, n)), z(rank), z((rank, rank)), z(0), z(0, np.int64),
            rows, z(0), z(0), z(0),
        )  # fmt: skip


@kernel
def balance_nonholonomic(terms: Terms, r: int, rows: Integers, k: int, scratch: NewtonScratch) -> None:
    """Row n + r of s.f, and its entry of coordinate k of s.K, from the ``terms`` of its perturbation.

    If the mechanism is in motion, J v = nu. At rest this holds everywhere: positions change as the constraint allows.
    """
    n, speed = scratch.v.shape[0], 0.0
    opening = -terms.nu[rows[r]]
    for j in range(n):
        speed = max(speed, abs(scratch.v[j].real) / scratch.size[j])
        opening += terms.J[rows[r], j] * scratch.v[j]
    if speed > 0.0:
        unit = speed * scratch.row[r]
        scratch.f[n + r] = opening.real / unit
        scratch.K[n + r, k] = opening.imag / PRODUCT_STEP_SIZE * scratch.size[k] / unit
    else:
        scratch.f[n + r] = 0.0
        scratch.K[n + r, k] = terms.J[rows[r], k].real * scratch.size[k] / scratch.row[r]


@kernel
def linearize(
    eqs: Equations,
    t: float,
    q: Reals,
    lam: Reals,
    moved: Any,
    rows: Integers,
    c2: float,
    mass: float,
    scale: float,
    scratch: NewtonScratch,
) -> None:
    """s.f and s.K at (q, lam), c2 M moved among the forces; one evaluation a coordinate. ``scale`` is an energy.

    In K the mass matrix is taken ``mass`` times.
    """
    n, rank, terms = scratch.v.shape[0], rows.shape[0], eqs.terms
    for k in range(n):
        for i in range(q.shape[0]):
            scratch.q[i] = q[i]
        for i in range(n):
            scratch.dq[i] = 0.0
        scratch.dq[k] = PRODUCT_STEP_SIZE * 1j
        eqs.retract(scratch.q, scratch.dq, eqs.data)
        eqs.dynamics(t, scratch.q, scratch.v, eqs.data, terms)
        for i in range(n):
            balance = terms.h[i]
            for r in range(rank):
                balance += terms.J[rows[r], i] * lam[r]
            if mass != 0.0:
                for j in range(n):
                    balance += terms.M[i, j] * (c2 * moved[j] + mass * scratch.dq[j])
            scratch.f[i] = balance.real * scratch.size[i] / scale
            scratch.K[i, k] = balance.imag / PRODUCT_STEP_SIZE * scratch.size[i] * scratch.size[k] / scale
        for r in range(rank):
            scratch.f[n + r] = terms.Phi[rows[r]].real / scratch.row[r]
            scratch.K[n + r, k] = terms.Phi[rows[r]].imag / PRODUCT_STEP_SIZE * scratch.size[k] / scratch.row[r]
        for i in range(scratch.nonholonomic.shape[0]):
            balance_nonholonomic(terms, scratch.nonholonomic[i], rows, k, scratch)
    for r in range(rank):
        for i in range(n):
            scratch.K[i, n + r] = terms.J[rows[r], i].real * scratch.size[i] / scratch.row[r]
        for other in range(rank):
            scratch.K[n + other, n + r] = 0.0


@kernel
def solve_correction(scratch: NewtonScratch, z: Reals) -> float:
    """z with K z = -f by the factors at hand; return the length of its coordinates, which multipliers follow."""
    N, square = z.shape[0], 0.0
    solve_full_pivot(scratch.LU, N, scratch.rank[0], scratch.order, scratch.columns, scratch.f, z)
    for i in range(N):
        z[i] = -z[i]
    for i in range(scratch.v.shape[0]):
        square += z[i] * z[i]
    return np.sqrt(square)


@kernel
def is_balanced(lam: Reals, scale: float, scratch: NewtonScratch) -> bool:
    """Whether s.f is small against what s.K and the multipliers do in each row; where they do nothing, zero."""
    n, N = scratch.v.shape[0], scratch.f.shape[0]
    for i in range(N):
        acts = 0.0 if i < n else 1.0
        for k in range(N):
            if i < n and k < n:
                acts += abs(scratch.K[i, k])
            elif i < n:
                acts += abs(scratch.K[i, k] * lam[k - n] * scratch.row[k - n] / scale)
        if abs(scratch.f[i]) > BALANCE_TOLERANCE * acts + BALANCE_FLOOR:
            return False
    return True


@kernel
def max_stiffness(scratch: NewtonScratch) -> float:
    """Largest entry of the force rows of K, or 1."""
    n, largest = scratch.v.shape[0], 0.0
    for i in range(n):
        for k in range(n):
            largest = max(largest, abs(scratch.K[i, k]))
    return largest if largest > 0.0 and np.isfinite(largest) else 1.0


@kernel
def apply_correction(
    eqs: Equations, q: Reals, lam: Reals, damping: float, scale: float, scratch: NewtonScratch
) -> None:
    """s.q_try, s.lam_try, s.moved_try = (q, lam) and s.moved, changed by ``damping`` times the correction s.z."""
    n = scratch.v.shape[0]
    for i in range(q.shape[0]):
        scratch.q[i] = q[i]
    for i in range(n):
        step = damping * scratch.size[i] * scratch.z[i]
        scratch.dq[i], scratch.moved_try[i] = step, scratch.moved[i] + step
    eqs.retract(scratch.q, scratch.dq, eqs.data)
    for i in range(q.shape[0]):
        scratch.q_try[i] = scratch.q[i].real
    for r in range(lam.shape[0]):
        scratch.lam_try[r] = lam[r] + damping * scale / scratch.row[r] * scratch.z[n + r]


@kernel
def accept_trial(q: Reals, lam: Reals, scratch: NewtonScratch) -> None:
    """Accept the trial state."""
    for i in range(q.shape[0]):
        q[i] = scratch.q_try[i]
    for r in range(lam.shape[0]):
        lam[r] = scratch.lam_try[r]
    for i in range(scratch.moved.shape[0]):
        scratch.moved[i] = scratch.moved_try[i]


def factor_jacobian_template(scratch: NewtonScratch) -> bool:
    """Eliminate K; False where it or f is not finite. A template whose hook is ``UNDETERMINED_PIVOT_RATIO``."""
    N = scratch.z.shape[0]
    for i in range(N):
        if not np.isfinite(scratch.f[i]):
            return False
        for j in range(N):
            if not np.isfinite(scratch.K[i, j]):
                return False
            scratch.LU[i, j] = scratch.K[i, j]
    scratch.rank[0] = factor_full_pivot(scratch.LU, N, N, UNDETERMINED_PIVOT_RATIO, scratch.order, scratch.columns)
    return True


factor_jacobian = specialize(factor_jacobian_template, __name__, {})


@kernel
def evaluate(eqs: Equations, t: float, q: Reals, v: Reals) -> None:
    """The terms at (t, q, v), called from Python."""
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)


@kernel
def find_constraint_forces(rows: Integers, terms: Terms, scratch: NewtonScratch, lam: Reals) -> bool:
    """lam (rank,): multipliers of least residual with the ``terms`` at hand; return whether J~ has its full rank."""
    n, rank = scratch.v.shape[0], rows.shape[0]
    for r in range(rank):
        for i in range(n):
            scratch.J[r, i] = terms.J[rows[r], i].real * scratch.size[i] / scratch.row[r]
    decompose(scratch.J, rank, n, scratch.A, scratch.pivots, scratch.U, scratch.sigma, scratch.W)
    for i in range(n):
        scratch.f[i] = -terms.h[i].real * scratch.size[i]
    count = 0
    while count < rank and scratch.sigma[count] > SINGULAR_VALUE_RATIO * scratch.largest[0]:
        count += 1
    pseudo_inverse_transposed(scratch.f, rank, n, count, scratch.U, scratch.sigma, scratch.W, lam)
    for r in range(rank):
        lam[r] /= scratch.row[r]
    return count == rank


def newton_template(
    eqs: Equations,
    t: float,
    q: Reals,
    lam: Reals,
    rows: Integers,
    c2: float,
    mass: float,
    scratch: NewtonScratch,
    report: Any,
) -> int:
    """Solve f = 0 from (q, lam), in place, or a pseudo-transient step; report: Jacobians factored.

    A template whose hooks are ``linearize`` and ``factor_jacobian``.
    """
    n = scratch.v.shape[0]
    for i in range(n):
        scratch.moved[i] = 0.0
    linearize(eqs, t, q, lam, scratch.moved, rows, c2, mass, 1.0, scratch)
    scale = max_stiffness(scratch)
    for i in range(n):
        scratch.f[i] /= scale
        for k in range(n):
            scratch.K[i, k] /= scale
    damping, first = 1.0, True
    for _ in range(MAX_EQUILIBRIUM_ITERATIONS):
        report[0] += 1.0
        if not factor_jacobian(scratch):
            return NOT_FINITE
        size = solve_correction(scratch, scratch.z)
        if size <= EQUILIBRIUM_NEWTON_TOLERANCE:
            apply_correction(eqs, q, lam, 1.0, scale, scratch)
            accept_trial(q, lam, scratch)
            linearize(eqs, t, q, lam, scratch.moved, rows, c2, mass, scale, scratch)
            if not is_balanced(lam, scale, scratch):
                return SINGULAR
            return FOUND if find_constraint_forces(rows, eqs.terms, scratch, scratch.lam_try) else UNDETERMINED
        if first:  # what is farther may be another state
            damping, first = min(1.0, MAX_FIRST_STEP / size), False
        while True:
            apply_correction(eqs, q, lam, damping, scale, scratch)
            linearize(eqs, t, scratch.q_try, scratch.lam_try, scratch.moved_try, rows, c2, mass, scale, scratch)
            after = solve_correction(scratch, scratch.z_next)
            if after <= (1.0 - 0.25 * damping) * size:
                break
            damping *= 0.5
            if damping < MIN_DAMPING:
                return NO_PROGRESS
        accept_trial(q, lam, scratch)
        damping = min(1.0, 2.0 * damping)
    return NO_PROGRESS


newton = specialize(newton_template, __name__, {"linearize": linearize})


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
    n_states
        Number of first-order states among the positions, which come last.
    """

    def __init__(self, system: System, t: float, q: Array, v: Array, n_states: int = 0) -> None:
        super().__init__(system)
        self.system, self._n_moving = system, system.n - n_states
        self._terms = system.allocate_terms(complex)
        self._eqs = Equations.of(system, self._terms)
        self.rows = self._independent_rows(t, q)
        scratch = NewtonScratch.allocate(
            system.nq,
            system.size,
            system.row_size[self.rows],
            np.flatnonzero(np.isin(self.rows, system.nonholonomic)),
        )
        scratch.v[:] = v
        scaled = self._terms.J.real[self.rows] * system.size / scratch.row[:, np.newaxis]
        scratch.largest[:] = np.linalg.norm(scaled, 2) if scaled.size else 1.0
        self._v, self._lam, self._moved, self._K = scratch.v, scratch.lam_try, scratch.moved, scratch.K
        self._scratch, self._held_terms = pin(scratch), pin(self._terms)

    def _independent_rows(self, t: float, q: Array) -> NDArray[np.int64]:
        n, m = self.system.n, self.system.m
        self.system.fill(t, q.astype(complex), np.zeros(n, complex), self._terms)
        rows, columns = np.zeros(m, np.int64), np.zeros(n, np.int64)
        scaled = self._terms.J.real * self.system.size / self.system.row_size[:, np.newaxis]
        self._stuck = bool((np.abs(scaled).max(axis=1, initial=0.0) < SINGULAR_VALUE_RATIO).any())
        rank = factor_full_pivot(scaled, m, n, INDEPENDENT_PIVOT_RATIO, rows, columns)
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
        null = Vt[sigma <= NULL_SINGULAR_RATIO * sigma.max(initial=0.0)][:, coordinates]
        return int(np.linalg.matrix_rank(null, tol=np.sqrt(NULL_SINGULAR_RATIO))) if null.size else 0

    def is_singular(self, t: float, q: Array) -> bool:
        """See the base."""
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return self._stuck or not find_constraint_forces(self.rows, self._held_terms, self._scratch, self._lam)

    def _initial_multipliers(self, t: float, q: Array) -> Array:
        """Return those that leave the least residual force."""
        evaluate(self._eqs, t, q.astype(complex), self._v)
        lam = np.zeros(len(self.rows))
        find_constraint_forces(self.rows, self._held_terms, self._scratch, lam)
        return lam

    def _accelerate(self, t: float, q: Array) -> Array:
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return np.asarray(np.linalg.lstsq(self._terms.M.real, -self._terms.h.real, rcond=None)[0], float)

    def _newton(self, t: float, at: Unknowns, c2: float, mass: float) -> tuple[Outcome, Unknowns, Array, int]:
        found, report = Unknowns(at.q.copy(), at.lam.copy()), np.zeros(1)
        try:
            outcome = Outcome(newton(self._eqs, t, *found, self.rows, c2, mass, self._scratch, report))
        except ZeroDivisionError:  # of complex numbers; of real numbers the quotient is infinite
            outcome = Outcome(NOT_FINITE)
        return outcome, found, self._moved.copy(), int(report[0])

    def _is_far_from_start(self, moved: Array) -> bool:
        far = np.abs(moved / self._size)[: self._n_moving]
        return bool(far.max(initial=0.0) > MAX_STATE_DISTANCE)

    def _all_multipliers(self, lam: Array) -> Array:
        full = np.zeros(self.system.m)
        full[self.rows] = lam
        return full
