"""The lowest modes of a very large tree about a steady state, by shifted inverse iteration.

Where nothing moves or damps, and forces have a potential: K x = -s^2 M x by Lanczos, from below all eigenvalues, so
that those nearest to the shift are the lowest. The inertia of the factors of K + shift M (Sylvester) is the number that
are below it. Otherwise the state matrix by Arnoldi, shifted to the right of the origin.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.projection.products import Products
from solvers.projection.saddle import Saddle
from solvers.system import Array, TreeSystem

from .matrices import MACHINE_EPSILON, ROUNDING_PERTURBATION, ROUNDING_SAFETY
from .spectrum import Spectrum, order_spectrum

MAX_RESTARTS = 100
# of an eigenvalue of the inverse; full precision may not be within the reach of rounding
INVERSE_EIGENVALUE_TOLERANCE = 1e-12
FIRST_SHIFT_RATIO = 1e-10  # first shift relative to what the stiffness of a random motion is worth, (rad/s)^2
# shifts relative to the largest eigenvalue found, which are good, and the one taken
GOOD_SHIFT_RATIOS, USUAL_SHIFT_RATIO = (1e-4, 1.0), 1e-2
MOTION_ERROR_RATIO = 1e-10  # of the shift: what the error of a motion may be worth
SHIFT_GROWTH_FACTOR, MAX_SHIFTS = 16.0, 40  # from shift to shift as long as eigenvalues are below it, and how often
PERTURBED_STATES = 3  # perturbed states by which rounding is measured
# of an eigenvalue by Arnoldi: its tolerance, and a bound of what is left of its error
ARNOLDI_TOLERANCE, ARNOLDI_ERROR_RATIO = 1e-11, 1e-9
EXTRA_EIGENVALUES = 8  # eigenvalues that Arnoldi computes beyond twice the requested number


class LowestModes:
    """The lowest modes of one large tree about the steady state (q, v, lam)."""

    def __init__(self, system: TreeSystem, q: Array, v: Array, lam: Array) -> None:
        self.system, self.saddle, self._state = system, Saddle(system, exact=True), (q, v, lam)
        self.zero = np.zeros(system.n)
        self.saddle.set_penalties(0.0, q)
        self.saddle.residual(0.0, q, v, self.zero, lam)
        self.products = self.saddle.products
        self.products.set_state(0.0, q, v, self.zero, lam)
        self.perturbed_products = [self._perturbed_products(k) for k in range(PERTURBED_STATES)]

    def _perturbed_products(self, seed: int) -> Products:
        """Return products at a state that differs in its last digits."""
        (q, v, lam), random, system = self._state, np.random.default_rng(seed), self.system
        moved = q.copy()
        system.apply(moved, ROUNDING_PERTURBATION * random.uniform(-1.0, 1.0, system.n) * system.size)
        v, lam = (x * (1.0 + ROUNDING_PERTURBATION * random.uniform(-1.0, 1.0, len(x))) for x in (v, lam))
        found = Products(system)
        found.set_state(0.0, moved, v, self.zero, lam)
        return found

    @property
    def is_conservative(self) -> bool:
        """Whether nothing moves or damps, and forces have a potential."""
        system = self.system
        if system.moves() or self._state[1].any() or not system.tangent.symmetric:
            return False
        x = np.random.default_rng(2).normal(size=system.n) * system.size
        damping, doubt = self.quadratic_form(x, 1), self.rounding_bound(x, 1)
        return abs(damping) <= doubt

    def quadratic_form(self, x: Array, which: int) -> complex:
        """Return x^H A x of K, C or M, by number."""
        parts = (
            [self.products.apply(part, *np.eye(3)[which]) for part in (x.real, x.imag)] if np.iscomplexobj(x) else None
        )
        product = parts[0] + 1j * parts[1] if parts else self.products.apply(x, *np.eye(3)[which])
        return complex(np.vdot(x, product))

    def rounding_bound(self, x: Array, which: int) -> float:
        """Return a bound of what rounding leaves open of :meth:`quadratic_form`."""
        here, c = self.quadratic_form(x, which), np.eye(3)[which]

        def perturbed_form(products: Products) -> complex:
            if np.iscomplexobj(x):
                return complex(np.vdot(x, products.apply(x.real, *c) + 1j * products.apply(x.imag, *c)))
            return complex(np.vdot(x, products.apply(x, *c)))

        inertia = abs(self.quadratic_form(x, 2)) * self.system.rate ** (2 - which)
        measured = max(abs(perturbed_form(products) - here) for products in self.perturbed_products)
        return ROUNDING_SAFETY * measured + MACHINE_EPSILON * (16.0 + self.system.n) * (abs(here) + inertia)

    def factor(self, c1: float, c2: float, averaged: bool = False) -> bool:
        """Factor C c1 + M c2 + K at the steady state."""
        q, v, lam = self._state
        self.saddle.residual(0.0, q, v, self.zero, lam)
        return self.saddle.factor(c1, c2, averaged=averaged)

    def first_shift(self) -> float:
        """Return a shift, (rad/s)^2, that is small against the stiffness, and against gravity and drives."""
        x = self.system.size * np.random.default_rng(0).normal(size=self.system.n)
        stiff = abs(self.quadratic_form(x, 0)) / abs(self.quadratic_form(x, 2))
        return max(FIRST_SHIFT_RATIO * stiff, 1e-2 * self.system.rate**2) or 1.0

    def count_below(self, shift: float) -> int:
        """Return how many eigenvalues s^2 of -K and M are above the shift, (rad/s)^2: motions that grow faster."""
        if not self.factor(0.0, shift, averaged=True):
            raise np.linalg.LinAlgError("stiffness and mass are singular together")
        return self.saddle.negative

    def find(self, count: int) -> Spectrum:
        """Return the lowest ``count`` modes."""
        shift = self.first_shift()
        if not self.is_conservative:
            growing = None
            if self.system.tangent.symmetric and not (self.system.moves() or self._state[1].any()):
                growing = self.count_below(shift)  # damping holds none of them (Kelvin, Tait and Chetaev)
            return self.solve_damped(count, np.sqrt(shift), growing)
        growing = below = self.count_below(shift)
        for _ in range(MAX_SHIFTS):
            if not below:
                break
            shift *= SHIFT_GROWTH_FACTOR
            below = self.count_below(shift)
        values, motions = self.solve_conservative(count, shift)
        largest = float(np.abs(values).max(initial=0.0))
        if not growing and largest > 0.0 and not GOOD_SHIFT_RATIOS[0] < shift / largest < GOOD_SHIFT_RATIOS[1]:
            shift = USUAL_SHIFT_RATIO * largest
            values, motions = self.solve_conservative(count, shift)
        return self.classify(motions, shift, growing)

    def solve_conservative(self, count: int, shift: float) -> tuple[Array, Array]:
        """Return the ``count`` values of omega^2 nearest to -shift, and the motions (n, count) of unit modal mass."""
        from scipy.sparse.linalg import LinearOperator, eigsh

        system = self.system
        tangent, n, none = system.tangent, system.n, np.zeros(system.m)
        if not self.factor(0.0, shift):
            raise np.linalg.LinAlgError("stiffness and mass are singular together")
        mass = LinearOperator((n, n), matvec=tangent.inertia, dtype=float)
        inverse = LinearOperator((n, n), matvec=lambda f: self.saddle.solve(f, none)[0], dtype=float)
        start = self.saddle.solve(tangent.inertia(np.random.default_rng(0).normal(size=n)), none)[0]
        options = {"sigma": -shift, "OPinv": inverse, "which": "LM", "v0": start, "tol": INVERSE_EIGENVALUE_TOLERANCE}
        return solve_eigenproblem(lambda: eigsh(mass, k=count, M=mass, maxiter=MAX_RESTARTS, **options), count)

    def classify(self, motions: Array, shift: float, growing: int) -> Spectrum:
        """Return a spectrum of motions of unit modal mass, each by its Rayleigh quotient."""
        found: list[tuple[complex, Array, float]] = []
        for motion in motions.T:
            square, doubt = (
                self.quadratic_form(motion, 0).real,
                self.rounding_bound(motion, 0) + MOTION_ERROR_RATIO * shift,
            )
            if abs(square) <= doubt:
                found.append((0.0, motion, np.sqrt(doubt)))
                continue
            s = np.sqrt(complex(-square))
            found += [(value, motion, doubt / abs(s)) for value in ((-s, s) if square < 0.0 else (s,))]
        s, motions, doubts = (np.array(part) for part in zip(*found, strict=True))
        spectrum = order_spectrum(s.astype(complex), motions.T, doubts)
        return Spectrum(
            values=spectrum.values, motions=spectrum.motions, doubts=spectrum.doubts, complete=False, growing=growing
        )

    def solve_damped(self, count: int, shift: float, growing: int | None) -> Spectrum:
        """Return the eigenvalues of the state matrix nearest to a shift to the right of the origin, 1/s."""
        from scipy.sparse.linalg import LinearOperator, eigs

        system, n = self.system, self.system.n
        none, size = np.zeros(system.m), system.size
        if not self.factor(shift, shift**2):
            raise np.linalg.LinAlgError("stiffness, damping and mass are singular together")

        def inverse(z: Array) -> Array:
            """Return (A - shift)^-1 z of the state matrix A of (x, x' / shift) in units."""
            b1, b2 = z[:n] * size, shift * z[n:] * size
            load = -self.products.apply(b2, 0.0, 0.0, 1.0) - self.products.apply(b1, 0.0, 1.0, shift)
            x = self.saddle.solve(load, none)[0]
            return np.concatenate((x / size, (b1 + shift * x) / (shift * size)))

        k = min(2 * count + EXTRA_EIGENVALUES, 2 * n - 2)
        start = inverse(np.random.default_rng(0).normal(size=2 * n))
        OP: Any = LinearOperator((2 * n, 2 * n), matvec=inverse, dtype=float)
        inverses, vectors = solve_eigenproblem(
            lambda: eigs(OP, k=k, which="LM", v0=start, tol=ARNOLDI_TOLERANCE, maxiter=MAX_RESTARTS), 2 * count
        )
        found = [
            self.classify_eigenvalue(shift + 1.0 / nu, x * size) for nu, x in zip(inverses, vectors[:n].T, strict=True)
        ]
        kept = [one for one in found if one[0].imag >= 0.0]
        s, motions, doubts = (np.array(part) for part in zip(*kept, strict=True))
        spectrum = order_spectrum(s.astype(complex), motions.T, doubts)
        return Spectrum(
            values=spectrum.values, motions=spectrum.motions, doubts=spectrum.doubts, complete=False, growing=growing
        )

    def classify_eigenvalue(self, s: complex, x: Array) -> tuple[complex, Array, float]:
        """Return an eigenvalue with its motion and a bound of what rounding leaves open; zero where it may be that."""
        x = x / np.linalg.norm(x)
        a, b = self.quadratic_form(x, 2), self.quadratic_form(x, 1)
        error = (
            self.rounding_bound(x, 0) + abs(s) * self.rounding_bound(x, 1) + ARNOLDI_ERROR_RATIO * abs(s) ** 2 * abs(a)
        )
        slope = abs(2.0 * a * s + b)
        doubt = 2.0 * error / (slope + np.sqrt(slope**2 + 4.0 * abs(a) * error))
        if abs(s) <= doubt:
            return 0.0, x, doubt
        return complex(s.real, s.imag if abs(s.imag) > doubt else 0.0), x, doubt


def solve_eigenproblem(find: Any, count: int) -> tuple[Array, Array]:
    """Return eigenvalues and vectors that ARPACK finds; LinAlgError where they are fewer than ``count``."""
    from scipy.sparse.linalg import ArpackError, ArpackNoConvergence

    try:
        values, vectors = find()
    except ArpackNoConvergence as stuck:
        values, vectors = stuck.eigenvalues, stuck.eigenvectors
        if len(values) < count:
            raise np.linalg.LinAlgError(f"{len(values)} of {count} converged; ask for fewer") from stuck
    except ArpackError as error:
        raise np.linalg.LinAlgError("stiffness and mass are too far apart; ask for fewer modes") from error
    order = np.argsort(np.abs(values), kind="stable")
    return values[order], vectors[:, order]


def lowest_modes(system: TreeSystem, q: Array, v: Array, lam: Array, count: int) -> Spectrum:
    """Return the lowest ``count`` modes of a large tree about the steady state q (nq,), v (n,), lam (m,).

    LinAlgError where they are not found.
    """
    return LowestModes(system, q, v, lam).find(count)
