"""Directions as users give them, and frames about them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError

from .numbers import array_of

Vector = Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)
X_AXIS_TOLERANCE = 1e-6  # of the component of a unit vector across x, below which it counts as x
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def unit_axis(axis: str | Vector, what: str) -> NDArray[np.float64]:
    """Return the unit vector of 'x', 'y', 'z' or of three numbers."""
    if isinstance(axis, str):
        if axis not in AXES:
            raise UserError(f"{what} is {axis!r}; allowed: 'x', 'y', 'z' or three numbers")
        return np.array(AXES[axis])
    vector = array_of(what, axis)
    norm = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not np.isfinite(norm) or norm == 0.0:
        raise UserError(f"{what} is {axis!r}; it needs three finite numbers, not all zero")
    return vector / norm


def plane_axes(normal: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors in a plane, which with its unit normal are a right-handed frame.

    The first is the x axis projected into the plane, or the y axis where x is the normal; the second normal x first.
    """
    flat = float(np.hypot(normal[1], normal[2]))  # length of the x axis' projection
    first = np.eye(3)[1] if flat < X_AXIS_TOLERANCE else np.eye(3)[0] - normal[0] * normal
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    return first, second / np.linalg.norm(second)


def along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rotation whose third column is a unit vector."""
    other = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(other, direction)
    first /= np.linalg.norm(first)
    return np.column_stack((first, np.cross(direction, first), direction))
