"""Distance: the points P and Q keep their distance L.

Phi = (d.d - L^2) / (2 L) with d = r_Q - r_P: smooth at every d, and lambda is the force in N at the closed position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH, is_finite
from mbfmu.mechanics.spatial import arm, centripetal
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8

from .base import CutJoint, CutJointRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State


class DistanceCutRecord(CutJointRecord):
    """Parameters of :class:`DistanceCutJoint`."""

    length: f8  # m


@kernel
def evaluate(cut: DistanceCutRecord, A: MotionRecord, B: MotionRecord, row: int, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`. Phi' = d.d'/L, Phi'' = (d.d'' + d'.d')/L."""
    out = state.rows[row]
    ax, ay, az = arm(A, cut.Pa)
    bx, by, bz = arm(B, cut.Pb)
    inverse = 1.0 / cut.length
    Ya, Yb = A.Y, B.Y
    dx, dy, dz = B.r[0] + bx - A.r[0] - ax, B.r[1] + by - A.r[1] - ay, B.r[2] + bz - A.r[2] - az
    ux = Yb[0] + Yb[4] * bz - Yb[5] * by - (Ya[0] + Ya[4] * az - Ya[5] * ay)
    uy = Yb[1] + Yb[5] * bx - Yb[3] * bz - (Ya[1] + Ya[5] * ax - Ya[3] * az)
    uz = Yb[2] + Yb[3] * by - Yb[4] * bx - (Ya[2] + Ya[3] * ay - Ya[4] * ax)
    out.Phi = 0.5 * inverse * (dx * dx + dy * dy + dz * dz - cut.length * cut.length)
    bias = ux * ux + uy * uy + uz * uz
    bias += dx * (centripetal(B, bx, by, bz, 0) - centripetal(A, ax, ay, az, 0))
    bias += dy * (centripetal(B, bx, by, bz, 1) - centripetal(A, ax, ay, az, 1))
    bias += dz * (centripetal(B, bx, by, bz, 2) - centripetal(A, ax, ay, az, 2))
    out.bias = inverse * bias
    dx, dy, dz = inverse * dx, inverse * dy, inverse * dz
    out.Gb[0], out.Gb[1], out.Gb[2] = dx, dy, dz
    out.Gb[3], out.Gb[4], out.Gb[5] = by * dz - bz * dy, bz * dx - bx * dz, bx * dy - by * dx
    out.Ga[0], out.Ga[1], out.Ga[2] = -dx, -dy, -dz
    out.Ga[3], out.Ga[4], out.Ga[5] = az * dy - ay * dz, ax * dz - az * dx, ay * dx - ax * dy


@dataclass(frozen=True, kw_only=True)
class DistanceCutJoint(CutJoint):
    """Distance constraint: massless rod with a spherical joint at each end.

    Parameters
    ----------
    length
        Length of the rod, m.
    """

    record = DistanceCutRecord
    rows = ("",)
    units = ("N",)
    drawn = "rod"
    evaluate = evaluate

    length: float

    def check(self, what: str) -> None:
        """Refuse what is no length."""
        if not (is_finite(self.length) and MIN_LENGTH <= self.length <= MAX_LENGTH):
            raise UserError(f"length of {what} is {self.length!r} m; allowed: {MIN_LENGTH:g} to {MAX_LENGTH:g}")

    def extent(self) -> float:
        """Return its length."""
        return self.length
