"""Shapes of bodies in pictures, without effect on the motion.

A shape is a unit solid (sphere of radius 1, cylinder of radius 1 and length 1 along z, cube of side 1, square of side 1
across z, all centered at the origin) brought to its size and place in the body's frame.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError
from mbfmu.util.mesh_files import TriangleMesh, read_mesh

from .axes import along, unit_axis
from .checks import lengths, rotation
from .numbers import array_of, finite, positive

Vector = Sequence[float]
Matrix = NDArray[np.float64]

SURFACE_OPACITY = 0.12  # opacity of surfaces that others touch: those are seen through them
SHAPES = ("Box", "Capsule", "Cylinder", "Ellipsoid", "MeshFile", "Panel", "Sphere")  # names of the classes
PANEL_THICKNESS_RATIO = 1e-3  # of a panel's shorter side: its thickness to a click


class Piece(NamedTuple):
    """Part of a shape: a unit solid, its center (3,), m, and the 3x3 matrix of its axes and size, body axes."""

    solid: str
    at: Matrix
    axes: Matrix
    mesh: TriangleMesh | None = None  # the solid, in a cube of side 1 at the origin, if it is none of the unit solids


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A solid fixed to a body.

    Parameters
    ----------
    at
        Center in the body's frame, m.
    color
        Color ``"#rrggbb"``; empty: the color of the body.
    opacity
        Opacity from 0 (invisible) to 1 (opaque); translucent shapes cast no shadow.
    """

    at: Vector = (0.0, 0.0, 0.0)
    color: str = ""
    opacity: float = 1.0

    solid: ClassVar[str]

    def __post_init__(self) -> None:
        """Check color and opacity; raises UserError."""
        check_color(self.color)
        if not 0.0 <= finite("opacity of a shape", self.opacity) <= 1.0:
            raise UserError(f"opacity of a shape is {self.opacity!r}; allowed: 0 to 1")

    def axes(self) -> Matrix:
        """Return the 3x3 matrix that takes the unit solid to its size and orientation in the body's frame."""
        raise NotImplementedError

    def pieces(self) -> list[Piece]:
        """Return the unit solids of which the shape consists."""
        return [Piece(self.solid, np.asarray(self.at, float), self.axes())]


@dataclass(frozen=True, kw_only=True)
class Sphere(Shape):
    """Sphere.

    Parameters
    ----------
    radius
        Radius, m.
    """

    radius: float
    solid = "sphere"

    def axes(self) -> Matrix:
        """See :class:`Shape`."""
        return positive("radius of a sphere", self.radius) * np.eye(3)


@dataclass(frozen=True, kw_only=True)
class Cylinder(Shape):
    """Circular cylinder.

    Parameters
    ----------
    radius, length
        Radius and length, m.
    axis
        Axis in the body's frame: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
    """

    radius: float
    length: float
    axis: str | Vector = "z"
    solid = "cylinder"

    def axes(self) -> Matrix:
        """See :class:`Shape`."""
        radius, length = positive("radius of a cylinder", self.radius), positive("length of a cylinder", self.length)
        return along(unit_axis(self.axis, "axis of a cylinder")) * [radius, radius, length]


@dataclass(frozen=True, kw_only=True)
class Ellipsoid(Shape):
    """Ellipsoid.

    Parameters
    ----------
    size
        Lengths of the three axes (3,), which are twice the radii, m.
    rotation
        3x3 rotation matrix whose columns are the directions of the axes in the body's frame; None: the body's axes.
    """

    size: Vector
    rotation: Any = None
    solid = "sphere"

    def axes(self) -> Matrix:
        """See :class:`Shape`."""
        return rotation("rotation of an ellipsoid", self.rotation) * (0.5 * lengths("size of an ellipsoid", self.size))


@dataclass(frozen=True, kw_only=True)
class Capsule(Cylinder):
    """Circular cylinder with a hemisphere at each end.

    Parameters
    ----------
    radius, length
        Radius, and length of the cylinder without the hemispheres, m.
    axis
        Axis in the body's frame: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
    """

    def pieces(self) -> list[Piece]:
        """See :class:`Shape`."""
        (cylinder,) = super().pieces()
        ball, half = self.radius * np.eye(3), 0.5 * cylinder.axes[:, 2]
        return [cylinder, *(Piece("sphere", cylinder.at + sign * half, ball) for sign in (-1.0, 1.0))]


@dataclass(frozen=True, kw_only=True)
class Box(Shape):
    """Rectangular box.

    Parameters
    ----------
    size
        Lengths of the edges (3,), m.
    rotation
        3x3 rotation matrix whose columns are the directions of the edges in the body's frame; None: the body's axes.
    """

    size: Vector
    rotation: Any = None
    solid = "box"

    def axes(self) -> Matrix:
        """See :class:`Shape`."""
        return rotation("rotation of a box", self.rotation) * lengths("size of a box", self.size)


@dataclass(frozen=True, kw_only=True)
class Panel(Shape):
    """Rectangle without thickness, visible from both sides.

    Parameters
    ----------
    size
        Lengths of the edges (2,), m.
    rotation
        3x3 rotation matrix whose first two columns are the directions of the edges in the body's frame; None: the
        body's axes.
    """

    size: Vector
    rotation: Any = None
    solid = "panel"

    def axes(self) -> Matrix:
        """See :class:`Shape`."""
        a, b = (positive("size of a panel", length) for length in self.size)
        return rotation("rotation of a panel", self.rotation) * [a, b, PANEL_THICKNESS_RATIO * min(a, b)]


@dataclass(frozen=True)
class MeshFile(Shape):
    """Triangles of a file, which is read when a picture is drawn.

    If the file cannot be read then, the body is drawn as one without shapes, and a warning is given.

    Parameters
    ----------
    path
        STL file (text or binary) or OBJ file.
    scale
        Factor or factors (3,) of the coordinates in the file: 0.001 for a file in mm; negative factors mirror.
    rotation
        3x3 rotation matrix whose columns are the axes of the file in the body's frame; None: the body's axes.
    """

    path: Path | str
    scale: float | Vector = 1.0
    rotation: Any = None
    solid = "mesh"

    def axes(self) -> Matrix:
        """Return the 3x3 matrix that takes points of the file to the body's frame, without ``at``."""
        what = f"mesh file {str(self.path)!r}"
        return rotation(f"rotation of {what}", self.rotation) * scale_factors(f"scale of {what}", self.scale)

    def pieces(self) -> list[Piece]:
        """See :class:`Shape`; raises UserError if the file cannot be read."""
        mesh, axes = read_mesh(self.path), self.axes()
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        middle, size = 0.5 * (low + high), np.maximum(high - low, PANEL_THICKNESS_RATIO * (high - low).max())
        unit = TriangleMesh((mesh.points - middle) / size, mesh.triangles)
        return [Piece(str(self.path), axes @ middle + np.asarray(self.at, float), axes * size, unit)]


def scale_factors(what: str, scale: float | Vector | Matrix) -> Matrix:
    """Check one factor or three factors that are not zero; return three."""
    factors = array_of(what, scale)
    if factors.shape not in ((), (3,)) or not np.all(np.isfinite(factors)) or np.any(factors == 0.0):
        raise UserError(f"{what} is {scale!r}; allowed: one number or three numbers other than zero")
    return np.broadcast_to(factors, (3,)).astype(float)


def ribbon(points: Matrix, across: Matrix, width: float, **appearance: Any) -> tuple[Panel, ...]:
    """Return panels from each of the points (k, 3), m, to the next, which are so wide along a unit vector across."""
    panels = []
    for start, end in pairwise(points):
        length = float(np.linalg.norm(end - start))
        way = (end - start) / length
        axes = np.column_stack((way, across, np.cross(way, across)))
        panels.append(Panel(size=(length, width), at=0.5 * (start + end), rotation=axes, **appearance))
    return tuple(panels)


def check_color(color: str) -> str:
    """Return a color ``#rrggbb`` or nothing as it is."""
    if not isinstance(color, str) or not re.fullmatch(r"(#[0-9a-fA-F]{6})?", color):
        raise UserError(f"color is {color!r}; write #rrggbb")
    return color
