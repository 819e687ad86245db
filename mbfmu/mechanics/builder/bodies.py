"""Handles that the builder returns (bodies, cut joints, couplings, forces, elastic bodies) and their sensors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError
from mbfmu.mechanics.checks import Matrix, Vector, one_of, vector
from mbfmu.mechanics.couplings import Coupling
from mbfmu.mechanics.cuts import Cut
from mbfmu.mechanics.flexible import Beam
from mbfmu.mechanics.joints import Joint, Section
from mbfmu.mechanics.loads import DistanceStop, LineForce, Load, Spring
from mbfmu.mechanics.numbers import is_whole
from mbfmu.mechanics.sensors import (
    Acceleration,
    AngularVelocity,
    BendingMoment,
    Coordinate,
    CouplingEffort,
    CutForce,
    Deflection,
    DirectionCosine,
    Distance,
    DistanceRate,
    Effort,
    JointForce,
    LoadEffort,
    LoadWrench,
    PointAcceleration,
    PointPosition,
    PointVelocity,
    Quaternion,
    Rate,
    RowForce,
    Sensor,
    axis_index,
)

if TYPE_CHECKING:
    from .mechanism import Mechanism

BETWEEN_POINTS = (DistanceStop, LineForce, Spring)  # forces along the line that joins their two points


@dataclass(frozen=True, eq=False)
class Body:
    """Body of a mechanism, as returned by :meth:`Mechanism.body`.

    Attributes
    ----------
    name
        Name, unique in the mechanism.
    index, parent
        Numbers of the body and of its parent; the ground is number 0.
    joint
        Tree joint that connects the body to its parent.
    mass, com, inertia
        Mass, kg, center of mass (3,), m, and inertia about it (3, 3), kg m^2, in the body's frame.
    """

    name: str
    index: int
    parent: int
    joint: Joint
    mass: float = 0.0
    com: Matrix = field(default_factory=lambda: np.zeros(3))
    inertia: Matrix = field(default_factory=lambda: np.zeros((3, 3)))

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
        return JointForce(unit="N", item=self, component=self._axis(axis))

    def joint_moment(self, axis: str) -> Sensor:
        """Global component of the moment of the tree joint on this body about its origin, N m.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        """
        return JointForce(unit="N.m", item=self, component=3 + self._axis(axis))

    def _axis(self, axis: str) -> int:
        return axis_index(axis, f"of body {self.name!r}")

    def _point(self, point: Vector) -> Matrix:
        return vector(f"point of body {self.name!r}", point)

    def _unit(self, k: int) -> str:
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


@dataclass(frozen=True, eq=False)
class CutHandle:
    """Loop-closing joint (cut joint) of a mechanism, as returned by :meth:`Mechanism.cut`.

    Attributes
    ----------
    name
        Name, unique among the cut joints and couplings.
    index
        Number among the cut joints.
    cut
        Type of the joint and its frames.
    a, b
        Bodies that it connects.
    """

    name: str
    index: int
    cut: Cut
    a: Body
    b: Body
    what: ClassVar[str] = "loop"  # as messages call it

    @property
    def rows(self) -> tuple[str, ...]:
        """Suffix of the name of each constraint equation."""
        return self.cut.rows

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of the residual of each constraint equation."""
        return tuple("rad" if unit == "N.m" else "m" for unit in self.cut.units)

    def force(self, row: str = "") -> Sensor:
        """Force (N) or moment (N m) of one constraint equation on body b.

        Parameters
        ----------
        row
            Name of the constraint equation, one of ``rows``: ``x``, ``y``, ``z`` are forces along the axes of the cut
            frame, which are fixed in body a. A :class:`.DistanceCut` has one equation, ``""``, along the line from a
            to b.

        Raises
        ------
        UserError
            The joint has no constraint equation of this name.
        """
        if row not in self.cut.rows:
            raise UserError(
                f"cut {self.name!r} has no component {row!r}; allowed: {', '.join(map(repr, self.cut.rows))}"
            )
        k = self.cut.rows.index(row)
        return RowForce(unit=self.cut.units[k], item=self, component=k)

    def joint_force(self, axis: str, on: str = "b") -> Sensor:
        """Global component of the force that the cut joint exerts on a body, N.

        Constraint equations that are always satisfied exert no force.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        on
            Body on which the force acts, ``"a"`` or ``"b"``.
        """
        one_of(f"body of cut {self.name!r}", on, ("a", "b"))
        component = axis_index(axis, f"of cut {self.name!r}") + (3 if on == "a" else 0)
        return CutForce(unit="N", item=self, component=component)


@dataclass(frozen=True, eq=False)
class CouplingHandle:
    """Coupling of two joint coordinates, as returned by :meth:`Mechanism.couple`.

    Attributes
    ----------
    name
        Name, unique among the cut joints and couplings.
    index
        Number among the couplings.
    coupling
        Coupling law.
    a, b
        Bodies whose joints are coupled.
    coordinate_a, coordinate_b
        Numbers of the coordinates of their joints, from 0.
    """

    name: str
    index: int
    coupling: Coupling
    a: Body
    b: Body
    coordinate_a: int
    coordinate_b: int
    what: ClassVar[str] = "coupling"
    rows: ClassVar[tuple[str, ...]] = ("",)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of its residual: that of the first coordinate."""
        return (self.a.joint.units[self.coordinate_a],)

    def effort(self, on: str = "a") -> Sensor:
        """Generalized force of the coupling on a joint coordinate, N or N m.

        Parameters
        ----------
        on
            Body whose coordinate is meant, ``"a"`` or ``"b"``.
        """
        one_of(f"body of coupling {self.name!r}", on, ("a", "b"))
        unit = (self.a.joint.units[self.coordinate_a], self.b.joint.units[self.coordinate_b])["ab".index(on)]
        return CouplingEffort(unit=effort_unit(unit), item=self, component="ab".index(on), bodies=(self.a, self.b))


@dataclass(frozen=True, eq=False)
class ForceHandle:
    """Force element of a mechanism, as returned by :meth:`Mechanism.force`.

    Attributes
    ----------
    name
        Name, unique among the forces and loads.
    index
        Number among the forces.
    load
        Type of the force and its data.
    a, b
        Bodies on which it acts; b is the ground if none was given.
    """

    name: str
    index: int
    load: Load
    a: Body
    b: Body

    def force(self, axis: str, on: str = "a") -> Sensor:
        """Global component of the force on a body, N.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        on
            Body on which the force acts, ``"a"`` or ``"b"``.

        Raises
        ------
        UserError
            The element acts along a joint coordinate; use :meth:`effort`.
        """
        return self._wrench("N", self._axis(axis), on)

    def moment(self, axis: str, on: str = "a") -> Sensor:
        """Global component of the moment on a body about the origin of the body, N m.

        Parameters
        ----------
        axis, on
            As for :meth:`force`.
        """
        return self._wrench("N.m", 3 + self._axis(axis), on)

    def effort(self) -> Sensor:
        """Generalized force on the coordinate of its joint, N or N m.

        Raises
        ------
        UserError
            The element acts on bodies; use :meth:`force` or :meth:`moment`.
        """
        if not self.load.on_joint:
            raise UserError(
                f"force {self.name!r} acts on bodies and not along a joint coordinate; use force() or moment()"
            )
        return LoadEffort(unit=effort_unit(self.a.joint.units[0]), item=self, bodies=(self.a,))

    def length(self) -> Sensor:
        """Distance of the two points of a force that acts along the line between them, m.

        Raises
        ------
        UserError
            The element is not a ``Spring``, a ``DistanceStop`` or a ``LineForce``; use :meth:`.Mechanism.distance`.
        """
        return Distance(unit="m", bodies=(self.a, self.b), **self._ends())

    def length_rate(self) -> Sensor:
        """Rate of :meth:`length`, m/s; zero where the points coincide."""
        return DistanceRate(unit="m/s", bodies=(self.a, self.b), **self._ends())

    def _ends(self) -> dict[str, Any]:
        """Return its points, body axes, m; raises UserError for a force that is not along a line between two."""
        load = self.load
        if not isinstance(load, BETWEEN_POINTS):
            raise UserError(
                f"force {self.name!r} is of class {type(load).__name__}, which has no length; allowed: "
                f"{', '.join(kind.__name__ for kind in BETWEEN_POINTS)}. Use Mechanism.distance for other points"
            )
        return {key: vector(f"{key} of force {self.name!r}", getattr(load, key)) for key in ("at_a", "at_b")}

    def _axis(self, axis: str) -> int:
        return axis_index(axis, f"of force {self.name!r}")

    def _wrench(self, unit: str, component: int, on: str) -> Sensor:
        one_of(f"body of force {self.name!r}", on, ("a", "b"))
        if self.load.on_joint:
            raise UserError(f"force {self.name!r} acts along a joint coordinate; use effort()")
        return LoadWrench(unit=unit, item=self, component=component + (6 if on == "b" else 0), bodies=(self.a, self.b))


@dataclass(frozen=True, eq=False)
class FlexibleBody:
    """Elastic body, as returned by :meth:`Mechanism.flexible_body`.

    Attributes
    ----------
    name, index
        Name, and number among the elastic bodies.
    beam
        Beam and its modes.
    body
        Frame of the beam as a body of the tree without mass, connected to the parent by the joint.
    modes
        First section: coordinate k is the amplitude of mode k + 1, m.
    """

    name: str
    index: int
    beam: Beam
    body: Body
    modes: Body
    _mechanism: Mechanism
    _sections: dict[float, Body] = field(default_factory=dict)

    def section(self, x: float) -> Body:
        """Return a cross-section as a body, for joints, cut joints, loads and outputs.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.

        Returns
        -------
        Body
            Body without mass, whose frame moves and rotates with the cross-section.
        """
        if x not in self._sections:
            self.beam.shape(x)
            joint = Section(beam=self.beam, x=float(x), frame=self.modes)
            self._sections[x] = self._mechanism.add_section(f"{self.name}[{x:g}]", self.modes, joint)
        return self._sections[x]

    def deflection(self, x: float) -> Sensor:
        """Deflection along y at x, m.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.
        """
        return Deflection(unit="m", item=self.section(x))

    def moment(self, x: float) -> Sensor:
        """Bending moment E I w'' about z, N m; without the damping of the material.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.
        """
        return BendingMoment(unit="N.m", item=self.section(x))


@dataclass(frozen=True, eq=False)
class Surface:
    """A grid of bodies drawn as one skin, see :meth:`Mechanism.surface`."""

    name: str
    bodies: NDArray[np.int64]  # (rows, columns) indices
    at: Matrix  # the point of every body it passes through, body axes, m
    color: str
    field: str = ""  # cell (i, k) is colored by the output field[i,k]; empty: by none


@dataclass(frozen=True, kw_only=True)
class Profile:
    """The rectangular cross-section an elastic body is drawn with, see :meth:`Mechanism.profile`."""

    height: float  # along y, in which it bends, m
    width: float  # along z, m
    color: str
