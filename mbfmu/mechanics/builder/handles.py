"""Handles of loop-closing joints, couplings and forces, and their sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from mbfmu.mechanics.checks import one_of, vector
from mbfmu.mechanics.couplings import Coupling
from mbfmu.mechanics.cuts import CutJoint
from mbfmu.mechanics.loads import Damper, DistanceStop, LineForce, LineFriction, Load, Rope, Spring
from mbfmu.mechanics.numbers import is_whole
from mbfmu.mechanics.sensors import (
    CouplingEffort,
    CutForce,
    DeclaredJointForce,
    Distance,
    DistanceRate,
    LoadEffort,
    LoadWrench,
    RequiredFriction,
    RopeLength,
    RopeLengthRate,
    RopeTension,
    RowForce,
    Sensor,
    axis_index,
)
from mbfmu.util.errors import UserError

from .bodies import Body, effort_unit
from .joint_handle import JointPlace

BETWEEN_POINTS = (
    Damper,
    DistanceStop,
    LineForce,
    LineFriction,
    Spring,
)  # forces along the line that joins their two points


class Mesh(Protocol):
    """Bodies that elements connect to one another: nodes in rows, which move together more than by themselves."""

    @property
    def name(self) -> str:
        """Name."""

    @property
    def nodes(self) -> Sequence[Sequence[Body]]:
        """Nodes by row and column."""

    @property
    def along(self) -> int:
        """Which way the tree of its joints grows: its columns lie across the rows (0) or along them (1)."""


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
    cut: CutJoint
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

    @property
    def nonholonomic(self) -> tuple[bool, ...]:
        """Whether each constraint equation restricts velocities only."""
        return tuple(row in self.cut.nonholonomic for row in self.cut.rows)

    def force(self, row: str = "") -> Sensor:
        """Force (N) or moment (N m) of one constraint equation on body b.

        Parameters
        ----------
        row
            Name of the constraint equation, one of ``rows``: ``x``, ``y``, ``z`` are forces along the axes of the cut
            frame, which are fixed in body a. A :class:`.DistanceCutJoint` has one equation, ``""``, along the line
            from a to b. A :class:`.RollingWheel` has ``normal``, ``longitudinal`` and ``lateral``.

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

    def required_friction(self) -> Sensor:
        """Coefficient of friction that a :class:`.RollingWheel` requires.

        (F_longitudinal^2 + F_lateral^2)^(1/2) / N with the normal force N: the wheel would slip if it exceeds the
        coefficient of friction of the surfaces. It is negative if the plane would have to pull the wheel.

        Raises
        ------
        UserError
            The joint is no rolling wheel.
        """
        if not self.cut.nonholonomic:
            raise UserError(f"cut {self.name!r} is a {type(self.cut).__name__}; allowed: a RollingWheel")
        return RequiredFriction(unit="1", item=self)

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

    def joint_moment(self, axis: str, on: str = "b") -> Sensor:
        """Global component of the moment that the cut joint exerts on a body, N m.

        The moment is about the origin of the cut frame in this body, ``at_a`` or ``at_b`` of the joint.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        on
            Body on which the moment acts, ``"a"`` or ``"b"``.
        """
        one_of(f"body of cut {self.name!r}", on, ("a", "b"))
        component = 3 + axis_index(axis, f"of cut {self.name!r}")
        return DeclaredJointForce(unit="N.m", item=self, component=component, on=on)

    def place(self, on: str) -> JointPlace:
        """Return where the force and the moment that the cut joint exerts on a body are found.

        Parameters
        ----------
        on
            The body, ``"a"`` or ``"b"``.
        """
        body, point = (self.a, self.cut.at_a) if on == "a" else (self.b, self.cut.at_b)
        return JointPlace(0, self.index, -1 if on == "a" else 1, body.index, point)


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
    nonholonomic: ClassVar[tuple[bool, ...]] = (False,)

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

    def effort(self, k: int = 0) -> Sensor:
        """Generalized force on the coordinate of its joint, N or N m.

        Parameters
        ----------
        k
            Number among the coordinates on which it acts; friction such as
            :class:`.SphericalFriction` has several.

        Raises
        ------
        UserError
            The element acts on bodies; use :meth:`force` or :meth:`moment`. Or there is no coordinate k.
        """
        if not self.load.on_joint:
            raise UserError(
                f"force {self.name!r} acts on bodies and not along a joint coordinate; use force() or moment()"
            )
        coordinates = self.load.coordinates
        if not is_whole(k) or not 0 <= k < len(coordinates):
            raise UserError(f"k of effort of force {self.name!r} is {k!r}; allowed: 0 to {len(coordinates) - 1}")
        component = coordinates[k]
        unit = effort_unit(self.a.joint.units[component])
        return LoadEffort(unit=unit, item=self, bodies=(self.a,), component=component)

    def length(self) -> Sensor:
        """Distance of the two points of a force that acts along the line between them, m.

        Raises
        ------
        UserError
            The element is not a ``Spring``, a ``Damper``, a ``DistanceStop``, a ``LineForce`` or a ``LineFriction``;
            use :meth:`.Mechanism.distance`.
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
class RopeHandle:
    """Rope of a mechanism, as returned by :meth:`Mechanism.rope`.

    Attributes
    ----------
    name
        Name, unique among the forces and loads.
    load
        The rope and its path.
    bodies
        Bodies on which it acts.
    """

    name: str
    load: Rope
    bodies: tuple[Body, ...]

    def tension(self) -> Sensor:
        """Tension, N, the same in the whole rope; zero if it is slack."""
        return RopeTension(unit="N", item=self, bodies=self.bodies)

    def length(self) -> Sensor:
        """Length of the path, m: less than the unloaded length if the rope is slack."""
        return RopeLength(unit="m", item=self, bodies=self.bodies)

    def length_rate(self) -> Sensor:
        """Rate of :meth:`length`, m/s."""
        return RopeLengthRate(unit="m/s", item=self, bodies=self.bodies)
