"""What bodies appearance like: pure data for pictures, without effect on the motion.

A shape is a unit solid (sphere of radius 1, cylinder of radius 1 and length 1 along z, cube of side 1, square of side 1
across z, all centered at the origin) brought to its size and place in the body's frame.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError

from .axes import along, unit_axis
from .checks import lengths, rotation
from .numbers import finite, positive

Vector = Sequence[float]
Matrix = NDArray[np.float64]

SURFACE_OPACITY = 0.12  # opacity of surfaces that others touch: those are seen through them
PANEL_THICKNESS_RATIO = 1e-3  # of a panel's shorter side: its thickness to a click


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
