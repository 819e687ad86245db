"""The surface of a sheet in contact: smooth over cells and the borders between them.

Contact must not see the facets of the grid. Over every cell lies the bicubic patch of Ferguson, with the positions of
the four nodes and their axes in the sheet, xi and zeta in [0, 1] along the sides a and b of the cell:

    r = sum_i  N_i r_i + A_i L_i,    L_i = a Nx_i e_x + b Nz_i e_z,

    N = H0(xi) H0(zeta),  Nx = H1(xi) H0(zeta),  Nz = H0(xi) H1(zeta),  H0, H1 the cubics of Hermite.

Neighbors share what is at their border, so position and tangent plane are continuous, and a rigid motion of the nodes
is one of the patch. A point of it moves with v = sum N_i r_i' + w_i x A_i L_i, and a force f there is the forces N_i f
and the moments A_i L_i x f on the nodes, which do the same work: momentum and moment of momentum are kept.

Every kernel is analytic in what it reads of the state.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from solvers.compiled.record import Reals, Table


class CellSides(Protocol):
    """What kernels read of a cell."""

    @property
    def node(self) -> Any:
        """Numbers of the bodies at its corners (4,)."""

    @property
    def a(self) -> float:
        """Side along x, m."""

    @property
    def b(self) -> float:
        """Side along z, m."""


@kernel
def evaluate_weights(cell: CellSides, xi: float, zeta: float, c: Reals) -> None:
    """c (4, 3) <- weights at a point of a cell."""
    X1, Z1 = xi * xi * (3.0 - 2.0 * xi), zeta * zeta * (3.0 - 2.0 * zeta)
    X0, Z0 = 1.0 - X1, 1.0 - Z1
    A0, A1 = cell.a * xi * (1.0 - xi) * (1.0 - xi), -cell.a * xi * xi * (1.0 - xi)
    B0, B1 = cell.b * zeta * (1.0 - zeta) * (1.0 - zeta), -cell.b * zeta * zeta * (1.0 - zeta)
    c[0, 0], c[1, 0], c[2, 0], c[3, 0] = X0 * Z0, X1 * Z0, X1 * Z1, X0 * Z1
    c[0, 1], c[1, 1], c[2, 1], c[3, 1] = A0 * Z0, A1 * Z0, A1 * Z1, A0 * Z1
    c[0, 2], c[1, 2], c[2, 2], c[3, 2] = X0 * B0, X1 * B0, X1 * B1, X0 * B1


@kernel
def evaluate_ruled_weights(cell: CellSides, axis: int, xi: float, zeta: float, c: Reals, cx: Reals, cz: Reals) -> None:
    """As :func:`evaluate_weights`, of a surface that is straight across x (``axis`` 0) or z (1), with derivatives
    by xi and zeta.
    """
    u, w, h = (xi, zeta, cell.a) if axis == 0 else (zeta, xi, cell.b)
    H1 = u * u * (3.0 - 2.0 * u)
    H0, dH = 1.0 - H1, 6.0 * u * (1.0 - u)
    T0, T1 = h * u * (1.0 - u) * (1.0 - u), -h * u * u * (1.0 - u)
    dT0, dT1 = h * (1.0 - u) * (1.0 - 3.0 * u), h * u * (3.0 * u - 2.0)
    by_u, by_w, slope = (cx, cz, 1) if axis == 0 else (cz, cx, 2)
    for i in range(4):
        far, sideways = (i in (1, 2), i in (2, 3)) if axis == 0 else (i in (2, 3), i in (1, 2))
        N, dN, T, dT = (H1, dH, T1, dT1) if far else (H0, -dH, T0, dT0)
        share, dshare = (w, 1.0) if sideways else (1.0 - w, -1.0)
        for k in range(3):
            c[i, k], cx[i, k], cz[i, k] = 0.0, 0.0, 0.0
        c[i, 0], c[i, slope] = N * share, T * share
        by_u[i, 0], by_u[i, slope] = dN * share, dT * share
        by_w[i, 0], by_w[i, slope] = N * dshare, T * dshare


@kernel
def interpolate_point(cell: Any, c: Reals, bodies: Table[MotionRecord], r: Reals) -> None:
    """r (3,) <- what the weights make of the nodes: a point, or its derivative."""
    for k in range(3):
        r[k] = 0.0
    for i in range(4):
        node = bodies[cell.node[i]]
        for k in range(3):
            r[k] += c[i, 0] * node.r[k] + c[i, 1] * node.A[k, 0] + c[i, 2] * node.A[k, 2]


@kernel
def evaluate_line(cell: CellSides, xi: float, bodies: Table[MotionRecord], line: Reals) -> None:
    """line (4, 3) <- the cubic on which all points at xi lie: where it begins and ends, and its derivatives there."""
    X1 = xi * xi * (3.0 - 2.0 * xi)
    X0, A0, A1 = 1.0 - X1, cell.a * xi * (1.0 - xi) * (1.0 - xi), -cell.a * xi * xi * (1.0 - xi)
    for end in range(2):
        one, two = bodies[cell.node[3 * end]], bodies[cell.node[1 + end]]
        for k in range(3):
            line[end, k] = X0 * one.r[k] + X1 * two.r[k] + A0 * one.A[k, 0] + A1 * two.A[k, 0]
            line[2 + end, k] = cell.b * (X0 * one.A[k, 2] + X1 * two.A[k, 2])


@kernel
def evaluate_on_line(line: Reals, zeta: float, r: Reals) -> None:
    """r (3,) <- the point of a line at zeta."""
    Z1 = zeta * zeta * (3.0 - 2.0 * zeta)
    Z0, B0, B1 = 1.0 - Z1, zeta * (1.0 - zeta) * (1.0 - zeta), -zeta * zeta * (1.0 - zeta)
    for k in range(3):
        r[k] = Z0 * line[0, k] + Z1 * line[1, k] + B0 * line[2, k] + B1 * line[3, k]


@kernel
def evaluate_center(cell: CellSides, bodies: Table[MotionRecord], r: Reals) -> None:
    """r (3,) <- the mean of the nodes; the patch is within :func:`hull_radius` of it."""
    for k in range(3):
        r[k] = 0.0
        for i in range(4):
            r[k] += 0.25 * bodies[cell.node[i]].r[k]


@kernel
def squared_corner_distance(cell: CellSides, bodies: Table[MotionRecord], r: Reals) -> float:
    """Square of the largest distance of a node from the middle r of a patch, m^2."""
    largest = 0.0
    for i in range(4):
        square = 0.0
        for k in range(3):
            off = bodies[cell.node[i]].r[k].real - r[k].real
            square += off * off
        largest = max(largest, square)
    return largest


@kernel
def hull_radius(cell: CellSides, bodies: Table[MotionRecord], r: Reals) -> float:
    """Radius of a ball about the middle r of a patch that holds all of it, m: that of its sixteen Bezier points, whose
    convex hull does: r_i, and a third of a side on into the cell along t_x, along t_z and along both.
    """
    largest, p, q = 0.0, cell.a.real / 3.0, cell.b.real / 3.0
    for i in range(4):
        node = bodies[cell.node[i]]
        square, along, across = 0.0, 0.0, 0.0
        for k in range(3):
            off = node.r[k].real - r[k].real
            square += off * off
            along += off * node.A[k, 0].real
            across += off * node.A[k, 2].real
        along, across = (-along if i in (1, 2) else along), (-across if i in (2, 3) else across)
        largest = max(largest, square + max(p * (p + 2.0 * along), 0.0) + max(q * (q + 2.0 * across), 0.0))
    return np.sqrt(largest)


@kernel
def sagitta(cell: CellSides, bodies: Table[MotionRecord], r: Reals, n: Reals) -> float:
    """How far, at most, the patch reaches from its middle r against the unit vector n, m: as far as its Bezier points
    do, see :func:`hull_radius`.
    """
    deepest = 0.0
    for i in range(4):
        node = bodies[cell.node[i]]
        down, along, across = 0.0, 0.0, 0.0
        for k in range(3):
            down += n[k].real * (r[k].real - node.r[k].real)
            along += n[k].real * node.A[k, 0].real
            across += n[k].real * node.A[k, 2].real
        along, across = (along if i in (1, 2) else -along), (across if i in (2, 3) else -across)
        down += max(cell.a.real * along, 0.0) / 3.0 + max(cell.b.real * across, 0.0) / 3.0
        deepest = max(deepest, down)
    return deepest


def bezier_lever(sides: tuple[float, float]) -> float:
    """Return the largest distance of a Bezier point of a cell from the node that it moves with, or a little more, m."""
    return sum(sides) / 3.0


@inlined
def moment_arm(A: Reals, along: float, across: float) -> Any:
    """A L of a node with the axes A (3, 3), by its weights a Nx and b Nz."""
    return (
        along * A[0, 0] + across * A[0, 2],
        along * A[1, 0] + across * A[1, 2],
        along * A[2, 0] + across * A[2, 2],
    )


@kernel
def point_velocity(cell: CellSides, c: Reals, bodies: Table[MotionRecord], v: Reals) -> None:
    """v (3,) <- velocity of the point."""
    for k in range(3):
        v[k] = 0.0
    for i in range(4):
        node = bodies[cell.node[i]]
        A, Y = node.A, node.Y
        x, y, z = moment_arm(A, c[i, 1], c[i, 2])
        v[0] += c[i, 0] * Y[0] + Y[4] * z - Y[5] * y
        v[1] += c[i, 0] * Y[1] + Y[5] * x - Y[3] * z
        v[2] += c[i, 0] * Y[2] + Y[3] * y - Y[4] * x


@kernel
def apply_to_nodes(cell: CellSides, c: Reals, bodies: Table[MotionRecord], f: Reals) -> None:
    """Add a force f (3,) at the point to the applied wrenches of the nodes."""
    for i in range(4):
        node = bodies[cell.node[i]]
        A, F = node.A, node.F
        x, y, z = moment_arm(A, c[i, 1], c[i, 2])
        for k in range(3):
            F[k] += c[i, 0] * f[k]
        F[3] += y * f[2] - z * f[1]
        F[4] += z * f[0] - x * f[2]
        F[5] += x * f[1] - y * f[0]


@kernel
def apply_reaction(body: MotionRecord, r: Reals, f: Reals) -> None:
    """Take a force f (3,) at a point r from the applied wrench of a body."""
    x, y, z = r[0] - body.r[0], r[1] - body.r[1], r[2] - body.r[2]
    F = body.F
    for k in range(3):
        F[k] -= f[k]
    F[3] -= y * f[2] - z * f[1]
    F[4] -= z * f[0] - x * f[2]
    F[5] -= x * f[1] - y * f[0]


@kernel
def smooth_step(u: float) -> Any:
    """From 0 where u is 0 to 1 where it is 1, without a corner."""
    if u.real <= 0.0:
        return 0.0 * u
    if u.real >= 1.0:
        return 0.0 * u + 1.0
    return u * u * (3.0 - 2.0 * u)
