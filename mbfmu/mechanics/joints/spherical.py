"""Spherical: any orientation about a common point, as a unit quaternion, so that no orientation is singular.

Velocities are the angular velocity in the child's axes; it has no bias, because R(w' x w') = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbfmu.mechanics.spatial import quaternion_matrix
from solvers.kernel import kernel

from .base import Joint


@kernel
def move(axis: Any, q: Any, qi: int, v: Any, vi: int, rel: Any) -> None:
    """See :mod:`.base`."""
    quaternion_matrix(q, qi, rel, 7)
    for k in range(3):
        for i in range(3):
            rel[k, 3 + i] = rel[7 + i, k]


@dataclass(frozen=True, kw_only=True)
class Spherical(Joint):
    """Turns about a point; positions: unit quaternion (scalar first), velocities: rad/s in the child's axes."""

    nq = 4
    nv = 3
    quaternion = True
    move = move
    coordinates = ("wx", "wy", "wz")
    units = ("rad", "rad", "rad")
