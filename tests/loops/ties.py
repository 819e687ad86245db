"""Every joint and cut joint as ties between two bodies, whatever coordinates they are written in."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from tree import Known, NotCovered, joint_axes, known

from mbfmu.mechanics import (
    CylindricalCutJoint,
    DistanceCutJoint,
    Floating,
    Mechanism,
    PlanarCutJoint,
    PlaneCutJoint,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Translational,
    TranslationalCutJoint,
    Weld,
    WeldCutJoint,
)


class Tie(NamedTuple):
    """One constraint between bodies a and b; what p, r, length are depends on the kind."""

    kind: str
    a: int
    b: int
    pa: Any = None
    pb: Any = None
    axis: Any = None  # of a drive, in body a
    drive: Known | None = None
    length: float = 0.0


def ties(mechanism: Mechanism) -> list[Tie]:
    """Every joint and cut joint as ties: meet, hinge (axes parallel), lock (axes equal), slide, guide, apart."""
    found = []
    for body in mechanism.bodies[1:]:
        found += _of_joint(body.joint, body.parent, body.index)
    return found + cut_ties(mechanism)


def cut_ties(mechanism: Mechanism) -> list[Tie]:
    """Those of the cut joints."""
    return [tie for c in mechanism.cuts for tie in _of_cut(c.cut, c.a.index, c.b.index)]


def _of_joint(joint: Any, a: int, b: int) -> list[Tie]:
    at, F, zero = np.asarray(joint.at, float), joint_axes(joint), np.zeros(3)
    meet, lock = Tie("meet", a, b, at, zero), Tie("lock", a, b, F, np.eye(3))
    if isinstance(joint, Weld):
        return [meet, lock]
    if isinstance(joint, Spherical):
        return [meet]
    if isinstance(joint, Floating):
        return []
    axis = F @ joint.direction
    drive = None if joint.drive is None else known(joint.drive)
    if isinstance(joint, Revolute):
        if drive is None:
            return [meet, Tie("hinge", a, b, axis, joint.direction)]
        return [meet, lock._replace(axis=axis, drive=drive)]
    if isinstance(joint, Translational):
        if drive is not None:
            return [meet._replace(axis=axis, drive=drive), lock]
        return [lock, Tie("guide", a, b, (axis, at), zero)]
    raise NotCovered(f"joint {joint!r}")


def _of_cut(cut: Any, a: int, b: int) -> list[Tie]:
    at_a, at_b = np.asarray(cut.at_a, float), np.asarray(cut.at_b, float)
    Ra, Rb = cut.frames()
    meet, hinge = Tie("meet", a, b, at_a, at_b), Tie("hinge", a, b, Ra[:, 2], Rb[:, 2])
    slide, guide = (Tie(kind, a, b, (Ra[:, 2], at_a), at_b) for kind in ("slide", "guide"))
    match cut:
        case DistanceCutJoint():
            return [Tie("apart", a, b, at_a, at_b, length=cut.length)]
        case SphericalCutJoint():
            return [meet]
        case RevoluteCutJoint():
            return [meet, hinge]
        case WeldCutJoint():
            return [meet, Tie("lock", a, b, Ra, Rb)]
        case PlaneCutJoint():
            return [slide]
        case PlanarCutJoint():
            return [slide, hinge]
        case TranslationalCutJoint():
            return [guide, Tie("lock", a, b, Ra, Rb)]
        case CylindricalCutJoint():
            return [guide, hinge]
    raise NotCovered(f"cut {cut!r}")


def across(axis: Any) -> tuple[Any, Any]:
    """Two unit vectors that make a right-handed frame with a unit axis; exact where the axis is a coordinate axis."""
    e = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    e /= np.linalg.norm(e)
    return e, np.cross(axis, e)
