"""Handles that the builder returns (bodies, cut joints, couplings, forces) and their sensors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mbfmu.mechanics.checks import Matrix, Vector, one_of, vector
from mbfmu.mechanics.joints import Joint
from mbfmu.mechanics.numbers import is_whole
from mbfmu.mechanics.sensors import (
    Acceleration,
    AngularVelocity,
    Coordinate,
    DirectionCosine,
    Effort,
    JointForce,
    PointAcceleration,
    PointPosition,
    PointVelocity,
    Quaternion,
    Rate,
    Sensor,
    axis_index,
)
from mbfmu.util.errors import UserError

UNPLACED = -1  # parent of a body whose parent and joint are not known before the mechanism is compiled


@dataclass(frozen=True, eq=False)
class Body:
    """Body of a mechanism, as returned by :meth:`Mechanism.body`.

    Attributes
    ----------
    name
        Name, unique in the mechanism.
    index, parent
        Numbers of the body and of its parent; the ground is number 0. The parent of a body that is declared without a
        joint is UNPLACED before the mechanism is compiled.
    joint
        Tree joint that connects the body to its parent.
    mass, com, inertia
        Mass, kg, center of mass (3,), m, and inertia about it (3, 3), kg m^2, in the body's frame.
    joint_name
        Name of the tree joint if it was declared by :meth:`Mechanism.joint`; else empty.
    reversed
        The joint was declared from this body to its parent.
    attached
        The joint is reversed, or its frame in this body is not the body's frame.
    joint_at, joint_rotation
        Origin (3,), m, and axes (3, 3) as columns of the joint frame in this body.
    """

    name: str
    index: int
    parent: int
    joint: Joint
    mass: float = 0.0
    com: Matrix = field(default_factory=lambda: np.zeros(3))
    inertia: Matrix = field(default_factory=lambda: np.zeros((3, 3)))
    joint_name: str = ""
    reversed: bool = False
    attached: bool = False
    joint_at: Matrix = field(default_factory=lambda: np.zeros(3))
    joint_rotation: Matrix = field(default_factory=lambda: np.eye(3))

    @property
    def coordinate_name(self) -> str:
        """Name of the joint coordinates: of the joint if it has a name, else of the body."""
        return self.joint_name or self.name

    def place(self, index: int, parent: int, joint: Joint, **frame: Any) -> None:
        """Give a body its number, parent and joint when the mechanism is compiled.

        Parameters
        ----------
        index, parent, joint
            Attributes of the body.
        frame
            Further attributes that concern the joint.
        """
        for name, value in {"index": index, "parent": parent, "joint": joint, **frame}.items():
            object.__setattr__(self, name, value)

    def scale_mass(self, factor: float) -> None:
        """Multiply mass and inertia of a body from which parts are separated when the mechanism is compiled.

        Parameters
        ----------
        factor
            Fraction of the mass that remains.
        """
        object.__setattr__(self, "mass", factor * self.mass)
        object.__setattr__(self, "inertia", factor * self.inertia)

    def coordinate(self, k: int = 0) -> Sensor:
        """Joint position k, rad or m.

        Parameters
        ----------
        k
            Number of the coordinate of the joint, from 0.

        Raises
        ------
        UserError
            The joint has no coordinate of this number.
        """
        return Coordinate(unit=self._unit(k), item=self, component=k)

    def rate(self, k: int = 0) -> Sensor:
        """Joint velocity k, rad/s or m/s.

        Parameters
        ----------
        k
            Number of the coordinate of the joint, from 0.

        Raises
        ------
        UserError
            The joint has no coordinate of this number.
        """
        return Rate(unit=self._unit(k) + "/s", item=self, component=k)

    def acceleration(self, k: int = 0) -> Sensor:
        """Joint acceleration k, rad/s2 or m/s2.

        Parameters
        ----------
        k
            Number of the coordinate of the joint, from 0.

        Raises
        ------
        UserError
            The joint has no coordinate of this number.
        """
        return Acceleration(unit=self._unit(k) + "/s2", item=self, component=k)

    def effort(self, k: int = 0) -> Sensor:
        """Generalized force of the drive of a driven joint, N or N m.

        Parameters
        ----------
        k
            Number of the coordinate of the joint, from 0.

        Raises
        ------
        UserError
            The joint has no coordinate of this number.
        """
        return Effort(unit=effort_unit(self._unit(k)), item=self, component=k)

    angle = coordinate

    def position(self, axis: str, point: Vector = (0.0, 0.0, 0.0)) -> Sensor:
        """Global component of the position of a body-fixed point, m.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        point
            Point in the frame of the body (3,), m; its origin by default.
        """
        return PointPosition(unit="m", item=self, component=self._axis(axis), point=self._point(point))

    def velocity(self, axis: str, point: Vector = (0.0, 0.0, 0.0)) -> Sensor:
        """Global component of the velocity of a body-fixed point, m/s.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        point
            Point in the frame of the body (3,), m; its origin by default.
        """
        return PointVelocity(unit="m/s", item=self, component=self._axis(axis), point=self._point(point))

    def point_acceleration(self, axis: str, point: Vector = (0.0, 0.0, 0.0)) -> Sensor:
        """Global component of the acceleration of a body-fixed point, m/s2.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        point
            Point in the frame of the body (3,), m; its origin by default.
        """
        return PointAcceleration(
            unit="m/s2",
            item=self,
            component=self._axis(axis),
            point=self._point(point),
        )

    def quaternion(self, k: int) -> Sensor:
        """Component of the orientation as a unit quaternion, scalar first.

        The scalar is not negative, so that the orientation determines the signs. Where the sign changes, half a turn
        from the ground's axes, all four components are discontinuous.

        Parameters
        ----------
        k
            Number of the component, 0 to 3; 0: the scalar.

        Raises
        ------
        UserError
            k is not 0, 1, 2 or 3.
        """
        if not is_whole(k) or not 0 <= k < 4:
            raise UserError(
                f"component of the quaternion of body {self.name!r} is {k!r}; allowed: 0, 1, 2, 3, scalar first"
            )
        return Quaternion(item=self, component=k)

    def direction(self, i: str, j: str) -> Sensor:
        """Direction cosine A[i, j]: the component along the global axis i of this body's axis j.

        Parameters
        ----------
        i, j
            Global axis and axis of the body: ``"x"``, ``"y"`` or ``"z"``.
        """
        return DirectionCosine(item=self, component=self._axis(i), axis=self._axis(j))

    def angular_velocity(self, axis: str, frame: str = "global") -> Sensor:
        """Component of the absolute angular velocity, rad/s.

        Parameters
        ----------
        axis
            Axis ``"x"``, ``"y"`` or ``"z"`` of ``frame``.
        frame
            ``"global"`` or ``"body"``: the frame whose axis is meant.
        """
        one_of(f"frame of the angular velocity of body {self.name!r}", frame, ("global", "body"))
        return AngularVelocity(item=self, component=self._axis(axis) + (3 if frame == "body" else 0))

    def joint_force(self, axis: str) -> Sensor:
        """Global component of the force of the tree joint on this body, N.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        """
        self._require_joint()
        return JointForce(unit="N", item=self, component=self._axis(axis))

    def joint_moment(self, axis: str) -> Sensor:
        """Global component of the moment of the tree joint on this body about its origin, N m.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        """
        self._require_joint()
        return JointForce(unit="N.m", item=self, component=3 + self._axis(axis))

    def _axis(self, axis: str) -> int:
        return axis_index(axis, f"of body {self.name!r}")

    def _point(self, point: Vector) -> Matrix:
        return vector(f"point of body {self.name!r}", point)

    def _require_joint(self) -> None:
        """Refuse a body whose joint is not known."""
        if self.parent == UNPLACED:
            raise UserError(
                f"body {self.name!r} is declared without a joint, so that it has no joint coordinates and no joint "
                "force; allowed: those of a joint. Use what Mechanism.joint has returned"
            )

    def _unit(self, k: int) -> str:
        self._require_joint()
        if not is_whole(k) or not 0 <= k < self.joint.nv:
            raise UserError(f"body {self.name!r} has no joint coordinate {k!r}; it has {self.joint.nv}")
        return self.joint.units[k]


def effort_unit(unit: str) -> str:
    """Return the unit of what acts along a coordinate in rad or m."""
    return "N.m" if unit == "rad" else "N"


def coordinate_of(what: str, body: Body, given: int | None) -> int:
    """Return which coordinate of a body's joint is meant: the one given, or the only one.

    Raises
    ------
    UserError
        There is none of that number, there are several and none is given, or it is one of a quaternion.
    """
    if isinstance(body, Body):
        body._require_joint()
    joint, k = body.joint, given
    plain = joint.nv - 3 * joint.quaternion
    names = ", ".join(f"{k}: {name or joint.units[k]}" for k, name in enumerate(joint.coordinates[:plain]))
    if plain == 0:
        why = "has an orientation given by a quaternion" if joint.quaternion else "has none"
        raise UserError(f"{what}: the joint of body {body.name!r} {why}; allowed: an angle or a displacement")
    if k is None and plain == joint.nv == 1:
        return 0
    if not is_whole(k) or not 0 <= k < plain:
        raise UserError(f"{what} is {given!r}, of body {body.name!r}; allowed: {names}")
    return int(k)
