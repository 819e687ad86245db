"""Guide: a plate with round edges, along which a sheet is led on either side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import Vector, vector
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.shapes import SURFACE_OPACITY, Matrix, Shape, ribbon
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8

from .base import FrameRecord, Surface, round_gap, to_frame_axes

if TYPE_CHECKING:
    from mbfmu.sheets.contact.scratch import ContactScratch

EDGE_PANELS = 8  # panels that a rounded edge is drawn with


class GuideRecord(FrameRecord):
    """Parameters of :class:`Guide`."""

    length: f8
    radius: f8
    width: f8


@kernel
def gap(guide: GuideRecord, contact: ContactScratch) -> float:
    """See :mod:`.base`: distance from the segment less the radius."""
    x, y, z = to_frame_axes(guide, contact)
    if x.real > guide.length.real:
        x = x - guide.length
    elif x.real > 0.0:
        x = 0.0 * x
    return round_gap(guide, x, y, z, guide.radius, 0.5 * guide.width, contact)


@dataclass(frozen=True, kw_only=True)
class Guide(Surface):
    """Straight guide plate with rounded edges; several plates end to end guide a sheet around a bend.

    Parameters
    ----------
    start, end
        Ends of the plate, in the middle of its width, m, in the frame of the body that carries the surface.
    radius
        Radius of the rounded edges, half the thickness of the plate, m.
    width
        Width, m.
    across
        Direction of the width in that frame, normal to the line from ``start`` to ``end``: ``"x"``, ``"y"``,
        ``"z"``, or a vector (3,).
    """

    record = GuideRecord
    gap = gap
    convex = True

    start: Vector
    end: Vector
    radius: float
    width: float
    across: str | Sequence[float] = "z"

    def check(self, what: str) -> None:
        """See the base."""
        for key in ("radius", "width"):
            positive(f"{key} of {what}", getattr(self, key))
        way = vector(f"end of {what}", self.end) - vector(f"start of {what}", self.start)
        length = float(np.linalg.norm(way))
        if length == 0.0:
            raise UserError(f"start and end of {what} are both {self.start!r}; allowed: two points")
        if abs(unit_axis(self.across, f"across of {what}") @ way) > 1e-9 * length:
            raise UserError(f"across of {what} is {self.across!r}; allowed: a direction normal to the way along it")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its frame, x along it and z across, and its size."""
        super().fill(record, site)
        record["origin"], record["axes"] = self.start, self._axes()
        record["length"] = self._length()

    def shapes(self, near: Any) -> tuple[Shape, ...]:
        """See the base: its rim, open at both ends of its width."""
        axes = self._axes()
        angle = np.linspace(
            0.5 * np.pi, 1.5 * np.pi, EDGE_PANELS + 1
        )  # about the start, and half a turn on about the end
        half = self.radius * (np.outer(np.cos(angle), axes[:, 0]) + np.outer(np.sin(angle), axes[:, 1]))
        rim = np.concatenate((self.start + half, self.end - half))
        return ribbon(np.concatenate((rim, rim[:1])), axes[:, 2], self.width, opacity=SURFACE_OPACITY)

    def edges(self) -> tuple[float, float, Matrix]:
        """See the base."""
        return self.radius, self.width, self._axes()[:, 2]

    def core(self) -> float:
        """See the base."""
        return self.radius

    def _length(self) -> float:
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    def _axes(self) -> Matrix:
        """Return the columns x along it, y and z across."""
        x, z = np.subtract(self.end, self.start) / self._length(), unit_axis(self.across, "across")
        return np.column_stack((x, np.cross(z, x), z))
