"""The equations of a steady state and their Jacobian, as paths take them: of small and of large systems.

    K x + J^T y = f,      J x = g,      K the derivative of h + J^T lambda by the coordinates

A state is statically unstable along as many motions as K has negative eigenvalues on J x = 0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import scipy

from solvers.projection.saddle import Saddle
from solvers.system import Array, TreeSystem

from .dense import UNDETERMINED_PIVOT_RATIO, DenseEquilibriumSolver
from .matrices import MAX_ASSEMBLED_COORDINATES, allowed_motions

# eigenvalues of a large tree that are requested: more as long as all of them are negative
REQUESTED_EIGENVALUES = (12, 24, 48, 96)
MIN_KRYLOV_DIMENSION, MAX_SIGN_RESTARTS = 40, 4
EIGENVALUE_SIGN_TOLERANCE = 1e-2  # relative error of eigenvalues of which only the sign counts
SYMMETRY_TOLERANCE = 1e-8  # of the largest entry: what is less is rounding
ZERO_EIGENVALUE_RATIO = 1e-12  # of the largest eigenvalue of the inverse


class Linearized(ABC):
    """Equations of one mechanism, with the inputs it has now.

    Attributes
    ----------
    size
        Units of the coordinates (n,).
    """

    size: Array

    @abstractmethod
    def residual(self, q: Array, lam: Array) -> tuple[Array, Array]:
        """Return h + J^T lambda (n,) and Phi."""

    @abstractmethod
    def factor(self, q: Array, lam: Array) -> bool:
        """Factor the Jacobian; False where it cannot be."""

    @abstractmethod
    def inspect(self, q: Array, lam: Array) -> int:
        """Factor the Jacobian of a steady state; return the negative eigenvalues of K on J x = 0."""

    @abstractmethod
    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Return x (n,) and y by the last factors."""

    @abstractmethod
    def moved(self, q: Array, x: Array) -> Array:
        """Return positions changed by x (n,)."""


def count_negative_eigenvalues(A: Array, floor: float) -> int:
    """Return how many real eigenvalues of A (n, n) are below minus this part of the largest.

    Where A is symmetric, as without follower loads, they must be found so: of two that are alike rounding makes a pair.
    """
    symmetric = np.abs(A - A.T).max(initial=0.0) <= SYMMETRY_TOLERANCE * np.abs(A).max(initial=0.0)
    values = np.linalg.eigvalsh(0.5 * (A + A.T)) if symmetric else np.linalg.eigvals(A)
    return int(np.sum((values.real < -floor * np.abs(values).max(initial=0.0)) & (values.imag == 0.0)))


class DenseLinearized(Linearized):
    """A mechanism with dense matrices; lambda are the multipliers of the solver's independent rows."""

    def __init__(self, solver: DenseEquilibriumSolver) -> None:
        self._solver, self._system = solver, solver.system
        self.size, self._row = self._system.size, self._system.row_size[solver.rows]

    def residual(self, q: Array, lam: Array) -> tuple[Array, Array]:
        """See the base."""
        full = np.zeros(self._system.m)
        full[self._solver.rows] = lam
        forces, gaps = self._solver.residual(0.0, q, full)
        return forces, gaps[self._solver.rows]

    def factor(self, q: Array, lam: Array) -> bool:
        """See the base. Where nothing depends on an unknown it stays."""
        K, n = self._solver.jacobian(0.0, q, lam), len(self.size)
        if not np.isfinite(K).all():
            return False
        self._scale = float(np.abs(K[:n, :n]).max()) or 1.0
        K[:n, :n] /= self._scale
        self._K = K
        self._inverse = np.linalg.pinv(K, rcond=UNDETERMINED_PIVOT_RATIO)
        return True

    def inspect(self, q: Array, lam: Array) -> int:
        """See the base."""
        self.factor(q, lam)
        n = len(self.size)
        free = scipy.linalg.null_space(self._K[n:, :n]) if len(self._row) else np.eye(n)
        return count_negative_eigenvalues(free.T @ self._K[:n, :n] @ free, UNDETERMINED_PIVOT_RATIO)

    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """See the base."""
        n = len(self.size)
        z = self._inverse @ np.concatenate((f * self.size / self._scale, g / self._row))
        return z[:n] * self.size, z[n:] * self._scale / self._row

    def moved(self, q: Array, x: Array) -> Array:
        """See the base."""
        changed = q.astype(complex)
        self._system.apply(changed, x.astype(complex))
        return changed.real.copy()


class TreeLinearized(Linearized):
    """A large tree.

    Its negative eigenvalues are counted by the inertia of the factors where the structured tangent is exact and
    symmetric, else by those of the assembled matrix. Of more than MAX_ASSEMBLED_COORDINATES coordinates they are found
    from the left of the spectrum of the inverse by ARPACK (Arnoldi), until one that is not negative has converged too.
    """

    def __init__(self, system: TreeSystem, v: Array) -> None:
        self._system, self._v = system, v
        self.size, self._still, self._saddle = system.size, np.zeros(system.n), Saddle(system, exact=True)

    def residual(self, q: Array, lam: Array) -> tuple[Array, Array]:
        """See the base."""
        return self._saddle.residual(0.0, q, self._v, self._still, lam)

    def factor(self, q: Array, lam: Array) -> bool:
        """See the base."""
        self.residual(q, lam)
        return self._saddle.factor(0.0, 0.0)

    def inspect(self, q: Array, lam: Array) -> int:
        """See the base."""
        self._saddle.set_penalties(0.0, q)
        moving = self._system.moves() or bool(self._v.any())
        if self._system.tangent.symmetric and not moving:
            self.residual(q, lam)
            negative = self._saddle.negative if self._saddle.factor(0.0, 0.0, averaged=True) else 0
            self._saddle.factor(0.0, 0.0)
            return negative
        if not self.factor(q, lam):
            return 0
        if self._system.n <= MAX_ASSEMBLED_COORDINATES and self._system.complex_step is not None:
            return self._count_assembled()
        return self._count_by_arnoldi()

    def _count_assembled(self) -> int:
        """Return the negative eigenvalues of the exact matrix at the last state."""
        products, units = self._saddle.products, self.size
        if not self._saddle.is_incomplete:
            products.set_state(*self._saddle.state)
        K = products.matrix(1.0, 0.0, 0.0)
        basis = allowed_motions(self._saddle.terms.J, units, self._system.row_size)
        return count_negative_eigenvalues(basis.T @ K @ basis, UNDETERMINED_PIVOT_RATIO)

    def _count_by_arnoldi(self) -> int:
        """Return the negative eigenvalues of the inverse in units."""
        from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

        n, none = self._system.n, np.zeros(self._system.m)
        inverse = LinearOperator(
            (n, n), matvec=lambda z: self._saddle.solve(z / self.size, none)[0] / self.size, dtype=float
        )
        negative = 0
        for count in REQUESTED_EIGENVALUES:
            dimension = min(max(MIN_KRYLOV_DIMENSION, 2 * count + 1), n)
            try:
                values = eigs(
                    inverse,
                    k=min(count, dimension - 2),
                    which="SR",
                    v0=np.random.default_rng(1).normal(size=n),
                    ncv=dimension,
                    maxiter=MAX_SIGN_RESTARTS,
                    tol=EIGENVALUE_SIGN_TOLERANCE,
                    return_eigenvectors=False,
                )
            except ArpackNoConvergence as partial:
                values = partial.eigenvalues
            is_left = values.real < -ZERO_EIGENVALUE_RATIO * np.abs(values).max(initial=0.0)
            negative = int(np.sum(is_left & (values.imag == 0.0)))
            if not is_left.all():
                break
        return negative

    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """See the base."""
        return self._saddle.solve(f, g)

    def moved(self, q: Array, x: Array) -> Array:
        """See the base."""
        changed = q.copy()
        self._system.apply(changed, x)
        return changed
