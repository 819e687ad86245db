"""Floating: six free motions. Position in the joint frame, orientation as a unit quaternion.

Bae and Cho 2004 (eq. 1-3, 7-8) use A = A_x A_y A_z, singular at theta_y = +-90 deg; a body that tumbles passes
through that, so we do not. Velocities: the origin's velocity in the joint frame, then the angular velocity in the
child's axes.
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
    q, rel = state.q, state.rel[0]
    quaternion_matrix(q, qi + 3, rel.R)
    for k in range(3):
        for i in range(3):
            rel.S[k, i], rel.S[k, 3 + i] = 1.0 if i == k else 0.0, 0.0
            rel.S[3 + k, i], rel.S[3 + k, 3 + i] = 0.0, rel.R[i, k]
        rel.p[k] = q[qi + k]


@dataclass(frozen=True, kw_only=True)
class Floating(Joint):
    """Free motion; positions: x, y, z in m and unit quaternion, velocities: m/s and rad/s in the child's axes."""

    nq = 7
    nv = 6
    quaternion = True
    place = place
    coordinates = ("x", "y", "z", "wx", "wy", "wz")
    units = ("m", "m", "m", "rad", "rad", "rad")
    drawn = "free"
