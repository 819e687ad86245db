"""Out-of-plane: a node of a thin sheet on its neighbor (sheet paper, eq. 4, 5, 9, 10).

The sheet lies in the x-z plane of every node's frame. Coordinates (alpha, theta_z, theta_x): the child moves along the
parent's normal y', then turns about z' and about the x axis so turned,

    A_k = A_j A_z(theta_z) A_x(theta_x),     r_k = r_j + A_j (s' + g' alpha),     g' = (0, 1, 0).

s', from parent to child in the flat sheet, is the placement ``at``, so that the joint frame is where the flat sheet has
the child. It keeps the projected length, not the arc's, and what bends and twists at once turns it about its normal:
see :mod:`.geodesic`, which does neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mbfmu.mechanics.joints.base import Joint
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State
    from solvers.compiled.record import Record


@kernel
def place(joint: Record, qi: int, state: State) -> None:
    """See :mod:`.base`. Columns: g';  h' = (0, 0, 1);  A_z f' with f' = (1, 0, 0)."""
    q, rel = state.q, state.rel[0]
    cz, sz = np.cos(q[qi + 1]), np.sin(q[qi + 1])
    cx, sx = np.cos(q[qi + 2]), np.sin(q[qi + 2])
    for k in range(3):
        rel.S[0, k], rel.S[0, 3 + k] = 0.0, 0.0
        rel.S[1, k], rel.S[1, 3 + k] = 0.0, 0.0
        rel.S[2, k] = 0.0
        rel.p[k] = 0.0
    rel.S[0, 1] = 1.0
    rel.p[1] = q[qi]
    rel.S[1, 5] = 1.0
    rel.S[2, 3], rel.S[2, 4], rel.S[2, 5] = cz, sz, 0.0
    rel.R[0, 0], rel.R[0, 1], rel.R[0, 2] = cz, -sz * cx, sz * sx
    rel.R[1, 0], rel.R[1, 1], rel.R[1, 2] = sz, cz * cx, -cz * sx
    rel.R[2, 0], rel.R[2, 1], rel.R[2, 2] = 0.0, sx, cx


@kernel
def bias(joint: Record, qi: int, vi: int, state: State) -> None:
    """See :mod:`.base`: theta_z' theta_x' h' x A_z f'."""
    q, v, out = state.q, state.v, state.rel[0].bias
    turn = v[vi + 1] * v[vi + 2]
    for k in range(3):
        out[k] = 0.0 * turn
    out[3], out[4], out[5] = -np.sin(q[qi + 1]) * turn, np.cos(q[qi + 1]) * turn, 0.0 * turn


@dataclass(frozen=True, kw_only=True)
class OutOfPlane(Joint):
    """Out-of-plane joint [BC] between nodes of a sheet; ``at`` is the vector to the node in the flat sheet."""

    nq = 3
    nv = 3
    place = place
    bias = bias
    coordinates: ClassVar[tuple[str, ...]] = ("alpha", "theta_z", "theta_x")
    units: ClassVar[tuple[str, ...]] = ("m", "rad", "rad")
