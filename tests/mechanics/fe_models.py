"""Small finite element models: frames of Euler-Bernoulli elements, and blocks of tetrahedra."""

from __future__ import annotations

from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.verification.mechanisms.frames import Frame, straight

Array = NDArray[np.float64]

__all__ = ["Block", "Frame", "block", "bracket", "straight"]


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
