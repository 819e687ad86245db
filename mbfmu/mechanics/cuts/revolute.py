"""Revolute: the points coincide and an axis of the two cut frames stays parallel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import AxisCut, CutJointRecord, constrain_perpendicular, constrain_point

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. z_a is perpendicular to x_b and y_b."""
    constrain_point(cut, A, B, row, state)
    constrain_perpendicular(cut, 2, 0, A, B, state.rows[row + 3])
    constrain_perpendicular(cut, 2, 1, A, B, state.rows[row + 4])


@dataclass(frozen=True, kw_only=True)
class RevoluteCutJoint(AxisCut):
    """Revolute cut joint (hinge) about ``axis`` of the cut frames, which has the same direction on both bodies."""

    named = ("x", "y", "z", "zx", "zy")
    units = ("N", "N", "N", "N.m", "N.m")
    evaluate = evaluate
    parallel = "z"
