"""Nip: a roller that drives a sheet, and an idler that presses it on, by stations fixed in space.

The contact of a nip is some millimeter long, a tenth of a cell. Points fixed in the sheet would pass it one by one; so
a station, a point P in space, finds the material under it: (r(xi, zeta) - P) . d = 0 and . e = 0, by Newton on the
patch of a cell, with the directions d of feed, n from the roller to the idler, e = d x n. It has no memory, and its
forces glide from cell to cell. Stations stand in pairs, at +-c along the feed, so that they hold the slope as well, and
the pairs in the middles of equal parts of the width.

**Across the plane of the nip.** y = (r - P) . n is held to zero by the rubber, k, from both sides. Three things are
needed that a clamp comes out as stiff as it is, wherever in a cell it stands; without them errors repeat with every
cell and meet the frequencies of the sheet.

1. *What a cubic cannot follow.* The moment jumps in the nip. Between its nodes a cell is a beam clamped at both ends,
   whose deflection at x under a unit force at u is G(x, u): in parts of the side h of the cell and with B the bending
   stiffness that a pair stands for,

       G(x, u) = h^3 (1 - u)^2 x^2 (3 u - 3 u x - (1 - u) x) / (6 B),   x <= u.

   A pair in one cell pushes with f = -(1 + K G)^-1 K y, K = part k: rubber and cell in series.
2. *The sheet is flat across a nip*: the surface is straight there. The plate's bending along x does not vary across, so
   that nothing would balance the moments about x that a cubic's weights have.
3. *A frictionless clamp pushes along the sheet's own normal*, n - s d - s_e e, s the slope of the surface as it is,
   with the deflection of the cell. So the stations are the gradient of an energy. Along n they would do the work
   M^2 / (2 B) for every length that is fed.

A pair at +-c holds the sheet as a clamp at c/3 does, to first order.

**In the plane.** With s = v - v_roller and the idler's force N, a number or a signal,

    f_d = -part mu N s_d / S,   f_e = -part (mu + mu_i) N s_e / S,   S = sqrt(s_d^2 + s_e^2 + v_r^2)

mu_i is what the idler resists sideways, which turns freely and has no inertia. One that is a body rubs as the roller
does, with its own slip and mu_i, and the roller with mu both ways. ``part`` rises from zero to one while an edge of the
sheet passes the length of entry. So long roller and idler are a wedge to it: at s from the end of that way they are
2 o apart, o = s^2 / (2 R), and the rubber feels y^3 / (y^2 + o^2) in place of y. Else the first touch would tear the
edge into the plane. The roller creeps: v_r^2 = least^2 + (creep v_roller)^2, and under a load F along the feed
the slip is v_r F / sqrt(mu^2 N^2 - F^2), also of a stopped sheet. With a ``deflection`` it sticks, see
:mod:`.nip_friction`.

``result`` of the scratch memory: sums over stations of part (0), of part times the slip s_d (1), of -f_d (2), of f_e
(3) and of f (4), N; power of these forces on sheet and rollers but for what the rubber stores (5), W; stored energy
(6), J.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mbfmu.mechanics.dispatch import signal_value
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.loads.base import Load
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, step
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Integers, Record, Vec3, f8, i8

from .initial_contact import misplaced_nips
from .nip_friction import (
    IDLER,
    LONGEST_STEP_PLACE,
    ROLLER,
    apply_friction_reaction,
    begin_history,
    find_friction_direction,
    find_slip,
    history_size,
)
from .patch import (
    apply_to_nodes,
    bezier_lever,
    evaluate_ruled_weights,
    interpolate_point,
    point_velocity,
)
from .scratch import (
    ALL_POINTS,
    CONTACT_REASON,
    CONTACT_SCRATCH,
    MOVE_ANCHORS,
    NIP_SCRATCH,
    contact_scratch,
    nip_scratch,
)
from .stations import (
    bound_cell,
    cell_clearance,
    cell_share,
    clamped_beam_compliance,
    edge_margins,
    entry_gap,
    entry_gap_law,
    find_material_point,
    height_beyond_reach,
    is_within_cell,
    station_offset,
)

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from mbfmu.sheets.contact.scratch import ContactScratch, NipScratch
    from solvers.compiled.record import Reals, Table


class NipRecord(Record):
    """A cell of a sheet in a nip."""

    roller: i8  # number of its body
    idler: i8  # of its body, 0: it has none
    force: i8  # number of the signal N
    scratch: i8  # places of the scratch memory
    pair_scratch: i8
    history: i8  # place of the history, see :mod:`.nip_friction`
    pairs: i8  # of stations, across the width
    way: i8  # the feed is along x (0) or z (1) of the sheet
    cell: Annotated[Integers, (2,)]  # number of the cell along x and z
    ends: Annotated[Integers, (2, 2)]  # as those of a surface contact
    node: Annotated[Integers, (4,)]
    a: f8
    b: f8
    place: Vec3  # middle of the nip, m
    d: Vec3  # feed
    n: Vec3  # from roller to idler
    e: Vec3
    radius: f8  # of the roller, m
    idler_radius: f8
    half: f8  # c, m
    entry: f8  # half the way over which an edge comes in, m
    width: f8  # m
    uneven: f8  # share of the force more at the end along e than in the middle
    stiffness: f8  # k of all stations, N/m
    damping: f8  # N s/m
    bending: f8  # B of a pair, N m^2
    friction: f8  # mu
    idler_friction: f8
    creep: f8
    friction_velocity: f8  # slip v_r at rest, m/s
    deflection: f8  # d of the bristles, m; 0: there are none
    static: f8  # mu_s of the roller
    idler_static: f8
    stribeck: f8  # v_s, m/s


@kernel
def evaluate_contact(nip: NipRecord, t: float, arrays: Arrays, state: State) -> None:
    """Add the forces at all stations in this cell to ``here.result``, and unless ``accumulate_only`` to the bodies."""
    here, bodies, pair = contact_scratch(nip, state), state.bodies, nip_scratch(nip, state)
    if height_beyond_reach(nip, bodies) > 0.0:
        return
    back, front = bound_cell(nip, nip.d, bodies)
    if front < -nip.half.real or back > nip.half.real:
        return
    near, far = bound_cell(nip, nip.e, bodies)
    N = signal_value(nip.force, t, arrays)
    if N.real < 0.0:  # an idler does not pull
        N = 0.0 * N
    before, after, left, right = edge_margins(nip)
    for j in range(nip.pairs):
        place = (2.0 * j + 1.0) / nip.pairs - 1.0  # across: from -1 to 1
        met = False
        for i in range(2):
            pair.part[i], pair.y[i] = 0.0, 0.0
            along, sideways = station_offset(nip, place, i)
            if along.real < back or along.real > front or sideways.real < near or sideways.real > far:
                continue
            xi, zeta, found = find_material_point(nip, along, sideways, bodies, here)
            if not found:
                continue
            u, w = (xi, zeta) if nip.way == 0 else (zeta, xi)
            part = cell_share(u, before, after) * cell_share(w, left, right)
            if part.real > 0.0:
                met, state.search[0].has_acted = True, 1
                pair.part[i], pair.at[i, 0], pair.at[i, 1] = part, xi, zeta
                pair.u[i] = u
                for k in range(3):
                    pair.y[i] += (here.r[k] - nip.place[k]) * nip.n[k]
                pair.y[i], pair.gain[i] = entry_gap_law(pair.y[i], entry_gap(nip, pair.u[i]))
        if not met:
            continue
        solve_pair_forces(nip, pair, here)
        for i in range(2):
            if pair.part[i].real > 0.0:
                load = N * (1.0 + nip.uneven * place) / (2 * nip.pairs)
                apply_station_force(nip, j, i, load, t, arrays.numbers, pair, bodies, here)


@kernel
def solve_pair_forces(nip: NipRecord, pair: NipScratch, here: ContactScratch) -> None:
    """pair.f = -(1 + K G)^-1 K y, and pair.lean, of the stations that this cell has."""
    k, h = nip.stiffness / (2 * nip.pairs), nip.a if nip.way == 0 else nip.b
    by = h * h * h / nip.bending
    k0, k1 = k * pair.part[0], k * pair.part[1]
    u0, u1 = pair.u[0], pair.u[1]
    g00, s00, g01, s01, g11, s11, s10 = 0.0 * k0, 0.0 * k0, 0.0 * k0, 0.0 * k0, 0.0 * k0, 0.0 * k0, 0.0 * k0
    has_first, has_second = (
        pair.part[0].real > 0.0 and is_within_cell(u0),
        pair.part[1].real > 0.0 and is_within_cell(u1),
    )
    if has_first:
        g00, s00 = clamped_beam_compliance(u0, u0)
    if has_second:
        g11, s11 = clamped_beam_compliance(u1, u1)
    if has_first and has_second:
        g01, s01 = clamped_beam_compliance(u0, u1)
        s10 = clamped_beam_compliance(u1, u0)[1]
    a00, a01, a10, a11 = 1.0 + by * k0 * g00, by * k0 * g01, by * k1 * g01, 1.0 + by * k1 * g11
    det = a00 * a11 - a01 * a10
    r0, r1 = -k0 * pair.y[0], -k1 * pair.y[1]
    pair.f[0], pair.f[1] = (a11 * r0 - a01 * r1) / det, (a00 * r1 - a10 * r0) / det
    pair.lean[0] = by / h * (s00 * pair.f[0] + s01 * pair.f[1])
    pair.lean[1] = by / h * (s10 * pair.f[0] + s11 * pair.f[1])
    here.result[6] -= 0.5 * (pair.y[0] * pair.f[0] + pair.y[1] * pair.f[1])


@kernel
def apply_station_force(
    nip: NipRecord, j: int, i: int, N: float, t: float, numbers: Reals, pair: Any, bodies: Table[MotionRecord],
    here: Any,
) -> None:  # fmt: skip
    """Add the force at station i of pair j."""
    evaluate_ruled_weights(nip, nip.way, pair.at[i, 0], pair.at[i, 1], here.c, here.cx, here.cz)
    interpolate_point(nip, here.c, bodies, here.r)
    interpolate_point(nip, here.cx, bodies, here.rx)
    interpolate_point(nip, here.cz, bodies, here.rz)
    point_velocity(nip, here.c, bodies, here.v)
    v, f, result = here.v, here.f, here.result
    d, n, e, part = nip.d, nip.n, nip.e, pair.part[i]
    zero = 0.0 * part
    ahead, side, up = zero, zero, zero
    xd, xe, xn, zd, ze, zn = zero, zero, zero, zero, zero, zero
    for k in range(3):
        ahead, side, up = ahead + v[k] * d[k], side + v[k] * e[k], up + v[k] * n[k]
        xd, xe, xn = xd + here.rx[k] * d[k], xe + here.rx[k] * e[k], xn + here.rx[k] * n[k]
        zd, ze, zn = zd + here.rz[k] * d[k], ze + here.rz[k] * e[k], zn + here.rz[k] * n[k]
    det = xd * ze - xe * zd
    s_d, s_e = (xn * ze - xe * zn) / det, (xd * zn - xn * zd) / det  # slopes of the surface along d and e
    rise_rate = up - s_d * ahead - s_e * side  # of the surface at P
    lean = pair.f[i] * pair.gain[i] * pair.lean[i] * (nip.a if nip.way == 0 else nip.b) / det  # along which u falls
    lean_d, lean_e = (lean * ze, -lean * zd) if nip.way == 0 else (-lean * xe, lean * xd)
    damped = -part * pair.gain[i] * nip.damping / (2 * nip.pairs) * rise_rate
    fn = pair.f[i] * pair.gain[i] + damped
    along, sideways = part * nip.friction * N, part * nip.idler_friction * N
    across = along if nip.idler > 0 else along + sideways
    station, xi, zeta = 2 * j + i, pair.at[i, 0] + nip.cell[0], pair.at[i, 1] + nip.cell[1]
    roller, R = bodies[nip.roller], nip.radius
    sd, se, speed = find_slip(nip, roller, R, ahead, side)
    x, y, root = find_friction_direction(nip, station, ROLLER, R, sd, se, speed, xi, zeta, t, numbers, roller, here)
    fd, fe = -along * x / root, -across * y / root
    gd, ge, idler_power = zero, zero, zero
    if nip.idler > 0:
        idler, R = bodies[nip.idler], -nip.idler_radius
        td, te, speed = find_slip(nip, idler, R, ahead, side)
        x, y, root = find_friction_direction(nip, station, IDLER, R, td, te, speed, xi, zeta, t, numbers, idler, here)
        gd, ge = -sideways * x / root, -sideways * y / root
        idler_power = gd * td + ge * te
    result[0] += part
    result[1] += part * sd
    result[2] -= fd
    result[3] += fe + ge
    result[4] += fn
    result[5] += damped * rise_rate + fd * sd + fe * se + idler_power
    if here.accumulate_only != 0:
        return
    for k in range(3):
        f[k] = fn * (n[k] - s_d * d[k] - s_e * e[k]) + (fd + gd - lean_d) * d[k] + (fe + ge - lean_e) * e[k]
    apply_to_nodes(nip, here.c, bodies, f)
    apply_friction_reaction(nip, bodies[nip.roller], nip.radius, fd, fe, here)
    if nip.idler > 0:
        apply_friction_reaction(nip, bodies[nip.idler], -nip.idler_radius, gd, ge, here)


@inlined
def body_number(nip: NipRecord, p: int) -> int:
    """Number of the body p of the nip: four nodes, the roller, the idler."""
    if p < 4:
        return nip.node[p]
    return nip.roller if p == 4 else nip.idler


@kernel
def tangent(nip: NipRecord, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: by complex steps of the bodies, where a cell has stations at all."""
    if evaluate_quantity(nip, state.time[0], arrays, state, 0) == 0.0:
        return 0.0
    count = 6 if nip.idler > 0 else 5
    for j in range(6 * count):
        for p in range(count):
            i = body_number(nip, p)
            step(state.bodies[i], perturbed.bodies[i], j - 6 * p, c1)
        evaluate_contact(nip, state.time[0], arrays, perturbed)
        for p in range(count):
            F = perturbed.bodies[body_number(nip, p)].F
            for k in range(6):
                K[6 * p + k, j] -= F[k].imag / COMPLEX_STEP_SIZE
    return 1.0


@kernel
def evaluate_quantity(nip: NipRecord, t: float, arrays: Arrays, state: State, k: int) -> Any:
    """Entry k of ``result`` by one cell alone, the bodies left as they are."""
    here = contact_scratch(nip, state)
    for j in range(8):
        here.result[j] = 0.0
    here.accumulate_only = ALL_POINTS
    evaluate_contact(nip, t, arrays, state)
    here.accumulate_only = 0
    return here.result[k]


@kernel
def apply(nip: NipRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`. The power on sheet and roller is a by-product."""
    here = contact_scratch(nip, state)
    result = here.result
    if here.accumulate_only == 0:  # else sensors add up the values of several contacts
        result[5] = 0.0
    evaluate_contact(nip, t, arrays, state)
    state.cached_power[0] += result[5]


@kernel
def clearance(nip: NipRecord, arrays: Arrays, state: State) -> Any:
    """See :mod:`mbfmu.mechanics.loads.base`: distance of a cell from the stations."""
    return cell_clearance(nip, state.bodies) + 0.0 * state.time[0]


@kernel
def potential(nip: NipRecord, arrays: Arrays, state: State) -> float:
    """Energy that rubber and cells store, J."""
    return evaluate_quantity(nip, state.time[0].real, arrays, state, 6)


@kernel
def longest_step(nip: NipRecord, taken: float, arrays: Arrays, state: State) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: steps do not pass over a slip of its bristles, which are moved."""
    if nip.deflection == 0.0:
        return np.inf
    here = contact_scratch(nip, state)
    begin_history(nip, state.time[0], taken, arrays.numbers)
    here.accumulate_only, here.result[LONGEST_STEP_PLACE] = MOVE_ANCHORS, np.inf
    evaluate_contact(nip, state.time[0], arrays, state)
    here.accumulate_only = 0
    longest: float = here.result[LONGEST_STEP_PLACE]
    return longest


@dataclass(frozen=True, kw_only=True)
class RollerNip(Load):
    """One cell of a sheet against a nip; :func:`.add_nip` makes those of a sheet."""

    record = NipRecord
    apply = apply
    potential = potential
    tangent = tangent
    clearance = clearance
    longest_step = longest_step
    symmetric = False  # friction
    nonsmooth_reason = CONTACT_REASON
    stiffness_reason = "the contact stiffness of nips is thousands of times the bending stiffness of the sheet"

    name: str
    force: Any
    sides: tuple[float, float]
    cell: tuple[int, int]
    ends: tuple[tuple[bool, bool], tuple[bool, bool]]
    common: dict[str, Any]

    @property
    def n_untied_bodies(self) -> int:
        """A roller that turns freely, or an idler, would tie all cells to each other."""
        return 2 if self.common["idler_radius"] > 0.0 else 1

    @property
    def levers(self) -> tuple[float, ...]:
        """Of the nodes."""
        return (bezier_lever(self.sides),) * 4

    @property
    def slip_scale(self) -> float:
        """Slip at which friction turns over, of a roller at rest, m/s."""
        return float(self.common["friction_velocity"])

    @property
    def is_nonconservative(self) -> bool:
        """It does: by friction and by damping."""
        return True

    @classmethod
    def check_start(cls, group: LoadGroup) -> list[str]:
        """See the base: it is on its sheet."""
        return misplaced_nips(group)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the nodes, the roller and the idler, if there is one, and what every cell has in common."""
        record["node"], record["roller"] = site.bodies[:4], site.bodies[4]
        record["idler"] = site.bodies[5] if len(site.bodies) > 5 else 0
        record["cell"], record["ends"], (record["a"], record["b"]) = self.cell, self.ends, self.sides
        record["force"] = site.signal(self.force, f"force of nip {self.name!r}")
        record["scratch"], record["pair_scratch"] = site.scratch(CONTACT_SCRATCH), site.scratch(NIP_SCRATCH)
        for key, value in self.common.items():
            record[key] = value
        if self.common["deflection"] > 0.0:
            record["history"] = site.history(history_size(self.common["pairs"]), self.name)
