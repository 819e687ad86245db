"""Geodesic: a node of a thin sheet on its neighbor, as a sheet that neither stretches nor shears has it.

Coordinates and placement of :mod:`.out_of_plane`, and its deflection along the parent's normal. But on a surface that
keeps its lengths and angles a straight line of the flat sheet stays a geodesic, and that asks for two things to second
order in the distance |s'| of the nodes.

**It keeps its length.** With the paper's projected length a segment of curvature kappa is too long by the part
(|s'| kappa)^2 / 6, and a sheet that resists stretching locks. Between nodes the line is the cubic that the plate
element draws: it leaves the parent along s', and at the child has turned by theta = beta / |s'|, beta = s'_x theta_z -
s'_z theta_x. Its length is |s'| if the child moves back along s',

    r_k = r_j + A_j (s' - b P + g' alpha),   b = s' / |s'|^2,   P = (3/5) alpha^2 - alpha beta / 10 + beta^2 / 15,

two thirds of alpha^2 b on a circular arc. So an element has no membrane strain along the edges that are joints, however
they bend.

**It does not turn about its normal.** The frames of a surface are carried along a line by rotations about axes in the
surface. The paper's A_z A_x is not one: where it bends by theta_z and twists by theta_x it turns by theta_z theta_x / 2
about the normal, which adds up along a chain to an error of first order, and a sheet that resists shear locks against
twist once it is bent. The rotations about axes in the x-z plane are

    A_k = A_j A_z(theta_z / 2) A_x(theta_x) A_z(theta_z / 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.kind import Attachment
from mbfmu.util.errors import UserError
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Record, Vec3

from .out_of_plane import OutOfPlane

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


class GeodesicRecord(Record):
    """Parameters of :class:`Geodesic`."""

    b: Vec3  # s' / |s'|^2 in the joint frame, 1/m


@kernel
def place(joint: GeodesicRecord, qi: int, state: State) -> None:
    """See :mod:`.base`. Columns: g', (h' + A_z A_x h') / 2, A_z f' with h' = (0, 0, 1), f' = (1, 0, 0), less b dP."""
    q, b, rel = state.q, joint.b, state.rel[0]
    alpha, theta_z, theta_x = q[qi], q[qi + 1], q[qi + 2]
    square = 1.0 / (b[0] * b[0] + b[2] * b[2])
    beta = (b[0] * theta_z - b[2] * theta_x) * square
    by_alpha, by_beta = 1.2 * alpha - 0.1 * beta, (2.0 * beta / 15.0 - 0.1 * alpha) * square
    P = 0.6 * alpha * alpha + (beta / 15.0 - 0.1 * alpha) * beta
    for k in range(3):
        rel.S[0, k], rel.S[0, 3 + k] = -by_alpha * b[k], 0.0
        rel.S[1, k], rel.S[2, k] = -by_beta * b[0] * b[k], by_beta * b[2] * b[k]
        rel.p[k] = -P * b[k]
    rel.S[0, 1] += 1.0
    rel.p[1] += alpha
    cz, sz, cx, sx = np.cos(0.5 * theta_z), np.sin(0.5 * theta_z), np.cos(theta_x), np.sin(theta_x)
    rel.S[1, 3], rel.S[1, 4], rel.S[1, 5] = 0.5 * sz * sx, -0.5 * cz * sx, 0.5 + 0.5 * cx
    rel.S[2, 3], rel.S[2, 4], rel.S[2, 5] = cz, sz, 0.0
    both = sz * cz * (1.0 + cx)
    rel.R[0, 0], rel.R[0, 1], rel.R[0, 2] = cz * cz - sz * sz * cx, -both, sz * sx
    rel.R[1, 0], rel.R[1, 1], rel.R[1, 2] = both, cz * cz * cx - sz * sz, -cz * sx
    rel.R[2, 0], rel.R[2, 1], rel.R[2, 2] = sz * sx, cz * sx, cx


@kernel
def bias(joint: GeodesicRecord, qi: int, vi: int, state: State) -> None:
    """See :mod:`.base`: -b P'' of the rates alpha', beta', and the turning of the two axes of rotation."""
    q, v, b, out = state.q, state.v, joint.b, state.rel[0].bias
    rate, bend, twist = v[vi], v[vi + 1], v[vi + 2]
    beta = (b[0] * bend - b[2] * twist) / (b[0] * b[0] + b[2] * b[2])
    back = 1.2 * rate * rate + (2.0 * beta / 15.0 - 0.2 * rate) * beta
    for k in range(3):
        out[k] = -back * b[k]
    cz, sz = np.cos(0.5 * q[qi + 1]), np.sin(0.5 * q[qi + 1])
    cx, sx = np.cos(q[qi + 2]), np.sin(q[qi + 2])
    square, product = 0.25 * bend * bend, 0.5 * bend * twist
    out[3] = square * cz * sx + product * sz * (cx - 1.0)
    out[4] = square * sz * sx - product * cz * (cx - 1.0)
    out[5] = -product * sx


@dataclass(frozen=True, kw_only=True)
class Geodesic(OutOfPlane):
    """Out-of-plane joint that keeps lengths and angles; ``at`` is the vector to the node in the flat sheet."""

    record = GeodesicRecord
    place = place
    bias = bias

    def fill(self, record: Any, site: Attachment) -> None:
        """Write b, of s' what lies in the plane."""
        axes = rotation("rotation of a geodesic joint", self.rotation)
        s = axes.T @ np.asarray(self.at, float) * (1.0, 0.0, 1.0)
        if not s.any():
            raise UserError(f"at of {site.name} is {self.at!r} m; a Geodesic joint needs some way in the x-z plane")
        record["b"] = s / (s @ s)
