"""Stretching: a node of a shell on its neighbor, with all six motions, of which bending moves three.

A geodesic joint (:mod:`.geodesic`) whose child then moves in the plane of the parent by (u, v) along x' and z', and
turns by psi about its own normal,

    r_k = r_j + A_j (s' + (u, alpha, v) - b P),    A_k = A_j A_z(theta_z / 2) A_x(theta_x) A_z(theta_z / 2) A_y(psi).

That is every motion there is, as :mod:`.floating` has. But a sheet that hardly stretches moves along curves in the
positions of its nodes, which a step of Newton's along their tangents leaves: by half a degree of bending a cell is
strained by more than the weight of the whole sheet does. In these coordinates bending is a motion of alpha, theta_z and
theta_x alone, and what is stiff is u, v and psi.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel

from . import geodesic
from .geodesic import Geodesic, GeodesicRecord

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State


@kernel
def place(joint: GeodesicRecord, qi: int, state: State) -> None:
    """See :mod:`.base`. Columns: those of the geodesic joint, e_x, e_z, and the child's normal."""
    geodesic.place(joint, qi, state)
    q, rel = state.q, state.rel[0]
    rel.p[0] += q[qi + 3]
    rel.p[2] += q[qi + 4]
    c, s = np.cos(q[qi + 5]), np.sin(q[qi + 5])
    for k in range(3):
        rel.S[3, k], rel.S[3, 3 + k] = 0.0, 0.0
        rel.S[4, k], rel.S[4, 3 + k] = 0.0, 0.0
        rel.S[5, k], rel.S[5, 3 + k] = 0.0, rel.R[k, 1]
        x, z = rel.R[k, 0], rel.R[k, 2]
        rel.R[k, 0], rel.R[k, 2] = c * x - s * z, s * x + c * z
    rel.S[3, 0], rel.S[4, 2] = 1.0, 1.0


@kernel
def bias(joint: GeodesicRecord, qi: int, vi: int, state: State) -> None:
    """See :mod:`.base`: that of the geodesic joint, and psi' w x n, w and n the child's spin there and its normal."""
    geodesic.bias(joint, qi, vi, state)
    q, v, out = state.q, state.v, state.rel[0].bias
    cz, sz = np.cos(0.5 * q[qi + 1]), np.sin(0.5 * q[qi + 1])
    cx, sx = np.cos(q[qi + 2]), np.sin(q[qi + 2])
    bend, twist, turn = v[vi + 1], v[vi + 2], v[vi + 5]
    wx, wy, wz = 0.5 * sz * sx * bend + cz * twist, -0.5 * cz * sx * bend + sz * twist, 0.5 * (1.0 + cx) * bend
    nx, ny, nz = -sz * cz * (1.0 + cx), cz * cz * cx - sz * sz, cz * sx
    out[3] += turn * (wy * nz - wz * ny)
    out[4] += turn * (wz * nx - wx * nz)
    out[5] += turn * (wx * ny - wy * nx)


@dataclass(frozen=True, kw_only=True)
class Stretching(Geodesic):
    """Geodesic joint with in-plane deformation; ``at`` is the vector to the node in the flat sheet."""

    nq = 6
    nv = 6
    place = place
    bias = bias
    coordinates = ("alpha", "theta_z", "theta_x", "u", "v", "psi")
    units = ("m", "rad", "rad", "m", "m", "rad")
