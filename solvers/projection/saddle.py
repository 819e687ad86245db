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
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from solvers.compiled.kernel import kernel
from solvers.linalg.threads import one_thread
from solvers.outcome import Code
from solvers.stepper import start_rate
from solvers.system import Array, TreeSystem

from .products import Products
from .projection import MAX_PROJECTION_CORRECTIONS
from .rank import REDUNDANT_PIVOT_RATIO

PENALTY_STIFFNESS = 1e4  # (rad/s)^2, stiffness to effective mass of the springs alpha
# eigenvalues of a scaled Schur complement below this part of the largest count as zero
REDUNDANT_EIGENVALUE_RATIO = 1e-10
# eigenvalues of its inverse below this part of the largest are those of redundant constraints
ZERO_SCHUR_EIGENVALUE_RATIO = 1e-13
# Square of a row to that of the largest below which nothing works against it here: rounding is 1e-32, units make 1e-6.
ZERO_ROW_SQUARE_RATIO = 1e-20
# products with the exact tangent in one solution, and the residual at which there are enough
MAX_KRYLOV_DIMENSION, GMRES_TOLERANCE = 120, 1e-13
CONSTRAINT_TOLERANCE = 1e-11  # of a projection, in units of the rows


@kernel
def _forward(forward: Any, t: float, q: Array, v: Array, data: Any, qdot: Array, a: Array) -> int:
    return int(forward(t, q, v, data, qdot, a))


@kernel
def _mobilities(mobility: Any, J: Array, data: Any, X: Array) -> None:
    """X (m, n): row i is M^-1 J[i]^T."""
    for i in range(J.shape[0]):
        mobility(J[i], data, X[i])


def pseudo_inverse(S: Array) -> Array:
    """Return the pseudo-inverse (m, m) of a Schur complement whose rows are scaled to size one."""
    inverse: Any = np.linalg.pinv(S, rcond=REDUNDANT_EIGENVALUE_RATIO) if len(S) else S
    return np.asarray(inverse)


def inverse_squares(squares: Array) -> Array:
    """Return the factors that scale rows of these squares (m,) to one; a row that is zero here remains small."""
    largest = squares.max(initial=0.0) or 1.0
    return np.asarray(1.0 / np.where(squares > ZERO_ROW_SQUARE_RATIO * largest, squares, largest))


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
        self.system, self.terms = system, system.allocate_terms()
        self.qdot, self.a, self.lam = np.zeros(system.nq), np.zeros(system.n), np.zeros(system.m)
        self.masses = np.ones(system.m)

    def solve(self, t: float, q: Array, v: Array) -> Code:
        """Fill everything at (t, q, v)."""
        s, terms = self.system, self.terms
        if s.m:
            s.fill(t, q, v, terms)
        if _forward(s.forward, t, q, v, s.pinned_data, self.qdot, self.a) != 0:
            return Code.NO_MASS
        if s.m:
            X = np.zeros((s.m, s.n))
            _mobilities(s.mobility, terms.J, s.pinned_data, X)
            with one_thread():
                S = terms.J @ X.T
                if not np.isfinite(S).all():
                    return Code.NOT_FINITE
                self.masses = inverse_squares(np.diag(S))
                root = np.sqrt(self.masses)
                self.lam = root * (pseudo_inverse(root[:, None] * S * root) @ (root * (terms.J @ self.a - terms.gamma)))
                self.a -= self.lam @ X
        return Code.OK if np.isfinite(self.a).all() else Code.NOT_FINITE


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
    none as it starts.
    """
    s = motion.system
    if s.rate > 0.0:
        v = a = np.zeros(0)
    else:
        a = motion.a if motion.solve(t, q, v) is Code.OK else np.zeros(s.n)
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
        self.system, self.terms = system, system.allocate_terms()
        self._alpha = np.zeros(0)
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
        tangent, J = self.system.tangent, self.terms.J
        self.is_incomplete = self._exact and (self.system.moves() or bool(self.state[2].any()))
        if self.is_incomplete:
            self._c1, self._c2 = c1, c2
            self.products.set_state(*self.state)
        if self.system.m == 0:
            return tangent.factor(c1, c2, symmetric=symmetric, averaged=averaged)
        if not self._alpha.size:
            raise RuntimeError("Saddle.weigh comes first")
        if not tangent.factor(c1, c2, self._alpha, symmetric, averaged):
            return False
        root = np.sqrt(self._alpha)
        self._J = J.copy()
        self._A = tangent.solve(J.T)  # (n, m)
        with one_thread():
            S = root[:, None] * (J @ self._A) * root
            if not np.isfinite(S).all():
                return False
            self._inverse = root[:, None] * pseudo_inverse(S) * root
        return True

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
        root = np.sqrt(self._alpha)
        values = np.linalg.eigvals(self._inverse / np.outer(root, root))
        floor = ZERO_SCHUR_EIGENVALUE_RATIO * np.abs(values).max()
        return self.system.tangent.negative - int(np.sum((values.imag == 0.0) & (values.real < -floor)))

    def set_penalties(self, t: float, q: Array) -> None:
        """Choose alpha at a position."""
        if self.system.m:
            motion = Accelerations(self.system)
            motion.solve(t, q, np.zeros(self.system.n))
            self._alpha = PENALTY_STIFFNESS * motion.masses

    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Return x (n,) and y (m,)."""
        if not self.is_incomplete:
            return self._solve_structured(f, g)
        s, n = self.system, self.system.n
        forces = self._alpha / PENALTY_STIFFNESS * (s.rate or 1.0) ** 2 * s.row_size
        units = np.concatenate((s.size, forces))

        def structured(r: Array) -> Array:
            """Return the solution in units by the structured tangent of a residual."""
            return np.concatenate(self._solve_structured(r[:n], r[n:])) / units

        def operator(z: Array) -> Array:
            """Return the same of the exact system's product with z."""
            x, y = np.split(units * z, [n])
            force = self.products.apply(x, 1.0, self._c1, self._c2) + y @ J
            return structured(np.concatenate((force, J @ x)))

        J = self._J if self.system.m else np.zeros((0, n))
        z = units * solve_gmres(operator, structured(np.concatenate((f, g))))
        return z[:n], z[n:]

    def _solve_structured(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Return x (n,) and y (m,) by the structured tangent."""
        if self.system.m == 0:
            return self.system.tangent.solve(f), g
        x = self.system.tangent.solve(f + (self._alpha * g) @ self._J)
        y = self._inverse @ (self._J @ x - g)
        return x - self._A @ y, y


def solve_gmres(operator: Callable[[Array], Array], b: Array) -> Array:
    """Return z with operator(z) = b (N,) by the generalized minimal residual method (Saad and Schultz 1986).

    It is as good as rounding allows, or as MAX_KRYLOV_DIMENSION products.
    """
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
    terms, size = system.allocate_terms(), system.size
    for _ in range(MAX_PROJECTION_CORRECTIONS):
        system.fill_position(t, q, terms)
        off = float(np.abs(terms.Phi / system.row_size).max())
        if not np.isfinite(off):
            return Code.NOT_FINITE
        with one_thread():
            J = terms.J * size
            scale = np.sqrt(inverse_squares(np.einsum("ij,ij->i", J, J)))
            inverse = scale[:, None] * pseudo_inverse(scale[:, None] * (J @ J.T) * scale) * scale
            if off < CONSTRAINT_TOLERANCE:
                v -= size * ((inverse @ (terms.J @ v - terms.nu)) @ J)
                return Code.OK
            system.apply(q, -size * ((inverse @ terms.Phi) @ J))
    return Code.NOT_CLOSED
