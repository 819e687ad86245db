"""Interface of surfaces: rigid, fixed to a body, in contact with a sheet.

Its kernel ``gap(surface, contact)`` returns the distance of the point ``contact.p`` from it, m, positive outside, and
writes the unit normal there, towards the outside, into ``contact.n``, both in the axes of the body. The distance is
that to the nearest point, so that it bounds the distances of all points of a ball about the point. Where a surface
ends, ``contact.part``, which is one, falls to zero over :data:`FADE_LENGTH`. Where it is zero there is no contact, and
the distance is that to the nearest point with contact, or less. The kernel is analytic in p. ``contact``
is a record of :data:`.scratch.CONTACT_SCRATCH`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from mbfmu.mechanics.kind import ElementType
from mbfmu.mechanics.shapes import Matrix, Shape
from mbfmu.sheets.contact.patch import smooth_step
from mbfmu.sheets.contact.scratch import CONTACT_SCRATCH
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Mat3, Record, Vec3

if TYPE_CHECKING:
    from mbfmu.sheets.contact.scratch import ContactScratch

FADE_LENGTH = 1e-3  # m


class FrameRecord(Record):
    """Frame of what is drawn along a straight line, in the axes of the body."""

    origin: Vec3  # m
    axes: Mat3  # columns


@kernel
def edge_factor(along: float, half: float) -> Any:
    """Part of the force at a distance from the middle of a surface ``half`` of which is so long, m."""
    return smooth_step((half + 0.5 * FADE_LENGTH - along) / FADE_LENGTH) * smooth_step(
        (half + 0.5 * FADE_LENGTH + along) / FADE_LENGTH
    )


@kernel
def to_frame_axes(frame: FrameRecord, contact: ContactScratch) -> Any:
    """The point in a frame's plane, (x, y), and along its third axis, z; ``frame`` has ``origin`` and ``axes``."""
    p, o, A = contact.p, frame.origin, frame.axes
    x, y, z = p[0] - o[0], p[1] - o[1], p[2] - o[2]
    return (
        A[0, 0] * x + A[1, 0] * y + A[2, 0] * z,
        A[0, 1] * x + A[1, 1] * y + A[2, 1] * z,
        A[0, 2] * x + A[1, 2] * y + A[2, 2] * z,
    )


@kernel
def set_normal(frame: FrameRecord, x: float, y: float, contact: ContactScratch) -> None:
    """Write a normal that has these components in the plane of a frame."""
    n, A = contact.n, frame.axes
    for k in range(3):
        n[k] = A[k, 0] * x + A[k, 1] * y


@kernel
def round_gap(
    frame: FrameRecord, x: float, y: float, z: float, radius: float, half: float, contact: ContactScratch
) -> float:
    """Distance of the point (x, y, z) of a frame from a cylinder about its third axis, ``half`` of which is so long, m;
    writes what a ``gap`` writes. A point on the axis has no normal.
    """
    distance = np.sqrt(x * x + y * y)
    if distance.real > 0.0:
        set_normal(frame, x / distance, y / distance, contact)
        contact.part = edge_factor(z, half)
    return distance - radius


class Surface(ElementType):
    """Rigid surface: a frozen dataclass in a separate file, like all element types."""

    kernels: ClassVar = {"gap": "contact -> number"}
    records: ClassVar = {"contact": CONTACT_SCRATCH}
    gap: ClassVar[Any]
    convex: ClassVar[bool] = False  # what it bounds is: cells that it is not near to are then known without a look

    def shapes(self, near: Any) -> tuple[Shape, ...]:
        """Return how it is drawn, in the axes of its body; nothing: it is not.

        ``near`` has where points of the sheet come, (k, 3), m: a surface without an end is drawn about those.
        """
        return ()

    def curvature(self) -> float:
        """Return the curvature of a sheet that lies on it, 1/m; zero: it lies flat, or on edges only."""
        return 0.0

    def edges(self) -> tuple[float, float, Matrix] | None:
        """Return the radius and the length of its edges, m, and their unit vector in the axes of its body;
        None: it has no edges that may lie between contact points of a sheet.
        """
        return None

    def passing_depth(self) -> float:
        """Return the depth beyond which it no longer pushes back to this side, m; infinite: it always does."""
        return self.core()

    def core(self) -> float:
        """Return the depth of its middle, beyond which it pushes to the other side, m; infinite: it has none."""
        return float("inf")
