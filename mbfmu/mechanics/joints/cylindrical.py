"""Cylindrical: the angle q_0 about an axis fixed in both bodies, and the displacement q_1 along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.spatial import axis_matrix
from solvers.compiled.kernel import kernel

from .base import AxisJoint, AxisRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


@kernel
def place(joint: AxisRecord, qi: int, state: State) -> None:
    """See :mod:`.base`."""
    q, axis, rel = state.q, joint.axis, state.rel[0]
    axis_matrix(axis, np.cos(q[qi]), np.sin(q[qi]), rel.R)
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = 0.0, axis[i]
        rel.S[1, i], rel.S[1, 3 + i] = axis[i], 0.0
        rel.p[i] = q[qi + 1] * axis[i]


@dataclass(frozen=True, kw_only=True)
class Cylindrical(AxisJoint):
    """Cylindrical joint: rotation about and translation along ``axis``; coordinates: angle (rad), displacement (m)."""

    nq = 2
    nv = 2
    place = place
    coordinates = ("angle", "displacement")
    units = ("rad", "m")
    drawn = "slide"
