"""Triangles of STL and OBJ files.

Reading the two formats needs about 60 lines; trimesh would be a further package for all users.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .errors import UserError

MESH_FORMATS = (".stl", ".obj")
MAX_MESH_SIZE = 500_000_000  # bytes
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
STL_HEADER = 80  # bytes before the number of triangles
VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE | re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Points (n, 3), and triangles (k, 3) between them; from outside, their corners are in counterclockwise order."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def transformed(self, axes: NDArray[np.float64], at: NDArray[np.float64]) -> TriangleMesh:
        """Return the mesh with its points p at ``axes @ p + at``; corners are in counterclockwise order then, too."""
        is_mirrored = np.linalg.det(axes) < 0.0
        triangles = self.triangles[:, ::-1] if is_mirrored else self.triangles
        return TriangleMesh(self.points @ axes.T + at, triangles)


def read_mesh(path: Path | str) -> TriangleMesh:
    """Return the mesh of an STL file (text or binary) or an OBJ file; corners at the same point are one point.

    Raises
    ------
    UserError
        The file cannot be read, has another format, or contains no triangle.
    """
    path = Path(path)
    try:
        status = path.stat()
        if status.st_size > MAX_MESH_SIZE:
            raise UserError(
                f"mesh file {str(path)!r} has {status.st_size / 1e6:.0f} MB; allowed: {MAX_MESH_SIZE / 1e6:.0f} MB"
            )
        return _read(path, status.st_mtime_ns)
    except (OSError, ValueError) as error:
        if isinstance(error, UserError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"mesh file {str(path)!r} cannot be read: {reason}", "file-access") from error


@lru_cache(maxsize=64)
def _read(path: Path, _modified: int) -> TriangleMesh:
    """Read a file; files are read again after a change."""
    kind = path.suffix.lower()
    if kind not in MESH_FORMATS:
        raise UserError(f"mesh file {str(path)!r} has the format {kind!r}; allowed: {', '.join(MESH_FORMATS)}")
    content = path.read_bytes()
    mesh = _obj(content) if kind == ".obj" else _stl(content)
    if not len(mesh.triangles) or not np.all(np.isfinite(mesh.points)):
        raise UserError(
            f"mesh file {str(path)!r} has {len(mesh.triangles)} triangles, or points that are not finite; allowed: one "
            "triangle or more between finite points. Export the file again"
        )
    return mesh


def is_binary_stl(content: bytes) -> bool:
    """Whether an STL file is binary; in text, the number of triangles would be above 5e8."""
    count = int.from_bytes(content[STL_HEADER : STL_HEADER + 4], "little")
    return STL_HEADER + 4 + count * STL_TRIANGLE.itemsize <= len(content) >= STL_HEADER + 4


def _stl(content: bytes) -> TriangleMesh:
    """Return the mesh of an STL file, which repeats the corners of each triangle."""
    count = int.from_bytes(content[STL_HEADER : STL_HEADER + 4], "little")
    if is_binary_stl(content):
        corners = np.frombuffer(content, STL_TRIANGLE, count, STL_HEADER + 4)["corners"].astype(float)
    else:
        corners = np.array(VERTEX.findall(content), float)
    return _merged(corners.reshape(-1, 3), np.arange(corners.size // 9 * 3).reshape(-1, 3))


def _obj(content: bytes) -> TriangleMesh:
    """Return the mesh of an OBJ file; polygons are divided into triangles."""
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for line in content.decode("utf-8", "replace").splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            points.append([float(number) for number in rest[:3]])
        elif word == "f":
            numbers = [int(corner.partition("/")[0]) for corner in rest]
            corners = [number - 1 if number > 0 else len(points) + number for number in numbers]
            if not all(0 <= corner < len(points) for corner in corners):
                raise ValueError(f"the face {line.strip()!r} has points that do not exist")
            triangles += [(corners[0], a, b) for a, b in pairwise(corners[1:])]
    return _merged(np.array(points, float).reshape(-1, 3), np.array(triangles, np.int64).reshape(-1, 3))


def _merged(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> TriangleMesh:
    """Return a mesh whose equal points are one point, without triangles that have two equal corners."""
    unique, numbers = np.unique(points + 0.0, axis=0, return_inverse=True)
    joined = numbers.reshape(-1)[triangles]
    is_flat = (joined[:, 0] == joined[:, 1]) | (joined[:, 1] == joined[:, 2]) | (joined[:, 2] == joined[:, 0])
    return TriangleMesh(unique, joined[~is_flat])
