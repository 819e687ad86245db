"""Whether the bodies at the corners of plates and shells are where those belong.

An element identifies its bodies by their order. In crosswise or reversed order they span a cell that is turned
inside out, which has forces, if it does not divide by zero, but has no meaning. The orientations reveal this: they
rotate the element as it is when nothing strains it, and each of its edges must go about that way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.arrays.load_groups import find_misplaced_load
from mbfmu.mechanics.loads.base import MAX_MISPLACEMENT
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.sheets.elements.plate_energy import PlateRecord
    from mbfmu.sheets.elements.shell_energy import ShellRecord

MAX_EDGE_ANGLE = np.radians(45.0)  # of an edge: no element is good that far from its own shape
CORNERS = 4
EDGES_X, EDGES_Z = np.array([1.0, 0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0, -1.0])  # of a rectangle, from its corners


@inlined
def edge_angle(element: Any, k: int, x: float, y: float, z: float, state: State) -> float:
    """Angle between (x, y, z) and the edge from corner k to the next one, rad; a right angle if one has no length."""
    a, b = state.bodies[element.node[k]].r, state.bodies[element.node[(k + 1) % CORNERS]].r
    u, v, w = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    sizes = np.sqrt(u * u + v * v + w * w) * np.sqrt(x * x + y * y + z * z)
    cosine = (u * x + v * y + w * z) / sizes if sizes > 0.0 else 0.0
    return np.arccos(min(1.0, max(-1.0, cosine)))


@kernel
def plate_edge_angle(plate: PlateRecord, k: int, state: State) -> float:
    """Angle between edge k of a rectangle and its direction by the orientations of the bodies, rad."""
    x, y, z = 0.0, 0.0, 0.0
    for c in range(CORNERS):
        A = state.bodies[plate.node[c]].A
        x += A[0, 0] * EDGES_X[k] + A[0, 2] * EDGES_Z[k]
        y += A[1, 0] * EDGES_X[k] + A[1, 2] * EDGES_Z[k]
        z += A[2, 0] * EDGES_X[k] + A[2, 2] * EDGES_Z[k]
    return edge_angle(plate, k, x, y, z, state)


@kernel
def shell_edge_angle(shell: ShellRecord, k: int, state: State) -> float:
    """Angle between edge k of a shell and its direction by the orientations of the bodies, rad."""
    x, y, z, X, last = 0.0, 0.0, 0.0, shell.X, (k + 1) % CORNERS
    for c in range(CORNERS):
        A, B = state.bodies[shell.node[c]].A, shell.B[c]
        for i in range(3):
            along = 0.0
            for j in range(3):
                along += B[i, j] * (X[last, j] - X[k, j])
            x += A[0, i] * along
            y += A[1, i] * along
            z += A[2, i] * along
    return edge_angle(shell, k, x, y, z, state)


@kernel
def plate_misplacement(plate: PlateRecord, arrays: Arrays, state: State) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: by the largest angle of an edge."""
    largest = 0.0
    for k in range(CORNERS):
        largest = max(largest, plate_edge_angle(plate, k, state))
    return largest / MAX_EDGE_ANGLE


@kernel
def shell_misplacement(shell: ShellRecord, arrays: Arrays, state: State) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: by the largest angle of an edge."""
    largest = 0.0
    for k in range(CORNERS):
        largest = max(largest, shell_edge_angle(shell, k, state))
    return largest / MAX_EDGE_ANGLE


def check_corners(group: LoadGroup, angle: Any) -> None:
    """Raise UserError for an element whose bodies do not span it; ``angle`` is the kernel for that of an edge."""
    arrays, state = group.kernel_data
    loads: Any = group.data.arrays.loads
    p, ratio = find_misplaced_load(loads[group.numbers], arrays, state)
    if ratio <= MAX_MISPLACEMENT:
        return
    record, bodies = group.records[p], group.acting[p].bodies
    names, angles = [body.name for body in bodies], [angle(record, k, state) for k in range(CORNERS)]
    c = int(np.argmax(angles))
    raise UserError(
        f"corners of a plate are {names}: from {names[c]!r} to {names[(c + 1) % CORNERS]!r} the direction of its "
        f"edge differs by {np.degrees(angles[c]):.0f} degrees from the one that the orientations of its "
        f"bodies give; allowed: at most {np.degrees(MAX_EDGE_ANGLE):.0f}, and the bodies at (0, 0), (a, 0), "
        "(a, b), (0, b) of their x-z plane, in this order"
    )
