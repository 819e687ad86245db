"""Matrices of a solid body from a mesh: read by meshio, assembled by scikit-fem (extra ``fe``).

Displacements are quadratic in tetrahedra and hexahedra, also in meshes with straight edges: linear tetrahedra are much
too stiff in bending.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.checks import one_of
from mbfmu.mechanics.numbers import is_finite, positive
from mbfmu.util.errors import UserError
from mbfmu.util.extras import import_optional

from .interfaces import Interface
from .recovery import StressRecovery, surface_triangles

Array = NDArray[np.float64]

METERS_OF_UNIT = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
QUADRATIC_ELEMENTS = {
    "MeshTet1": "ElementTetP2",
    "MeshTet2": "ElementTetP2",
    "MeshHex1": "ElementHex2",
    "MeshHex2": "ElementHex2",
}
QUADRATURE_ORDER = 4  # of products of two quadratic displacements
OTHER_CELLS = ("vertex", "line", "triangle", "quad", "polygon")  # beginnings of names of cells that are not solid
FLAT_CELL = 1e-12  # volume relative to that of the largest cell
SOLID_CELLS = ("tetra", "tetra10", "hexahedron", "hexahedron27")


class Assembled(NamedTuple):
    """Matrices of a mesh."""

    M: Any  # (3 n, 3 n)
    K: Any
    nodes: Array  # (n, 3) m
    interfaces: dict[str, Interface]
    geometric_stiffness: Callable[[Array], Any]
    stresses: Callable[[Array], Array]  # at the nodes (n, 6, k), Pa, by displacements (3 n, k), m
    triangles: NDArray[np.int64]  # (k, 3) nodes of the surface


def assemble(
    mesh: Any, density: float, young: float, poisson: float, interfaces: Mapping[str, Any], length_unit: str
) -> Assembled:
    """Assemble a mesh; arguments as for :meth:`FlexibleBody.from_mesh`."""
    skfem, meshio = import_optional("skfem", "fe"), import_optional("meshio", "fe")
    positive("density", density)
    positive("young", young)
    if np.ndim(poisson) or not is_finite(poisson) or not -1.0 < poisson < 0.5:
        raise UserError(f"poisson is {poisson!r}; allowed: greater than -1 and less than 0.5")
    one_of("length_unit", length_unit, tuple(METERS_OF_UNIT))
    read = _read(meshio, mesh) if isinstance(mesh, str | Path) else mesh
    if not isinstance(read, meshio.Mesh):
        raise UserError(f"mesh is {mesh!r}; allowed: a path or a meshio.Mesh")
    read = _checked(meshio, read)
    solid = import_optional("skfem.io.meshio", "fe").from_meshio(read)
    solid = type(solid)(METERS_OF_UNIT[length_unit] * solid.doflocs, solid.t, solid._boundaries, solid._subdomains)
    _check_shapes(skfem, solid)
    element = skfem.ElementVector(getattr(skfem, QUADRATIC_ELEMENTS[type(solid).__name__])())
    basis = skfem.Basis(solid, element, intorder=QUADRATURE_ORDER)
    lame, shear = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)), 0.5 * young / (1.0 + poisson)
    helpers = import_optional("skfem.helpers", "fe")

    def stress(u: Any) -> Any:
        strain = helpers.sym_grad(u)
        return 2.0 * shear * strain + lame * helpers.eye(helpers.trace(strain), 3)

    stiffness = skfem.BilinearForm(lambda u, v, w: helpers.ddot(stress(u), helpers.sym_grad(v)))
    inertia = skfem.BilinearForm(lambda u, v, w: density * helpers.dot(u, v))
    geometric = skfem.BilinearForm(
        lambda u, v, w: np.einsum("ij...,ki...,kj...->...", stress(w["static"]), helpers.grad(u), helpers.grad(v))
    )
    order = _order(basis)
    back = np.argsort(order)

    def geometric_stiffness(u: Array) -> Any:
        return geometric.assemble(basis, static=basis.interpolate(u[back]))[order][:, order]

    nodes = basis.doflocs[:, order[::3]].T
    ties = {name: _tie(name, given, basis, read, nodes, order) for name, given in interfaces.items()}
    M, K = (form.assemble(basis)[order][:, order] for form in (inertia, stiffness))
    recovery = StressRecovery(skfem, basis, order, stress)
    return Assembled(M, K, nodes, ties, geometric_stiffness, recovery, surface_triangles(basis, order))


def _read(meshio: Any, path: str | Path) -> Any:
    try:
        return meshio.read(path)
    except (Exception, SystemExit) as error:  # readers raise errors of any kind for damaged files
        raise UserError(
            f"mesh {str(path)!r} cannot be read ({type(error).__name__}: {error}); allowed: an undamaged file in a "
            "format of meshio"
        ) from error


def _checked(meshio: Any, read: Any) -> Any:
    """Return a mesh without nodes that belong to no solid cell; UserError unless its solid cells are of one kind."""
    kinds = [kind for kind in read.cells_dict if not kind.startswith(OTHER_CELLS)]
    if len(kinds) != 1 or kinds[0] not in SOLID_CELLS:
        found = ", ".join(f"{len(cells)} {kind}" for kind, cells in read.cells_dict.items()) or "none"
        raise UserError(f"mesh has the cells: {found}; allowed: solid cells of one kind, {' or '.join(SOLID_CELLS)}")
    cells = read.cells_dict[kinds[0]]
    repeated = len(cells) - len(np.unique(np.sort(cells, axis=1), axis=0))
    if repeated:
        raise UserError(f"mesh has {repeated} of its {len(cells)} {kinds[0]} cells twice; allowed: each cell once")
    used = np.unique(cells)
    if len(used) == len(read.points):
        return read
    place = np.full(len(read.points), -1)
    place[used] = np.arange(len(used))
    whole = [(place[block.data] >= 0).all(axis=1) for block in read.cells]
    return meshio.Mesh(
        read.points[used],
        [(block.type, place[block.data[kept]]) for block, kept in zip(read.cells, whole, strict=True)],
        point_sets={name: _kept(place, numbers) for name, numbers in read.point_sets.items()},
        cell_sets={
            name: [
                None if numbers is None else _kept(np.where(kept, np.cumsum(kept) - 1, -1), numbers)
                for numbers, kept in zip(sets, whole, strict=True)
            ]
            for name, sets in read.cell_sets.items()
        },
    )


def _kept(place: NDArray[np.int64], numbers: Any) -> NDArray[np.int64]:
    """Return new numbers of what is left of a set."""
    found = place[np.asarray(numbers, np.int64)]
    return found[found >= 0]


def _check_shapes(skfem: Any, solid: Any) -> None:
    """Refuse cells that are flat or whose nodes are in a wrong order, so that a part of their volume is negative."""
    points = skfem.quadrature.get_quadrature(solid.elem.refdom, QUADRATURE_ORDER)[0]
    volumes = np.linalg.det(np.moveaxis(solid.mapping().DF(points), (0, 1), (-2, -1)))  # (cells, points)
    volumes = volumes * np.sign(volumes.sum(axis=1, keepdims=True))
    least = volumes.min(axis=1)
    if least.min() <= FLAT_CELL * volumes.max():
        cell = int(least.argmin())
        corners = ", ".join(f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in solid.p[:, solid.t[:, cell]].T)
        raise UserError(
            f"cell {cell} of the mesh, with the corners {corners} m, is flat, or its nodes are in a wrong order; "
            "allowed: cells whose volume is positive everywhere, also for curved edges"
        )


def _order(basis: Any) -> NDArray[np.int64]:
    """Return the numbers of the degrees of freedom, node by node: of vertices, edges, faces and cells."""
    kinds = (basis.nodal_dofs, basis.edge_dofs, basis.facet_dofs, basis.interior_dofs)
    return np.concatenate([np.asarray(dofs, np.int64).T.ravel() for dofs in kinds])


def _tie(name: str, given: Any, basis: Any, read: Any, nodes: Array, order: NDArray[np.int64]) -> Interface:
    """Return an interface whose nodes are given by the name of a set, a function of positions, or numbers."""
    interface = given if isinstance(given, Interface) else Interface(nodes=given)
    chosen: Any = interface.nodes
    what = f"interface {name!r}"
    if callable(chosen):
        mask = np.asarray(chosen(nodes))
        if mask.shape != (len(nodes),) or mask.dtype != bool:
            raise UserError(f"nodes of {what}: the function returns {mask!r}; allowed: {len(nodes)} truth values")
        return replace(interface, nodes=np.flatnonzero(mask))
    if not isinstance(chosen, str):
        return interface
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order)) // 3
    if chosen in (basis.mesh.boundaries or {}):
        return replace(interface, nodes=np.unique(place[basis.get_dofs(chosen).flatten()]))
    if chosen in read.point_sets:
        held = np.zeros(basis.mesh.p.shape[1], bool)
        held[np.asarray(read.point_sets[chosen], np.int64)] = True
        vertices, edges = place[basis.nodal_dofs[0]], np.asarray(basis.edge_dofs, np.int64)
        within = held[basis.mesh.edges].all(axis=0)
        return replace(interface, nodes=np.concatenate([vertices[held], place[edges[0, within]]]))
    sets = [*map(repr, basis.mesh.boundaries or {}), *map(repr, read.point_sets)]
    raise UserError(
        f"set of {what} is {chosen!r}, which the mesh does not have; allowed: "
        f"{', '.join(sets) or 'none, it has no sets'}. Or give a function of the positions of the nodes"
    )
