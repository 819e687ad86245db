"""Friction of roller and idler on a sheet in a nip, by the slip of the material at a station; see :mod:`.nip`.

With a ``deflection`` d friction sticks where the roller rests, as in :mod:`.bristles`: with the part mu N of the normal
force at a station, the slip s along the feed and across it, and P(u) = u / max(1, |u|),

    f = -mu N P(z + s / S),    S = sqrt(v_r^2 + (creep v_roller)^2).

z is the deflection of a bristle over d. It changes by the displacement D by which the sheet has slipped, and roller and
sheet carry bristles out of the contact:

    z' = (s - |v_roller| z) / d,    z = P((z_0 + D / d) / (1 + r / d)),

by the implicit Euler method, and P along the path of the material (:mod:`.sliding`), where D is the integral of s and r
that of |v_roller| since the step began. D is the displacement of the material under the station less that of the
roller's surface. In steady rolling z = s / |v_roller| is small, and the traction is that of s / S.

**History** of a nip, which its cells share, in ``Arrays.numbers``: TIME of the end of the last accepted step, and its
STEP_LENGTH, s; and for every station, of the roller and of the idler, two bristles, of the beginning and of the end of
this step: 1 if there is one; xi and zeta counted over all cells; the point of the roller that touches the sheet, over
its radius, in the axes of the roller; and z and the slip (m/s) along d and e.

A coefficient of static friction that is larger than mu multiplies f by g(s) as in :mod:`.bristles`.

Steps are limited as by the points of a surface (:mod:`.breakaway`) if the roller is slower than S, and such that the
roller turns by MAX_TURN_ANGLE at most: its rotation in a step is known up to half a turn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.loads.bristle import stribeck_factor
from solvers.compiled.kernel import inlined, kernel

from .breakaway import longest_deflecting_step, time_to_corner
from .bristles import limit_to_unit, replaces_last_step
from .patch import apply_reaction
from .scratch import MOVE_ANCHORS
from .sliding import draw_bristle

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from mbfmu.sheets.contact.nip import NipRecord
    from mbfmu.sheets.contact.scratch import ContactScratch
    from solvers.compiled.record import Reals

TIME, STEP_LENGTH, FIRST_BRISTLE = 0, 1, 2  # places in the history of a nip
LONGEST_STEP_PLACE = 7  # place of the longest next step, s, in the result of the scratch memory
BRISTLE_SIZE = 10  # numbers of a bristle; every station has two, of the roller and of the idler each
ROLLER, IDLER = 0, 1
MAX_TURN_ANGLE = 0.5  # rad, of a roller in one step


def history_size(pairs: int) -> int:
    """Return how many numbers the history of a nip with these pairs of stations has."""
    return FIRST_BRISTLE + 2 * pairs * 2 * 2 * BRISTLE_SIZE


@inlined
def bristle_place(nip: NipRecord, station: int, which: int) -> int:
    """Place of the first bristle of a station on the ROLLER or the IDLER in ``Arrays.numbers``."""
    return nip.history + FIRST_BRISTLE + 2 * BRISTLE_SIZE * (2 * station + which)


@kernel
def begin_history(nip: NipRecord, t: float, taken: float, numbers: Reals) -> None:
    """Let the bristles at the end of a step be those at its beginning, after a step of ``taken`` to t, s; once."""
    if numbers[nip.history + TIME] == t:  # another cell was first
        return
    replaces = replaces_last_step(numbers[nip.history + TIME], t, taken)
    numbers[nip.history + TIME], numbers[nip.history + STEP_LENGTH] = t, taken
    for k in range(2 * 2 * nip.pairs):
        before = bristle_place(nip, k // 2, k % 2)
        for j in range(0 if replaces else BRISTLE_SIZE):
            numbers[before + j] = numbers[before + BRISTLE_SIZE + j]
        numbers[before + BRISTLE_SIZE] = 0.0


@kernel
def evaluate_bristle(
    nip: NipRecord, at: int, R: float, xi: float, zeta: float, slip: Any, taken: float, numbers: Reals,
    body: MotionRecord, here: Any,
) -> Any:  # fmt: skip
    """z along d and e, by the bristle at ``at`` of ``taken`` (s) before, of a station at the material (xi, zeta) with
    this slip (m/s) on a body whose surface is at R n from its axis; the derivatives of the point by xi and zeta are in
    here.rx and here.rz.
    """
    zero = 0.0 * here.r[0]
    if numbers[at].real == 0.0:
        return zero, zero
    dxi, dzeta, A = xi - numbers[at + 1], zeta - numbers[at + 2], body.A
    moved_d, moved_e, turned_d, turned_e, turned_n = zero, zero, zero, zero, zero
    for k in range(3):
        moved = -(here.rx[k] * dxi + here.rz[k] * dzeta)
        turned = A[k, 0] * numbers[at + 3] + A[k, 1] * numbers[at + 4] + A[k, 2] * numbers[at + 5]
        moved_d, moved_e = moved_d + moved * nip.d[k], moved_e + moved * nip.e[k]
        turned_d, turned_e = turned_d + turned * nip.d[k], turned_e + turned * nip.e[k]
        turned_n += turned * nip.n[k]
    if abs(moved_d.real) > abs(R):  # the roller may have turned by more than half a turn
        return zero, zero
    angle, per_sine = find_angle(turned_d, turned_e, turned_n)
    kept, d = 1.0 + abs(R) * angle / nip.deflection, nip.deflection
    z = numbers[at + 6] / kept, numbers[at + 7] / kept
    kept *= d
    moved = (moved_d - R * per_sine * turned_d) / kept, (moved_e - R * per_sine * turned_e) / kept
    return draw_bristle(z, moved, (slip[0] / kept, slip[1] / kept), taken)


@kernel
def find_angle(x: float, y: float, z: float) -> Any:
    """Angle of the unit vector (x, y, z) to the last axis, and its ratio to the sine of the angle."""
    square = x * x + y * y
    if square.real == 0.0:
        return 0.0 * square, 0.0 * square + 1.0
    sine = np.sqrt(square)
    angle = np.arctan2(sine.real, z.real) + z.real * (sine - sine.real) - sine.real * (z - z.real)
    return angle, angle / sine


@kernel
def store_bristle(
    nip: NipRecord, at: int, xi: float, zeta: float, z: Any, slip: Any, numbers: Reals, body: MotionRecord
) -> None:
    """Write the bristle of a station at ``at``; ``z`` and ``slip`` are pairs."""
    numbers[at], numbers[at + 1], numbers[at + 2] = 1.0, xi.real, zeta.real
    for k in range(3):
        touching = body.A[0, k] * nip.n[0] + body.A[1, k] * nip.n[1] + body.A[2, k] * nip.n[2]
        numbers[at + 3 + k] = touching.real
    numbers[at + 6], numbers[at + 7] = z[0].real, z[1].real
    numbers[at + 8], numbers[at + 9] = slip[0].real, slip[1].real


@kernel
def longest_station_step(nip: NipRecord, before: int, scale: float, speed: float, numbers: Reals) -> float:
    """Longest next step by a station whose bristles are at ``before``, s; ``scale`` is S, and ``speed`` that of the
    roller, m/s.
    """
    after, taken, d = before + BRISTLE_SIZE, numbers[nip.history + STEP_LENGTH].real, nip.deflection.real
    if numbers[before].real == 0.0:  # not in contact
        taken = np.inf
    sticks = numbers[after + 6].real ** 2 + numbers[after + 7].real ** 2 < 1.0
    uu, ur, rr, vv, aa = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(6, 8):
        z, slip = numbers[after + j].real, numbers[after + j + 2].real
        a = (slip - numbers[before + j + 2].real) / taken
        u, r = z + slip / scale, a / scale + ((slip - speed * z) / d if sticks else 0.0)
        uu, ur, rr, vv, aa = uu + u * u, ur + u * r, rr + r * r, vv + slip * slip, aa + a * a
    longest = time_to_corner(uu, ur, rr)
    return min(longest, longest_deflecting_step(d, scale, vv, aa)) if sticks else longest


@inlined
def find_slip(nip: NipRecord, body: MotionRecord, R: float, ahead: float, side: float) -> Any:
    """Slip along d and e of the sheet, whose speed is ``ahead`` and ``side``, on a body whose surface is at R n from
    its axis, and the square of the speed of this surface.
    """
    d, n, e, Y = nip.d, nip.n, nip.e, body.Y
    feed, slide = 0.0 * ahead, 0.0 * ahead
    for k in range(3):
        p, q = (k + 1) % 3, (k + 2) % 3
        surface = Y[k] + R * (Y[3 + p] * n[q] - Y[3 + q] * n[p])
        feed, slide = feed + surface * d[k], slide + surface * e[k]
    return ahead - feed, side - slide, feed * feed + slide * slide


@kernel
def find_friction_direction(
    nip: NipRecord, station: int, which: int, R: float, sd: float, se: float, speed: float, xi: float, zeta: float,
    t: float, numbers: Reals, body: MotionRecord, here: Any,
) -> Any:  # fmt: skip
    """-S f / (mu N) along d and e, and S, of a slip on the ROLLER or the IDLER, the square of whose speed is ``speed``;
    with bristles S is one.
    """
    least, creep = nip.friction_velocity, nip.creep
    if nip.deflection.real == 0.0:
        root = np.sqrt(sd * sd + se * se + least * least + creep * creep * speed)
        return sd, se, root
    before = bristle_place(nip, station, which)
    last = numbers[nip.history + TIME].real
    at, taken = before, numbers[nip.history + STEP_LENGTH].real
    if t > last:
        at, taken = before + BRISTLE_SIZE, t - last
    z_d, z_e = evaluate_bristle(nip, at, R, xi, zeta, (sd, se), taken, numbers, body, here)
    scale = np.sqrt(least * least + creep * creep * speed)
    if here.accumulate_only == MOVE_ANCHORS:
        store_bristle(nip, before + BRISTLE_SIZE, xi, zeta, (z_d, z_e), (sd, se), numbers, body)
        if speed.real < (scale * scale).real:
            longest = longest_station_step(nip, before, scale.real, np.sqrt(speed.real), numbers)
            here.result[LONGEST_STEP_PLACE] = min(here.result[LONGEST_STEP_PLACE].real, longest)
        if speed.real > 0.0:
            here.result[LONGEST_STEP_PLACE] = min(
                here.result[LONGEST_STEP_PLACE].real, MAX_TURN_ANGLE * abs(R) / np.sqrt(speed.real)
            )
    x, y, zero = limit_to_unit(z_d + sd / scale, z_e + se / scale, 0.0 * sd)
    friction, static = (nip.friction, nip.static) if which == ROLLER else (nip.idler_friction, nip.idler_static)
    if static.real > friction.real:
        g = stribeck_factor(friction, static, nip.stribeck, sd * sd + se * se)
        x, y = g * x, g * y
    return x, y, zero + 1.0


@inlined
def apply_friction_reaction(
    nip: NipRecord, body: MotionRecord, R: float, fd: Reals, fe: Reals, here: ContactScratch
) -> None:
    """Let the friction on the sheet, fd along d and fe along e, act back on the body."""
    for k in range(3):
        here.f[k] = fd * nip.d[k] + fe * nip.e[k]
        here.p[k] = body.r[k] + R * nip.n[k]
    apply_reaction(body, here.p, here.f)
