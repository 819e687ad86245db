"""Drum: the outside of a cylinder, of a roller or a turning bar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.axes import along, unit_axis
from mbfmu.mechanics.checks import Vector, vector
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import positive
from mbfmu.mechanics.shapes import SURFACE_OPACITY, Cylinder, Shape
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8

from .base import FrameRecord, Surface, round_gap, to_frame_axes

if TYPE_CHECKING:
    from mbfmu.sheets.contact.scratch import ContactScratch


class DrumRecord(FrameRecord):
    """Parameters of :class:`Drum`."""

    radius: f8
    length: f8


@kernel
def gap(drum: DrumRecord, contact: ContactScratch) -> float:
    """See :mod:`.base`: distance from the axis less the radius."""
    x, y, z = to_frame_axes(drum, contact)
    return round_gap(drum, x, y, z, drum.radius, 0.5 * drum.length, contact)


@dataclass(frozen=True, kw_only=True)
class Drum(Surface):
    """Outer surface of a circular cylinder, such as a roller.

    Parameters
    ----------
    radius, length
        Radius and length, m.
    at
        Center in the frame of the body that carries the surface, m.
    axis
        Axis in that frame: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
    """

    record = DrumRecord
    gap = gap
    convex = True

    radius: float
    length: float
    at: Vector = (0.0, 0.0, 0.0)
    axis: str | Sequence[float] = "z"

    def check(self, what: str) -> None:
        """See the base."""
        for key in ("radius", "length"):
            positive(f"{key} of {what}", getattr(self, key))
        vector(f"at of {what}", self.at)
        unit_axis(self.axis, f"axis of {what}")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its frame and its size."""
        super().fill(record, site)
        record["origin"], record["axes"] = self.at, along(unit_axis(self.axis, "axis"))

    def shapes(self, near: Any) -> tuple[Shape, ...]:
        """See the base."""
        at = tuple(float(x) for x in self.at)
        return (Cylinder(radius=self.radius, length=self.length, at=at, axis=self.axis, opacity=SURFACE_OPACITY),)

    def curvature(self) -> float:
        """See the base."""
        return 1.0 / self.radius

    def core(self) -> float:
        """See the base."""
        return self.radius
