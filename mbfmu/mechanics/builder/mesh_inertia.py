"""Mass properties of a solid that a closed mesh of triangles bounds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.mechanics.axes import ORIGIN
from mbfmu.mechanics.checks import Matrix, Vector, vector
from mbfmu.mechanics.checks import rotation as rotation_matrix
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.shapes import scale_factors
from mbfmu.util.errors import UserError
from mbfmu.util.mesh_files import TriangleMesh, read_mesh

FLATNESS = 1e-9  # volume relative to the cube of the size: a mesh below it encloses nothing


def solid_mesh(
    path: Path | str,
    *,
    density: float | None = None,
    mass: float | None = None,
    scale: float | Vector = 1.0,
    at: Vector = ORIGIN,
    rotation: Any = None,
) -> dict[str, Any]:
    """Mass properties of a uniform solid whose surface is a closed mesh.

    Parameters
    ----------
    path
        STL file (text or binary) or OBJ file.
    density, mass
        Density, kg/m^3, or mass, kg; one of them.
    scale
        Factor or factors (3,) of the coordinates in the file: 0.001 for a file in mm; negative factors mirror.
    at
        Origin of the file in the body's frame, m.
    rotation
        3x3 rotation matrix whose columns are the axes of the file in the body's frame; None: the body's axes.

    Returns
    -------
    dict
        ``mass`` (kg), ``com`` (3,) (m) and ``inertia`` about it (kg m^2), in the body's frame.

    Raises
    ------
    UserError
        The file cannot be read; the mesh has open edges, faces inward or encloses no volume; a value is not positive.
    """
    what = f"mesh file {str(path)!r}"
    if (density is None) == (mass is None):
        raise UserError(f"{what}: density is {density!r} and mass is {mass!r}; allowed: one of them")
    axes: Matrix = rotation_matrix(f"rotation of {what}", rotation) * scale_factors(f"scale of {what}", scale)
    mesh = read_mesh(path).transformed(axes, np.asarray(vector(f"at of {what}", at), float))
    check_closed(what, mesh)
    volume, center, second = volume_integrals(mesh)
    if volume <= FLATNESS * float(np.ptp(mesh.points, axis=0).max()) ** 3:
        raise UserError(
            f"{what} encloses a volume of {volume:.3g} m^3; allowed: a positive one. Reverse the triangles if they "
            "face inward, and close the surface"
        )
    own = positive(f"density of {what}", density) if mass is None else positive(f"mass of {what}", mass) / volume
    inertia = own * (np.trace(second) * np.eye(3) - second)
    return {"mass": float(own * volume), "com": center, "inertia": inertia}


def volume_integrals(mesh: TriangleMesh) -> tuple[float, np.ndarray, np.ndarray]:
    """Return volume, center (3,), and second moments about the center (3, 3): integral of r r^T over the volume.

    The volume is the sum of tetrahedra between the triangles (a, b, c) and a point in the middle of the mesh, with
    signs. For one of them, D = a . (b x c): V = D / 6, first moment D (a + b + c) / 24, second moment
    D (s s^T + a a^T + b b^T + c c^T) / 120 with s = a + b + c.
    """
    middle = 0.5 * (mesh.points.min(axis=0) + mesh.points.max(axis=0))
    a, b, c = np.moveaxis((mesh.points - middle)[mesh.triangles], 1, 0)
    D, s = np.einsum("ij,ij->i", a, np.cross(b, c)), a + b + c
    volume = float(D.sum()) / 6.0
    if volume == 0.0:
        return 0.0, middle, np.zeros((3, 3))
    center = np.einsum("i,ij->j", D, s) / (24.0 * volume)
    second = sum(np.einsum("i,ij,ik->jk", D, x, x) for x in (s, a, b, c)) / 120.0
    return volume, middle + center, second - volume * np.outer(center, center)


def check_closed(what: str, mesh: TriangleMesh) -> None:
    """Raise UserError if an edge is not between two triangles that have it in opposite directions."""
    edges = np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    count = len(mesh.points)
    ahead, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    numbers = np.unique(ahead, return_counts=True)[1]
    unmatched = np.setdiff1d(ahead, back).size
    if unmatched or numbers.max() > 1:
        raise UserError(
            f"{what} is not closed: {max(unmatched, int(np.sum(numbers > 1)))} of {len(edges)} edges have no triangle, "
            "or several, on their other side; allowed: a surface without holes and with all triangles facing outward. "
            "Repair the mesh where it was made, or give mass and inertia as numbers"
        )
