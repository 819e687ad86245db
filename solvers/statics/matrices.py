"""The matrices of the motion linearized about a steady state, exact by complex step, for small and large systems.

    M x'' + C x' + K x + J^T y = 0,      J x = 0

K is the derivative of h + J^T lambda by the coordinates, C that of h by the velocities. Each entry has the rounding of
the recursions behind it, which may be far larger than the entry: where large forces cancel. It is measured, see
:attr:`Matrices.rounding`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from solvers.projection.products import PRODUCT_STEP_SIZE, Products
from solvers.system import Array, System, TreeSystem

MAX_ASSEMBLED_COORDINATES = 300  # coordinates of a large tree up to which its matrices are assembled
MACHINE_EPSILON = float(np.finfo(float).eps)
# change of the state by which rounding is measured, in units of the coordinates
ROUNDING_PERTURBATION = 8.0 * MACHINE_EPSILON
# times that rounding is measured, and its bound relative to the largest found
ROUNDING_SAMPLES, ROUNDING_SAFETY = 2, 16.0
# singular values of J, relative to the largest, below which a row depends on the others
REDUNDANT_SINGULAR_RATIO = 1e-9


@dataclass(frozen=True, kw_only=True)
class Matrices:
    """M, C and K (f, f) over a basis of the motions that the constraints allow, in units of the coordinates.

    Attributes
    ----------
    basis
        (n, f): changes of the coordinates, in their SI units, by those of the basis.
    rounding
        (f, f) bound of the rounding of K, and in the unit of K times s that of C.
    rate
        1/s, of the motions of gravity and drives.
    n_states
        Number of first-order states z, the last of the basis: x' = z, and K has zero columns for them.
    """

    M: Array
    C: Array
    K: Array
    basis: Array
    rounding: tuple[Array, Array]
    rate: float
    n_states: int = 0


def allowed_motions(J: Array, size: Array, row_size: Array, states: int = 0) -> Array:
    """Return a basis (n, f) of the motions with J x = 0 in SI units, orthonormal in units; J (m, n).

    Its last columns are the last ``states`` coordinates, on which J does not depend.
    """
    n = len(size)
    if not len(J):
        return np.diag(size)
    moving = n - states
    scaled = (J * size / row_size[:, np.newaxis])[:, :moving]
    _, sigma, Vt = scipy.linalg.svd(scaled)
    rank = int(np.sum(sigma > REDUNDANT_SINGULAR_RATIO * sigma.max(initial=0.0)))
    found = np.asarray(size[:moving, np.newaxis] * Vt[rank:moving].T)
    return np.asarray(scipy.linalg.block_diag(found, np.diag(size[moving:]))) if states else found


def linearized_matrices(
    system: System | TreeSystem,
    t: float,
    q: Array,
    v: Array,
    lam: Array,
    basis: Array | None = None,
    *,
    measured: bool = True,
) -> Matrices:
    """Return the matrices at time t about q (nq,), v (n,), lam (m,); of a small system, its complex twin is given.

    ``basis`` (n, f): of the motions, where it is known. ``measured``: whether rounding is.
    """
    take = _tree_terms if isinstance(system, TreeSystem) else _dense_terms
    M, C, K, J = take(system, t, q, v, lam)  # type: ignore[arg-type]
    random, size, rate = np.random.default_rng(7), system.size, system.rate
    kind = float if isinstance(system, TreeSystem) else complex
    spreads = [np.zeros_like(K), np.zeros_like(C)]
    for _ in range(ROUNDING_SAMPLES if measured else 0):
        perturbed = q.astype(kind)
        system.apply(perturbed, (ROUNDING_PERTURBATION * random.uniform(-1.0, 1.0, len(size)) * size).astype(kind))
        others = [x * (1.0 + ROUNDING_PERTURBATION * random.uniform(-1.0, 1.0, len(x))) for x in (v, lam)]
        _, C_perturbed, K_perturbed, _ = take(system, t, perturbed.real.copy(), *others)  # type: ignore[arg-type]
        spreads = [np.maximum(spread, np.abs(A - B)) for spread, A, B in
                   zip(spreads, (K, C), (K_perturbed, C_perturbed), strict=True)]  # fmt: skip
    if basis is None:
        basis = allowed_motions(J, size, system.row_size, system.n_states)
    parts, stiff = np.abs(basis), np.sqrt(np.abs(np.diag(K)))
    floor = MACHINE_EPSILON * (16.0 + len(size))
    magnitudes = np.abs(K) + np.outer(stiff, stiff) + rate**2 * np.abs(M), np.abs(C) + rate * np.abs(M)
    doubts = [
        parts.T @ (ROUNDING_SAFETY * spread + floor * A) @ parts for spread, A in zip(spreads, magnitudes, strict=True)
    ]
    M, C, K = (basis.T @ A @ basis for A in (0.5 * (M + M.T), C, K))
    return Matrices(M=M, C=C, K=K, basis=basis, rounding=(doubts[0], doubts[1]), rate=rate, n_states=system.n_states)


def _tree_terms(system: TreeSystem, t: float, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array, Array]:
    """Return M, C, K (n, n) and J (m, n) of a large tree."""
    products, terms = Products(system), system.allocate_terms()
    products.set_state(t, q, v, np.zeros(system.n), lam)
    M, C, K = (products.matrix(*which) for which in np.eye(3)[::-1])
    if system.m:
        system.fill_position(t, q, terms)
    return M, C, K, terms.J


def _dense_terms(system: System, t: float, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array, Array]:
    """Return M, C, K (n, n) and J (m, n) by the complex twin of a small system."""
    terms, n = system.allocate_terms(complex), system.n
    C, K = np.zeros((n, n)), np.zeros((n, n))
    for k, unit in enumerate(PRODUCT_STEP_SIZE * 1j * np.eye(n)):
        system.fill(t, q.astype(complex), v + unit, terms)
        C[:, k] = terms.h.imag / PRODUCT_STEP_SIZE
        moved = q.astype(complex)
        system.apply(moved, unit)
        system.fill(t, moved, v.astype(complex), terms)
        K[:, k] = (terms.h + terms.J.T @ lam).imag / PRODUCT_STEP_SIZE
    return terms.M.real.copy(), C, K, terms.J.real.copy()


def is_undamped(matrices: Matrices) -> bool:
    """Whether C is nothing but rounding."""
    return bool((np.abs(matrices.C) <= matrices.rounding[1]).all())


def is_symmetric(matrices: Matrices) -> bool:
    """Whether K is, but for the rounding of the forces along the stiffer of two coordinates."""
    K, rounding = matrices.K, matrices.rounding[0]
    stiff = np.abs(np.diag(K))
    allowed = rounding + rounding.T + MACHINE_EPSILON * (16.0 + len(K)) * np.maximum.outer(stiff, stiff)
    return bool((np.abs(K - K.T) <= allowed).all())
