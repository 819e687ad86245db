"""What every tree joint says of itself.

A joint places its child in the joint frame F, which is fixed in the parent at the placement the builder was given. Its
kernel ``place(joint, qi, state)`` reads the positions from ``state.q[qi]`` on and writes, in F axes,

    state.rel[0:nv]       the columns of the motion subspace: the child's relative velocity is  sum_k v_k rel[k]
    state.rel[6:9, 0:3]   the child's axes in F,   state.rel[6:9, 3] its origin in F

all of it: what ``rel`` held before is another joint's. For axes that rest in F and for angular velocities in the
child's axes differentiating the columns adds nothing to the relative acceleration; a joint of other columns also has
``bias(joint, qi, vi, state)``, which writes sum_k v_k d(rel[k])/dt into ``state.bias`` (6,), F axes, with the
velocities from ``state.v[vi]`` on. Everything else about tree joints is common and lives in the recursions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError
from mbfmu.mechanics.axes import Vector, unit_axis
from mbfmu.mechanics.kind import Kind, Site


@dataclass(frozen=True, kw_only=True)
class Joint(Kind):
    """A tree joint at rest in its start position.

    Parameters
    ----------
    at, rotation
        Origin (m) and 3x3 axes of the joint frame in the parent's frame.
    start, rate
        First position (nq,) and velocity (nv,); a single number where there is one coordinate.
    fixed
        Assembly keeps ``start`` exactly instead of taking it as a guess.
    drive
        Signal the coordinate follows (joints of one coordinate), which says where it starts and how fast; None: free.
    nominal
        Usual size of the coordinates, one number or (nv,), which tolerances are relative to; None: 1 rad, and for m the
        characteristic length of the mechanism.
    """

    at: Vector = (0.0, 0.0, 0.0)
    rotation: Any = None
    start: float | Vector | None = None
    rate: float | Vector | None = None
    fixed: bool = False
    drive: Any = None
    nominal: float | Vector | None = None

    kernels: ClassVar = {"place": "index, state", "bias": "index, index, state"}
    place: ClassVar[Any]
    bias: ClassVar[Any] = None
    nq: ClassVar[int]
    nv: ClassVar[int]
    quaternion: ClassVar[bool] = False  # the last four positions are a unit quaternion, scalar first
    coordinates: ClassVar[tuple[str, ...]] = ()  # suffix of each velocity coordinate's name
    units: ClassVar[tuple[str, ...]] = ()  # of the coordinates: m or rad
    drawings: ClassVar = ("", "pin", "ball", "slide", "free")
    drawn: ClassVar[str] = ""  # how pictures show it: one of these; "free": nothing holds the child

    def __post_init__(self) -> None:
        """Refuse what a drive says already."""
        given = {"start": self.start is not None, "rate": self.rate is not None, "fixed": self.fixed}
        if self.drive is not None and any(given.values()):
            names = " and ".join(name for name, there in given.items() if there)
            raise UserError(
                f"{type(self).__name__}: drive and {names} are given; leave out {names}, the drive says where it is "
                "and how fast"
            )

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vector in the joint frame that a pin is drawn along."""
        return np.array((0.0, 0.0, 1.0))

    def rest(self) -> NDArray[np.float64]:
        """Positions (nq,) at which the child's frame lies on the joint frame."""
        q = np.zeros(self.nq)
        if self.quaternion:
            q[self.nq - 4] = 1.0
        return q


@dataclass(frozen=True, kw_only=True)
class AxisJoint(Joint):
    """A joint with an axis."""

    record = np.dtype([("axis", np.float64, (3,))], align=True)  # unit vector in the joint frame

    axis: str | Vector = "z"

    def check(self, what: str) -> None:
        """Refuse what is no axis."""
        unit_axis(self.axis, f"axis of {what}")

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vector of the axis in the joint frame."""
        return unit_axis(self.axis, f"axis of {type(self).__name__}")

    def fill(self, record: Any, site: Site) -> None:
        """Write the axis."""
        record["axis"] = self.direction
