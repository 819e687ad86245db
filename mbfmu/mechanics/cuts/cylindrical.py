"""Cylindrical: an axis of the two cut frames stays one line, through P and through Q."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.compiled.kernel import kernel

from .base import AxisCut, between, hold_along, perpendicular


@kernel
def evaluate(cut: Any, A: Any, B: Any, row: int, state: Any) -> None:
    """See :mod:`.base`. z_a is perpendicular to x_b and y_b."""
    way = between(cut, A, B)
    hold_along(cut, 0, A, way, state.rows[row])
    hold_along(cut, 1, A, way, state.rows[row + 1])
    perpendicular(cut, 2, 0, A, B, state.rows[row + 2])
    perpendicular(cut, 2, 1, A, B, state.rows[row + 3])


@dataclass(frozen=True, kw_only=True)
class CylindricalCut(AxisCut):
    """Cylindrical cut joint: body b translates along ``axis`` of the cut frames and rotates about it."""

    named = ("x", "y", "zx", "zy")
    units = ("N", "N", "N.m", "N.m")
    evaluate = evaluate
    parallel = "z"
