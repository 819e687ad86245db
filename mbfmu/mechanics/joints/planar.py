"""Planar: the displacements q_0, q_1 along two axes of the joint frame and the angle q_2 about their normal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import plane_axes
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import axis_matrix
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Vec3

from .base import AxisJoint, AxisRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


class PlanarRecord(AxisRecord):
    """Parameters of :class:`Planar`."""

    first: Vec3  # unit vectors in the joint frame
    other: Vec3


@kernel
def place(joint: PlanarRecord, qi: int, state: State) -> None:
    """See :mod:`.base`."""
    q, axis, first, other, rel = state.q, joint.axis, joint.first, joint.other, state.rel[0]
    axis_matrix(axis, np.cos(q[qi + 2]), np.sin(q[qi + 2]), rel.R)
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = first[i], 0.0
        rel.S[1, i], rel.S[1, 3 + i] = other[i], 0.0
        rel.S[2, i], rel.S[2, 3 + i] = 0.0, axis[i]
        rel.p[i] = q[qi] * first[i] + q[qi + 1] * other[i]


@dataclass(frozen=True, kw_only=True)
class Planar(AxisJoint):
    """Planar joint: translation normal to ``axis`` and rotation about it; coordinates: x and y in m, angle in rad.

    x and y are displacements along two axes that are fixed in the joint frame: for ``axis`` z its x and y. For any
    other axis x is along the joint frame's x, projected into the plane, or along its y where ``axis`` is the frame's x;
    y is along ``axis`` cross that. So for ``axis`` y they are along the frame's x and -z, for x along its y and z.
    """

    record = PlanarRecord
    nq = 3
    nv = 3
    place = place
    coordinates = ("x", "y", "angle")
    units = ("m", "m", "rad")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the three axes."""
        super().fill(record, site)
        record["first"], record["other"] = plane_axes(self.direction)
