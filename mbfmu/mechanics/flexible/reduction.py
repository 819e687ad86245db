"""Craig-Bampton reduction: modes of a finite element model with its interfaces fixed, and motions of the interfaces.

With the internal coordinates i and the motions b of the interfaces (Craig and Bampton 1968)

    u_i = Phi eta + Psi z,     K_ii Phi = M_ii Phi Omega^2,     Psi = -K_ii^-1 K_ib,

where Psi are the static displacements by unit motions z of the interfaces. The rigid-body motions among them are those
of the frame of the body: either the interface that carries the frame does not move (z = 0), or the modes are orthogonal
to the rigid-body motions in M, so that the frame is in the mean position of the body. The natural modes of what remains
are orthogonal in M and K; they span the same motions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.util.errors import UserError

from .interfaces import Tie, rigid_motion, transformation

Array = NDArray[np.float64]

MAX_DENSE = 1500  # internal coordinates up to which all modes are computed by dense matrices
MASSLESS_RATIO = 1e-9  # part of the largest eigenvalue that a mass of zero reaches by rounding errors
LOOSE_PART_PIVOT_RATIO = 1e-13  # of a pivot to its diagonal entry; a cantilever of 1000 elements has 2e-10
EQUAL_DISPLACEMENTS = 1e-6  # relative difference of displacements that symmetry makes equal, by rounding
MIN_STIFFNESS_RATIO = (
    1e-14  # part of the largest squared frequency that a motion without stiffness reaches by rounding errors
)
MIN_MASS_RATIO = 1e-14  # part of the masses of its coordinates that a motion without mass reaches by rounding errors
SUPPORT_RATIO = 1e-4  # of the squared frequency of a rigid-body motion to that of the softest deformation


class Reduced(NamedTuple):
    """A reduced model; the largest displacement of a mode, or rotation times the size of the body, is 1 m."""

    squares: Array  # (modes,) squared angular frequencies, 1/s^2
    shapes: Array  # (dof n, modes) motions of all nodes
    frames: Array  # (interfaces, 6, modes) motions of the interfaces
    statics: Statics | None  # None: no geometric stiffening


def reduce_model(
    M: Any,
    K: Any,
    ties: list[Tie],
    dof: int,
    frame: int,
    center: Array,
    size: float,
    modes: int | None,
    limit: float | None,
    stiffens: bool,
) -> Reduced:
    """Reduce a model of a ``size``, m; ``frame`` is the interface with the body's frame, -1: it is in ``center``."""
    count = M.shape[0] // dof
    B, free = transformation(ties, count, dof)
    My, Ky = (B.T @ M @ B).tocsc(), (B.T @ K @ B).tocsc()
    Kii, Mii = Ky[:free, :free], My[:free, :free]
    factor = Factor(Kii) if free else None
    squares, Phi = fixed_modes(Kii, Mii, factor, modes, limit) if free else (np.zeros(0), np.zeros((0, 0)))
    Psi = -factor.solve(Ky[:free, free:].toarray()) if factor else np.zeros((0, 6 * len(ties)))
    # generalized coordinates (eta, z)
    m, moved = Phi.shape[1], np.arange(6 * len(ties))
    basis = np.zeros((My.shape[0], m + len(moved)))
    basis[:free, :m], basis[:free, m:], basis[free:, m:] = Phi, Psi, np.eye(len(moved))
    Kr = np.zeros((basis.shape[1],) * 2)
    Kr[:m, :m] = np.diag(squares)
    Kr[m:, m:] = Ky[free:, free:].toarray() + Ky[free:, :free] @ Psi
    Mr = basis.T @ (My @ basis)
    check_free(Kr, Mr)
    if frame >= 0:
        kept = np.delete(np.eye(basis.shape[1]), m + 6 * frame + np.arange(6), axis=1)
    else:
        kept = orthogonal_to_rigid(
            Mr, np.vstack([np.zeros((m, 6)), *(rigid_motion(t.origin - center, 6) for t in ties)])
        )
    if not kept.shape[1]:
        raise UserError(
            "the flexible body has no mode: its only interface carries the frame, and modes is 0; give modes or "
            "another interface"
        )
    squares, own = natural_modes(kept.T @ Kr @ kept, kept.T @ Mr @ kept)
    motions = basis @ (kept @ own)
    shapes = B @ motions
    scale = largest_motion(shapes.reshape(count, dof, -1), size)
    frames = motions[free:].reshape(len(ties), 6, -1)
    statics = Statics(Ky, B, free, frame) if frame >= 0 and stiffens else None
    return Reduced(squares, shapes / scale, frames / scale, statics)


class Factor:
    """Factors of a positive definite matrix, sparse or dense by its size."""

    def __init__(self, K: Any) -> None:
        self._size = K.shape[0]
        if self._size <= MAX_DENSE:
            try:
                self._factor: Any = scipy.linalg.cho_factor(K.toarray())
            except np.linalg.LinAlgError:
                raise _not_held() from None
            d = np.diag(self._factor[0]) ** 2 / K.diagonal()
            if d.min() < LOOSE_PART_PIVOT_RATIO:
                raise _not_held()
            return
        options = {"SymmetricMode": True}
        try:
            self._factor = scipy.sparse.linalg.splu(
                K, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
            )
        except RuntimeError:
            raise _not_held() from None
        pivots = self._factor.U.diagonal() / K.diagonal()[np.argsort(self._factor.perm_c)]
        if pivots.min() < LOOSE_PART_PIVOT_RATIO:
            raise _not_held()

    def solve(self, f: Array) -> Array:
        """Return K^-1 f."""
        x: Array = scipy.linalg.cho_solve(self._factor, f) if self._size <= MAX_DENSE else self._factor.solve(f)
        return x


def _not_held() -> UserError:
    return UserError(
        "the stiffness matrix is singular or indefinite although all interfaces are fixed; allowed: a positive "
        "definite one. A part of the mesh may be connected to no interface (nodes that no element uses, parts that are "
        "not joined)"
    )


def fixed_modes(
    Kii: Any, Mii: Any, factor: Factor | None, modes: int | None, limit: float | None
) -> tuple[Array, Array]:
    """Return squared frequencies (k,) and modes (free, k), orthonormal in M, with all interfaces fixed."""
    free = Kii.shape[0]
    if modes is not None and modes > free:
        raise UserError(f"modes is {modes}; the model has {free} degrees of freedom with fixed interfaces")
    if free <= MAX_DENSE:
        squares, Phi = _dense_modes(Kii.toarray(), Mii.toarray(), free if modes is None else modes)
    else:
        squares, Phi = _sparse_modes(Kii, Mii, factor, modes, limit)
    if modes is not None and modes > len(squares):
        raise UserError(f"modes is {modes}; the model has {len(squares)} modes with fixed interfaces")
    count = int(np.searchsorted(squares, limit**2)) if limit is not None else modes
    return squares[:count], Phi[:, :count]


def _dense_modes(K: Array, M: Array, count: int) -> tuple[Array, Array]:
    if count == 0:
        return np.zeros(0), np.zeros((len(K), 0))
    try:
        squares, Phi = scipy.linalg.eigh(K, M, subset_by_index=(0, count - 1))
    except np.linalg.LinAlgError:  # coordinates without mass: their frequencies are infinite
        inverse, Phi = scipy.linalg.eigh(M, K)
        if inverse[0] < -MASSLESS_RATIO * abs(inverse[-1]):
            raise UserError(
                "the mass matrix is indefinite: a motion has a negative kinetic energy; allowed: a positive "
                "semidefinite one. Check that it belongs to the same model and order of degrees of freedom"
            ) from None
        massive = inverse > MASSLESS_RATIO * inverse[-1]
        squares, Phi = 1.0 / inverse[massive][::-1], (Phi[:, massive] / np.sqrt(inverse[massive]))[:, ::-1]
    return squares, Phi


def _sparse_modes(K: Any, M: Any, factor: Any, modes: int | None, limit: float | None) -> tuple[Array, Array]:
    count = modes if modes is not None else 20
    if count == 0:
        return np.zeros(0), np.zeros((K.shape[0], 0))
    operator = scipy.sparse.linalg.LinearOperator(K.shape, matvec=factor.solve)
    start = np.random.default_rng(0).normal(size=K.shape[0])  # the same modes in every run
    while True:
        squares, Phi = scipy.sparse.linalg.eigsh(K, count, M, sigma=0.0, OPinv=operator, v0=start)
        order = np.argsort(squares)
        squares, Phi = squares[order], Phi[:, order]
        if squares[0] <= 0.0:
            raise UserError("the mass matrix is indefinite; allowed: a positive semidefinite one")
        if limit is None or squares[-1] > limit**2:
            return squares, Phi
        count = min(2 * count, K.shape[0] - 1)


def check_free(K: Array, M: Array) -> None:
    """Refuse a reduced model (k, k) that is held by supports, or whose parts are not joined.

    Forces of single nodes do not show weak supports of a slender body: they are compared with its softest deformation.
    """
    if len(K) <= 6:
        return
    size, scaled = scaled_masses(M)
    if scipy.linalg.eigvalsh(scaled)[0] <= MIN_MASS_RATIO:  # reported with the natural modes, unless it is a rigid body
        return
    squares = np.abs(scipy.linalg.eigvalsh(K * np.outer(size, size), scaled))
    squares.sort()
    if squares[6] <= MIN_STIFFNESS_RATIO * squares[-1]:
        raise UserError(
            "the stiffness matrix has more than six motions without energy; allowed: the six rigid-body motions. Parts "
            "of the body may not be joined (nodes at one place that are not one node), or joined by hinges only"
        )
    ratio = squares[5] / squares[6]
    if ratio > SUPPORT_RATIO:
        raise UserError(
            f"the stiffness matrix resists rigid-body motions: their squared frequency is {ratio:.2g} of that of the "
            "softest deformation; allowed: a model without supports and springs to the ground. If a program has "
            "written the matrix, write more digits"
        )


def scaled_masses(M: Array) -> tuple[Array, Array]:
    """Return scales (k,) of coordinates and the mass matrix (k, k) in them; its diagonal is 1, or 0 without mass."""
    diagonal = np.diag(M)
    size = np.where(diagonal > 0.0, 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)), 1.0)
    return size, M * np.outer(size, size)


def natural_modes(K: Array, M: Array) -> tuple[Array, Array]:
    """Return squared frequencies (k,) and modes (k, k), orthonormal in M, of the reduced model."""
    size, scaled = scaled_masses(M)
    if scipy.linalg.eigvalsh(scaled)[0] <= MIN_MASS_RATIO:
        raise UserError(
            "the mass matrix of the reduced model is not positive definite: a motion has no kinetic energy, or a "
            "negative one; allowed: a mass or an inertia for every motion of the interfaces and of the modes. If "
            "masses are lumped at nodes, give fewer modes, and inertias to nodes that rotate"
        )
    squares, own = scipy.linalg.eigh(K * np.outer(size, size), scaled)
    if squares[0] <= MIN_STIFFNESS_RATIO * squares[-1]:
        raise UserError(
            "the stiffness matrix gives no positive energy to a deformation; allowed: one whose only motions without "
            "energy are the six rigid-body motions"
        )
    return squares, size[:, None] * own


def orthogonal_to_rigid(M: Array, rigid: Array) -> Array:
    """Return a basis (k, k - 6) of the motions that are orthogonal to rigid-body motions (k, 6) in M (k, k)."""
    size = 1.0 / np.sqrt(np.abs(np.diag(M)))
    across = (M @ rigid) * size[:, None]
    Q = np.linalg.qr(across / np.linalg.norm(across, axis=0), mode="complete")[0]
    kept: Array = size[:, None] * Q[:, 6:]
    return kept


def largest_motion(shapes: Array, size: float) -> Array:
    """Return the largest motion (modes,) of a node by modes (n, dof, modes): a displacement, or a rotation times the
    size of the body. Of those that are equal but for their sign it is the first.
    """
    moving = np.concatenate([shapes[:, :3], size * shapes[:, 3:]], axis=1).reshape(-1, shapes.shape[2])
    largest = np.abs(moving) > (1.0 - EQUAL_DISPLACEMENTS) * np.abs(moving).max(axis=0)
    return moving[largest.argmax(axis=0), np.arange(moving.shape[1])]


class Statics:
    """Static displacements with the interface of the frame fixed."""

    def __init__(self, Ky: Any, B: Any, free: int, frame: int) -> None:
        self._B, self._free = B, free
        self._kept = np.delete(np.arange(Ky.shape[0]), free + 6 * frame + np.arange(6))
        self._factor = Factor(Ky[self._kept][:, self._kept].tocsc())

    def by_loads(self, load: Array) -> Array:
        """Return the displacements (dof n,) of the nodes by loads (dof n,) on them."""
        return self._solve(self._B.T @ load)

    def by_wrench(self, interface: int, component: int) -> Array:
        """Return the displacements (dof n,) by a unit force or moment on the frame of an interface."""
        load = np.zeros(self._B.shape[1])
        load[self._free + 6 * interface + component] = 1.0
        return self._solve(load)

    def _solve(self, load: Array) -> Array:
        y = np.zeros(len(load))
        y[self._kept] = self._factor.solve(load[self._kept])
        return np.asarray(self._B @ y)
