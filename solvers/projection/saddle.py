"""A large tree with cut joints: its saddle system, its accelerations, its way back onto the constraints.

    T x + J^T y = f,      J x = g,      T the structured tangent of the tree (n), J (m, n) with few rows

is solved with the factors of T_alpha = T + J^T alpha J, which has the same solutions where f becomes
f + J^T alpha g, and is regular where T alone is not (a tree that floats until its cut joints hold it)::

    S y = J T_alpha^-1 (f + J^T alpha g) - g,     x = T_alpha^-1 (f + J^T alpha g - J^T y),     S = J T_alpha^-1 J^T

A redundant row makes S singular; y is then the shortest, in units of alpha. alpha counts only for rounding: the
effective mass of each row, (J M^-1 J^T)_ii^-1, times SPRING.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.linalg.blocks import one_thread
from solvers.outcome import Code
from solvers.stepper import swiftest
from solvers.system import Array, TreeSystem

SPRING = 1e4  # (rad/s)^2, stiffness to effective mass of the springs alpha
REDUNDANT = 1e-10  # eigenvalues of a scaled Schur complement below this part of the largest count as zero
ZERO = 1e-13  # eigenvalues of its inverse below this part of the largest are those of redundant rows
# Square of a row to that of the largest below which nothing works against it here: rounding is 1e-32, units make 1e-6.
VANISHING = 1e-20
PASSES, CLOSED = 12, 1e-11  # of the way back onto the constraints, in units of their rows


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
    inverse: Any = np.linalg.pinv(S, rcond=REDUNDANT) if len(S) else S
    return np.asarray(inverse)


def inverse_squares(squares: Array) -> Array:
    """Return what scales rows of these squares (m,) to one; a row that vanishes here is left small."""
    largest = squares.max(initial=0.0) or 1.0
    return np.asarray(1.0 / np.where(squares > VANISHING * largest, squares, largest))


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
        if _forward(s.forward, t, q, v, s.held_data, self.qdot, self.a) != 0:
            return Code.NO_MASS
        if s.m:
            X = np.zeros((s.m, s.n))
            _mobilities(s.mobility, terms.J, s.held_data, X)
            with one_thread():
                S = terms.J @ X.T
                if not np.isfinite(S).all():
                    return Code.NOT_FINITE
                self.masses = inverse_squares(np.diag(S))
                root = np.sqrt(self.masses)
                self.lam = root * (pseudo_inverse(root[:, None] * S * root) @ (root * (terms.J @ self.a - terms.gamma)))
                self.a -= self.lam @ X
        return Code.OK if np.isfinite(self.a).all() else Code.NOT_FINITE


def rate_of_motion(motion: Accelerations, t: float, q: Array, v: Array) -> float:
    """Return the rate of a tree's motion, 1/s: by gravity and drives, or where there are none as it starts."""
    s = motion.system
    if s.rate > 0.0:
        return s.rate
    a = motion.a if motion.solve(t, q, v) is Code.OK else np.zeros(s.n)
    return float(swiftest(s.size, v, a)) or 1.0


class Saddle:
    """The saddle system of a tree, factored and solved as often as wanted; without constraints T alone."""

    def __init__(self, system: TreeSystem) -> None:
        self.system, self.terms = system, system.allocate_terms()
        self._alpha = np.zeros(0)

    def residual(self, t: float, q: Array, v: Array, a: Array, lam: Array) -> tuple[Array, Array]:
        """Return M a + h + J^T lambda (n,) and Phi (m,); the state is left there, and J."""
        if self.system.m:
            self.system.fill_position(t, q, self.terms)
        return self.system.residual(t, q, v, a, lam), self.terms.Phi.copy()

    def factor(self, c1: float, c2: float, symmetric: bool = False) -> bool:
        """Factor at the last :meth:`residual`; False where T is singular even with the springs.

        ``symmetric``: as if T were.
        """
        tangent, J = self.system.tangent, self.terms.J
        if self.system.m == 0:
            return tangent.factor(c1, c2, symmetric=symmetric)
        if not self._alpha.size:
            raise RuntimeError("Saddle.weigh comes first")
        if not tangent.factor(c1, c2, self._alpha, symmetric):
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
    def positive(self) -> bool:
        """Whether det S is, redundant rows aside; T has on J x = 0 the determinant det T_alpha det S / det J J^T."""
        if self.system.m == 0:
            return True
        root = np.sqrt(self._alpha)
        values = np.linalg.eigvals(self._inverse / np.outer(root, root))
        floor = ZERO * np.abs(values).max()
        return bool(np.sum((values.real < -floor) & (values.imag == 0.0)) % 2 == 0)

    def weigh(self, t: float, q: Array) -> None:
        """Choose alpha at a position."""
        if self.system.m:
            motion = Accelerations(self.system)
            motion.solve(t, q, np.zeros(self.system.n))
            self._alpha = SPRING * motion.masses

    def solve(self, f: Array, g: Array) -> tuple[Array, Array]:
        """Return x (n,) and y (m,)."""
        if self.system.m == 0:
            return self.system.tangent.solve(f), g
        x = self.system.tangent.solve(f + (self._alpha * g) @ self._J)
        y = self._inverse @ (self._J @ x - g)
        return x - self._A @ y, y


def close(system: TreeSystem, t: float, q: Array, v: Array) -> Code:
    """Bring (q, v) onto the constraints, in place: least change of the coordinates (Gauss-Newton, then J v = nu)."""
    if system.m == 0:
        return Code.OK
    terms = system.allocate_terms()
    for _ in range(PASSES):
        system.fill_position(t, q, terms)
        off = float(np.abs(terms.Phi / system.row_size).max())
        if not np.isfinite(off):
            return Code.NOT_FINITE
        with one_thread():
            scale = np.sqrt(inverse_squares(np.einsum("ij,ij->i", terms.J, terms.J)))
            inverse = scale[:, None] * pseudo_inverse(scale[:, None] * (terms.J @ terms.J.T) * scale) * scale
            if off < CLOSED:
                v -= (inverse @ (terms.J @ v - terms.nu)) @ terms.J
                return Code.OK
            system.apply(q, -(inverse @ terms.Phi) @ terms.J)
    return Code.NOT_CLOSED
