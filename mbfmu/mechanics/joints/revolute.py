"""Revolute: the angle q about an axis fixed in both bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from solvers.kernel import kernel

from .base import AxisJoint


@kernel
def place(joint: Any, qi: int, state: Any) -> None:
    """See :mod:`.base`. Rotation by Rodrigues' formula, R = c I + s skew(n) + (1 - c) n n^T."""
    axis, rel = joint.axis, state.rel
    c, s = np.cos(state.q[qi]), np.sin(state.q[qi])
    for i in range(3):
        rel[0, i], rel[0, 3 + i] = 0.0, axis[i]
        for j in range(3):
            rel[6 + i, j] = (1.0 - c) * axis[i] * axis[j]
        rel[6 + i, i] += c
        rel[6 + i, 3] = 0.0
    rel[6, 1] -= s * axis[2]
    rel[6, 2] += s * axis[1]
    rel[7, 0] += s * axis[2]
    rel[7, 2] -= s * axis[0]
    rel[8, 0] -= s * axis[1]
    rel[8, 1] += s * axis[0]


@dataclass(frozen=True, kw_only=True)
class Revolute(AxisJoint):
    """Turns about ``axis``; coordinate: angle in rad."""

    nq = 1
    nv = 1
    place = place
    coordinates = ("",)
    units = ("rad",)
