"""In a plane: a point of body b stays in the plane normal to an axis of the cut frame in body a."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import AxisCut, CutJointRecord, constrain_along, relative_motion

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    constrain_along(cut, 2, A, relative_motion(cut, A, B), state.rows[row])


@dataclass(frozen=True, kw_only=True)
class PlaneCutJoint(AxisCut):
    """Point in a plane: a point of body b remains in a plane of body a; normal: ``axis`` of the cut frame in body a."""

    named = ("z",)
    units = ("N",)
    planes = "a"
    evaluate = evaluate
