"""The equations of a steady state and their Jacobian, as paths take them: of small and of large systems.

    K x + J^T y = f,      J x = g,      K the derivative of h + J^T lambda by the coordinates
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from scipy import linalg

from solvers.projection.saddle import Saddle
from solvers.system import Array, TreeSystem

from .small import PIVOT, DenseEquilibriumSolver


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
        self._inverse = np.linalg.pinv(K, rcond=PIVOT)
        return True

    def inspect(self, q: Array, lam: Array) -> int:
        """See the base."""
        self.factor(q, lam)
        n = len(self.size)
        free = linalg.null_space(self._K[n:, :n]) if len(self._row) else np.eye(n)
        values = np.linalg.eigvals(free.T @ self._K[:n, :n] @ free)
        return int(np.sum((values.real < -PIVOT) & (values.imag == 0.0)))

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

    ``negative`` returns the negative eigenvalues of its tangent as it was last factored, as a symmetric one.
    """

    def __init__(self, system: TreeSystem, v: Array, negative: Callable[[], int]) -> None:
        self._system, self._v, self._negative = system, v, negative
        self.size, self._still, self._saddle = system.size, np.zeros(system.n), Saddle(system)

    def residual(self, q: Array, lam: Array) -> tuple[Array, Array]:
        """See the base."""
        return self._saddle.residual(0.0, q, self._v, self._still, lam)

    def factor(self, q: Array, lam: Array) -> bool:
        """See the base."""
        return self._factor(q, lam, symmetric=False)

    def _factor(self, q: Array, lam: Array, symmetric: bool) -> bool:
        self.residual(q, lam)
        return self._saddle.factor(0.0, 0.0, symmetric)

    def inspect(self, q: Array, lam: Array) -> int:
        """See the base. At rest K is symmetric but for follower loads, of which one triangle is taken."""
        self._saddle.weigh(0.0, q)
        if not self._factor(q, lam, symmetric=True):
            return 0
        return self._negative() - self._saddle.against

    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """See the base."""
        return self._saddle.solve(f, g)

    def moved(self, q: Array, x: Array) -> Array:
        """See the base."""
        changed = q.copy()
        self._system.apply(changed, x)
        return changed
