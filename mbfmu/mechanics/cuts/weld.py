"""Weld: the points coincide and the two cut frames stay parallel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import CutJoint, CutJointRecord, constrain_perpendicular, constrain_point

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. x_a, y_a, z_a are perpendicular to y_b, z_b, x_b."""
    constrain_point(cut, A, B, row, state)
    constrain_perpendicular(cut, 0, 1, A, B, state.rows[row + 3])
    constrain_perpendicular(cut, 1, 2, A, B, state.rows[row + 4])
    constrain_perpendicular(cut, 2, 0, A, B, state.rows[row + 5])


@dataclass(frozen=True, kw_only=True)
class WeldCutJoint(CutJoint):
    """Weld cut joint: rigid connection of two bodies."""

    rows = ("x", "y", "z", "xy", "yz", "zx")
    units = ("N", "N", "N", "N.m", "N.m", "N.m")
    evaluate = evaluate
    parallel = "xyz"
