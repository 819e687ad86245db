"""Bending angle of plate elements between neighboring nodes, which shows whether a mesh is too coarse.

An element is a polynomial over its cell, so the angle between the normals of neighboring nodes determines its error. At
about 15 degrees the error is 1 %; at 40 a sheet has several states of rest; beyond 60 a cell is folded, and what it
does means nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.loads.base import MAX_VALID_RATIO, limit_ratio
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup
    from mbfmu.mechanics.records import Arrays, State

MAX_ACCURATE_ANGLE, MAX_VALID_ANGLE = np.radians(15.0), np.radians(60.0)
ELEMENT_EDGES = np.array([[0, 1], [3, 2], [0, 3], [1, 2]])  # corners of an element: two edges along x, two along z
ADVICE = "Move it more slowly, damp it or make it stiffer; if the motion is intended, use a finer grid"


@kernel
def monitor(element: Any, arrays: Arrays, state: State) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: by the largest angle between the normals at the ends of an edge."""
    largest = 0.0
    for k in range(ELEMENT_EDGES.shape[0]):
        a = state.bodies[element.node[ELEMENT_EDGES[k, 0]]].A
        b = state.bodies[element.node[ELEMENT_EDGES[k, 1]]].A
        cosine = a[0, 1] * b[0, 1] + a[1, 1] * b[1, 1] + a[2, 1] * b[2, 1]
        largest = max(largest, np.arccos(min(1.0, max(-1.0, cosine))))
    return limit_ratio(largest, MAX_ACCURATE_ANGLE, MAX_VALID_ANGLE)


def describe_limit(group: LoadGroup, ratio: float, when: str) -> str:
    """Say where elements bend too far for their mesh, by how much, and what to do."""
    edges = np.array([[body.index for body in acting.bodies] for acting in group.acting])[:, ELEMENT_EDGES]
    normals = group.bodies["A"][:, :, 1]
    angles = np.arccos(np.clip(np.einsum("pek,pek->pe", normals[edges[:, :, 0]], normals[edges[:, :, 1]]), -1.0, 1.0))
    a, b = (group.mechanism.bodies[k] for k in edges[np.unravel_index(angles.argmax(), angles.shape)])
    text = (
        f"adjacent cells are rotated by up to {np.degrees(angles.max()):.0f} deg between nodes {a.name!r} and "
        f"{b.name!r}; allowed: about {np.degrees(MAX_ACCURATE_ANGLE):.0f} deg"
    )
    mesh, advice = group.mesh_of(a), "Refine the mesh"
    if mesh is not None:  # to a grid on which every cell would bend by the accurate angle at most
        own = [body.index for row in mesh.nodes for body in row]
        sharp = angles[np.isin(edges[:, 0, 0], own)].reshape(-1, 2, 2).max(axis=(0, 2))  # along x, along z
        cells = np.array([len(mesh.nodes), len(mesh.nodes[0])]) - 1
        finer = np.ceil(cells * np.maximum(1.0, sharp / MAX_ACCURATE_ANGLE)).astype(int) + 1
        advice = f"Refine the grid of {mesh.name!r} to {finer[0]} x {finer[1]} nodes"
    if ratio > MAX_VALID_RATIO:
        return f"a cell is folded{when}: {text}. {advice}. {ADVICE}"
    return f"the mesh is too coarse{when}: {text}. {advice}"
