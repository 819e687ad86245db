"""Loops whose geometry is rounded: how long they are, and which of their axes are nearly parallel.

A planar loop closes out of its plane by parallel axes alone. Axes that are off by a rounding (1.5708 for a right angle)
make equations of its cut joint depend on the coordinates by that angle, which would lock the loop.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import rotation
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
    ways = []
    for k in (handle.a.index, handle.b.index):
        way = [k]
        while way[-1] > 0:
            way.append(mechanism.bodies[way[-1]].parent)
        ways.append(way)
    there, back = ways
    while len(there) > 1 and len(back) > 1 and there[-2] == back[-2]:
        there.pop()
        back.pop()
    return [*there, *reversed(back[:-1])]


def loop_length(mechanism: Mechanism, handle: CutHandle, state: State) -> float:
    """Return the length of the way from joint to joint around a loop where ``state`` places its bodies, m."""
    r, A = state.bodies["r"], state.bodies["A"]
    given = (handle.a, handle.cut.at_a), (handle.b, handle.cut.at_b)
    ends = [r[body.index] + A[body.index] @ np.asarray(at, float) for body, at in given]
    path = loop_path(mechanism, handle)  # one body of it carries the others, its origin does not matter
    inside = set(path)
    joints = [
        r[k] + A[k] @ mechanism.bodies[k].joint_at for k in path if mechanism.bodies[k].parent in inside and k > 0
    ]
    corners = [ends[0], *joints, ends[1]]
    return float(sum(np.linalg.norm(b - a) for a, b in pairwise(corners)))


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
        length, which = loop_length(mechanism, handle, state), nearly_parallel(mechanism, state, handle, known)
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


def joint_axes(mechanism: Mechanism, state: State) -> dict[int, Array]:
    """Return the axes (3,) of joints that have one, global, by the numbers of their bodies; ``state`` places these."""
    A, bodies = state.bodies["A"], enumerate(mechanism.bodies)
    return {
        k: A[body.parent] @ rotation("rotation", body.joint.rotation) @ body.joint.direction
        for k, body in bodies
        if k > 0 and isinstance(body.joint, AxisJoint)
    }


def nearly_parallel(mechanism: Mechanism, state: State, handle: CutHandle, known: dict[int, Array]) -> str:
    """Say which two of the axes of a loop that are nearly parallel are most off; empty: none is nearly parallel only.

    ``state`` places the bodies; ``known`` are the axes of their joints.
    """
    path = loop_path(mechanism, handle)
    inside = set(path)
    along = [k for k in path if k in known and mechanism.bodies[k].parent in inside]
    names = [f"joint {mechanism.bodies[k].name!r}" for k in along]
    axes = [known[k] for k in along]
    if handle.cut.parallel == "z":
        for body, R in zip((handle.a, handle.b), handle.cut.frames(), strict=True):
            names.append(f"cut joint {handle.name!r} on {body.name!r}")
            axes.append(state.bodies["A"][body.index] @ R[:, 2])
    worst, description, left = 0.0, "", np.arange(len(axes))
    directions = np.array(axes).reshape(-1, 3)
    while len(left):
        first, left = left[0], left[1:]
        one, others = directions[first], directions[left]
        angles = np.arctan2(np.linalg.norm(np.cross(one, others), axis=1), np.abs(others @ one))
        near = np.where(angles < MAX_ROUNDED_ANGLE, angles, 0.0)
        if near.max(initial=0.0) > max(PARALLEL_ANGLE, worst):
            worst, other = float(near.max()), left[np.argmax(near)]
            description = f"the axes of {names[first]} and {names[other]} are {worst:.3g} rad from parallel"
        left = left[angles > PARALLEL_ANGLE]  # the others are compared by this one
    return description
