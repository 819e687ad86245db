"""Stations of a nip: positions, material in contact, compliance between it and the roller; see :mod:`.nip`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import kernel

from .patch import bounding_radius, evaluate_ruled_weights, interpolate_point, smooth_step

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from mbfmu.sheets.contact.nip import NipRecord
    from solvers.compiled.record import Reals, Table

MAX_STATION_ITERATIONS = 12  # of Newton for the material under a station
STATION_TOLERANCE = 1e-9  # sides of a cell: after a correction as small one more makes it exact


@kernel
def station_position(nip: NipRecord, place: float, i: int) -> Any:
    """Where a station of a pair is: the first ahead, the second behind."""
    along, sideways = nip.half if i == 0 else -nip.half, 0.5 * nip.width * place
    return (
        nip.place[0] + along * nip.d[0] + sideways * nip.e[0],
        nip.place[1] + along * nip.d[1] + sideways * nip.e[1],
        nip.place[2] + along * nip.d[2] + sideways * nip.e[2],
    )


@kernel
def is_separated(nip: NipRecord, P: Reals, x: float, y: float, z: float) -> bool:
    """Whether nothing of a cell, whose middle is at (x, y, z), is under a point P, however far above or below."""
    along, sideways, near = 0.0, 0.0, bounding_radius(nip).real + nip.entry.real
    for k in range(3):
        off = (x if k == 0 else y if k == 1 else z) - P[k].real
        along, sideways = along + off * nip.d[k].real, sideways + off * nip.e[k].real
    return along * along + sideways * sideways > near * near


@kernel
def find_material_point(nip: NipRecord, P: Any, bodies: Table[MotionRecord], here: Any) -> Any:
    """Find the material of a cell under a point P (three numbers); return xi, zeta and whether they were found.

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
        g0, g1, a00, a01, a10, a11 = 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi
        for k in range(3):
            off = here.r[k] - P[k]
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
