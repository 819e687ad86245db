"""Trough: the inside of a part of a cylinder, of the outer guide of a turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.axes import unit_axis
from mbfmu.mechanics.checks import Vector, vector
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import finite, positive
from mbfmu.mechanics.shapes import SURFACE_OPACITY, Matrix, Shape, ribbon
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import f8

from .base import FrameRecord, Surface, edge_factor, set_normal, to_frame_axes

if TYPE_CHECKING:
    from mbfmu.sheets.contact.scratch import ContactScratch

BACK_DISTANCE_RATIO = 0.2  # of the radius: what is so far behind it is not on its inside
PANEL_ANGLE = np.pi / 24.0  # rad of the arc that a panel is drawn for


class TroughRecord(FrameRecord):
    """Parameters of :class:`Trough`."""

    half: f8
    radius: f8
    length: f8


@kernel
def gap(trough: TroughRecord, contact: ContactScratch) -> float:
    """See :mod:`.base`: the radius less the distance from the axis, between two planes through that."""
    x, y, z = to_frame_axes(trough, contact)
    distance = np.sqrt(x * x + y * y)
    outside = distance - (1.0 + BACK_DISTANCE_RATIO) * trough.radius
    if distance.real <= 0.0 or outside.real > 0.0:  # no normal; behind it
        contact.part = 0.0
        return outside if distance.real > 0.0 else trough.radius + 0.0 * x
    set_normal(trough, -x / distance, -y / distance, contact)
    # from the middle of the arc, along it; beyond a quarter turn as far as that
    sideways = trough.radius * y / distance if x.real >= 0.0 else 2.0 * trough.radius * (1.0 if y.real > 0.0 else -1.0)
    contact.part = edge_factor(sideways, trough.half) * edge_factor(z, 0.5 * trough.length)
    return trough.radius - distance


@dataclass(frozen=True, kw_only=True)
class Trough(Surface):
    """Part of the inner surface of a circular cylinder, such as a curved guide.

    Parameters
    ----------
    radius, length
        Radius and length, m.
    angle
        Angle of the arc, rad, at most pi: it extends by half of this to both sides of ``towards``.
    towards
        Direction from the axis to the middle of the arc, normal to ``axis``.
    at
        Center of the cylinder in the frame of the body that carries the surface, m.
    axis
        Axis of the cylinder in that frame: ``"x"``, ``"y"``, ``"z"``, or a vector (3,).
    """

    record = TroughRecord
    gap = gap

    radius: float
    length: float
    angle: float
    towards: str | Sequence[float]
    at: Vector = (0.0, 0.0, 0.0)
    axis: str | Sequence[float] = "z"

    def check(self, what: str) -> None:
        """See the base."""
        for key in ("radius", "length", "angle"):
            positive(f"{key} of {what}", getattr(self, key))
        if finite(f"angle of {what}", self.angle) > np.pi:
            raise UserError(f"angle of {what} is {self.angle!r} rad; allowed: pi at most; use two troughs for more")
        vector(f"at of {what}", self.at)
        axis, towards = unit_axis(self.axis, f"axis of {what}"), unit_axis(self.towards, f"towards of {what}")
        if abs(axis @ towards) > 1e-9:
            raise UserError(f"towards of {what} is {self.towards!r}; allowed: a direction normal to its axis")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its frame and its size."""
        super().fill(record, site)
        record["origin"], record["axes"] = self.at, self._axes()
        record["half"] = self.radius * np.sin(0.5 * self.angle)

    def shapes(self, near: Any) -> tuple[Shape, ...]:
        """See the base."""
        axes = self._axes()
        angle = np.linspace(-0.5 * self.angle, 0.5 * self.angle, 1 + int(np.ceil(self.angle / PANEL_ANGLE)))
        arc = np.outer(np.cos(angle), axes[:, 0]) + np.outer(np.sin(angle), axes[:, 1])
        return ribbon(self.at + self.radius * arc, axes[:, 2], self.length, opacity=SURFACE_OPACITY)

    def _axes(self) -> Matrix:
        """Return the columns x towards the middle of the arc, y and z along the axis."""
        axis, towards = unit_axis(self.axis, "axis"), unit_axis(self.towards, "towards")
        return np.column_stack((towards, np.cross(axis, towards), axis))

    def passing_depth(self) -> float:
        """See the base: what is so deep is behind it."""
        return BACK_DISTANCE_RATIO * self.radius

    def curvature(self) -> float:
        """See the base."""
        return 1.0 / self.radius
