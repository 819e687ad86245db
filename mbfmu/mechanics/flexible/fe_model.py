"""Matrices of a finite element model as users give them, checked: sizes, symmetry, rigid-body motions, units."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.numbers import array_of
from mbfmu.util.errors import UserError
from solvers.diagnostics import Diagnostic

from .invariants import rigid_motions

Array = NDArray[np.float64]

WRITTEN_DIGITS = 1e-6  # relative error of numbers that a program has written with seven digits
RESISTANCE = 1e-5  # of rigid-body motions, relative to that of single nodes; from numbers of seven digits
FASTEST_WAVES = 4e4  # m/s; sound in diamond has 1.8e4 m/s, and no material has more than 3.6e4 m/s
WAVE_FACTOR = 10.0  # by which the estimate of the speed may be too large
MASS_ERROR = 1e-4  # of the mass along an axis, and of first moments
MAX_MATRIX_ENTRY = 1e150  # whose square is a number
LENGTH_UNITS = {"mm": 1e-3, "in": 0.0254, "km": 1e3, "cm": 1e-2}


def checked_matrices(mass_matrix: Any, stiffness_matrix: Any, nodes: Any) -> tuple[Any, Any, Array, int]:
    """Return both matrices, sparse and symmetric, the positions (n, 3), and the degrees of freedom of a node."""
    positions = array_of("nodes of the finite element model", nodes)
    if positions.ndim != 2 or positions.shape[1] != 3 or not len(positions):
        raise UserError(f"nodes have the shape {positions.shape}; allowed: positions (n, 3), m")
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        i = int(finite.argmin())
        raise UserError(f"node {i} is at {positions[i].tolist()}; allowed: finite numbers, m")
    M, K = _symmetric("mass matrix", mass_matrix), _symmetric("stiffness matrix", stiffness_matrix)
    size = M.shape[0]
    if K.shape[0] != size:
        raise UserError(f"mass matrix has {size} rows and stiffness matrix {K.shape[0]}; allowed: as many")
    count = len(positions)
    if size not in (3 * count, 6 * count):
        raise UserError(
            f"the matrices have {size} rows and there are {count} nodes; allowed: 3 or 6 degrees of freedom a "
            f"node, {3 * count} or {6 * count} rows, node by node. Keep degrees of freedom that supports remove: the "
            "joints of the mechanism support the body"
        )
    dof = size // count
    loose = np.flatnonzero(~belongs_to_element(M, K, dof))
    if len(loose):
        raise UserError(
            f"node {loose[0]} has neither mass nor stiffness{_others(len(loose) - 1)}; allowed: nodes of elements. "
            "Remove it from nodes and matrices"
        )
    _check_mass(M, positions, dof)
    _check_rigid_motions(K, positions, dof)
    _check_first_moments(M, positions, dof)
    _check_waves(M, K, positions, dof)
    return M, K, positions, dof


def belongs_to_element(M: Any, K: Any, dof: int) -> NDArray[np.bool_]:
    """Return for every node (n,) whether it has mass or stiffness."""
    found: NDArray[np.bool_] = ((M.diagonal() != 0.0) | (K.diagonal() != 0.0)).reshape(-1, dof).any(axis=1)
    return found


def _others(count: int) -> str:
    return f", as {count} other node{'s' * (count > 1)}" if count else ""


def _symmetric(what: str, given: Any) -> Any:
    if not scipy.sparse.issparse(given):
        given = array_of(what, given)
    if given.ndim != 2 or given.shape[0] != given.shape[1]:
        raise UserError(f"{what} has the shape {given.shape}; allowed: a square matrix, dense or sparse")
    matrix = scipy.sparse.csc_array(given, dtype=float)
    if not np.all(np.isfinite(matrix.data)):
        raise UserError(f"{what} contains numbers that are not finite")
    if np.abs(matrix.data).max(initial=0.0) > MAX_MATRIX_ENTRY:
        raise UserError(f"{what} contains {np.abs(matrix.data).max():.3g}; allowed: numbers up to {MAX_MATRIX_ENTRY:g}")
    size, difference = np.abs(matrix).max(), np.abs(matrix - matrix.T)
    if size == 0.0:
        raise UserError(f"{what} is zero")
    if difference.max() > WRITTEN_DIGITS * size:
        worst = difference.tocoo()
        i, j = (int(k[worst.data.argmax()]) for k in worst.coords)
        raise UserError(
            f"{what} is not symmetric: entries ({i}, {j}) and ({j}, {i}) differ by {difference.max():.3g}; allowed: a "
            "symmetric matrix. If a program has written one triangle, add the other"
        )
    return (0.5 * (matrix + matrix.T)).tocsc()


def _check_mass(M: Any, positions: Array, dof: int) -> None:
    if M.diagonal().min() < 0.0:
        i = int(M.diagonal().argmin())
        raise UserError(
            f"the mass matrix is indefinite: entry {i} of its diagonal, of node {i // dof}, is "
            f"{M.diagonal()[i]:.3g}; allowed: a positive semidefinite matrix"
        )
    T = rigid_motions(positions, dof)[0]
    masses = T.T @ (M @ T)
    mean = np.trace(masses) / 3.0
    if not mean > 0.0 or not np.abs(masses - mean * np.eye(3)).max() <= MASS_ERROR * mean:
        raise UserError(
            f"the mass matrix gives the masses {masses[0, 0]:.6g}, {masses[1, 1]:.6g} and {masses[2, 2]:.6g} kg along "
            "x, y and z; allowed: one mass. Check the order of degrees of freedom: all of the first node, then all of "
            "the second; and that no supports are applied"
        )


def _check_first_moments(M: Any, positions: Array, dof: int) -> None:
    """Refuse entries that are missing or wrong: T^T M R is the cross product with the first moment, antisymmetric."""
    T, R = rigid_motions(positions - positions.mean(axis=0), dof)
    moments, terms = T.T @ (M @ R), np.abs(T).T @ (np.abs(M) @ np.abs(R))
    excess = float(np.abs(moments + moments.T).max())
    if not excess <= MASS_ERROR * terms.max():
        raise UserError(
            f"the mass matrix gives first moments that differ by {excess / terms.max():.2g} between the axes; allowed: "
            "a mass matrix of nodes at these positions. Check that all its entries are given, and the order of the "
            "nodes"
        )


def _resistance(K: Any, positions: Array, dof: int) -> float:
    """Return the largest force by a rigid-body motion, relative to the forces of the terms of its sum."""
    T, R = rigid_motions(positions - positions.mean(axis=0), dof)
    motion = np.hstack([T, R])
    forces, terms = K @ motion, np.abs(K) @ np.abs(motion)
    kinds = np.arange(len(motion)) % dof >= 3
    worst = 0.0
    for kind in (False, True):
        own = kinds == kind
        if own.any():
            worst = max(worst, float((np.abs(forces[own]).max(axis=0) / (terms[own].max(axis=0) + 1e-300)).max()))
    return worst


def _check_rigid_motions(K: Any, positions: Array, dof: int) -> None:
    worst = _resistance(K, positions, dof)
    if worst <= RESISTANCE:
        return
    for unit, size in LENGTH_UNITS.items():
        if _resistance(K, size * positions, dof) <= RESISTANCE:
            raise UserError(
                f"the stiffness matrix resists rigid-body motions of the nodes, but not if their positions are in "
                f"{unit}; allowed: m. Multiply nodes by {size:g}"
            )
    raise UserError(
        f"the stiffness matrix resists rigid-body motions, by {worst:.2g} of the forces of single nodes; allowed: a "
        "model without supports and springs to the ground, positions of nodes in m in the order of the degrees of "
        "freedom"
    )


def _check_waves(M: Any, K: Any, positions: Array, dof: int) -> None:
    """Warn if waves would be faster than in any material, which is so if lengths are in mm."""
    if len(positions) < 2:
        return
    spacing = scipy.spatial.KDTree(positions).query(positions, 2)[0][:, 1]
    stiff, mass = (A.diagonal().reshape(-1, dof)[:, :3] for A in (K, M))
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.sqrt(stiff / mass)
    speed = float(np.median(np.where(np.isfinite(rates), rates, np.inf).min(axis=1) * spacing))
    if np.isfinite(speed) and speed > WAVE_FACTOR * FASTEST_WAVES:
        warnings.warn(
            str(
                Diagnostic.warning(
                    "implausible-units",
                    f"waves in the finite element model would travel at about {speed:.2g} m/s, faster than in any "
                    "material",
                    "Check the units: positions in m, the mass matrix in kg, the stiffness matrix in N/m. For models "
                    "in mm, t and s multiply nodes by 1e-3, and both matrices by 1000",
                )
            ),
            stacklevel=5,
        )
