"""Stations of a nip: positions, material in contact, compliance between it and the roller; see :mod:`.nip`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel

from .patch import evaluate_ruled_weights, interpolate_point, smooth_step

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from mbfmu.sheets.contact.nip import NipRecord
    from solvers.compiled.record import Reals, Table

MAX_STATION_ITERATIONS = 12  # of Newton for the material under a station
SEAM_WIDTH = (
    1e-6  # sides of a cell: where a station passes from one to the next, both have it, with parts that add up to one
)
REACH_RATIO = 0.6  # diagonals of a cell beyond the stations, to which a nip acts along its normal
STATION_TOLERANCE = 1e-9  # sides of a cell: after a correction as small one more makes it exact


@inlined
def station_offset(nip: NipRecord, place: float, i: int) -> Any:
    """Where a station of a pair is from the middle of the nip, along d and e: the first ahead, the second behind."""
    return nip.half if i == 0 else -nip.half, 0.5 * nip.width * place


@inlined
def blossom(points: Any, x: float, y: float, z: float) -> float:
    """Polar form of a cubic with these four Bezier points; its Bezier points over [p, q] are those of (p, p, p),
    (p, p, q), (p, q, q) and (q, q, q).
    """
    a, b, c, d = points
    a, b, c = a + x * (b - a), b + x * (c - b), c + x * (d - c)
    a, b = a + y * (b - a), b + y * (c - b)
    return a + z * (b - a)


@inlined
def bezier_points(points: Any, p: float, q: float) -> Any:
    """Bezier points over [p, q] of a cubic with these four Bezier points over [0, 1]."""
    return blossom(points, p, p, p), blossom(points, p, p, q), blossom(points, p, q, q), blossom(points, q, q, q)


@inlined
def edge_margins(nip: NipRecord) -> Any:
    """Margins by which the surface of a cell is continued, in parts of its sides: where it begins and where it ends
    along the feed, and the same across.
    """
    mx, mz = nip.entry / nip.a, nip.entry / nip.b
    x0, x1 = mx if nip.ends[0, 0] == 1 else SEAM_WIDTH, mx if nip.ends[0, 1] == 1 else SEAM_WIDTH
    z0, z1 = mz if nip.ends[1, 0] == 1 else SEAM_WIDTH, mz if nip.ends[1, 1] == 1 else SEAM_WIDTH
    return (x0, x1, z0, z1) if nip.way == 0 else (z0, z1, x0, x1)


@kernel
def bound_edge(nip: NipRecord, side: int, direction: Reals, bodies: Table[MotionRecord]) -> Any:
    """Bezier points of the edge of a cell along the feed at its first (0) or second ``side`` (1): distances along a
    direction from the middle of the nip, m.
    """
    if nip.way == 0:
        one, two, axis, h = bodies[nip.node[3 * side]], bodies[nip.node[1 + side]], 0, nip.a.real
    else:
        one, two, axis, h = bodies[nip.node[side]], bodies[nip.node[3 - side]], 2, nip.b.real
    first, last, rise, fall = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        part = direction[k].real
        first, last = first + part * (one.r[k] - nip.place[k]).real, last + part * (two.r[k] - nip.place[k]).real
        rise, fall = rise + part * one.A[k, axis].real, fall + part * two.A[k, axis].real
    return first, first + h / 3.0 * rise, last - h / 3.0 * fall, last


@kernel
def bound_cell(nip: NipRecord, direction: Reals, bodies: Table[MotionRecord]) -> Any:
    """Smallest and largest distance along a direction from the middle of the nip, m, of the ruled surface of a cell
    (:func:`.patch.evaluate_ruled_weights`), continued by its margins: those of its eight Bezier points, whose convex
    hull contains it.
    """
    before, after, left, right = edge_margins(nip)
    p, q, low, high = -before.real, 1.0 + after.real, np.inf, -np.inf
    near = bezier_points(bound_edge(nip, 0, direction, bodies), p, q)
    far = bezier_points(bound_edge(nip, 1, direction, bodies), p, q)
    for j in range(4):
        begin, end = near[j] - left.real * (far[j] - near[j]), far[j] + right.real * (far[j] - near[j])
        low, high = min(low, begin, end), max(high, begin, end)
    return low, high


@kernel
def height_beyond_reach(nip: NipRecord, bodies: Table[MotionRecord]) -> float:
    """How far the mean of the nodes is from the plane of the nip beyond its reach, m; negative: it is within."""
    off = 0.0
    for i in range(4):
        for k in range(3):
            off += 0.25 * ((bodies[nip.node[i]].r[k] - nip.place[k]) * nip.n[k]).real
    reach = REACH_RATIO * np.sqrt(nip.a.real**2 + nip.b.real**2) + nip.half.real + 0.5 * nip.width.real
    return float(abs(off) - reach)


@kernel
def cell_clearance(nip: NipRecord, bodies: Table[MotionRecord]) -> float:
    """How far the nodes of a cell may be displaced before one of the stations acts on it, in the measure of
    :mod:`mbfmu.mechanics.recursions.active_loads`, m.

    The Bezier points of a surface that is continued by m sides are displaced by at most (1 + 2 m)^3 times as much.
    """
    before, after, left, right = edge_margins(nip)
    (back, front), (near, far) = bound_cell(nip, nip.d, bodies), bound_cell(nip, nip.e, bodies)
    half, sideways = nip.half.real, 0.5 * nip.width.real
    apart = max(back - half, -half - front, near - sideways, -sideways - far)
    growth = (1.0 + 2.0 * max(before.real, after.real)) ** 3 * (1.0 + 2.0 * max(left.real, right.real))
    return float(max(apart / growth, height_beyond_reach(nip, bodies)))


@kernel
def find_material_point(nip: NipRecord, along: float, sideways: float, bodies: Table[MotionRecord], here: Any) -> Any:
    """Find the material of a cell under a station at these distances along d and e from the middle of the nip; return
    xi, zeta and whether they were found.

    Leaves weights, point and derivatives there. In a complex state the imaginary part is exact after the last pass.
    """
    d, e = nip.d, nip.e
    xi, zeta, last = 0.0 * here.r[0] + 0.5, 0.0 * here.r[0] + 0.5, False
    for _ in range(MAX_STATION_ITERATIONS):
        evaluate_ruled_weights(nip, nip.way, xi, zeta, here.c, here.cx, here.cz)
        interpolate_point(nip, here.c, bodies, here.r)
        interpolate_point(nip, here.cx, bodies, here.rx)
        interpolate_point(nip, here.cz, bodies, here.rz)
        if last:
            return xi, zeta, True
        g0, g1, a00, a01, a10, a11 = -along + 0.0 * xi, -sideways + 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi
        for k in range(3):
            off = here.r[k] - nip.place[k]
            g0, g1 = g0 + off * d[k], g1 + off * e[k]
            a00, a01 = a00 + here.rx[k] * d[k], a01 + here.rz[k] * d[k]
            a10, a11 = a10 + here.rx[k] * e[k], a11 + here.rz[k] * e[k]
        det = a00 * a11 - a01 * a10
        if abs(det.real) < 1e-3 * nip.a.real * nip.b.real:  # seen from the side
            return xi, zeta, False
        dx, dz = (a01 * g1 - a11 * g0) / det, (a10 * g0 - a00 * g1) / det
        xi, zeta = xi + dx, zeta + dz
        if not (abs(xi.real) < 3.0 and abs(zeta.real) < 3.0):
            return xi, zeta, False
        last = abs(dx.real) + abs(dz.real) < STATION_TOLERANCE
    return xi, zeta, False


@kernel
def cell_share(x: float, before: float, after: float) -> Any:
    """Part of a station that a cell has, by the margins where it begins and where it ends."""
    return smooth_step((x + before) / (2.0 * before)) * smooth_step((1.0 + after - x) / (2.0 * after))


@kernel
def entry_gap(nip: NipRecord, u: float) -> Any:
    """Half of what roller and idler leave open where the sheet's edge is, as long as it is on its way in or out, m."""
    h = nip.a if nip.way == 0 else nip.b
    short = 0.0 * u
    if nip.ends[nip.way, 0] == 1 and (u * h).real < nip.entry.real:
        short = nip.entry - u * h
    elif nip.ends[nip.way, 1] == 1 and ((1.0 - u) * h).real < nip.entry.real:
        short = nip.entry - (1.0 - u) * h
    return short * short / (2.0 * nip.radius)


@kernel
def entry_gap_law(y: float, gap: float) -> Any:
    """Part of y that acts on rubber near an opening, and its derivative: almost zero within, almost all outside."""
    if gap.real == 0.0:
        return y, 0.0 * y + 1.0
    square, both = y * y, y * y + gap * gap
    return y * square / both, square * (square + 3.0 * gap * gap) / (both * both)


@kernel
def clamped_beam_compliance(x: float, u: float) -> Any:
    """Deflection at x of a clamped beam of length 1 and stiffness 1 under a unit force at u, and its slope there."""
    if x.real <= u.real:
        free, v = (1.0 - u) * (1.0 - u) / 6.0, 3.0 * u - (1.0 + 2.0 * u) * x
        return free * x * x * v, free * (2.0 * x * v - (1.0 + 2.0 * u) * x * x)
    back, far = 1.0 - x, 1.0 - u
    free, v = (1.0 - far) * (1.0 - far) / 6.0, 3.0 * far - (1.0 + 2.0 * far) * back
    return free * back * back * v, -free * (2.0 * back * v - (1.0 + 2.0 * far) * back * back)


@kernel
def is_within_cell(u: float) -> bool:
    """Whether a place is in the cell; a station over the edge of the sheet need not be."""
    return 0.0 < u.real < 1.0
