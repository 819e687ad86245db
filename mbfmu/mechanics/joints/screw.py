"""Screw: the angle q about an axis fixed in both bodies, along which the child moves by h q, h = lead / (2 pi)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH, is_finite
from mbfmu.mechanics.spatial import axis_matrix
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8

from .base import AxisJoint, AxisRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


class ScrewRecord(AxisRecord):
    """Parameters of :class:`Screw`."""

    rise: f8  # displacement along the axis, m/rad


@kernel
def place(joint: ScrewRecord, qi: int, state: State) -> None:
    """See :mod:`.base`."""
    angle, axis, rel = state.q[qi], joint.axis, state.rel[0]
    axis_matrix(axis, np.cos(angle), np.sin(angle), rel.R)
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = joint.rise * axis[i], axis[i]
        rel.p[i] = joint.rise * angle * axis[i]


@dataclass(frozen=True, kw_only=True)
class Screw(AxisJoint):
    """Screw joint: rotation about ``axis`` with proportional translation along it; coordinate: angle in rad.

    Parameters
    ----------
    lead
        Displacement along ``axis`` per revolution, m; negative: left-handed thread.
    """

    record = ScrewRecord
    nq = 1
    nv = 1
    place = place
    coordinates = ("",)
    units = ("rad",)
    drawn = "slide"

    lead: float

    def check(self, what: str) -> None:
        """Refuse what is no lead."""
        super().check(what)
        if np.ndim(self.lead) or not is_finite(self.lead) or not MIN_LENGTH <= abs(self.lead) <= MAX_LENGTH:
            raise UserError(
                f"lead of {what} is {self.lead!r} m per turn; allowed: {MIN_LENGTH:g} to {MAX_LENGTH:g}, of either sign"
            )

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the axis and the way per radian."""
        super().fill(record, site)
        record["rise"] = self.lead / (2.0 * np.pi)
