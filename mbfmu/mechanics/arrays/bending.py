"""Bending angle of plate elements between neighboring nodes, which shows whether a mesh is too coarse.

An element is a polynomial over its cell, so the angle between the normals of neighboring nodes determines its error. At
about 15 degrees the error is 1 %; at 40 a sheet has several states of rest; beyond 60 a cell is folded, and what it
does means nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.records import State
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.mechanism import Mechanism

MAX_ACCURATE_ANGLE, MAX_VALID_ANGLE = np.radians(15.0), np.radians(60.0)
ELEMENT_EDGES = np.array([[0, 1], [3, 2], [0, 3], [1, 2]])  # corners of an element: two edges along x, two along z


@dataclass(frozen=True, kw_only=True)
class BendingAngles:
    """How the edges of all plate elements bend at one time.

    Attributes
    ----------
    nodes
        (P, 4, 2), bodies at the ends of every edge.
    angles
        (P, 4), between their normals, rad.
    """

    mechanism: Mechanism
    nodes: Any
    angles: Any

    @property
    def largest(self) -> float:
        """The sharpest angle, rad; more than COARSE calls for a finer grid, more than FOLDED is past all meaning."""
        return float(self.angles.max(initial=0.0))

    def __str__(self) -> str:
        """Say where, by how much, and what to do."""
        a, b = self.nodes[np.unravel_index(self.angles.argmax(), self.angles.shape)]
        names = [self.mechanism.bodies[k].name for k in (a, b)]
        return (
            f"adjacent cells are rotated by up to {np.degrees(self.largest):.0f} deg between nodes {names[0]!r} and "
            f"{names[1]!r}; allowed: about {np.degrees(MAX_ACCURATE_ANGLE):.0f} deg. {self._advice(a)}"
        )

    def _advice(self, node: int) -> str:
        """Return the grid of the sheet that has ``node`` on which every cell would bend by COARSE at most."""
        for sheet in self.mechanism.sheets:
            own = [body.index for row in sheet.nodes for body in row]
            if node in own:
                inside = np.isin(self.nodes[:, 0, 0], own)
                sharp = self.angles[inside].reshape(-1, 2, 2).max(axis=(0, 2))  # along x, along z
                cells = np.array([len(sheet.nodes), len(sheet.nodes[0])]) - 1
                finer = np.ceil(cells * np.maximum(1.0, sharp / MAX_ACCURATE_ANGLE)).astype(int) + 1
                return f"Refine the grid of {sheet.name!r} to {finer[0]} x {finer[1]} nodes"
        return "Refine the mesh"


def measure_bending(mechanism: Mechanism, cells: NDArray[np.int64], state: State) -> BendingAngles:
    """Return how plates between bodies ``cells`` (P, 4) bend as the bodies of ``state`` are placed."""
    angles = np.zeros((len(cells), len(ELEMENT_EDGES)))
    measure_edges(cells, state.bodies, angles)
    return BendingAngles(mechanism=mechanism, nodes=cells[:, ELEMENT_EDGES], angles=angles)


@kernel
def measure_edges(cells: Any, bodies: Any, angles: Any) -> None:
    """angles (P, 4) at the edges of plates between bodies ``cells`` (P, 4), rad, as the bodies are placed."""
    for i in range(cells.shape[0]):
        for k in range(ELEMENT_EDGES.shape[0]):
            angles[i, k] = edge_angle(cells[i], k, bodies)


@kernel
def find_largest_angle(cells: Any, bodies: Any) -> float:
    """The largest of these angles, rad; zero: there are no plates."""
    largest = 0.0
    for i in range(cells.shape[0]):
        for k in range(ELEMENT_EDGES.shape[0]):
            largest = max(largest, edge_angle(cells[i], k, bodies))
    return largest


@inlined
def edge_angle(cell: Any, k: int, bodies: Any) -> float:
    """Angle between the normals at the ends of an edge, rad."""
    a, b = bodies[cell[ELEMENT_EDGES[k, 0]]].A, bodies[cell[ELEMENT_EDGES[k, 1]]].A
    cosine = a[0, 1] * b[0, 1] + a[1, 1] * b[1, 1] + a[2, 1] * b[2, 1]
    return np.arccos(min(1.0, max(-1.0, cosine)))
