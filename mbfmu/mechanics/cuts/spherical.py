"""Spherical: the points P and Q coincide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import CutJoint, CutJointRecord, constrain_point

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    constrain_point(cut, A, B, row, state)


@dataclass(frozen=True, kw_only=True)
class SphericalCutJoint(CutJoint):
    """Spherical cut joint: the points of both bodies coincide."""

    rows = ("x", "y", "z")
    units = ("N", "N", "N")
    drawn = "ball"
    evaluate = evaluate
