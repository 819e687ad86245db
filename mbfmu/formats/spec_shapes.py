"""Shapes of a model of MuJoCo before it is compiled: contact is counted, and what needs files is removed."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbfmu.util.errors import UserError

from .description import Matrix, Vector
from .inertias import does_not_move, has_own_inertia, rotation_of

PLACEHOLDER_SIZE = 1e-3  # m, of the spheres that stand for meshes
DEFAULT_COLOR = (0.5, 0.5, 0.5, 1.0)  # of MuJoCo


class Mesh(NamedTuple):
    """File of a mesh, its scale (3,), and the frame of the mesh, in which the coordinates of the file are given."""

    file: Path
    scale: Vector
    origin: Vector
    axes: Matrix


def count_contacts(spec: Any) -> int:
    """Return the number of shapes that can be in contact."""
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    return sum(bool(geom.contype | geom.conaffinity) or geom.name in paired for geom in spec.geoms)


def remove_shapes(path: Path, mujoco: Any, spec: Any) -> list[tuple[Any, Mesh | None]]:
    """Remove what has no part in the motion: contact, sensors, appearance, and shapes of files that give no inertia.

    A sphere without mass takes the place of a mesh.

    Returns
    -------
    list
        Shapes that are meshes, and their files; None: the mesh has no file.

    Raises
    ------
    UserError
        The file of a mesh that gives an inertia is missing.
    """
    kinds = mujoco.mjtGeom
    for group in (spec.pairs, spec.excludes, spec.sensors):  # they may refer to shapes that are removed
        for element in list(group):
            spec.delete(element)
    meshes = {mesh.name: mesh for mesh in spec.meshes}
    found: list[tuple[Any, Mesh | None]] = []
    needed = set()
    for body in spec.bodies:
        is_given = has_own_inertia(mujoco, spec, body) or does_not_move(body)
        for geom in list(body.geoms):
            if geom.type in (kinds.mjGEOM_SDF, kinds.mjGEOM_HFIELD):
                spec.delete(geom)
            elif geom.type == kinds.mjGEOM_MESH:
                found.append((geom, file_of(path, spec, meshes.get(geom.meshname))))
                if is_given:
                    replace_by_sphere(kinds, geom)
                else:
                    needed.add(geom.meshname)
                    _require_mesh(path, body.name, found[-1][1])
    _remove_appearance(spec)
    for mesh in list(spec.meshes):
        if mesh.name not in needed:
            spec.delete(mesh)
    return found


def replace_by_sphere(kinds: Any, geom: Any) -> None:
    """Replace a mesh by a sphere without mass in its frame."""
    geom.type, geom.meshname, geom.size = kinds.mjGEOM_SPHERE, "", np.full(3, PLACEHOLDER_SIZE)
    geom.mass = geom.density = geom.fluid_ellipsoid = 0.0


def _remove_appearance(spec: Any) -> None:
    """Remove materials and textures, but give shapes the colors of their materials."""
    colors = {material.name: np.array(material.rgba) for material in spec.materials}
    for geom in spec.geoms:
        if geom.material in colors and np.allclose(geom.rgba, DEFAULT_COLOR):
            geom.rgba = colors[geom.material]
    for element in (*spec.geoms, *spec.sites, *spec.tendons):
        element.material = ""
    for group in (spec.skins, spec.hfields, spec.materials, spec.textures):
        for element in list(group):
            spec.delete(element)


def file_of(path: Path, spec: Any, mesh: Any) -> Mesh | None:
    """Return the file of a mesh; None: it is given by its points, or scaled along other axes than those of the file."""
    if mesh is None or not mesh.file:
        return None
    file = path.parent / (spec.meshdir or spec.compiler.meshdir or "") / mesh.file
    # MuJoCo: point = scale * R^T (point of the file - refpos), with the axes R of refquat
    scale, R = np.array(mesh.scale, float), rotation_of(mesh.refquat).T
    if np.ptp(scale) and not np.array_equal(R, np.eye(3)):
        return None
    return Mesh(file, scale, -scale * (R @ np.array(mesh.refpos, float)), R)


def _require_mesh(path: Path, body: str, mesh: Mesh | None) -> None:
    """Raise UserError if a body has its inertia from a mesh whose file is missing."""
    if mesh is not None and not mesh.file.exists():
        raise UserError(
            f"{str(path)!r}: body {body!r} has its mass and inertia from the mesh file {str(mesh.file)!r}, which does "
            "not exist; add the file, or give the body its inertia (<inertial>)"
        )
