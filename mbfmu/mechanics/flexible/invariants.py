"""Integrals of the inertia of a body of finite elements, from its consistent mass matrix.

The nodes of a body whose frame moves with (v, w), axes of the frame, and that deforms by u = U p have the velocities

    T v + (R + sum_a e_a Z_a u) w + U p',

with the motions T and R (dof n, 3) by unit translations and rotations of the frame, and Z_a, which multiplies every
displacement and rotation vector by the unit vector a from the left (cross product). The kinetic energy is half the
square of this in M. For nodes with three degrees of freedom it is exact, since shape functions contain the rigid-body
motions. Rotations of nodes are interpolated as vectors; the terms of second order have an error that becomes zero with
the size of the elements.

With geometric stiffening the integrals of second order contain K[F], the geometric stiffness by the static stresses of
a load F: M T_a and M R_a for unit accelerations, -(Z_b M R_a + Z_a M R_b) for the products w_a w_b of the angular
velocity, and unit forces and moments for the interfaces (Wallrapp 1994).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .interfaces import rigid_motion

Array = NDArray[np.float64]

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # components of a symmetric tensor in their order


class Invariants(NamedTuple):
    """What the dynamics need of a body; the symbols are those of :mod:`.solid`."""

    mass: float  # kg
    S0: Array  # (3,) kg m
    J0: Array  # (3, 3) kg m^2
    S1: Array  # (3, modes) kg
    h1: Array  # (3, modes) kg m
    J1: Array  # (6, modes) kg m
    J2: Array  # (6, modes, modes) kg
    C: Array  # (3, modes, modes) kg
    G: Array  # (3, modes, modes) kg/m; zero without geometric stiffening
    H: Array  # (3, modes, modes) kg


def rigid_motions(nodes: Array, dof: int) -> tuple[Array, Array]:
    """Return T and R (dof n, 3) of nodes at (n, 3) from the origin, m."""
    motion = np.concatenate([rigid_motion(x, dof) for x in nodes])
    return motion[:, :3], motion[:, 3:]


def turned(U: Array, axis: int) -> Array:
    """Return Z_a U of motions U (dof n, k)."""
    vectors = np.moveaxis(U.reshape(-1, 3, U.shape[1]), 1, -1)
    crossed: Array = np.moveaxis(np.cross(np.eye(3)[axis], vectors), -1, 1).reshape(U.shape)
    return crossed


def first_moment(M: Any, nodes: Array, dof: int) -> tuple[float, Array, Array]:
    """Return the mass, the first moment (3,) about the origin, and the inertia (3, 3) about it."""
    T, R = rigid_motions(nodes, dof)
    mass = float(np.trace(T.T @ (M @ T)) / 3.0)
    coupled = T.T @ (M @ R)  # -S_0 x
    S = 0.5 * np.array([coupled[1, 2] - coupled[2, 1], coupled[2, 0] - coupled[0, 2], coupled[0, 1] - coupled[1, 0]])
    return mass, S, R.T @ (M @ R)


def invariants(M: Any, nodes: Array, dof: int, U: Array, stiffness_of: Callable[[Array], Array] | None) -> Invariants:
    """Return the integrals of a body.

    Parameters
    ----------
    M
        Mass matrix (dof n, dof n).
    nodes
        Positions (n, 3) from the origin of the frame, m.
    dof
        Degrees of freedom of a node, 3 or 6.
    U
        Modes (dof n, k).
    stiffness_of
        Function that returns the geometric stiffness (k, k) by the static stresses of loads (dof n,); None: no
        geometric stiffening.
    """
    T, R = rigid_motions(nodes, dof)
    mass, S0, J0 = first_moment(M, nodes, dof)
    MU, MR, n = M @ U, M @ R, U.shape[1]
    Z = [turned(U, a) for a in range(3)]
    MZ = [M @ z for z in Z]
    J1, J2 = np.zeros((6, n)), np.zeros((6, n, n))
    for k, (a, b) in enumerate(PAIRS):
        J1[k] = Z[b].T @ MR[:, a] + Z[a].T @ MR[:, b]
        own = Z[a].T @ MZ[b]
        J2[k] = own + own.T
    C = np.zeros((3, n, n))
    for a in range(3):
        own = MU.T @ Z[a]
        C[a] = 0.5 * (own - own.T)
    G, H = np.zeros((3, n, n)), np.zeros((3, n, n))
    if stiffness_of is not None:
        for a in range(3):
            G[a], H[a] = stiffness_of(M @ T[:, a]), stiffness_of(MR[:, a])
        for k, (a, b) in enumerate(PAIRS):
            J2[k] += stiffness_of((turned(MR[:, [a]], b) + turned(MR[:, [b]], a))[:, 0])
    return Invariants(mass, S0, J0, T.T @ MU, R.T @ MU, J1, J2, C, G, H)
