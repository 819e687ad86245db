"""Spherical: any orientation about a common point, as a unit quaternion, so that no orientation is singular.

Velocities are the angular velocity in the child's axes, whose columns turn without effect: R(w' x w') = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbfmu.mechanics.spatial import quaternion_matrix
from solvers.compiled.kernel import kernel

from .base import Joint

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State
    from solvers.compiled.record import Record


@kernel
def place(joint: Record, qi: int, state: State) -> None:
    """See :mod:`.base`."""
    rel = state.rel[0]
    quaternion_matrix(state.q, qi, rel.R)
    for k in range(3):
        for i in range(3):
            rel.S[k, i], rel.S[k, 3 + i] = 0.0, rel.R[i, k]
        rel.p[k] = 0.0


@dataclass(frozen=True, kw_only=True)
class Spherical(Joint):
    """Spherical joint; positions: unit quaternion (scalar first), velocities: rad/s in the child's axes."""

    nq = 4
    nv = 3
    quaternion = True
    place = place
    coordinates = ("wx", "wy", "wz")
    units = ("rad", "rad", "rad")
    drawn = "ball"
