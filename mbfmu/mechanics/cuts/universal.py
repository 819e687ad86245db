"""Universal: the points coincide, and an axis of body a and one of body b, those of the cross, stay perpendicular."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import Matrix
from solvers.compiled.kernel import kernel

from .base import AxisCut, CutJoint, CutJointRecord, constrain_perpendicular, constrain_point, with_axis_last

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


@kernel
def evaluate(cut: CutJointRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. z_a is perpendicular to z_b."""
    constrain_point(cut, A, B, row, state)
    constrain_perpendicular(cut, 2, 2, A, B, state.rows[row + 3])


@dataclass(frozen=True, kw_only=True)
class UniversalCutJoint(AxisCut):
    """Universal (Cardan) cut joint: two axes that cross, one fixed in each body, remain perpendicular.

    Parameters
    ----------
    axis
        Axis of the cross in the cut frame of body a: ``"x"``, ``"y"``, ``"z"`` or three numbers.
    second
        Axis of the cross in the cut frame of body b. If the joint is closed, it is perpendicular to ``axis``.

    Notes
    -----
    Constraint equations: three forces along the axes of the frame in body a, and the moment that is perpendicular to
    both axes of the cross. The name of the moment consists of the names of both axes: ``"xy"`` by default.
    """

    axis: Any = "x"
    second: Any = "y"

    named = ("x", "y", "z")
    units = ("N", "N", "N", "N.m")
    evaluate = evaluate

    @property
    def rows(self) -> tuple[str, ...]:  # type: ignore[override]
        """Suffix of each row's name."""
        return (*super().rows, self.letters[2] + (self.second if isinstance(self.second, str) else "n"))

    def check(self, what: str) -> None:
        """Refuse what is no axis."""
        super().check(what)
        unit_axis(self.second, f"second axis of {what}")

    def frames(self, what: str = "a cut joint") -> tuple[Matrix, Matrix]:
        """Return the axes of the cut frames as columns in bodies a and b, as kernels have them."""
        Ra, Rb = CutJoint.frames(self, what)
        return with_axis_last(Ra, self.axis, what), with_axis_last(Rb, self.second, what)
