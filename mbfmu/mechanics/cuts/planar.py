"""Planar: the planes normal to an axis of the two cut frames stay one plane; body b may slide and turn in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import AxisCut, CutJointRecord, constrain_along, constrain_perpendicular, relative_motion

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. z_b is perpendicular to x_a and y_a."""
    constrain_along(cut, 2, A, relative_motion(cut, A, B), state.rows[row])
    constrain_perpendicular(cut, 0, 2, A, B, state.rows[row + 1])
    constrain_perpendicular(cut, 1, 2, A, B, state.rows[row + 2])


@dataclass(frozen=True, kw_only=True)
class PlanarCutJoint(AxisCut):
    """Planar cut joint: two planes that slide and rotate on each other; normal: ``axis`` of the cut frames."""

    named = ("z", "xz", "yz")
    units = ("N", "N.m", "N.m")
    evaluate = evaluate
    planes = "ab"
    parallel = "z"
