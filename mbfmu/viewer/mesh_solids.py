"""Meshes of files in pictures: read once each, with fewer triangles if there are many."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.shapes import MeshFile, Shape
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from mbfmu.util.mesh_files import TriangleMesh, read_mesh

from .picture import MeshSolid

MAX_TRIANGLES = 4000  # of a mesh in a picture
CELLS = (96, 64, 48, 32, 24, 16, 12, 8)  # along the edges of a mesh, in which its points are joined
COORDINATE_DIGITS = 5  # of coordinates in a cube of side 1


class MeshSolids:
    """Solids of a picture that files define.

    Attributes
    ----------
    solids
        The solids; the picture names them by their numbers.
    """

    def __init__(self) -> None:
        self.solids: list[MeshSolid] = []
        self._names: dict[str, str] = {}

    def name_of(self, path: str, mesh: TriangleMesh) -> str:
        """Return the name of the solid of a file, which is added when it is first used."""
        if path not in self._names:
            self._names[path] = f"mesh{len(self.solids)}"
            few = with_fewer_triangles(mesh)
            points = tuple(np.round(few.points, COORDINATE_DIGITS).ravel().tolist())
            self.solids.append(MeshSolid(points=points, triangles=tuple(few.triangles.ravel().tolist())))
        return self._names[path]


def with_fewer_triangles(mesh: TriangleMesh, most: int = MAX_TRIANGLES) -> TriangleMesh:
    """Return a mesh of at most ``most`` triangles: points in one cell of a grid become their mean."""
    found, low = mesh, mesh.points.min(axis=0)
    size = float(np.ptp(mesh.points, axis=0).max())
    for cells in CELLS:
        if len(found.triangles) <= most:
            break
        inside = np.minimum((mesh.points - low) * (cells / size), cells - 1).astype(int)
        numbers, counts = np.unique(inside, axis=0, return_inverse=True, return_counts=True)[1:]
        numbers = numbers.reshape(-1)
        points = np.stack([np.bincount(numbers, mesh.points[:, k]) for k in range(3)], axis=1) / counts[:, None]
        triangles = numbers[mesh.triangles]
        first, second, third = triangles.T
        triangles = triangles[(first != second) & (second != third) & (third != first)]
        found = TriangleMesh(points, np.unique(triangles, axis=0))
    return found


def readable_shapes(shapes: Iterable[tuple[Body, Shape]]) -> list[tuple[Body, Shape]]:
    """Return the shapes whose files can be read; a warning is given for others."""
    found = []
    for body, shape in shapes:
        if isinstance(shape, MeshFile):
            try:
                read_mesh(shape.path)
            except UserError as error:
                text = f"{error.diagnostic.text}; body {body.name!r} is drawn without this shape"
                warnings.warn(str(Diagnostic.warning("file-access", text)), stacklevel=2)
                continue
        found.append((body, shape))
    return found
