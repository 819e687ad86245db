"""Finite element models of frames of slender elements: matrices for flexible bodies."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Frame:
    """Frame of slender elements with six degrees of freedom a node: axial, torsion, bending in two planes.

    Parameters
    ----------
    nodes
        Positions (n, 3) of the nodes, m.
    elements
        Pairs of numbers of nodes.
    axial, bending, torsion
        Stiffnesses E A, N, (E I_z, E I_y), N m^2, and G J, N m^2.
    rho, spin
        Mass per length, kg/m, and moment of inertia about the axis per length, kg m.

    Attributes
    ----------
    M, K
        Mass and stiffness matrix (6 n, 6 n).
    """

    def __init__(
        self,
        nodes: Array,
        elements: Iterable[tuple[int, int]],
        *,
        axial: float,
        bending: tuple[float, float],
        torsion: float,
        rho: float,
        spin: float,
    ) -> None:
        self.nodes, self.elements = np.asarray(nodes, float), list(elements)
        self.axial = axial
        n = 6 * len(self.nodes)
        self.M, self.K = np.zeros((n, n)), np.zeros((n, n))
        for i, j in self.elements:
            h = float(np.linalg.norm(self.nodes[j] - self.nodes[i]))
            K, M = np.zeros((12, 12)), np.zeros((12, 12))
            for at, stiff, mass in ((0, axial, rho), (3, torsion, spin)):
                own = np.ix_([at, at + 6], [at, at + 6])
                K[own] += stiff / h * np.array([[1, -1], [-1, 1]])
                M[own] += mass * h / 6 * np.array([[2, 1], [1, 2]])
            for (v, slope, sign), EI in zip(((1, 5, 1), (2, 4, -1)), bending, strict=True):
                own, s = np.ix_([v, slope, v + 6, slope + 6], [v, slope, v + 6, slope + 6]), sign * h
                K[own] += EI / h**3 * hermite(12, 6 * s, 4 * h * h, 2 * h * h)
                M[own] += rho * h / 420 * hermite_mass(s, h)
            self._add(self.K, i, j, K)
            self._add(self.M, i, j, M)

    def axes(self, i: int, j: int) -> Array:
        """Return the axes (3, 3) of an element as rows."""
        x = (self.nodes[j] - self.nodes[i]) / np.linalg.norm(self.nodes[j] - self.nodes[i])
        z = np.cross(x, [0.0, 1.0, 0.0] if abs(x[1]) < 0.9 else [1.0, 0.0, 0.0])
        z /= np.linalg.norm(z)
        return np.array([x, np.cross(z, x), z])

    def _add(self, matrix: Array, i: int, j: int, own: Array) -> None:
        T = np.kron(np.eye(4), self.axes(i, j))
        at = np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
        matrix[np.ix_(at, at)] += T.T @ own @ T

    def geometric_stiffness(self, u: Array) -> Array:
        """Return the geometric stiffness matrix by the axial forces of displacements u (6 n,)."""
        found = np.zeros_like(self.K)
        for i, j in self.elements:
            h, axis = float(np.linalg.norm(self.nodes[j] - self.nodes[i])), self.axes(i, j)[0]
            force = self.axial / h * axis @ (u[6 * j : 6 * j + 3] - u[6 * i : 6 * i + 3])
            own = np.zeros((12, 12))
            for v, slope, sign in ((1, 5, 1), (2, 4, -1)):
                at, s = np.ix_([v, slope, v + 6, slope + 6], [v, slope, v + 6, slope + 6]), sign * h
                own[at] += force / (30 * h) * hermite(36, 3 * s, 4 * h * h, -h * h)
            self._add(found, i, j, own)
        return found


def hermite(a: float, b: float, c: float, d: float) -> Array:
    """Return the stiffness (4, 4) of cubic bending for (w1, slope1, w2, slope2)."""
    return np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]], float)


def hermite_mass(slope: float, h: float) -> Array:
    """Return the consistent mass (4, 4) of cubic bending, divided by rho h / 420."""
    return np.array(
        [
            [156, 22 * slope, 54, -13 * slope],
            [22 * slope, 4 * h * h, 13 * slope, -3 * h * h],
            [54, 13 * slope, 156, -22 * slope],
            [-13 * slope, -3 * h * h, -22 * slope, 4 * h * h],
        ],
        float,
    )


def straight(length: float, count: int, *, stiffness: float = 1.0, rho: float = 1.0, slender: float = 1e4) -> Frame:
    """Return a uniform beam along x from the origin; E I is equal in both planes, E A is ``slender`` E I / length^2."""
    nodes = np.column_stack([np.linspace(0.0, length, count + 1), np.zeros((count + 1, 2))])
    return Frame(
        nodes,
        pairwise(range(count + 1)),
        axial=slender * stiffness / length**2,
        bending=(stiffness, stiffness),
        torsion=stiffness,
        rho=rho,
        spin=1e-6 * rho * length**2,
    )
