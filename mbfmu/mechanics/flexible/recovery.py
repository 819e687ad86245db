"""Stresses at the nodes of a mesh by displacements of its nodes, and the triangles of its surface.

Stresses of quadratic elements are most accurate at the points of Gauss's rule with two points in every direction (four
points of tetrahedra): they are extrapolated from there to the nodes, linearly in every local coordinate, and the mean
of all cells at a node is used (Hinton and Campbell 1974; Zienkiewicz, Taylor, Zhu: The finite element method, 7th ed.,
section 15.2, ISBN 978-1-85617-633-0).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

STRESS_COMPONENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
VON_MISES = "von Mises"
GAUSS_POINT = 0.5 / 3.0**0.5  # distance from the middle of an edge of length 1
TETRAHEDRON_POINT = (5.0 - 5.0**0.5) / 20.0  # small coordinate of the points of the rule of order 2


def von_mises(stress: Array) -> Array:
    """Return the equivalent stress (...,) of stresses (..., 6) in the order of STRESS_COMPONENTS."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(stress, -1, 0)
    squares = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) + 3.0 * (xy**2 + xz**2 + yz**2)
    return np.asarray(np.sqrt(squares))


def _points(is_hexahedron: bool) -> Array:
    """Return the points (3, k) with the most accurate stresses, in local coordinates."""
    if is_hexahedron:
        return np.array(list(product((0.5 - GAUSS_POINT, 0.5 + GAUSS_POINT), repeat=3))).T
    points = np.full((3, 4), TETRAHEDRON_POINT)
    points[range(3), range(3)] = 1.0 - 3.0 * TETRAHEDRON_POINT
    return points


def _polynomials(points: Array, is_hexahedron: bool) -> Array:
    """Return the polynomials (k, 4 or 8), linear in every coordinate, at points (3, k)."""
    x, y, z = points
    linear = [np.ones_like(x), x, y, z]
    return np.stack([*linear, *([x * y, x * z, y * z, x * y * z] if is_hexahedron else [])], axis=1)


class StressRecovery:
    """Stresses at the nodes by displacements.

    Parameters
    ----------
    skfem
        The package scikit-fem.
    basis
        Basis of quadratic displacements.
    order
        Degrees of freedom of the basis, node by node.
    stress_of
        Function of a field of displacements that returns its stresses (3, 3, ...), Pa.
    """

    def __init__(self, skfem: Any, basis: Any, order: Integers, stress_of: Callable[[Any], Any]) -> None:
        self._order, self._stress_of = order, stress_of
        is_hexahedron = "Hex" in type(basis.mesh).__name__
        points = _points(is_hexahedron)
        weights = np.full(points.shape[1], 1.0 / points.shape[1])
        self._basis = skfem.Basis(basis.mesh, basis.elem, quadrature=(points, weights))
        places = np.empty(len(order), np.int64)
        places[order] = np.arange(len(order)) // 3
        self._nodes = places[self._basis.element_dofs[::3]]  # (nodes of a cell, cells)
        corners = np.asarray(basis.elem.elem.doflocs, float).T
        self._extrapolate = _polynomials(corners, is_hexahedron) @ np.linalg.inv(_polynomials(points, is_hexahedron))
        self._count = len(order) // 3
        self._cells = np.bincount(self._nodes.ravel(), minlength=self._count)

    def __call__(self, U: Array) -> Array:
        """Return the stresses (n, 6, k) of displacements (3 n, k), in the order of STRESS_COMPONENTS."""
        found = np.zeros((self._count, len(STRESS_COMPONENTS), U.shape[1]))
        own = np.empty(len(U))
        for k, u in enumerate(U.T):
            own[self._order] = u
            tensor = np.asarray(self._stress_of(self._basis.interpolate(own)))  # (3, 3, cells, points)
            for c, name in enumerate(STRESS_COMPONENTS):
                a, b = ("xyz".index(axis) for axis in name)
                values = self._extrapolate @ tensor[a, b].T
                found[:, c, k] = np.bincount(self._nodes.ravel(), values.ravel(), self._count) / self._cells
        return found


def surface_triangles(basis: Any, order: Integers) -> Integers:
    """Return the triangles (k, 3) between the nodes of the surface; seen from outside they are counterclockwise."""
    mesh = basis.mesh
    places = np.empty(len(order), np.int64)
    places[order] = np.arange(len(order)) // 3
    edges = {tuple(pair): k for k, pair in enumerate(np.sort(mesh.edges, axis=0).T.tolist())}
    found: list[tuple[int, int, int]] = []
    for facet in mesh.boundary_facets():
        cell = int(mesh.f2t[0, facet])
        local = int(np.flatnonzero(mesh.t2f[:, cell] == facet)[0])
        corners = mesh.t[mesh.refdom.facets[local], cell].tolist()
        middle = mesh.p[:, corners].mean(axis=1) - mesh.p[:, mesh.t[:, cell]].mean(axis=1)
        a, b, c = mesh.p[:, corners[:3]].T
        if np.cross(b - a, c - b) @ middle < 0.0:
            corners.reverse()
        nodes = [int(places[basis.nodal_dofs[0, corner]]) for corner in corners]
        pairs = zip(corners, [*corners[1:], corners[0]], strict=True)
        between = [int(places[basis.edge_dofs[0, edges[min(pair), max(pair)]]]) for pair in pairs]
        if len(nodes) == 3:
            found += [(nodes[k], between[k], between[k - 1]) for k in range(3)] + [(between[0], between[1], between[2])]
        else:
            center = int(places[basis.facet_dofs[0, facet]])
            ring = [node for pair in zip(nodes, between, strict=True) for node in pair]
            found += [(center, ring[k], ring[(k + 1) % len(ring)]) for k in range(len(ring))]
    return np.array(found, np.int64)
