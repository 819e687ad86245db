"""Profiles that wheels roll on, as shapes of their bodies."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.cuts import RollingWheel
from mbfmu.mechanics.shapes import Shape, ribbon

from .picture import Poses

MARGIN = 2.5  # of a profile around the centers of its wheels, in radii
PIECES = 100  # of a profile in a picture
TRACK_COLOR = "#ccd2db"


def profile_shapes(mechanism: Mechanism, poses: Poses | None) -> Iterator[tuple[Body, Shape]]:
    """Yield bodies and shapes; without poses profiles are left out."""
    tracks: dict[Any, list[CutHandle]] = {}
    for handle in mechanism.cuts if poses is not None else ():
        cut = handle.cut
        if isinstance(cut, RollingWheel) and cut.surface is not None:
            Ra, _ = cut.frames()
            frame = Ra.tobytes(), np.asarray(cut.at_a, float).tobytes()
            given = cut.profile if isinstance(cut.profile, str) else id(cut.profile)
            tracks.setdefault((handle.a.index, given, frame), []).append(handle)
    for wheels in tracks.values():
        assert poses is not None  # there are no tracks otherwise
        yield from ((wheels[0].a, shape) for shape in _track(wheels, poses))


def _track(wheels: list[CutHandle], poses: Poses) -> tuple[Shape, ...]:
    """Return the profile below wheels that share it, where they come."""
    first: Any = wheels[0].cut
    (Ra, _), radius = first.frames(), max(wheel.cut.extent() for wheel in wheels)
    places = np.concatenate([_centers(wheel, poses) for wheel in wheels])
    if not len(places):
        return ()
    low, high = places.min(axis=0) - MARGIN * radius, places.max(axis=0) + MARGIN * radius
    x = np.linspace(low[0], high[0], PIECES + 1)
    points = np.column_stack((x, np.full_like(x, 0.5 * (low[1] + high[1])), first.surface.values(x)[0]))
    return ribbon(first.at_a + points @ Ra.T, Ra[:, 1], high[1] - low[1], color=TRACK_COLOR)


def _centers(wheel: CutHandle, poses: Poses) -> NDArray[np.float64]:
    """Return where the center of a wheel comes (k, 3), in the frame of its profile, m."""
    (Ra, _), cut = wheel.cut.frames(), wheel.cut
    r, A = (np.asarray(array, float) for array in poses)
    a, b = wheel.a.index, wheel.b.index
    way = r[:, b] + A[:, b] @ np.asarray(cut.at_b, float) - r[:, a]
    near: NDArray[np.float64] = (np.einsum("tji,tj->ti", A[:, a], way) - np.asarray(cut.at_a, float)) @ Ra
    return near[np.isfinite(near).all(axis=1)]
