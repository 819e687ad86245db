"""Solids that sketches are made of, in the axes of a body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mbfmu.mechanics import Box, Cylinder, Sphere

Vector = Sequence[float]


def block(size: Vector, at: Vector = (0.0, 0.0, 0.0), color: str = "") -> Box:
    """Return a box."""
    return Box(size=size, at=at, color=color)


def rod(start: Vector, end: Vector, radius: float, color: str = "") -> Cylinder:
    """Return a cylinder between two points."""
    way = np.subtract(end, start)
    middle = tuple(0.5 * np.add(start, end))
    return Cylinder(radius=radius, length=float(np.linalg.norm(way)), axis=tuple(way), at=middle, color=color)


def disc(radius: float, thickness: float, at: Vector = (0.0, 0.0, 0.0), axis: Any = "z", color: str = "") -> Cylinder:
    """Return a flat cylinder."""
    return Cylinder(radius=radius, length=thickness, at=at, axis=axis, color=color)


def ball(radius: float, at: Vector = (0.0, 0.0, 0.0), color: str = "") -> Sphere:
    """Return a sphere."""
    return Sphere(radius=radius, at=at, color=color)


def gear(radius: float, teeth: int, thickness: float, color: str = "") -> list[Any]:
    """Return a spur gear about y."""
    wheel: list[Any] = [disc(radius, thickness, axis="y", color=color)]
    for angle in 2.0 * np.pi * np.arange(teeth) / teeth:
        turned = Rotation.from_rotvec([0.0, -angle, 0.0]).as_matrix()
        at = turned @ [radius, 0.0, 0.0]
        wheel.append(Box(size=(0.22, thickness, 0.16), at=tuple(at), rotation=turned, color=color))
    return wheel
