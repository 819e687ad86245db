"""Mechanisms that are declared as a graph: joints between two bodies in any order.

>>> from mbfmu.mechanics import CompiledMechanism, Mechanism, Revolute, rod
>>> m = Mechanism(gravity=(0, -9.81, 0))
>>> crank = m.body("crank", **rod(mass=1, length=1))
>>> coupler = m.body("coupler", **rod(mass=1, length=3))
>>> rocker = m.body("rocker", **rod(mass=1, length=2))
>>> joints = [
...     m.joint("A", m.ground, crank, Revolute(start=1.0)),
...     m.joint("B", crank, coupler, Revolute(at=(1, 0, 0))),
...     m.joint("C", coupler, rocker, Revolute(at=(3, 0, 0)), at_b=(2, 0, 0)),
...     m.joint("D", m.ground, rocker, Revolute(at=(3, 0, 0), start=1.5)),
... ]
>>> CompiledMechanism(m).mechanism.cuts[0].name
'C'
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.checks import Vector, rotation, vector
from mbfmu.mechanics.joints import Joint, Section
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.numbers import not_negative
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError

from .bodies import Body
from .handles import CouplingHandle, CutHandle
from .joint_handle import JointHandle
from .members import Members


class Graph(Members):
    """Base of :class:`.Mechanism`: joints between two bodies, and the constraints.

    Attributes
    ----------
    cuts, couplings
        Cut joints and couplings.
    joints
        Joints between two bodies, see :meth:`joint`.
    tree_notes
        What was chosen for these, when the mechanism is compiled.
    """

    def __init__(self) -> None:
        super().__init__()
        self.cuts: list[CutHandle] = []
        self.couplings: list[CouplingHandle] = []
        self.joints: list[JointHandle] = []
        self.tree_notes: list[Diagnostic] = []

    def joint(
        self,
        name: str,
        a: Body,
        b: Body,
        joint: Joint,
        *,
        at_b: Vector | None = None,
        rotation_b: Any = None,
    ) -> JointHandle:
        """Connect bodies a and b by a joint, in any order; the program chooses which joints form the tree.

        The coordinates are those of body b relative to body a. If they are zero, the frame of the joint in body b
        coincides with that in body a. Bodies are declared by ``body(name, mass=...)`` without parent and joint.

        Parameters
        ----------
        name
            Unique name among the joints, cut joints and couplings.
        a, b
            Bodies of this mechanism or its ground.
        joint
            Type of the joint, such as ``Revolute(at=(1, 0, 0))``; ``at`` and ``rotation`` are its frame in body a. A
            joint with a drive, an armature or ``fixed`` start values, or whose coordinates are used by a force, a
            coupling or an output is in the tree. Other start values are used if the joint is in the tree.
        at_b, rotation_b
            Origin (3,) of the frame of the joint in body b, m, and its axes there as columns of a 3x3 matrix or as a
            SciPy ``Rotation``; None: the frame of body b.

        Returns
        -------
        JointHandle
            Handle of the joint: for forces and couplings of its coordinates, and for sensors.

        Raises
        ------
        UserError
            The name is used already, a body is not one of this mechanism, or the joint is invalid.
        """
        what = f"joint {name!r}"
        self._new_name("joint", name, self._constraint_names())
        self._member(a, f"body a of {what}")
        self._member(b, f"body b of {what}")
        if a is b:
            raise UserError(f"{what} connects body {a.name!r} to itself; it needs two bodies")
        check_joint(what, joint)
        given = at_b is not None or rotation_b is not None
        at = np.zeros(3) if at_b is None else vector(f"at_b of {what}", at_b)
        axes = rotation(f"rotation_b of {what}", rotation_b)
        vector(f"at of {what}", joint.at)
        rotation(f"rotation of {what}", joint.rotation)
        is_needed = joint.drive is not None or joint.fixed or joint.armature > 0.0
        self.joints.append(JointHandle(name, a, b, joint, at, axes, given, is_needed))
        return self.joints[-1]

    def _constraint_names(self) -> list[str]:
        return [*(c.name for c in self.cuts), *(c.name for c in self.couplings), *(j.name for j in self.joints)]

    def _coordinate_owner(self, owner: Body | JointHandle, role: str) -> Body:
        """Check what a coordinate is of, a body by its tree joint or a joint; return it.

        A joint is replaced by the body that it moves when the mechanism is compiled.
        """
        if isinstance(owner, JointHandle):
            if not any(owner is own for own in self.joints):
                raise UserError(f"{role} is joint {owner.name!r}, which is not one of this mechanism; use its own")
            owner.needs_coordinates = True
            return owner  # type: ignore[return-value]  # has the name, the joint and the number of that body
        self._member(owner, role)
        return owner


def check_joint(what: str, joint: Joint) -> None:
    """Refuse what is no joint, or one that cannot be driven."""
    if isinstance(joint, Section):
        raise UserError(f"{what} is of class Section; use FlexibleHandle.section")
    check_element_type(what, joint, Joint)
    joint.check(what)
    if joint.drive is not None and joint.nv != 1:
        raise UserError(
            f"{what} has {joint.nv} coordinates and cannot be driven; allowed: a joint of one coordinate, or a chain "
            "of such joints through bodies without mass"
        )
    if not_negative(f"armature of {what}", joint.armature) and joint.nv != 1:
        raise UserError(
            f"armature of {what} is {joint.armature!r}, and the joint has {joint.nv} coordinates; allowed: an armature "
            "of a joint of one coordinate. Use a chain of such joints through bodies without mass"
        )
