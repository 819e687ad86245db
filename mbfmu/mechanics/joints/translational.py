"""Translational: the displacement q along an axis fixed in both bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.kernel import kernel

from .base import AxisJoint


@kernel
def move(axis: Any, q: Any, qi: int, v: Any, vi: int, rel: Any) -> None:
    """See :mod:`.base`."""
    for i in range(3):
        rel[0, i] = axis[i]
        rel[7 + i, i] = 1.0
        rel[7 + i, 3] = q[qi] * axis[i]


@dataclass(frozen=True, kw_only=True)
class Translational(AxisJoint):
    """Slides along ``axis``; coordinate: displacement in m."""

    nq = 1
    nv = 1
    move = move
    coordinates = ("",)
    units = ("m",)
