"""A large tree with cut joints: its saddle system, its accelerations, its projection onto the constraints.

    T x + J^T y = f,      J x = g,      T the structured tangent of the tree (n), J (m, n) with few rows

is solved with the factors of T_alpha = T + J^T alpha J, which has the same solutions where f becomes
f + J^T alpha g, and is regular where T alone is not (a tree that floats until its cut joints hold it)::

    S y = J T_alpha^-1 (f + J^T alpha g) - g,     x = T_alpha^-1 (f + J^T alpha g - J^T y),     S = J T_alpha^-1 J^T

A redundant constraint makes S singular; y is then the shortest, in units of alpha. alpha counts only for rounding: the
effective mass of each row, (J M^-1 J^T)_ii^-1, times SPRING.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from solvers.compiled.tuple_pointer import pin, unpin
from solvers.outcome import CODES, Code
from solvers.resolution import start_rate
from solvers.system import Array, TreeSystem

from .products import Products
from .rank import REDUNDANT_PIVOT_RATIO
from .tree_constraints import (
    PENALTY_STIFFNESS,
    SaddleMemory,
    constraint_scratch,
    project_state,
    reduce_saddle,
    solve_accelerations,
    solve_saddle,
)

# eigenvalues of its inverse below this part of the largest are those of redundant constraints
ZERO_SCHUR_EIGENVALUE_RATIO = 1e-13
# products with the exact tangent in one solution, and the residual at which there are enough
MAX_KRYLOV_DIMENSION, GMRES_TOLERANCE = 120, 1e-13


class Accelerations:
    """Accelerations and multipliers of a tree at any state, with what they came from.

    Attributes
    ----------
    qdot, a, lam
        N v (nq,), v' (n,) and the shortest lambda (m,), in units of the effective masses.
    masses
        Effective mass of every constraint (m,); of one that no motion works against here, the least there is.
    terms
        Constraints at that state.
    """

    def __init__(self, system: TreeSystem) -> None:
        self.system, self._scratch = system, constraint_scratch(system)
        self.qdot, self.a, self.lam = np.zeros(system.nq), np.zeros(system.n), np.zeros(system.m)
        own = unpin(self._scratch)
        self.terms, self.masses = unpin(own.terms), own.masses

    def solve(self, t: float, q: Array, v: Array) -> Code:
        """Fill everything at (t, q, v)."""
        s = self.system
        return CODES[solve_accelerations(s.equations, t, q, v, self._scratch, self.qdot, self.a, self.lam)]


def count_freedom(system: TreeSystem, t: float, q: Array) -> int:
    """Return in how many ways the constraints let a tree move about q (nq,) at most.

    They are counted only if there are enough constraint equations to leave none.
    """
    if system.m < system.n:
        return system.n
    terms = system.allocate_terms()
    system.fill_position(t, q, terms)
    sigma = np.linalg.svd(terms.J * system.size / system.row_size[:, None], compute_uv=False)
    return system.n - int(np.count_nonzero(sigma > REDUNDANT_PIVOT_RATIO * sigma[0]))


def motion_rate(motion: Accelerations, t: float, q: Array, v: Array, duration: float) -> float:
    """Return the rate of a tree's motion, 1/s, for a run of ``duration`` (s): by gravity and drives, or if there are
    none as it starts. First-order states have no part in it, however fast they are.
    """
    s = motion.system
    if s.rate > 0.0:
        v = a = np.zeros(0)
    else:
        v, a = v[: s.n_velocities], motion.a if motion.solve(t, q, v) is Code.OK else np.zeros(s.n)
    return float(start_rate(s.rate, duration, s.size, v, a))


class Saddle:
    """The saddle system of a tree, factored and solved as often as wanted; without constraints T alone.

    ``exact``: where drives move or the tree does, what the structured tangent leaves out is added by an iteration
    (GMRES), whose preconditioner it is.

    Attributes
    ----------
    at
        (t, q, v, a, lambda) of the last :meth:`residual`.
    left_out
        Whether the structured tangent, as it was factored last, leaves anything out.
    """

    def __init__(self, system: TreeSystem, exact: bool = False) -> None:
        self.system, self._scratch = system, constraint_scratch(system)
        self._pinned = pin(SaddleMemory.allocate(system.n, system.m))
        self.terms, self._memory = unpin(unpin(self._scratch).terms), unpin(self._pinned)
        self._exact = exact and system.complex_step is not None
        self._products: Products | None = None
        self.is_incomplete = False

    def residual(self, t: float, q: Array, v: Array, a: Array, lam: Array) -> tuple[Array, Array]:
        """Return M a + h + J^T lambda (n,) and Phi (m,); the state is left there, and J."""
        if self.system.m:
            self.system.fill_position(t, q, self.terms)
        self.state = t, q, v, a, lam
        return self.system.residual(t, q, v, a, lam), self.terms.Phi.copy()

    def factor(self, c1: float, c2: float, symmetric: bool = False, averaged: bool = False) -> bool:
        """Factor at the last :meth:`residual`; False where T is singular even with the springs.

        ``symmetric``: as if T were. ``averaged``: (T + T^T) / 2 instead, whose negative eigenvalues are counted.
        """
        tangent, alpha = self.system.tangent, self._memory.alpha
        self.is_incomplete = self._exact and (self.system.moves() or bool(self.state[2].any()))
        if self.is_incomplete:
            self._c1, self._c2 = c1, c2
            self.products.set_state(*self.state)
        if len(alpha) and not alpha.any():
            raise RuntimeError("Saddle.set_penalties comes first")
        if not tangent.factor(c1, c2, alpha, symmetric, averaged):
            return False
        return bool(reduce_saddle(self.system.equations, self._pinned, self._scratch))

    @property
    def products(self) -> Products:
        """Products of the exact tangent; they are taken where they were placed last."""
        if self._products is None:
            self._products = Products(self.system)
        return self._products

    @property
    def negative(self) -> int:
        """Number of negative eigenvalues of T on J x = 0, as it was last factored ``averaged``.

        By the inertia of [T_alpha, J^T; J, 0] on one side, of T_alpha and -S on the other.
        """
        if self.system.m == 0:
            return self.system.tangent.negative
        root = np.sqrt(self._memory.alpha)
        values = np.linalg.eigvals(self._memory.inverse / np.outer(root, root))
        floor = ZERO_SCHUR_EIGENVALUE_RATIO * np.abs(values).max()
        return self.system.tangent.negative - int(np.sum((values.imag == 0.0) & (values.real < -floor)))

    def set_penalties(self, t: float, q: Array) -> None:
        """Choose alpha at a position."""
        if self.system.m:
            motion = Accelerations(self.system)
            motion.solve(t, q, np.zeros(self.system.n))
            self._memory.alpha[:] = PENALTY_STIFFNESS * motion.masses

    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Return x (n,) and y (m,)."""
        if not self.is_incomplete:
            return self._solve_structured(f, g)
        s, n = self.system, self.system.n
        forces = self._memory.alpha / PENALTY_STIFFNESS * (s.rate or 1.0) ** 2 * s.row_size
        units = np.concatenate((s.size, forces))

        def structured(r: Array) -> Array:
            """Return the solution in units by the structured tangent of a residual."""
            return np.concatenate(self._solve_structured(r[:n], r[n:])) / units

        def operator(z: Array) -> Array:
            """Return the same of the exact system's product with z."""
            x, y = np.split(units * z, [n])
            J = self._memory.J
            force = self.products.apply(x, 1.0, self._c1, self._c2) + y @ J
            return structured(np.concatenate((force, J @ x)))

        z = units * solve_gmres(operator, structured(np.concatenate((f, g))))
        return z[:n], z[n:]

    def _solve_structured(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Return x (n,) and y (m,) by the structured tangent."""
        x, y = np.empty(self.system.n), np.empty(self.system.m)
        right = np.ascontiguousarray(f), np.ascontiguousarray(g)
        solve_saddle(self.system.equations, *right, self._pinned, x, y)
        return x, y


def solve_gmres(operator: Callable[[Array], Array], b: Array) -> Array:
    """Return z with operator(z) = b (N,) by the generalized minimal residual method (Saad and Schultz 1986).

    It is as good as rounding allows, or as MAX_KRYLOV_DIMENSION products.
    """
    from scipy.sparse.linalg import LinearOperator, gmres

    if not np.isfinite(b).all():
        return b
    A = LinearOperator((len(b), len(b)), matvec=operator, dtype=float)
    restart = min(MAX_KRYLOV_DIMENSION, len(b))
    return np.asarray(gmres(A, b, rtol=GMRES_TOLERANCE, restart=restart, maxiter=1)[0])


def project(system: TreeSystem, t: float, q: Array, v: Array) -> Code:
    """Project (q, v) onto the constraints, in place: least change of the coordinates in units of their sizes
    (Gauss-Newton, then J v = nu).
    """
    if system.m == 0:
        return Code.OK
    scratch = constraint_scratch(system)
    return CODES[project_state(system.equations, t, q, v, system.size, scratch)]
