"""How large a mechanism is: the length and the units in which its coordinates and constraints are of order one.

A threshold on a gap, a step or a Jacobian means something only against these.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.handles import CouplingHandle, CutHandle
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.joints import Joint
from mbfmu.mechanics.numbers import MAX_LENGTH, MIN_LENGTH, array_of
from mbfmu.mechanics.records import Arrays
from mbfmu.util.errors import UserError
from solvers.diagnostics import Diagnostic
from solvers.system import Array

ASSUMED_LENGTH = 1.0  # m, of a mechanism that has none


def characteristic_length(mechanism: Mechanism, arrays: Arrays) -> float:
    """Return the largest distance between two connection points of one body, m.

    Points are origins of joints, centers of mass, and where cut joints and forces act, of a plane the point nearest to
    the origin of its body; a rod between two points and an
    flexible body count with their length. A mechanism all of whose points coincide is measured by the springs and the
    radii of gyration it has, and one without any by ASSUMED_LENGTH, see :func:`describe_assumed_length`. Raises
    UserError for one that is no length of a mechanism.
    """
    length = _given_length(mechanism, arrays) or ASSUMED_LENGTH
    if not MIN_LENGTH <= length <= MAX_LENGTH:
        raise UserError(
            f"the largest length of the mechanism is {length:.3g} m; allowed: {MIN_LENGTH:g} to {MAX_LENGTH:g} m"
        )
    return length


def _given_length(mechanism: Mechanism, arrays: Arrays) -> float:
    """Return the characteristic length that the mechanism itself has, m; zero: it has none."""
    return float(spans(mechanism, arrays).max()) or _length_without_points(mechanism, arrays)


def describe_assumed_length(mechanism: Mechanism, arrays: Arrays, free: list[Body]) -> list[Diagnostic]:
    """Return a note if no length of the mechanism is known, and coordinates of these ``free`` joints are displacements
    measured by it; else nothing.
    """
    if _given_length(mechanism, arrays):
        return []
    names = [body.name for body in free if "m" in body.joint.units and body.joint.nominal is None]
    if not names:
        return []
    others = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return [
        Diagnostic.note(
            "assumed-length",
            f"no length of the mechanism is given: all points of its bodies coincide. A length of {ASSUMED_LENGTH:g} m "
            f"is assumed for the tolerances of the displacements of body {names[0]!r}{others}",
            f"If they are much smaller or larger, give `nominal` of the joint{'s' * (len(names) > 1)}, m",
            subject=names[0],
        )
    ]


def spans(mechanism: Mechanism, arrays: Arrays) -> Array:
    """Return the largest distance of connection points of every body, and every other relevant length, m."""
    points: defaultdict[int, list[Array]] = defaultdict(list)
    for i, body in enumerate(arrays.bodies[1:], 1):
        points[i] += [np.zeros(3), body["com"], body["child_s"]]
        points[int(body["parent"])].append(body["s"])
    for handle in mechanism.cuts:
        points[handle.a.index].append(handle.cut.nearest("a"))
        points[handle.b.index].append(handle.cut.nearest("b"))
    for acting in mechanism.loads():
        for body, point in zip(acting.bodies, acting.load.points(), strict=False):
            points[body.index].append(np.asarray(point, float))
    held = [handle.cut.extent() for handle in mechanism.cuts]
    elastic = [*arrays.nodes["x"], *(handle.elastic.size for handle in mechanism.flexible_bodies)]
    return np.array([*(_span(np.array(own)) for own in points.values()), *held, *elastic])


def _span(points: Array) -> float:
    """Return the distance between two far points of (k, 3): at least 0.57 of the largest there is."""
    with np.errstate(over="ignore"):
        far = points[np.linalg.norm(points - points[0], axis=1).argmax()]
        return float(np.linalg.norm(points - far, axis=1).max())


def _length_without_points(mechanism: Mechanism, arrays: Arrays) -> float:
    """Return the largest length of an unloaded load or radius of gyration, m."""
    massive = arrays.bodies[arrays.bodies["mass"] > 0.0]
    turning = np.trace(massive["inertia"], axis1=1, axis2=2) / massive["mass"]
    free = max((acting.load.extent() for acting in mechanism.loads()), default=0.0)
    return max(float(np.sqrt(turning.max(initial=0.0) / 2.0)), free)


def coordinate_sizes(bodies: list[Body], length: float) -> Array:
    """Return the unit of every velocity coordinate of these joints: the given one, or 1 rad and ``length`` m."""
    return np.concatenate([np.zeros(0), *(joint_sizes(body.name, body.joint, length) for body in bodies)])


def joint_sizes(name: str, joint: Joint, length: float) -> Array:
    """Return the unit of the coordinates (nv,) of one joint."""
    if joint.nominal is None:
        return np.array([length if unit == "m" else 1.0 for unit in joint.units])
    nominal = array_of(f"nominal of body {name!r}", joint.nominal)
    if nominal.shape not in ((), (joint.nv,)) or not np.all(np.isfinite(nominal)) or np.any(nominal <= 0.0):
        raise UserError(
            f"nominal of body {name!r} is {joint.nominal!r}; allowed: one number greater than zero, "
            f"or {joint.nv} of them"
        )
    return np.broadcast_to(nominal, (joint.nv,))


def row_sizes(handle: CutHandle | CouplingHandle, length: float) -> Array:
    """Return the unit of the residual of every row: of a cut joint 1 rad where it turns, else ``length`` m."""
    if isinstance(handle, CutHandle):
        return np.array([1.0 if unit == "rad" else length for unit in handle.units])
    return np.array([_coupling_size(handle, length)])


def _coupling_size(handle: CouplingHandle, length: float) -> float:
    """Return what the free ones of two coupled coordinates change the residual by at most, each moved by its unit: so
    that the larger entry of its row is one, whatever the ratio.
    """
    a, b, steep = handle.a, handle.b, handle.coupling.steepness() or 1.0
    moved = (
        float(joint_sizes(a.name, a.joint, length)[handle.coordinate_a]),
        float(joint_sizes(b.name, b.joint, length)[handle.coordinate_b]) * steep,
    )
    free = [size for size, body in zip(moved, (a, b), strict=True) if body.joint.drive is None]
    return max(free or moved)
