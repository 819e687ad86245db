"""Translational: point Q stays on an axis through P and the two cut frames stay parallel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import AxisCut, CutJointRecord, constrain_along, constrain_perpendicular, relative_motion

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. x_a, y_a, z_a are perpendicular to y_b, z_b, x_b."""
    motion = relative_motion(cut, A, B)
    constrain_along(cut, 0, A, motion, state.rows[row])
    constrain_along(cut, 1, A, motion, state.rows[row + 1])
    constrain_perpendicular(cut, 0, 1, A, B, state.rows[row + 2])
    constrain_perpendicular(cut, 1, 2, A, B, state.rows[row + 3])
    constrain_perpendicular(cut, 2, 0, A, B, state.rows[row + 4])


@dataclass(frozen=True, kw_only=True)
class TranslationalCutJoint(AxisCut):
    """Translational cut joint: body b translates along ``axis`` of the cut frames, without relative rotation."""

    named = ("x", "y", "xy", "yz", "zx")
    units = ("N", "N", "N.m", "N.m", "N.m")
    evaluate = evaluate
    parallel = "xyz"
