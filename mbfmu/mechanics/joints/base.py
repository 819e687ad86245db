"""Interface of tree joints.

A joint places its child in the joint frame F, which is fixed in the parent at the placement the builder was given. Its
kernel ``place(joint, qi, state)`` reads the positions from ``state.q[qi]`` on and writes, in F axes,

    rel.S[0:nv]   the columns of the motion subspace: the child's relative velocity is  sum_k v_k S[k]
    rel.R         the child's axes in F
    rel.p         its origin in F

with ``rel = state.rel[0]``; all of it: what ``rel`` held before is another joint's. For axes that rest in F and for
angular velocities in the child's axes differentiating the columns adds nothing to the relative acceleration; a joint of
other columns also has ``bias(joint, qi, vi, state)``, which writes sum_k v_k dS[k]/dt into ``rel.bias`` (6,), F axes,
with the velocities from ``state.v[vi]`` on. Everything else about tree joints is common and lives in the recursions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.axes import Vector, unit_axis
from mbfmu.mechanics.kind import Attachment, ElementType, RecordType
from mbfmu.util.errors import UserError
from solvers.compiled.record import Record, Vec3

MAX_COORDINATES = 6  # of a joint


@dataclass(frozen=True, kw_only=True)
class Joint(ElementType):
    """Base class of tree joints.

    Parameters
    ----------
    at, rotation
        Origin (m) of the joint frame in the parent's frame, and its axes there as columns of a 3x3 matrix or as a
        ``scipy.spatial.transform.Rotation``.
    start, rate
        Initial position (nq,) and velocity (nv,); a single number for one coordinate. Assembly changes given
        values only if the loops cannot close by the other coordinates.
    fixed
        Assembly keeps ``start`` and ``rate`` exactly, and fails if the loops cannot close with them.
    drive
        Signal that the coordinate follows (joints of one coordinate), with its start position and rate; None: free.
    nominal
        Nominal value: typical size of the coordinates, one number or (nv,), by which errors are divided; None: 1 rad,
        and for m the characteristic length of the mechanism.
    armature
        Inertia of the rotor of a geared drive as seen at the joint (reflected inertia), kg m^2, or kg for a
        displacement; joints of one coordinate. If the rotor turns by n rad per unit of the coordinate v, its kinetic
        energy is J (n v)^2 / 2, so that the armature is n^2 J. It is added to the diagonal of the mass matrix. The
        reaction of the angular momentum of the rotor on the parent, which is smaller by the factor 1 / n, is neglected.
    """

    at: Vector = (0.0, 0.0, 0.0)
    rotation: Any = None
    start: float | Vector | None = None
    rate: float | Vector | None = None
    fixed: bool = False
    drive: Any = None
    nominal: float | Vector | None = None
    armature: float = 0.0

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
        """Refuse values that the drive determines."""
        given = {"start": self.start is not None, "rate": self.rate is not None, "fixed": self.fixed}
        if self.drive is not None and any(given.values()):
            names = " and ".join(name for name, there in given.items() if there)
            raise UserError(
                f"{type(self).__name__}: drive and {names} are given; leave out {names}, which the drive determines"
            )

    def check_declaration(self, said: str) -> None:
        """Refuse numbers of coordinates that do not fit each other, and units that coordinates cannot have."""
        counts = {"nq": self.nq, "nv": self.nv}
        for name, count in counts.items():
            if isinstance(count, bool) or not isinstance(count, int) or count < 0:
                raise UserError(f"{said}, whose {name} is {count!r}; allowed: a whole number, zero or greater")
        if not isinstance(self.quaternion, bool):
            raise UserError(f"{said}, whose quaternion is {self.quaternion!r}; allowed: True or False")
        if self.nv > MAX_COORDINATES or (self.quaternion and self.nv < 3):
            low = 3 if self.quaternion else 0
            raise UserError(f"{said}, whose nv is {self.nv}; allowed: {low} to {MAX_COORDINATES}")
        if self.nq != self.nv + self.quaternion:
            with_one = (
                "one position more than velocities, as quaternion is True"
                if self.quaternion
                else (
                    "as many positions as velocities (one position more only with quaternion = True). Constraints of "
                    "velocities alone, as of a rolling wheel or a skate, are not supported"
                )
            )
            raise UserError(f"{said}, which declares nq = {self.nq} and nv = {self.nv}; allowed: {with_one}")
        for name, values in {"coordinates": self.coordinates, "units": self.units}.items():
            if not isinstance(values, tuple) or not all(isinstance(value, str) for value in values):
                raise UserError(f"{said}, whose {name} are {values!r}; allowed: a tuple of {self.nv} texts")
        if len(self.units) != self.nv or not set(self.units) <= {"m", "rad"}:
            raise UserError(
                f"{said}, whose units are {self.units!r}; allowed: 'm' or 'rad' for each of {self.nv} velocities"
            )
        if len(self.coordinates) != self.nv:
            raise UserError(
                f"{said}, whose coordinates are {self.coordinates!r}; allowed: one suffix for each of {self.nv} "
                "velocities"
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


class AxisRecord(Record):
    """Parameters of :class:`AxisJoint`."""

    axis: Vec3  # unit vector in the joint frame


@dataclass(frozen=True, kw_only=True)
class AxisJoint(Joint):
    """Base class of joints with an axis.

    Parameters
    ----------
    axis
        Axis in the joint frame: ``"x"``, ``"y"``, ``"z"``, or a vector (3,) of any length.
    """

    record: ClassVar[RecordType] = AxisRecord

    axis: str | Vector = "z"

    def check(self, what: str) -> None:
        """Refuse what is no axis."""
        unit_axis(self.axis, f"axis of {what}")

    @property
    def direction(self) -> NDArray[np.float64]:
        """Unit vector of the axis in the joint frame."""
        return unit_axis(self.axis, f"axis of {type(self).__name__}")

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the axis."""
        record["axis"] = self.direction
