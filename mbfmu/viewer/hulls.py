"""Surfaces of bodies of finite elements, deformed by their modes and colored by displacement or stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.flexible_handle import FlexibleHandle
from mbfmu.mechanics.flexible import FlexibleBody
from mbfmu.mechanics.flexible.recovery import von_mises

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Numbers = tuple[float, ...]

MAX_HULL_TRIANGLES = 6000  # of a hull in a picture
HULL_CELLS = (64, 48, 32, 24, 16, 12, 8, 6, 4)  # along the longest edge of a hull, in which its points are joined
HULL_DIGITS = 6  # significant digits of numbers in a picture
FRAMES_AT_ONCE = 50  # whose values are in memory


@dataclass(frozen=True, kw_only=True)
class Hull:
    """Surface of a body of finite elements.

    Attributes
    ----------
    body
        Its frame.
    first
        Of its amplitudes among those of all bars and hulls.
    points
        Positions of the n points in the frame, one point after the other, m.
    shapes
        Displacements of the points by unit amplitudes, for every mode, one point after the other.
    stresses
        Stresses xx, yy, zz, xy, xz, yz at the points by unit amplitudes, Pa/m, for every mode; empty: the displacement
        colors the hull.
    triangles
        Numbers of their points, one triangle after the other.
    """

    name: str
    body: int
    first: int
    points: Numbers
    shapes: tuple[Numbers, ...]
    stresses: tuple[Numbers, ...]
    triangles: tuple[int, ...]
    color: str

    @property
    def modes(self) -> slice:
        """Its amplitudes among those of all bars and hulls."""
        return slice(self.first, self.first + len(self.shapes))

    @property
    def corners(self) -> Integers:
        """Points (k, 3) of the triangles."""
        return np.reshape(np.array(self.triangles, np.int64), (-1, 3))

    def displaced(self, amplitudes: Array, scale: float) -> Array:
        """Return the points (..., n, 3) in the frame by amplitudes (..., modes); displacements times ``scale``."""
        moved = scale * amplitudes @ np.array(self.shapes)
        placed: Array = np.reshape(self.points, (-1, 3)) + moved.reshape(*moved.shape[:-1], -1, 3)
        return placed

    def values(self, amplitudes: Array) -> Array:
        """Return what colors the points (..., n): the equivalent stress, Pa, or the displacement, m."""
        found = amplitudes @ np.array(self.stresses or self.shapes)
        if self.stresses:
            return von_mises(found.reshape(*found.shape[:-1], -1, 6))
        return np.asarray(np.linalg.norm(found.reshape(*found.shape[:-1], -1, 3), axis=-1))

    @property
    def title(self) -> str:
        """Name and unit of the values."""
        return "von Mises stress [Pa]" if self.stresses else "displacement [m]"


def largest_values(hull: Hull, amplitudes: Array) -> float:
    """Return the largest value of a hull at all times (T, modes)."""
    parts = range(0, len(amplitudes), FRAMES_AT_ONCE)
    return max((float(hull.values(amplitudes[k : k + FRAMES_AT_ONCE]).max(initial=0.0)) for k in parts), default=0.0)


def hull_of(handle: FlexibleHandle, elastic: FlexibleBody, first: int, color: str) -> Hull:
    """Return the hull of a body whose surface is known."""
    assert elastic.triangles is not None
    used, triangles = np.unique(elastic.triangles, return_inverse=True)
    parts = [elastic.nodes[used], elastic.shapes[used].reshape(len(used), -1)]
    if elastic.stress_shapes is not None:
        parts.append(elastic.stress_shapes[used].reshape(len(used), -1))
    triangles, parts = with_fewer_triangles(triangles.reshape(-1, 3), parts)
    n = elastic.modes

    def by_mode(values: Array) -> tuple[Numbers, ...]:
        return tuple(rounded(mode) for mode in values.reshape(len(values), -1, n).reshape(-1, n).T)

    return Hull(
        name=handle.name,
        body=handle.body.index,
        first=first,
        points=rounded(parts[0].ravel()),
        shapes=by_mode(parts[1]),
        stresses=by_mode(parts[2]) if len(parts) > 2 else (),
        triangles=tuple(triangles.ravel().tolist()),
        color=color,
    )


def with_fewer_triangles(triangles: Integers, parts: Sequence[Array]) -> tuple[Integers, list[Array]]:
    """Return at most MAX_HULL_TRIANGLES triangles and the values of their points, of which the first are the positions:
    points in one cell of a grid become their mean.
    """
    found = list(parts)
    points, kept = found[0], triangles
    for cells in HULL_CELLS:
        if len(kept) <= MAX_HULL_TRIANGLES:
            break
        low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
        inside = np.minimum((points - low) * (cells / size), cells - 1).astype(int)
        numbers, counts = np.unique(inside, axis=0, return_inverse=True, return_counts=True)[1:]
        numbers = numbers.reshape(-1)
        found = [
            np.stack([np.bincount(numbers, column) for column in part.T], axis=1) / counts[:, None] for part in parts
        ]
        joined = numbers[triangles]
        a, b, c = joined.T
        kept = np.unique(joined[(a != b) & (b != c) & (c != a)], axis=0)
    return kept, found


def rounded(values: Array) -> Numbers:
    """Return numbers with few digits relative to the largest one."""
    size = float(np.abs(values).max(initial=0.0))
    if size == 0.0:
        return tuple([0.0] * len(values))
    digits = HULL_DIGITS - int(np.floor(np.log10(size)))
    return tuple(np.round(values, digits).tolist())
