"""Shapes for pictures from the geometries of a model of MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.util.mesh_files import MESH_FORMATS

from .description import Description, ImportedShape, Vector
from .inertias import rotation_of
from .losses import Losses, listed, printable
from .spec_shapes import DEFAULT_COLOR, Mesh
from .tree import Tree

MAX_SHOWN_GROUP = 2  # groups that MuJoCo shows by default; shapes of contact are usually in a higher one
SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH = range(2, 8)  # mjtGeom


def add_geometries(tree: Tree, description: Description, losses: Losses) -> None:
    """Add the geometries of all bodies as shapes; planes, height fields and invisible ones are left out."""
    model, missing = tree.file.model, []
    for k in range(model.ngeom):
        kind, mesh = int(model.geom_type[k]), tree.file.meshes.get(k)
        is_file = k in tree.file.meshes
        if int(model.geom_group[k]) > MAX_SHOWN_GROUP or model.geom_rgba[k][3] == 0.0:
            continue
        if is_file and (mesh is None or not mesh.file.is_file() or mesh.file.suffix.lower() not in MESH_FORMATS):
            missing.append(printable(mesh.file.name) if mesh is not None else "mesh without a file")
        elif is_file or SPHERE <= kind <= BOX:
            description.shapes.append(_shape(tree, k, kind, mesh))
    add_missing(missing, losses)


def add_missing(missing: list[str], losses: Losses) -> None:
    """Add which mesh files cannot be used."""
    if missing:
        losses.note(
            f"meshes are not drawn ({listed(sorted(set(missing)))})",
            f"Their files do not exist, or have another format than {', '.join(MESH_FORMATS)}",
        )


def _shape(tree: Tree, k: int, kind: int, mesh: Mesh | None) -> ImportedShape:
    """Return the shape of a geometry."""
    model, body = tree.file.model, int(tree.file.model.geom_bodyid[k])
    at, R = model.geom_pos[k] + tree.shift[body], rotation_of(model.geom_quat[k])
    file, color = None, np.asarray(model.geom_rgba[k], float)
    if mesh is not None:
        if kind == MESH:  # MuJoCo moves the frame to the center of mass and the principal axes
            number = int(model.geom_dataid[k])
            R = R @ rotation_of(model.mesh_quat[number]).T
            at = at - R @ model.mesh_pos[number]
        at, R, file = at + R @ mesh.origin, R @ mesh.axes, mesh.file.resolve()
        name, size = "MeshFile", dict[str, Any](scale=mesh.scale)
    else:
        name, size = sizes_of(kind, np.asarray(model.geom_size[k], float))
    return ImportedShape(
        body=tree.of_body[body],
        kind=name,  # type: ignore[arg-type]
        at=at,
        rotation=R,
        size=size,
        file=file,
        color="" if np.allclose(color, DEFAULT_COLOR) else color_text(color),
        opacity=round(float(color[3]), 3),
    )


def sizes_of(kind: int, size: Vector) -> tuple[str, dict[str, Any]]:
    """Return class and sizes of a geometry of MuJoCo, which has half lengths."""
    if kind == SPHERE:
        return "Sphere", {"radius": float(size[0])}
    if kind in (CAPSULE, CYLINDER):
        name = "Capsule" if kind == CAPSULE else "Cylinder"
        return name, {"radius": float(size[0]), "length": 2.0 * float(size[1])}
    return "Box" if kind == BOX else "Ellipsoid", {"size": 2.0 * size}


def color_text(rgba: Vector) -> str:
    """Return a color as ``#rrggbb``."""
    return "#" + "".join(f"{round(255.0 * min(max(float(part), 0.0), 1.0)):02x}" for part in rgba[:3])
