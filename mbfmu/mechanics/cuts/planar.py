"""Planar: the planes normal to an axis of the two cut frames stay one plane; body b may slide and turn in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.compiled.kernel import kernel

from .base import AxisCut, between, hold_along, perpendicular


@kernel
def evaluate(cut: Any, A: Any, B: Any, row: int, state: Any) -> None:
    """See :mod:`.base`. z_b is perpendicular to x_a and y_a."""
    hold_along(cut, 2, A, between(cut, A, B), state.rows[row])
    perpendicular(cut, 0, 2, A, B, state.rows[row + 1])
    perpendicular(cut, 1, 2, A, B, state.rows[row + 2])


@dataclass(frozen=True, kw_only=True)
class PlanarCut(AxisCut):
    """Planar cut joint: two planes that slide and rotate on each other; normal: ``axis`` of the cut frames."""

    named = ("z", "xz", "yz")
    units = ("N", "N.m", "N.m")
    evaluate = evaluate
    parallel = "z"
