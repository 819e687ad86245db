"""Universal: the angle q_0 about an axis n of the joint frame, then q_1 about a second axis m, which the first carries.

    A_k = A_n(q_0) A_m(q_1),     w_rel = q_0' n + q_1' A_n m

The two axes of a cross are perpendicular in every position, so that no position is singular.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import Vector, unit_axis
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.spatial import axis_matrix, rotated
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Vec3

from .base import AxisJoint, AxisRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State

MAX_AXIS_COSINE = 1e-9  # cosine of the angle between two axes


class UniversalRecord(AxisRecord):
    """Parameters of :class:`Universal`."""

    second: Vec3


@kernel
def place(joint: UniversalRecord, qi: int, state: State) -> None:
    """See :mod:`.base`. Columns: n;  A_n m."""
    q, n, m, rel = state.q, joint.axis, joint.second, state.rel[0]
    axis_matrix(m, np.cos(q[qi + 1]), np.sin(q[qi + 1]), rel.R)
    c, s = np.cos(q[qi]), np.sin(q[qi])
    for k in range(3):
        rel.R[0, k], rel.R[1, k], rel.R[2, k] = rotated(n, c, s, rel.R[0, k], rel.R[1, k], rel.R[2, k])
        rel.p[k] = 0.0
        rel.S[0, k], rel.S[0, 3 + k] = 0.0, n[k]
        rel.S[1, k] = 0.0
    rel.S[1, 3], rel.S[1, 4], rel.S[1, 5] = rotated(n, c, s, m[0], m[1], m[2])


@kernel
def bias(joint: UniversalRecord, qi: int, vi: int, state: State) -> None:
    """See :mod:`.base`: q_0' q_1' n x A_n m."""
    q, v, n, m, out = state.q, state.v, joint.axis, joint.second, state.rel[0].bias
    x, y, z = rotated(n, np.cos(q[qi]), np.sin(q[qi]), m[0], m[1], m[2])
    turn = v[vi] * v[vi + 1]
    for k in range(3):
        out[k] = 0.0
    out[3], out[4], out[5] = turn * (n[1] * z - n[2] * y), turn * (n[2] * x - n[0] * z), turn * (n[0] * y - n[1] * x)


@dataclass(frozen=True, kw_only=True)
class Universal(AxisJoint):
    """Universal joint: rotation about ``axis``, then about ``second``, which rotates with the first; two angles in rad.

    Parameters
    ----------
    axis, second
        Perpendicular axes in the joint frame, for zero angles.
    """

    record = UniversalRecord
    nq = 2
    nv = 2
    place = place
    bias = bias
    coordinates = ("first", "second")
    units = ("rad", "rad")
    drawn = "ball"

    axis: str | Vector = "x"
    second: str | Vector = "y"

    def check(self, what: str) -> None:
        """Refuse axes that are not perpendicular."""
        cosine = unit_axis(self.axis, f"axis of {what}") @ unit_axis(self.second, f"second axis of {what}")
        if abs(cosine) > MAX_AXIS_COSINE:
            angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            raise UserError(
                f"second axis of {what} is {self.second!r}, {angle:.6g} deg from its axis {self.axis!r}; "
                "allowed: an axis perpendicular to that"
            )

    def fill(self, record: Any, site: Attachment) -> None:
        """Write both axes."""
        super().fill(record, site)
        record["second"] = unit_axis(self.second, f"second axis of {site.name}")
