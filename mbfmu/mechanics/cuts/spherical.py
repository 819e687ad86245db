"""Spherical: the points P and Q coincide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.compiled.kernel import kernel

from .base import Cut, constrain_point


@kernel
def evaluate(cut: Any, A: Any, B: Any, row: int, state: Any) -> None:
    """See :mod:`.base`."""
    constrain_point(cut, A, B, row, state)


@dataclass(frozen=True, kw_only=True)
class SphericalCut(Cut):
    """Spherical cut joint: the points of both bodies coincide."""

    rows = ("x", "y", "z")
    units = ("N", "N", "N")
    drawn = "ball"
    evaluate = evaluate
