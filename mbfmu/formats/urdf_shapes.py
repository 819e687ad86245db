"""Shapes for pictures from the elements ``<visual>`` of a URDF file, which MuJoCo does not read."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from mbfmu.util.mesh_files import MESH_FORMATS

from .description import Description, ImportedShape, Matrix, Vector
from .losses import Losses, printable
from .mujoco_shapes import add_missing, color_text
from .tree import Tree

SIZES = {  # class, and the attributes that are its sizes
    "box": ("Box", ("size",)),
    "sphere": ("Sphere", ("radius",)),
    "cylinder": ("Cylinder", ("radius", "length")),
    "capsule": ("Capsule", ("radius", "length")),
    "mesh": ("MeshFile", ("scale",)),
}


def add_visuals(robot: Element, tree: Tree, description: Description, losses: Losses) -> None:
    """Add the shapes of all links: those of <visual>, or of <collision> if a link has no other."""
    missing: list[str] = []
    colors = {
        material.get("name", ""): color.get("rgba", "")
        for material in robot.iter("material")
        if (color := material.find("color")) is not None
    }
    for link in robot.findall("link"):
        number = tree.number_of_body(link.get("name", ""))
        if number < 0:
            continue
        for element in link.findall("visual") or link.findall("collision"):
            geometry = element.find("geometry")
            solid = next(iter(geometry), None) if geometry is not None else None
            if solid is None or solid.tag not in SIZES:
                continue
            at, R = pose_of(element)
            file = None
            if solid.tag == "mesh":
                file = find_mesh(tree.file.path.parent, solid.get("filename", ""))
                if file is None:
                    missing.append(printable(Path(solid.get("filename", "")).name))
                    continue
            name, keys = SIZES[solid.tag]
            rgba = color_of(element, colors)
            description.shapes.append(
                ImportedShape(
                    body=tree.of_body[number],
                    kind=name,  # type: ignore[arg-type]
                    at=at + tree.shift[number],
                    rotation=R,
                    size={key: size_of(solid, key) for key in keys},
                    file=file,
                    color="" if rgba is None else color_text(rgba),
                    opacity=1.0 if rgba is None else round(float(rgba[3]), 3),
                )
            )
    add_missing(missing, losses)


def pose_of(element: Element) -> tuple[Vector, Matrix]:
    """Return position (3,) and axes (3, 3) of the element <origin>: angles about the fixed axes x, y, z."""
    origin = element.find("origin")
    xyz, rpy = (numbers(origin.get(key, "0 0 0") if origin is not None else "0 0 0") for key in ("xyz", "rpy"))
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array(((1.0, 0.0, 0.0), (0.0, cr, -sr), (0.0, sr, cr)))
    y = np.array(((cp, 0.0, sp), (0.0, 1.0, 0.0), (-sp, 0.0, cp)))
    z = np.array(((cy, -sy, 0.0), (sy, cy, 0.0), (0.0, 0.0, 1.0)))
    return xyz, z @ y @ x


def size_of(solid: Element, key: str) -> Any:
    """Return a size of a solid."""
    found = numbers(solid.get(key, "1 1 1" if key == "scale" else "0"))
    return float(found[0]) if len(found) == 1 else found


def color_of(element: Element, colors: dict[str, str]) -> Vector | None:
    """Return the color of a shape; None: it has none."""
    material = element.find("material")
    if material is None:
        return None
    own = material.find("color")
    text = own.get("rgba", "") if own is not None else colors.get(material.get("name", ""), "")
    return numbers(text) if len(text.split()) == 4 else None


def numbers(text: str) -> Vector:
    """Return the numbers of an attribute."""
    return np.array(text.split(), float)


def find_mesh(folder: Path, name: str) -> Path | None:
    """Return the file of a mesh, which may be in a package of ROS; None: it does not exist, or its format is another.

    ``package://robot/meshes/link.stl`` is searched in the folder of the URDF file and in those above it.
    """
    plain = name.partition("://")[2] if "://" in name else name
    inside = plain.partition("/")[2]
    for above in (folder, *folder.resolve().parents):
        for part in (plain, inside) if name.startswith("package://") else (plain,):
            path = above / part
            if part and path.is_file():
                return path.resolve() if path.suffix.lower() in MESH_FORMATS else None
        if not name.startswith("package://"):
            break
    return None
