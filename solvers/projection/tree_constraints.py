"""Accelerations, projections and saddle systems of a large tree as kernels; the equations are in :mod:`.saddle`.

All kernels get the callbacks of a tree in a named tuple ``eqs`` (:class:`solvers.system.TreeEquations`), and scratch
that is allocated once. Without constraints they cost no more than the recursions that they call.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.svd import decompose
from solvers.outcome import NO_MASS, NOT_CLOSED, NOT_FINITE, OK
from solvers.resolution import start_rate
from solvers.system import Array, Terms, TreeSystem

from .projection import MAX_PROJECTION_CORRECTIONS

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

PENALTY_STIFFNESS = 1e4  # (rad/s)^2, stiffness to effective mass of the springs alpha
# eigenvalues of a scaled Schur complement below this part of the largest count as zero
REDUNDANT_EIGENVALUE_RATIO = 1e-10
# Square of a row to that of the largest below which nothing works against it here: rounding is 1e-32, units make 1e-6.
ZERO_ROW_SQUARE_RATIO = 1e-20
CONSTRAINT_TOLERANCE = 1e-11  # of a projection, in units of the rows


class ConstraintScratch(NamedTuple):
    """Terms of m constraints, and scratch."""

    terms: Any  # solvers.system.Terms, held: those of the constraints
    row_size: Array  # (m,) units of the rows
    masses: Array  # (m,) effective mass of every constraint, see solve_accelerations
    moved: Array  # (m, n) M^-1 J^T, or J in units of the coordinates
    S: Array  # (m, m)
    inverse: Array  # (m, m) its pseudo-inverse
    root: Array  # (m,) factors that scale its rows
    right: Array  # (m,)
    reduced: Array  # (m, m) scratch of the decomposition, as the four that follow
    pivots: NDArray[np.int64]  # (m,)
    U: Array  # (m, m)
    sigma: Array  # (m,)
    W: Array  # (m, m)
    change: Array  # (n,)
    zero: Array  # (n,)
    qdot: Array  # (nq,) results of solve_accelerations that nobody else needs, as the two that follow
    a: Array  # (n,)
    lam: Array  # (m,)

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> ConstraintScratch:
        """Return zeroed scratch with units of one."""
        z, shapes = np.zeros, (0, (0, 0), 0, m, (m, n), m, m)
        terms = pin(Terms(*(z(shape) for shape in shapes)))
        return ConstraintScratch(
            terms, np.ones(m), np.ones(m), z((m, n)), z((m, m)), z((m, m)), z(m), z(m), z((m, m)), z(m, np.int64),
            z((m, m)), z(m), z((m, m)), z(n), z(n), z(nq), z(n), z(m),
        )  # fmt: skip


def constraint_scratch(system: TreeSystem) -> Any:
    """Return scratch for a system, with the units of its rows, pinned."""
    own = ConstraintScratch.allocate(system.nq, system.n, system.m)
    own.row_size[:] = system.row_size
    return pin(own)


@kernel
def set_scales(squares: Reals, scales: Reals) -> None:
    """Scales (m,) that multiply rows of these squares (m,) to one; a row that is zero here remains small."""
    largest = 0.0
    for row in range(squares.shape[0]):
        largest = max(largest, squares[row])
    if largest == 0.0:
        largest = 1.0
    for row in range(squares.shape[0]):
        scales[row] = 1.0 / (squares[row] if squares[row] > ZERO_ROW_SQUARE_RATIO * largest else largest)


@kernel
def invert_scaled(own: ConstraintScratch) -> bool:
    """own.inverse (m, m) <- R (R S R)^+ R of own.S with the diagonal matrix R of own.root; False: S is not finite."""
    m, S, root = own.root.shape[0], own.S, own.root
    for i in range(m):
        for j in range(m):
            S[i, j] *= root[i] * root[j]
            if not np.isfinite(S[i, j]):
                return False
    decompose(S, m, m, own.reduced, own.pivots, own.U, own.sigma, own.W)
    for i in range(m):
        for j in range(m):
            total = 0.0
            for k in range(m):
                if own.sigma[k] > REDUNDANT_EIGENVALUE_RATIO * own.sigma[0]:
                    total += own.U[i, k] * own.W[j, k] / own.sigma[k]
            own.inverse[i, j] = root[i] * total * root[j]
    return True


@kernel
def multiply_rows(A: Reals, B: Reals, out: Reals) -> None:
    """out (m, m) <- A B^T of A and B (m, n)."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[j, k]
            out[i, j] = total


@kernel
def solve_accelerations(
    eqs: Any, t: float, q: Reals, v: Reals, own: ConstraintScratch, qdot: Reals, a: Reals, lam: Reals
) -> int:
    """N v (nq,), accelerations a (n,) and the shortest multipliers lam (m,), in units of the effective masses; return a
    code.

    Of a constraint that no motion works against here the effective mass is the least there is.
    """
    m, n, terms = lam.shape[0], a.shape[0], own.terms
    if m > 0:
        eqs.constraints(t, q, v, eqs.data, terms)
    if eqs.forward(t, q, v, eqs.data, qdot, a) != 0:
        return NO_MASS
    if m > 0:
        for row in range(m):
            eqs.mobility(terms.J[row], eqs.data, own.moved[row])
        multiply_rows(terms.J, own.moved, own.S)
        for row in range(m):
            own.right[row] = own.S[row, row]
        set_scales(own.right, own.masses)
        for row in range(m):
            own.root[row] = np.sqrt(own.masses[row])
        if not invert_scaled(own):
            return NOT_FINITE
        for row in range(m):
            own.right[row] = -terms.gamma[row]
            for i in range(n):
                own.right[row] += terms.J[row, i] * a[i]
        for row in range(m):
            lam[row] = 0.0
            for other in range(m):
                lam[row] += own.inverse[row, other] * own.right[other]
        for row in range(m):
            for i in range(n):
                a[i] -= lam[row] * own.moved[row, i]
    for i in range(n):
        if not np.isfinite(a[i]):
            return NOT_FINITE
    return OK


@kernel
def find_rate(
    eqs: Any, t: float, q: Reals, v: Reals, moving: int, size: Reals, known: float, duration: float,
    own: ConstraintScratch,
) -> float:  # fmt: skip
    """Rate of the motion, 1/s, for a run of ``duration`` (s): by gravity and drives, which is ``known``, or if there
    are none as it starts at (t, q, v), whose first ``moving`` velocities are not first-order states.
    """
    if known > 0.0:
        return start_rate(known, duration, size, v[:0], own.a[:0])
    if solve_accelerations(eqs, t, q, v, own, own.qdot, own.a, own.lam) != OK:
        for i in range(own.a.shape[0]):
            own.a[i] = 0.0
    return start_rate(known, duration, size, v[:moving], own.a)


@kernel
def project_state(eqs: Any, t: float, q: Reals, v: Reals, size: Reals, own: ConstraintScratch) -> int:
    """Project (q, v) onto the constraints, in place: least change of the coordinates in units of their ``size`` (n,)
    (Gauss-Newton, then J v = nu). Return a code.
    """
    m, n, terms = own.root.shape[0], size.shape[0], own.terms
    if m == 0:
        return OK
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        eqs.position(t, q, eqs.data, terms)
        off = 0.0
        for row in range(m):
            part = abs(terms.Phi[row] / own.row_size[row])
            if not part <= off:
                off = part
            for i in range(n):
                own.moved[row, i] = terms.J[row, i] * size[i]
        if not np.isfinite(off):
            return NOT_FINITE
        multiply_rows(own.moved, own.moved, own.S)
        for row in range(m):
            own.right[row] = own.S[row, row]
        set_scales(own.right, own.root)
        for row in range(m):
            own.root[row] = np.sqrt(own.root[row])
        if not invert_scaled(own):
            return NOT_FINITE
        closed = off < CONSTRAINT_TOLERANCE
        for row in range(m):
            own.right[row] = terms.Phi[row]
            if closed:
                own.right[row] = -terms.nu[row]
                for i in range(n):
                    own.right[row] += terms.J[row, i] * v[i]
        for i in range(n):
            own.change[i] = 0.0
        for row in range(m):
            part = 0.0
            for other in range(m):
                part += own.inverse[row, other] * own.right[other]
            for i in range(n):
                own.change[i] -= part * own.moved[row, i] * size[i]
        if closed:
            for i in range(n):
                v[i] += own.change[i]
            return OK
        eqs.retract(q, own.change, eqs.data)
    return NOT_CLOSED


class SaddleMemory(NamedTuple):
    """Factors of a saddle system."""

    alpha: Array  # (m,) stiffness of the springs that hold the constraints
    J: Array  # (m, n)
    A: Array  # (m, n) rows T_alpha^-1 J^T
    inverse: Array  # (m, m)
    load: Array  # (n,) scratch
    right: Array  # (m,) scratch

    @staticmethod
    def allocate(n: int, m: int) -> SaddleMemory:
        """Return zeroed memory."""
        z = np.zeros
        return SaddleMemory(z(m), z((m, n)), z((m, n)), z((m, m)), z(n), z(m))


@kernel
def set_penalties(eqs: Any, t: float, q: Reals, saddle: SaddleMemory, own: ConstraintScratch) -> None:
    """Choose alpha at a position."""
    if saddle.alpha.shape[0] == 0:
        return
    solve_accelerations(eqs, t, q, own.zero, own, own.qdot, own.a, own.lam)
    for row in range(saddle.alpha.shape[0]):
        saddle.alpha[row] = PENALTY_STIFFNESS * own.masses[row]


@kernel
def factor_saddle(
    eqs: Any, c1: float, c2: float, symmetric: bool, saddle: SaddleMemory, own: ConstraintScratch
) -> bool:
    """Factor T and the saddle system at the last inverse dynamics, with J of own.terms; False where it is singular."""
    if not eqs.factor_tangent(c1, c2, saddle.alpha, symmetric, eqs.tangent):
        return False
    return reduce_saddle(eqs, saddle, own)


@kernel
def reduce_saddle(eqs: Any, saddle: SaddleMemory, own: ConstraintScratch) -> bool:
    """Solve for the equations of the multipliers, T_alpha having been factored; False where they are singular."""
    m = saddle.alpha.shape[0]
    if m == 0:
        return True
    for row in range(m):
        for i in range(saddle.J.shape[1]):
            saddle.J[row, i] = own.terms.J[row, i]
        eqs.solve_tangent(saddle.J[row], eqs.tangent, saddle.A[row])
        own.root[row] = np.sqrt(saddle.alpha[row])
    multiply_rows(saddle.J, saddle.A, own.S)
    if not invert_scaled(own):
        return False
    for row in range(m):
        for other in range(m):
            saddle.inverse[row, other] = own.inverse[row, other]
    return True


@kernel
def solve_saddle(eqs: Any, f: Reals, gap: Reals, saddle: SaddleMemory, x: Reals, y: Reals) -> None:
    """x (n,) and y (m,) of the saddle system with right-hand sides f (n,) and gap (m,)."""
    m, n = gap.shape[0], f.shape[0]
    if m == 0:
        eqs.solve_tangent(f, eqs.tangent, x)
        return
    for i in range(n):
        saddle.load[i] = f[i]
    for row in range(m):
        for i in range(n):
            saddle.load[i] += saddle.alpha[row] * gap[row] * saddle.J[row, i]
    eqs.solve_tangent(saddle.load, eqs.tangent, x)
    for row in range(m):
        saddle.right[row] = -gap[row]
        for i in range(n):
            saddle.right[row] += saddle.J[row, i] * x[i]
    for row in range(m):
        y[row] = 0.0
        for other in range(m):
            y[row] += saddle.inverse[row, other] * saddle.right[other]
    for row in range(m):
        for i in range(n):
            x[i] -= saddle.A[row, i] * y[row]
