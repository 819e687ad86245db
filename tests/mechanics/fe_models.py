"""Small finite element models, assembled here: frames of Euler-Bernoulli elements, and blocks of tetrahedra."""

from __future__ import annotations

from itertools import pairwise, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Frame:
    """Frame of slender elements with six degrees of freedom a node: axial, torsion, bending in two planes."""

    def __init__(
        self,
        nodes: Array,
        elements: Any,
        *,
        axial: float,
        bending: tuple[float, float],
        torsion: float,
        rho: float,
        spin: float,
    ) -> None:
        """Stiffnesses E A, (E I_z, E I_y), G J; mass per length, and moment of inertia about the axis per length."""
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

    def turn(self, i: int, j: int) -> Array:
        """Rotation of an element: rows are its axes."""
        x = (self.nodes[j] - self.nodes[i]) / np.linalg.norm(self.nodes[j] - self.nodes[i])
        z = np.cross(x, [0.0, 1.0, 0.0] if abs(x[1]) < 0.9 else [1.0, 0.0, 0.0])
        z /= np.linalg.norm(z)
        return np.array([x, np.cross(z, x), z])

    def _add(self, matrix: Array, i: int, j: int, own: Array) -> None:
        T = np.kron(np.eye(4), self.turn(i, j))
        at = np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
        matrix[np.ix_(at, at)] += T.T @ own @ T

    def geometric_stiffness(self, u: Array) -> Array:
        """Geometric stiffness by the axial forces of displacements u."""
        found = np.zeros_like(self.K)
        for i, j in self.elements:
            h, axis = float(np.linalg.norm(self.nodes[j] - self.nodes[i])), self.turn(i, j)[0]
            force = self.axial / h * axis @ (u[6 * j : 6 * j + 3] - u[6 * i : 6 * i + 3])
            own = np.zeros((12, 12))
            for v, slope, sign in ((1, 5, 1), (2, 4, -1)):
                at, s = np.ix_([v, slope, v + 6, slope + 6], [v, slope, v + 6, slope + 6]), sign * h
                own[at] += force / (30 * h) * hermite(36, 3 * s, 4 * h * h, -h * h)
            self._add(found, i, j, own)
        return found


def hermite(a: float, b: float, c: float, d: float) -> Array:
    """Stiffness of cubic bending for (w1, slope1, w2, slope2)."""
    return np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]], float)


def hermite_mass(s: float, h: float) -> Array:
    """Consistent mass of cubic bending, by rho h / 420."""
    return np.array(
        [
            [156, 22 * s, 54, -13 * s],
            [22 * s, 4 * h * h, 13 * s, -3 * h * h],
            [54, 13 * s, 156, -22 * s],
            [-13 * s, -3 * h * h, -22 * s, 4 * h * h],
        ],
        float,
    )


def straight(length: float, count: int, *, stiffness: float = 1.0, rho: float = 1.0, slender: float = 1e4) -> Frame:
    """Uniform beam along x from the origin; E I equal in both planes, E A = ``slender`` E I / length^2."""
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


def bracket(size: float = 1.0, young: float = 7e10) -> Frame:
    """L with a strut, of unequal stiffnesses: nodes 0 (foot), 3 (corner), 5 (tip)."""
    nodes = size * np.array(
        [[0, 0, 0], [0, 0.2, 0], [0, 0.4, 0.05], [0, 0.6, 0], [0.25, 0.6, 0], [0.5, 0.65, 0.1]], float
    )
    E = young
    return Frame(
        nodes,
        [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (1, 4)],
        axial=E * 2e-4 * size**2,
        bending=(E * 4e-9 * size**4, E * 2e-9 * size**4),
        torsion=E * 1e-9 * size**4,
        rho=2700 * 2e-4 * size**2,
        spin=2700 * 6e-9 * size**4,
    )


class Block:
    """Block of linear tetrahedra from the origin, six to a cell; three degrees of freedom a node."""

    def __init__(self, size: Any, cells: Any, *, young: float, poisson: float, density: float) -> None:
        axes = [np.linspace(0.0, s, c + 1) for s, c in zip(size, cells, strict=True)]
        self.nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        number = np.arange(len(self.nodes)).reshape([c + 1 for c in cells])
        self.tetrahedra = [
            [number[tuple(np.array(cell) + np.sum(np.eye(3, dtype=int)[list(order[:k])], axis=0))] for k in range(4)]
            for cell in np.ndindex(*cells)
            for order in permutations(range(3))
        ]
        n = 3 * len(self.nodes)
        self.M, self.K = np.zeros((n, n)), np.zeros((n, n))
        lame, shear = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
        D = np.zeros((6, 6))
        D[:3, :3] = lame + 2 * shear * np.eye(3)
        D[3:, 3:] = shear * np.eye(3)
        for corners in self.tetrahedra:
            P = np.column_stack([np.ones(4), self.nodes[corners]])
            volume, slopes = abs(np.linalg.det(P)) / 6, np.linalg.inv(P)[1:]
            B = np.zeros((6, 12))
            for k, (x, y, z) in enumerate(slopes.T):
                B[:, 3 * k : 3 * k + 3] = [[x, 0, 0], [0, y, 0], [0, 0, z], [y, x, 0], [0, z, y], [z, 0, x]]
            at = np.add.outer(3 * np.array(corners), np.arange(3)).ravel()
            self.K[np.ix_(at, at)] += volume * B.T @ D @ B
            self.M[np.ix_(at, at)] += density * volume / 20 * np.kron(np.ones((4, 4)) + np.eye(4), np.eye(3))

    def face(self, axis: int, last: bool) -> Array:
        """Numbers of the nodes on a face."""
        x = self.nodes[:, axis]
        return np.flatnonzero(x == (x.max() if last else x.min()))


def block() -> Block:
    """Rubber-like block of 0.4 x 0.1 x 0.1 m."""
    return Block((0.4, 0.1, 0.1), (4, 1, 1), young=2e8, poisson=0.3, density=1200.0)
