"""Loops whose geometry is rounded: how long they are, and which of their axes are nearly parallel.

A planar loop closes out of its plane by parallel axes alone. Axes that are off by a rounding (1.5708 for a right angle)
make equations of its cut joint depend on the coordinates by that angle, which would lock the loop.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.joints import Section
from mbfmu.mechanics.joints.base import AxisJoint
from mbfmu.mechanics.records import State
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import Array

ROUNDED_ADVICE = (
    "give their directions with more digits, use a cut joint that does not constrain what the other joints already "
    "constrain, or increase the assembly tolerance of the mechanism"
)
PARALLEL_ANGLE = 1e-13  # rad: below this axes are parallel to rounding
MAX_ROUNDED_ANGLE = 0.02  # rad: above this axes are meant to be at an angle


def loop_path(mechanism: Mechanism, handle: CutHandle) -> list[int]:
    """Return the numbers of the bodies from a to b of a cut joint, along the tree."""
    bodies, there, back = mechanism.bodies, [handle.a.index], [handle.b.index]
    while there[-1] != back[-1]:  # a body has a greater number than its parent
        way = there if there[-1] > back[-1] else back
        way.append(bodies[way[-1]].parent)
    return [*there, *reversed(back[:-1])]


def _loop_joints(path: list[int]) -> NDArray[np.int64]:
    """Return the bodies of a loop whose joints are in it: all but the one that is nearest to the ground."""
    found = np.array(path)
    return np.asarray(found[found != found.min()])


def loop_length(mechanism: Mechanism, handle: CutHandle, path: list[int], state: State, longest_travel: float) -> float:
    """Return the length of the way from joint to joint around a loop where ``state`` places its bodies, m.

    The distance that the coordinates of a joint move its two points apart is counted up to ``longest_travel``, m: it
    may be any, as that of a wheel which has rolled far, and the axes of the loop are no longer for it.
    """
    r, A, bodies = state.bodies["r"], state.bodies["A"], mechanism.bodies

    def place(k: int, at: Any) -> Array:
        found: Array = r[k] + A[k] @ np.asarray(at, float)
        return found

    def nearest(k: int, on: str, to: Array) -> Array:
        return place(k, handle.cut.nearest(on, A[k].T @ (to - r[k])))

    corners, top = [place(handle.a.index, handle.cut.at_a)], path.index(min(path))
    for k, body in enumerate(path):
        if k == top:
            continue
        own, joint = place(body, bodies[body].joint_at), bodies[body].joint
        on_parent = own if isinstance(joint, Section) else place(bodies[body].parent, joint.at)
        corners += [own, on_parent] if k < top else [on_parent, own]
    corners.append(place(handle.b.index, handle.cut.at_b))
    corners[0] = nearest(handle.a.index, "a", corners[1])
    corners[-1] = nearest(handle.b.index, "b", corners[-2])
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    return float(lengths[::2].sum() + np.minimum(lengths[1::2], longest_travel).sum())


class Measures(NamedTuple):
    """What the residuals of all rows are measured by where geometry is rounded."""

    units: Array  # (rows,) 1 rad, or the length of the loop in m; of a coupling the unit of its row
    relative: Array  # (rows,) 1, or 0 where no rounding is allowed: of couplings
    names: list[str]  # of the units
    axes: list[str]  # which axes of the loop are not parallel

    def allowed(self, tolerance: float) -> Array:
        """Return the largest gap (rows,) from rounded geometry, in SI units."""
        return tolerance * self.relative * self.units

    def describe(self, row: int, gap: float) -> str:
        """Return a gap, given in units, with its unit."""
        return f"{gap * self.units[row]:.2g} {self.names[row]}"


def measure_rows(mechanism: Mechanism, state: State, row_size: Array) -> Measures:
    """Return the measures of all rows, whose units are ``row_size``, where ``state`` places the bodies."""
    units, relative = row_size.copy(), np.zeros(len(row_size))
    names = [unit for handle in mechanism.constraints for unit in handle.units]
    axes, row, known = [""] * len(units), 0, joint_axes(mechanism, state)
    for handle in mechanism.cuts:
        path = loop_path(mechanism, handle)
        travel = float(row_size[row : row + len(handle.units)].max(initial=0.0))
        length = loop_length(mechanism, handle, path, state, travel)
        which = nearly_parallel(mechanism, state, handle, path, known)
        for unit in handle.units:
            units[row] = length if unit == "m" and length > 0.0 else row_size[row]
            relative[row] = 1.0 if unit == "rad" or length > 0.0 else 0.0
            axes[row], row = which, row + 1
    return Measures(units, relative, names, axes)


def describe_omitted(name: str, violation: str, tolerance: float, axes: str) -> Diagnostic:
    """Return a warning about a constraint equation that is left out."""
    why = f": {axes}" if axes else ""
    return Diagnostic.warning(
        "nearly-parallel-axes",
        f"constraint {name!r} is left out: it is violated by at most {violation}, which is within the assembly "
        f"tolerance of {tolerance:g}{why}",
        "Reduce the assembly tolerance of the mechanism if it is intended",
        subject=name,
    )


def joint_axes(mechanism: Mechanism, state: State) -> Array:
    """Return the axes (bodies, 3) of joints, global, zero of those that have none; ``state`` places the bodies."""
    A, found = state.bodies["A"], np.zeros((len(mechanism.bodies), 3))
    for k, body in enumerate(mechanism.bodies):
        if k > 0 and isinstance(body.joint, AxisJoint):
            found[k] = A[body.parent] @ rotation("rotation", body.joint.rotation) @ body.joint.direction
    return found


def nearly_parallel(mechanism: Mechanism, state: State, handle: CutHandle, path: list[int], known: Array) -> str:
    """Say which two of the axes of a loop that are nearly parallel are most off; empty: none is nearly parallel only.

    ``state`` places the bodies, ``path`` are those of the loop, and ``known`` the axes of their joints.
    """
    along = _loop_joints(path)
    along = along[known[along].any(axis=1)]
    directions = known[along]
    if handle.cut.parallel == "z":
        sides = zip((handle.a, handle.b), handle.cut.frames(), strict=True)
        directions = np.vstack([directions, *(state.bodies["A"][body.index] @ R[:, 2] for body, R in sides)])

    def name(k: int) -> str:
        if k < len(along):
            return f"joint {mechanism.bodies[along[k]].coordinate_name!r}"
        return f"cut joint {handle.name!r} on {(handle.a, handle.b)[k - len(along)].name!r}"

    worst, description, left = 0.0, "", np.arange(len(directions))
    while len(left):
        first, left = left[0], left[1:]
        one, others = directions[first], directions[left]
        angles = np.arctan2(np.linalg.norm(np.cross(one, others), axis=1), np.abs(others @ one))
        near = np.where(angles < MAX_ROUNDED_ANGLE, angles, 0.0)
        if near.max(initial=0.0) > max(PARALLEL_ANGLE, worst):
            worst, other = float(near.max()), left[np.argmax(near)]
            description = f"the axes of {name(first)} and {name(other)} are {worst:.3g} rad from parallel"
        left = left[angles > PARALLEL_ANGLE]  # the others are compared by this one
    return description
