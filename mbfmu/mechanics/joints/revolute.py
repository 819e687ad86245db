"""Revolute: the angle q about an axis fixed in both bodies."""

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
    axis, rel = joint.axis, state.rel[0]
    axis_matrix(axis, np.cos(state.q[qi]), np.sin(state.q[qi]), rel.R)
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = 0.0, axis[i]
        rel.p[i] = 0.0


@dataclass(frozen=True, kw_only=True)
class Revolute(AxisJoint):
    """Revolute joint: rotation about ``axis``; coordinate: angle in rad."""

    nq = 1
    nv = 1
    place = place
    coordinates = ("",)
    units = ("rad",)
    drawn = "pin"
