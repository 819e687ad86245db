"""Cylindrical: an axis of the two cut frames stays one line, through P and through Q."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import AxisCut, CutJointRecord, constrain_along, constrain_perpendicular, relative_motion

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. z_a is perpendicular to x_b and y_b."""
    motion = relative_motion(cut, A, B)
    constrain_along(cut, 0, A, motion, state.rows[row])
    constrain_along(cut, 1, A, motion, state.rows[row + 1])
    constrain_perpendicular(cut, 2, 0, A, B, state.rows[row + 2])
    constrain_perpendicular(cut, 2, 1, A, B, state.rows[row + 3])


@dataclass(frozen=True, kw_only=True)
class CylindricalCutJoint(AxisCut):
    """Cylindrical cut joint: body b translates along ``axis`` of the cut frames and rotates about it."""

    named = ("x", "y", "zx", "zy")
    units = ("N", "N", "N.m", "N.m")
    evaluate = evaluate
    parallel = "z"
