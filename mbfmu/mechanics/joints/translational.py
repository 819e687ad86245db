"""Translational: the displacement q along an axis fixed in both bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import AxisJoint, AxisRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


@kernel
def place(joint: AxisRecord, qi: int, state: State) -> None:
    """See :mod:`.base`."""
    q, axis, rel = state.q, joint.axis, state.rel[0]
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = axis[i], 0.0
        for j in range(3):
            rel.R[i, j] = 1.0 if i == j else 0.0
        rel.p[i] = q[qi] * axis[i]


@dataclass(frozen=True, kw_only=True)
class Translational(AxisJoint):
    """Translational (prismatic) joint along ``axis``; coordinate: displacement in m."""

    nq = 1
    nv = 1
    place = place
    coordinates = ("",)
    units = ("m",)
    drawn = "slide"
