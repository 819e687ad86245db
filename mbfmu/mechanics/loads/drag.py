"""Quadratic air drag on an element between four bodies: pressure -rho c |v_n| v_n / 2 on its area.

v_n is the velocity of its center, the mean of the corners, along its normal; a quarter of the force acts on each body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Integers, Record, f8

from .base import Load, zero_tangent

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Table


class DragRecord(Record):
    """Parameters of :class:`Drag`."""

    node: Annotated[Integers, (4,)]  # bodies at the corners, in the order of those of a pressure
    coefficient: f8  # rho c area / 2, kg/m


@kernel
def normal_flow(drag: DragRecord, bodies: Table[MotionRecord]) -> tuple[float, float, float, float]:
    """v_n, and the normal of the area, g2 x g1."""
    n1, n2, n3, n4 = bodies[drag.node[0]], bodies[drag.node[1]], bodies[drag.node[2]], bodies[drag.node[3]]
    r1, r2, r3, r4 = n1.r, n2.r, n3.r, n4.r
    # the diagonals span the same plane: 2 g2 x g1 = (r3 - r1) x (r2 - r4)
    px, py, pz = r3[0] - r1[0], r3[1] - r1[1], r3[2] - r1[2]
    sx, sy, sz = r2[0] - r4[0], r2[1] - r4[1], r2[2] - r4[2]
    nx, ny, nz = py * sz - pz * sy, pz * sx - px * sz, px * sy - py * sx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    speed = 0.25 * (
        nx * (n1.Y[0] + n2.Y[0] + n3.Y[0] + n4.Y[0])
        + ny * (n1.Y[1] + n2.Y[1] + n3.Y[1] + n4.Y[1])
        + nz * (n1.Y[2] + n2.Y[2] + n3.Y[2] + n4.Y[2])
    )
    return speed, nx, ny, nz


@kernel
def apply(drag: DragRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`.base`."""
    bodies = state.bodies
    speed, nx, ny, nz = normal_flow(drag, bodies)
    f = 0.25 * drag.coefficient * speed * speed
    if speed.real > 0.0:
        f = -f
    for i in range(4):
        F = bodies[drag.node[i]].F
        F[0] += f * nx
        F[1] += f * ny
        F[2] += f * nz


@kernel
def power(drag: DragRecord, t: float, arrays: Arrays, state: State) -> float:
    """-rho c area |v_n|^3 / 2, W."""
    speed, _, _, _ = normal_flow(drag, state.bodies)
    return -drag.coefficient * speed * speed * (speed if speed.real > 0.0 else -speed)


@dataclass(frozen=True, kw_only=True)
class Drag(Load):
    """Drag on a cell of some area (m^2); ``density`` is that of the air times the drag coefficient, kg/m^3."""

    record = DragRecord
    apply = apply
    power = power
    tangent = zero_tangent

    density: float
    area: float

    def fill(self, record: Any, site: Attachment) -> None:
        """Write its corners, and how much."""
        record["node"], record["coefficient"] = site.bodies, 0.5 * self.density * self.area
