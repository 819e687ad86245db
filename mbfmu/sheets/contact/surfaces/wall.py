"""Wall: a plane, of a table or a stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import plane_axes, unit_axis
from mbfmu.mechanics.checks import Vector, vector
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.shapes import SURFACE_OPACITY, Panel, Shape
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, Vec3

from .base import Surface

if TYPE_CHECKING:
    from mbfmu.sheets.contact.scratch import ContactScratch

DRAWING_MARGIN_RATIO = 0.1  # of the space that a sheet takes: it is drawn where the sheet comes so near


class WallRecord(Record):
    """Parameters of :class:`Wall`."""

    origin: Vec3
    normal: Vec3


@kernel
def gap(wall: WallRecord, contact: ContactScratch) -> float:
    """See :mod:`.base`: (p - at) . normal."""
    p, n, total = contact.p, contact.n, 0.0 * contact.p[0]
    for k in range(3):
        n[k] = wall.normal[k]
        total += (p[k] - wall.origin[k]) * wall.normal[k]
    return total


@dataclass(frozen=True, kw_only=True)
class Wall(Surface):
    """Infinite plane.

    Parameters
    ----------
    at
        Point of the plane in the frame of the body that carries the surface, m.
    normal
        Normal that points to the sheet, in that frame: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
    """

    record = WallRecord
    gap = gap
    convex = True

    at: Vector = (0.0, 0.0, 0.0)
    normal: str | Sequence[float] = "y"

    def check(self, what: str) -> None:
        """See the base."""
        vector(f"at of {what}", self.at)
        unit_axis(self.normal, f"normal of {what}")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write point and unit normal."""
        record["origin"], record["normal"] = self.at, unit_axis(self.normal, "normal")

    def shapes(self, near: Any) -> tuple[Shape, ...]:
        """See the base: a rectangle below what comes near, and as far beyond."""
        normal = unit_axis(self.normal, "normal")
        axes = np.column_stack((*plane_axes(normal), normal))
        local = (near - np.asarray(self.at, float)) @ axes
        reach = DRAWING_MARGIN_RATIO * float(np.linalg.norm(np.ptp(local, axis=0)))
        if reach == 0.0:
            return ()
        close = local[local[:, 2] <= max(reach, local[:, 2].min()), :2]
        low, high = close.min(axis=0) - reach, close.max(axis=0) + reach
        middle = self.at + axes[:, :2] @ (0.5 * (low + high))
        return (Panel(size=high - low, at=middle, rotation=axes, opacity=SURFACE_OPACITY),)
