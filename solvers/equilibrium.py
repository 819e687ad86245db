"""Steady states by Newton-Raphson: no acceleration, drives and cyclic coordinates at constant speed, the rest still.

Unknowns z = (q, lambda); equations (20)-(24) of Choi, Park and Yoo, with v zero but for cyclic coordinates::

    f(z) = [ h(t, q, v) + J(q)^T lambda ;  Phi(t, q) ] = 0

h is the recursive inverse dynamics at no acceleration with the drives moving. The Jacobian K is exact: the recursions
run on complex numbers, and a perturbation i e of one coordinate leaves the derivative in the imaginary part, with no
difference that could cancel (Squire and Trapp 1998). So the system given is the complex twin of a mechanism's.

K may be singular for a harmless reason: a coordinate on which nothing depends, such as the angle of a free spindle.
K is eliminated with full pivoting and what is left undetermined stays where it was; a force that nothing can balance
is left over, and then there is no steady state.

**Globalisation.** Newton is damped by the natural monotonicity test (Deuflhard, *Newton Methods for Nonlinear
Problems*, 2004, section 3.3): a step is good where the next correction, taken with the old Jacobian, is shorter. The
test does not change with the units of the equations; those of lambda enter through the largest stiffness. It follows
the Newton path, which may end where the Jacobian is singular. Then the start is led downhill first, by implicit Euler
steps of the motion of a heavily damped mechanism, M q' = -(h + J^T lambda), Phi = 0, longer as the unbalance falls
(pseudo-transient continuation, Kelley and Keyes 1998): it ends at a stable state where there is one, and Newton
finishes there.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .bundle import bundle
from .dense import decompose, full_pivot, least_norm_transposed, solve_full_pivot
from .held import hold
from .kernel import kernel
from .partition import length, rank_at, ratio
from .system import Array, System

EPSILON = 1e-30  # of the complex step; its square must vanish beside one
CONVERGED = 1e-10  # the last correction; what it leaves is of the order of its square
ITERATIONS = 60
LEAST_DAMPING = 1e-4
DESCENT_STEPS = 300
LONGEST = 0.2  # step of the descent in one coordinate, rad or m
NEAR = 1e-3  # a descent step this short leaves the rest to Newton
SINGULAR = 1e-12  # pivot of K relative to the first, below which an unknown is undetermined
BALANCED = 1e-9  # unbalance left by the last correction, of forces in units of the largest stiffness, of loops in m
SINGULAR_POSITION = 1e-7  # ratio of the singular values of J below which cut-joint forces are not determined
INDEPENDENT = 1e-8  # relative pivot of an independent constraint


class Outcome(IntEnum):
    """How a solution ended; the numbers are those the kernel returns."""

    FOUND = 0
    NO_PROGRESS = 1
    SINGULAR = 2
    NOT_FINITE = 3
    UNDETERMINED = 4  # in a singular position, where cut joints share forces in many ways


class Scratch(NamedTuple):
    """Allocated once. N = n + rank unknowns."""

    q: NDArray[Any]  # (nq,) complex: perturbed position
    v: NDArray[Any]  # (n,)  complex: velocity of the steady motion
    dq: NDArray[Any]  # (n,)  complex: perturbation
    q_try: Array  # (nq,)
    lam_try: Array  # (rank,)
    f: Array  # (N,)
    K: Array  # (N, N) df/dz, forces divided by the scale
    z: Array  # (N,)   correction, multipliers divided by the scale
    z_next: Array  # (N,)
    LU: Array  # (N, N) factors of K, fully pivoted
    order: NDArray[np.int64]  # (N,) of its rows
    columns: NDArray[np.int64]  # (N,)
    rank: NDArray[np.int64]  # (1,)
    J: Array  # (rank, n) independent rows of the constraint Jacobian
    A: Array  # (n, rank) scratch of its decomposition
    pivots: NDArray[np.int64]  # (rank,)
    U: Array  # (n, n)
    sigma: Array  # (rank,)
    W: Array  # (rank, rank)

    @staticmethod
    def allocate(nq: int, n: int, rank: int) -> Scratch:
        """Return zeroed scratch."""
        N, z = n + rank, np.zeros
        return Scratch(
            z(nq, complex), z(n, complex), z(n, complex), z(nq), z(rank), z(N), z((N, N)), z(N), z(N), z((N, N)),
            z(N, np.int64), z(N, np.int64), z(1, np.int64), z((rank, n)), z((n, rank)), z(rank, np.int64), z((n, n)),
            z(rank), z((rank, rank)),
        )  # fmt: skip


@kernel
def linearise(eqs: Any, t: float, q: Any, lam: Any, rows: Any, scale: float, s: Any) -> None:
    """s.f and s.K at (q, lam), one evaluation a coordinate; forces in units of ``scale``."""
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
            s.f[i] = balance.real / scale
            s.K[i, k] = balance.imag / (EPSILON * scale)
        for r in range(rank):
            s.f[n + r] = terms.Phi[rows[r]].real
            s.K[n + r, k] = terms.Phi[rows[r]].imag / EPSILON
    for r in range(rank):
        for i in range(n):
            s.K[i, n + r] = terms.J[rows[r], i].real
        for other in range(rank):
            s.K[n + other, n + r] = 0.0


@kernel
def correction(s: Any, z: Any) -> float:
    """z with K z = -f by the factors at hand; return its length."""
    N = z.shape[0]
    solve_full_pivot(s.LU, N, s.rank[0], s.order, s.columns, s.f, z)
    for i in range(N):
        z[i] = -z[i]
    return length(z)


@kernel
def stiffness(s: Any) -> float:
    """Largest entry of the force rows of K, or 1: the scale of forces."""
    n, largest = s.v.shape[0], 0.0
    for i in range(n):
        for k in range(n):
            largest = max(largest, abs(s.K[i, k]))
    return largest if largest > 0.0 and np.isfinite(largest) else 1.0


@kernel
def move(eqs: Any, q: Any, lam: Any, damping: float, scale: float, s: Any) -> None:
    """s.q_try, s.lam_try = (q, lam) moved by ``damping`` times the correction s.z."""
    n = s.v.shape[0]
    for i in range(q.shape[0]):
        s.q[i] = q[i]
    for i in range(n):
        s.dq[i] = damping * s.z[i]
    eqs.retract(s.q, s.dq, eqs.data)
    for i in range(q.shape[0]):
        s.q_try[i] = s.q[i].real
    for r in range(lam.shape[0]):
        s.lam_try[r] = lam[r] + damping * scale * s.z[n + r]


@kernel
def take(q: Any, lam: Any, s: Any) -> None:
    """Accept the trial state."""
    for i in range(q.shape[0]):
        q[i] = s.q_try[i]
    for r in range(lam.shape[0]):
        lam[r] = s.lam_try[r]


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
    s.rank[0] = full_pivot(s.LU, N, N, SINGULAR, s.order, s.columns)
    return True


@kernel
def evaluate(eqs: Any, t: float, q: Any, v: Any) -> None:
    """The terms at (t, q, v), called from Python."""
    eqs.dynamics(t, q, v, eqs.data, eqs.terms)


@kernel
def constraint_forces(rows: Any, terms: Any, s: Any, lam: Any) -> float:
    """lam (rank,): multipliers of least unbalance with the ``terms`` at hand; return how far J is from losing rank."""
    n, rank = s.v.shape[0], rows.shape[0]
    for r in range(rank):
        for i in range(n):
            s.J[r, i] = terms.J[rows[r], i].real
    decompose(s.J, rank, n, s.A, s.pivots, s.U, s.sigma, s.W)
    for i in range(n):
        s.f[i] = -terms.h[i].real
    least_norm_transposed(s.f, rank, n, rank_at(s.sigma, rank, SINGULAR_POSITION), s.U, s.sigma, s.W, lam)
    return ratio(s.sigma, rank)


@kernel
def newton(eqs: Any, t: float, q: Any, lam: Any, rows: Any, s: Any, report: Any) -> int:
    """Solve f = 0 from (q, lam), in place; report: Jacobians factored, largest stiffness."""
    linearise(eqs, t, q, lam, rows, 1.0, s)
    scale, n = stiffness(s), s.v.shape[0]
    report[1] = scale
    for i in range(n):
        s.f[i] /= scale
        for k in range(n):
            s.K[i, k] /= scale
    damping = 1.0
    for _ in range(ITERATIONS):
        report[0] += 1.0
        if not factor(s):
            return 3
        size = correction(s, s.z)
        if size <= CONVERGED:
            move(eqs, q, lam, 1.0, scale, s)
            take(q, lam, s)
            linearise(eqs, t, q, lam, rows, scale, s)
            if length(s.f) > BALANCED:
                return 2
            return 0 if constraint_forces(rows, eqs.terms, s, s.lam_try) > SINGULAR_POSITION else 4
        while True:
            move(eqs, q, lam, damping, scale, s)
            linearise(eqs, t, s.q_try, s.lam_try, rows, scale, s)
            after = correction(s, s.z_next)
            if after <= (1.0 - 0.25 * damping) * size:
                break
            damping *= 0.5
            if damping < LEAST_DAMPING:
                return 1
        take(q, lam, s)
        damping = min(1.0, 2.0 * damping)
    return 1


@kernel
def descend(eqs: Any, t: float, q: Any, lam: Any, rows: Any, s: Any, report: Any) -> bool:
    """Lead (q, lam) downhill, in place, until Newton can take over; False where it does not come to rest."""
    n = s.v.shape[0]
    linearise(eqs, t, q, lam, rows, 1.0, s)
    scale = stiffness(s)
    linearise(eqs, t, q, lam, rows, scale, s)
    inertia = 0.0
    for i in range(n):
        inertia = max(inertia, eqs.terms.M[i, i].real)
    unbalance, duration = length(s.f), inertia / scale
    for _ in range(DESCENT_STEPS):
        report[0] += 1.0
        for i in range(n):
            for k in range(n):
                s.K[i, k] += eqs.terms.M[i, k].real / (duration * scale)
        if not factor(s):
            return False
        correction(s, s.z)
        longest = 0.0
        for i in range(n):
            longest = max(longest, abs(s.z[i]))
        part = min(1.0, LONGEST / longest) if longest > 0.0 else 1.0
        move(eqs, q, lam, part, scale, s)
        take(q, lam, s)
        linearise(eqs, t, q, lam, rows, scale, s)
        after = length(s.f)
        if not np.isfinite(after):
            return False
        if longest < NEAR and duration > 1e3 * inertia / scale:
            return True
        duration *= min(3.0, max(0.3, unbalance / after)) if after > 0.0 else 3.0
        unbalance = after
    return False


@dataclass(frozen=True, kw_only=True)
class Solution:
    """What Newton found.

    Attributes
    ----------
    q, lam
        Positions (nq,) and multipliers (m,), redundant ones zero.
    iterations
        Jacobians factored.
    stiffness
        Largest entry of d(force)/dq at the start: the scale of forces, N/m or N m/rad.
    forces, gaps
        h + J^T lambda (n,) and Phi (m,) there.
    """

    outcome: Outcome
    q: Array
    lam: Array
    iterations: int
    stiffness: float
    forces: Array
    gaps: Array


class EquilibriumSolver:
    """Newton for one mechanism.

    Parameters
    ----------
    system
        The complex twin of a mechanism's system.
    q
        A closed position (nq,) in general position, where the independent constraints are told from redundant ones.
    v
        Velocities (n,) of the steady motion: zero but for cyclic coordinates.
    """

    def __init__(self, system: System, t: float, q: Array, v: Array) -> None:
        self.system = system
        self._terms = system.allocate_terms(complex)
        self._eqs = bundle(system, self._terms)
        self.rows = self._independent(t, q)
        scratch = Scratch.allocate(system.nq, system.n, len(self.rows))
        scratch.v[:] = v
        self._v, self._lam = scratch.v, scratch.lam_try
        self._scratch, self._held_terms = hold(scratch), hold(self._terms)

    def _independent(self, t: float, q: Array) -> NDArray[np.int64]:
        n, m = self.system.n, self.system.m
        self.system.fill(t, q.astype(complex), np.zeros(n, complex), self._terms)
        rows, columns = np.zeros(m, np.int64), np.zeros(n, np.int64)
        rank = full_pivot(self._terms.J.real.copy(), m, n, INDEPENDENT, rows, columns)
        return np.sort(rows[:rank])

    def rehearse(self, q: Array) -> None:
        """Have everything compiled now, and not in the time of a solution."""
        self.solve(0.0, q, downhill=True)

    def solve(self, t: float, q: Array, lam: Array | None = None, *, downhill: bool = False) -> Solution:
        """Run Newton from positions q (nq,) and multipliers lam (m,); without lam from those of least unbalance.

        ``downhill`` lets the descent go first.
        """
        q, report = q.copy(), np.zeros(2)
        start = self._balancing(t, q) if lam is None else lam[self.rows]
        if downhill:
            descend(self._eqs, t, q, start, self.rows, self._scratch, report)
        outcome = Outcome(newton(self._eqs, t, q, start, self.rows, self._scratch, report))
        full = np.zeros(self.system.m)
        full[self.rows] = start
        forces, gaps = self.unbalance(t, q, full)
        return Solution(
            outcome=outcome,
            q=q,
            lam=full,
            iterations=int(report[0]),
            stiffness=float(report[1]),
            forces=forces,
            gaps=gaps,
        )

    def unbalance(self, t: float, q: Array, lam: Array) -> tuple[Array, Array]:
        """Return h + J^T lambda (n,) and Phi (m,)."""
        T = self._terms
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return T.h.real + T.J.real.T @ lam, T.Phi.real.copy()

    def singular(self, t: float, q: Array) -> bool:
        """Whether the independent constraints lose rank at q."""
        evaluate(self._eqs, t, q.astype(complex), self._v)
        return not constraint_forces(self.rows, self._held_terms, self._scratch, self._lam) > SINGULAR_POSITION

    def _balancing(self, t: float, q: Array) -> Array:
        """Return the multipliers of the independent rows (rank,) that leave the least unbalanced force."""
        evaluate(self._eqs, t, q.astype(complex), self._v)
        lam = np.zeros(len(self.rows))
        constraint_forces(self.rows, self._held_terms, self._scratch, lam)
        return lam
