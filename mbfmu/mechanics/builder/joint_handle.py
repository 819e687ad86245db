"""Handles of joints between two bodies of a mechanism that is declared as a graph, and their sensors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mbfmu.mechanics.checks import Matrix, Vector, one_of
from mbfmu.mechanics.joints import Joint
from mbfmu.mechanics.numbers import is_whole
from mbfmu.mechanics.sensors import Acceleration, Coordinate, DeclaredJointForce, Effort, Rate, Sensor, axis_index
from mbfmu.util.errors import UserError

from .bodies import Body, effort_unit


class JointPlace(NamedTuple):
    """Where the wrench of a joint on one of its bodies is found."""

    child: int  # body whose tree joint it is
    cut: int  # number of the cut joint; -1: it is in the tree
    sign: int  # 1: the wrench is that on the child or on body b of the cut joint, -1: on the other one
    body: int  # on which it acts
    point: Vector  # origin of the joint frame in this body (3,), m


@dataclass(eq=False)
class JointHandle:
    """Joint between two bodies, as returned by :meth:`Mechanism.joint`.

    Its sensors have the same meaning whether the joint is in the tree or closes a loop. Coordinates are those of body b
    relative to body a.

    Attributes
    ----------
    name
        Name, unique among the joints, cut joints and couplings.
    a, b
        Bodies that it connects.
    joint
        Type of the joint, its start values and its drive; ``at`` and ``rotation`` are its frame in body a.
    at_b, rotation_b
        Origin (3,), m, and axes (3, 3) as columns of its frame in body b.
    is_placed_on_b
        Whether ``at_b`` or ``rotation_b`` was given.
    needs_coordinates
        Whether something uses its coordinates, so that it must be in the tree.
    carrier
        Body whose tree joint it is; None: it closes a loop, or the mechanism is not compiled yet.
    cut
        Number of its cut joint; -1: it is in the tree.
    """

    name: str
    a: Body
    b: Body
    joint: Joint
    at_b: Matrix
    rotation_b: Matrix
    is_placed_on_b: bool
    needs_coordinates: bool
    carrier: Body | None = None
    cut: int = -1

    @property
    def index(self) -> int:
        """Number of the body whose tree joint it is, in a compiled mechanism."""
        return 0 if self.carrier is None else self.carrier.index

    def coordinate(self, k: int = 0) -> Sensor:
        """Joint position k, rad or m: of body b relative to body a.

        Parameters
        ----------
        k
            Number of the coordinate of the joint, from 0.

        Raises
        ------
        UserError
            The joint has no coordinate of this number.
        """
        return Coordinate(unit=self._unit(k), item=self, component=k, bodies=self._carriers())

    def rate(self, k: int = 0) -> Sensor:
        """Joint velocity k, rad/s or m/s.

        Parameters
        ----------
        k
            As for :meth:`coordinate`.
        """
        return Rate(unit=self._unit(k) + "/s", item=self, component=k, bodies=self._carriers())

    def acceleration(self, k: int = 0) -> Sensor:
        """Joint acceleration k, rad/s2 or m/s2.

        Parameters
        ----------
        k
            As for :meth:`coordinate`.
        """
        return Acceleration(unit=self._unit(k) + "/s2", item=self, component=k, bodies=self._carriers())

    def effort(self, k: int = 0) -> Sensor:
        """Generalized force of the drive of a driven joint, N or N m.

        Parameters
        ----------
        k
            As for :meth:`coordinate`.
        """
        return Effort(unit=effort_unit(self._unit(k)), item=self, component=k, bodies=self._carriers())

    angle = coordinate

    def force(self, axis: str, on: str = "b") -> Sensor:
        """Global component of the force that the joint exerts on a body, N.

        Parameters
        ----------
        axis
            Global axis: ``"x"``, ``"y"`` or ``"z"``.
        on
            Body on which the force acts, ``"a"`` or ``"b"``.
        """
        return self._wrench("N", axis_index(axis, f"of joint {self.name!r}"), on)

    def moment(self, axis: str, on: str = "b") -> Sensor:
        """Global component of the moment of the joint on a body about the origin of the joint frame in it, N m.

        Parameters
        ----------
        axis, on
            As for :meth:`force`.
        """
        return self._wrench("N.m", 3 + axis_index(axis, f"of joint {self.name!r}"), on)

    def place(self, on: str) -> JointPlace:
        """Return where the wrench on a body is found in the compiled mechanism.

        Parameters
        ----------
        on
            Body on which it acts, ``"a"`` or ``"b"``.
        """
        body, point = (self.a, self.joint.at) if on == "a" else (self.b, self.at_b)
        if self.carrier is None:
            return JointPlace(0, self.cut, 1 if on == "b" else -1, body.index, point)
        is_on_carrier = self.carrier.reversed == (on == "a")
        acted = self.carrier if is_on_carrier else body
        return JointPlace(self.carrier.index, -1, 1 if is_on_carrier else -1, acted.index, point)

    def _carriers(self) -> tuple[JointHandle]:
        """Require that the joint is in the tree; return what has the number of the body that it then moves."""
        self.needs_coordinates = True
        return (self,)

    def _wrench(self, unit: str, component: int, on: str) -> Sensor:
        one_of(f"body of joint {self.name!r}", on, ("a", "b"))
        if self.joint.nv == 6:
            raise UserError(f"joint {self.name!r} does not constrain its bodies and exerts no force")
        return DeclaredJointForce(unit=unit, item=self, component=component, on=on)

    def _unit(self, k: int) -> str:
        if not is_whole(k) or not 0 <= k < self.joint.nv:
            raise UserError(f"joint {self.name!r} has no coordinate {k!r}; it has {self.joint.nv}")
        return self.joint.units[k]
