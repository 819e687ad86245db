"""Where a sheet is: points, the direction of an edge, what a beam of light meets; and whether nips jam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.sensors.base import Follows, Sensor
from mbfmu.mechanics.spatial import angle_of
from mbfmu.sheets.contact.patch import (
    evaluate_center,
    evaluate_ruled_weights,
    evaluate_weights,
    hull_radius,
    interpolate_point,
    smooth_step,
)
from mbfmu.sheets.contact.scratch import ALL_POINTS, CONTACT_SCRATCH, contact_scratch
from solvers.compiled.kernel import kernel
from solvers.compiled.record import Integers, Reals, Record, Vec3, f8, i8

from .contacts import sum_contact_results

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from mbfmu.sheets.contact.scratch import ContactScratch
    from solvers.compiled.record import Table

EDGE_BLUR_WIDTH = 0.5e-3  # m, on either side of an edge, within which a beam is partly covered
MAX_BEAM_ITERATIONS = 12  # of Newton for the material in a beam
BEAM_TOLERANCE = 1e-9  # sides of a cell: a correction as small is the last
JAM_SLIP_RATIO = 0.5  # of the speed of a roller's surface: slip above which a nip jams
MIN_LOADED_SHARE = 0.5  # part of a nip that is in the sheet, below which it does not count


class SheetPositionRecord(Record):
    """Parameters of :class:`SheetPosition`."""

    component: i8
    node: Annotated[Integers, (4,)]
    scratch: i8
    weight: Annotated[Reals, (4, 3)]


class SkewRecord(Record):
    """Parameters of :class:`Skew`."""

    a: i8
    b: i8
    across: Vec3


class CoveredRecord(Record):
    """Parameters of :class:`Covered`."""

    first: i8  # of the numbers: six for every cell
    cells: i8
    scratch: i8
    a: f8
    b: f8
    place: Vec3
    direction: Vec3
    u: Vec3  # across the beam
    w: Vec3


class JammedRecord(Record):
    """Parameters of :class:`Jammed`."""

    first: i8
    nips: i8
    scratch: i8


class Cell(NamedTuple):
    """What the patch asks of a cell."""

    node: tuple[int, int, int, int]
    a: float
    b: float


@kernel
def position(sensor: SheetPositionRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`."""
    r = contact_scratch(sensor, state).r
    interpolate_point(sensor, sensor.weight, state.bodies, r)
    return r[sensor.component]


@kernel
def skew(sensor: SkewRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`: the angle about the mean normal, by sine and cosine."""
    A, B, s = state.bodies[sensor.a], state.bodies[sensor.b], sensor.across
    x, y, z = B.r[0] - A.r[0], B.r[1] - A.r[1], B.r[2] - A.r[2]
    nx, ny, nz = A.A[0, 1] + B.A[0, 1], A.A[1, 1] + B.A[1, 1], A.A[2, 1] + B.A[2, 1]
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    sine = nx * (s[1] * z - s[2] * y) + ny * (s[2] * x - s[0] * z) + nz * (s[0] * y - s[1] * x)
    return angle_of(sine / length, s[0] * x + s[1] * y + s[2] * z)


@kernel
def covered(sensor: CoveredRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`: the most that any cell covers."""
    here, P, d = contact_scratch(sensor, state), sensor.place, sensor.direction
    most = 0.0 * here.r[0]
    for e in range(sensor.cells):
        k = sensor.first + 6 * e
        cell = Cell(
            (
                int(arrays.numbers[k].real),
                int(arrays.numbers[k + 1].real),
                int(arrays.numbers[k + 2].real),
                int(arrays.numbers[k + 3].real),
            ),
            sensor.a,
            sensor.b,
        )
        evaluate_center(cell, state.bodies, here.r)
        along, square = 0.0, 0.0
        for j in range(3):
            off = here.r[j].real - P[j]
            along, square = along + off * d[j], square + off * off
        if square - along * along > (edge_growth(cell) * hull_radius(cell, state.bodies, here.r)) ** 2:
            continue
        xi, zeta, found = find_beam_intersection(cell, sensor, state.bodies, here)
        if not found:
            continue
        ends_x, ends_z = int(arrays.numbers[k + 4].real), int(arrays.numbers[k + 5].real)
        part = cell_coverage(xi, sensor.a, ends_x) * cell_coverage(zeta, sensor.b, ends_z)
        if part.real > most.real:
            most = part
    return most


@kernel
def edge_growth(cell: Cell) -> float:
    """Factor by which a ball about a cell that holds its Bezier points grows if its surface is continued by
    :data:`EDGE_BLUR_WIDTH` at its edges.
    """
    x, z = 1.0 + 2.0 * EDGE_BLUR_WIDTH / cell.a, 1.0 + 2.0 * EDGE_BLUR_WIDTH / cell.b
    return x * x * x * z


@kernel
def cell_coverage(x: float, side: float, ends: int) -> Any:
    """Part of a beam that a cell covers which it meets at x, by the edges of the sheet: 1 where it begins, 2 where it
    ends on one, 3 both.
    """
    first, last = (
        (x * side + EDGE_BLUR_WIDTH) / (2.0 * EDGE_BLUR_WIDTH),
        ((1.0 - x) * side + EDGE_BLUR_WIDTH) / (2.0 * EDGE_BLUR_WIDTH),
    )
    if (ends % 2 == 0 and x.real < 0.0) or (ends < 2 and x.real > 1.0):
        return 0.0 * x
    found = 0.0 * x + 1.0
    if ends % 2 == 1:
        found = found * smooth_step(first)
    if ends >= 2:
        found = found * smooth_step(last)
    return found


@kernel
def find_beam_intersection(cell: Any, beam: CoveredRecord, bodies: Table[MotionRecord], here: ContactScratch) -> Any:
    """Where a beam meets the surface of a cell, by Newton: xi, zeta and whether it does."""
    xi, zeta, last = 0.0 * here.r[0] + 0.5, 0.0 * here.r[0] + 0.5, False
    for _ in range(MAX_BEAM_ITERATIONS):
        if last:
            return xi, zeta, True
        evaluate_ruled_weights(cell, 0, xi, zeta, here.c, here.cx, here.cz)
        interpolate_point(cell, here.c, bodies, here.r)
        interpolate_point(cell, here.cx, bodies, here.rx)
        interpolate_point(cell, here.cz, bodies, here.rz)
        g0, g1, a00, a01, a10, a11 = 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi, 0.0 * xi
        for k in range(3):
            off = here.r[k] - beam.place[k]
            g0, g1 = g0 + off * beam.u[k], g1 + off * beam.w[k]
            a00, a01 = a00 + here.rx[k] * beam.u[k], a01 + here.rz[k] * beam.u[k]
            a10, a11 = a10 + here.rx[k] * beam.w[k], a11 + here.rz[k] * beam.w[k]
        det = a00 * a11 - a01 * a10
        if abs(det.real) < 1e-3 * cell.a * cell.b:  # seen from the side
            return xi, zeta, False
        dx, dz = (a01 * g1 - a11 * g0) / det, (a10 * g0 - a00 * g1) / det
        xi, zeta = xi + dx, zeta + dz
        if not (abs(xi.real) < 3.0 and abs(zeta.real) < 3.0):
            return xi, zeta, False
        last = abs(dx.real) + abs(dz.real) < BEAM_TOLERANCE
    return xi, zeta, False


@kernel
def jammed(sensor: JammedRecord, lam: Reals, arrays: Arrays, state: State) -> float:
    """See :mod:`.base`: 1 if any of the nips slips."""
    here = contact_scratch(sensor, state)
    for e in range(sensor.nips):
        k = sensor.first + 5 * e
        first, count = int(arrays.numbers[k].real), int(arrays.numbers[k + 1].real)
        sum_contact_results(first, count, ALL_POINTS, arrays, state, here)
        loaded, Y = here.result[0].real, state.bodies[int(arrays.numbers[k + 2].real)].Y
        surface = 0.0
        for j in range(3):
            surface += Y[3 + j].real ** 2
        surface = np.sqrt(surface) * arrays.numbers[k + 3].real
        if (
            loaded > MIN_LOADED_SHARE * arrays.numbers[k + 4].real
            and abs(here.result[1].real) > JAM_SLIP_RATIO * surface * loaded
        ):
            return 1.0 + 0.0 * here.result[0]
    return 0.0 * here.result[0]


@dataclass(frozen=True, kw_only=True)
class SheetPosition(Sensor):
    """Global ``component`` of a point of a cell, m; ``bodies`` are those at its corners.

    Parameters
    ----------
    sides
        Of the cell, m.
    at
        xi and zeta, 0 to 1.
    """

    record = SheetPositionRecord
    read = position

    sides: tuple[float, float]
    at: tuple[float, float]

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the nodes and their weights."""
        record["component"], record["node"] = self.component, site.bodies
        record["scratch"] = site.scratch(CONTACT_SCRATCH)
        getattr(evaluate_weights, "py_func", evaluate_weights)(
            Cell((0, 1, 2, 3), *self.sides), *self.at, record["weight"]
        )


@dataclass(frozen=True, kw_only=True)
class Skew(Sensor):
    """Angle of the way from the first to the second of two bodies, nodes of a sheet, against ``across``, rad."""

    record = SkewRecord
    read = skew

    across: Any

    def fill(self, record: Any, site: Attachment) -> None:
        """Write both and the direction."""
        (record["a"], record["b"]), record["across"] = site.bodies, self.across


@dataclass(frozen=True, kw_only=True)
class Covered(Sensor):
    """How much of a beam a sheet covers, 0 to 1; ``bodies`` are four for every cell.

    Parameters
    ----------
    place, direction
        A point of the beam, m, and its unit vector.
    sides
        Of the cells, m.
    ends
        Of every cell, ((begins, ends) along x, (begins, ends) along z): whether that is an edge of the sheet.
    """

    record = CoveredRecord
    read = covered

    place: Any
    direction: Any
    sides: tuple[float, float]
    ends: Sequence[Any]

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the beam, with two directions across it, and the cells."""
        d = np.asarray(self.direction, float)
        u = np.cross(d, np.eye(3)[np.argmin(abs(d))])
        record["place"], record["direction"] = self.place, d
        record["u"], record["w"] = u / np.linalg.norm(u), np.cross(d, u / np.linalg.norm(u))
        record["scratch"], (record["a"], record["b"]) = site.scratch(CONTACT_SCRATCH), self.sides
        nodes, flags = np.reshape(site.bodies, (-1, 4)), np.reshape(self.ends, (-1, 2, 2)) @ [1, 2]
        record["first"], record["cells"] = site.numbers(np.hstack((nodes, flags))), len(nodes)


@dataclass(frozen=True, kw_only=True)
class Jammed(Sensor):
    """1 while the sheet slips in one of some nips by more than half the speed of its roller, else 0; no memory.

    ``bodies`` are the rollers; ``nips`` have for each the handle, the radius (m) and the number of stations.
    """

    record = JammedRecord
    read = jammed
    follows = Follows.FORCES

    nips: Sequence[tuple[Any, float, int]]

    def fill(self, record: Any, site: Attachment) -> None:
        """Write five numbers for every nip."""
        rows = [
            (nip.index, nip.count, roller, radius, stations)
            for (nip, radius, stations), roller in zip(self.nips, site.bodies, strict=True)
        ]
        record["first"], record["nips"] = site.numbers(rows), len(rows)
        record["scratch"] = site.scratch(CONTACT_SCRATCH)
