"""Which coordinates a mechanism is written in: those of its plane, if it moves in one."""

from __future__ import annotations

from typing import Any

import numpy as np
from maximal import Maximal
from planar import Planar
from spatial import Spatial
from ties import ties
from tree import Pose, Units

from mbfmu.mechanics import Mechanism, Revolute, Spring, Translational, Weld


def normal_of(mechanism: Mechanism, poses: list[Pose]) -> Any:
    """Normal of the plane all bodies move in, from their poses; None where there is none."""
    axes = [poses[b.index].R @ b.joint.direction for b in mechanism.bodies[1:] if isinstance(b.joint, Revolute)]
    if not axes:
        return None
    n = axes[0]
    k = int(np.argmax(np.abs(n)))
    n = np.sign(n[k]) * n
    if abs(n[k] - 1.0) < 1e-14:
        n = np.eye(3)[k]
    found = True
    for body in mechanism.bodies[1:]:
        joint = body.joint
        if isinstance(joint, Revolute):
            found &= np.linalg.norm(np.cross(n, poses[body.index].R @ joint.direction)) < 1e-11
        elif isinstance(joint, Translational):
            found &= abs(n @ poses[body.index].R @ joint.direction) < 1e-11
        else:
            found &= isinstance(joint, Weld)
    for tie in ties(mechanism):
        if tie.kind == "hinge":
            found &= np.linalg.norm(np.cross(n, poses[tie.a].R @ tie.pa)) < 1e-11
        elif tie.kind == "slide":
            along = abs(n @ poses[tie.a].R @ tie.pa[0])
            found &= min(along, abs(along - 1.0)) < 1e-11
        elif tie.kind == "apart":
            found &= _level(n, poses, tie.a, tie.pa, tie.b, tie.pb)
    for _, force, a, b in mechanism.forces:
        if isinstance(force, Spring):
            found &= _level(n, poses, a.index, force.at_a, b.index, force.at_b)
    return n if found else None


def _level(n: Any, poses: list[Pose], a: int, pa: Any, b: int, pb: Any) -> bool:
    """Whether two points lie in one plane across n."""
    way = poses[b].o + poses[b].R @ np.asarray(pb) - poses[a].o - poses[a].R @ np.asarray(pa)
    return abs(float(n @ way)) < 1e-11 * max(1e-30, float(np.linalg.norm(pa)), float(np.linalg.norm(pb)))


def formulate(mechanism: Mechanism, unit: Units, t0: float, poses: list[Pose]) -> Maximal:
    """The mechanism in the plane if it moves in one, else in space."""
    normal = normal_of(mechanism, poses)
    if normal is None:
        return Spatial(mechanism, unit, t0, poses)
    return Planar(mechanism, unit, t0, poses, normal)
