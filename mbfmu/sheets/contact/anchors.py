"""Anchors of the bristles of a contact, which are moved at the end of every accepted step; see :mod:`.bristles`.

The next step is limited by every point in contact, see :mod:`.breakaway`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel

from .breakaway import longest_deflecting_step, time_to_corner
from .bristles import (
    ANCHOR_SIZE,
    BEGINNING,
    IS_ANCHORED,
    POINT_HISTORY_SIZE,
    POINT_PLACE,
    SLIP,
    TIME,
    anchor_place,
    deflected_part,
    replaces_last_step,
)
from .patch import evaluate_center, evaluate_line, evaluate_on_line, evaluate_weights, point_velocity
from .scratch import contact_scratch
from .surface_force import gap, is_separated, subtract_surface_velocity

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from mbfmu.sheets.contact.scratch import ContactScratch
    from mbfmu.sheets.contact.surface_force import SurfaceContactRecord
    from solvers.compiled.record import Reals


@kernel
def move_anchors(contact: SurfaceContactRecord, taken: float, arrays: Arrays, state: State) -> float:
    """Move the anchors of a cell to the end of an accepted step of ``taken`` (s), where the bodies are; return the
    longest next step, s.
    """
    here, bodies, numbers, longest = contact_scratch(contact, state), state.bodies, arrays.numbers, np.inf
    head, t = contact.history, state.time[0]
    replaces = replaces_last_step(numbers[head + TIME], t, taken)
    if not replaces:
        numbers[head + BEGINNING] = numbers[head + TIME]
    numbers[head + TIME] = t
    evaluate_center(contact, bodies, here.r)
    separated = is_separated(contact, gap(contact, arrays, state), bodies, here)
    if separated and numbers[head + IS_ANCHORED] == 0.0:
        return longest
    nx, nz, is_anchored = contact.samples[0], contact.samples[1], 0.0
    for i in range(nx + 1):
        if not separated:
            evaluate_line(contact, i / nx, bodies, here.line)
        for k in range(nz + 1):
            before = anchor_place(contact, i * (nz + 1) + k)
            after = before + ANCHOR_SIZE
            for j in range(0 if replaces else ANCHOR_SIZE):
                numbers[before + j] = numbers[after + j]
            numbers[after] = 0.0
            if not separated:
                evaluate_on_line(here.line, k / nz, here.r)
                if gap(contact, arrays, state) < 0.0 and here.part > 0.0:
                    evaluate_weights(contact, i / nx, k / nz, here.c)
                    point_velocity(contact, here.c, bodies, here.v)
                    find_slip(bodies[contact.body], here)
                    sticks = map_anchor(contact, before, after, t - numbers[head + BEGINNING], numbers, here)
                    since = taken if numbers[before] == 1.0 else np.inf  # in contact
                    anchor, last = numbers[after : before + SLIP], numbers[before + SLIP : before + POINT_HISTORY_SIZE]
                    limit = longest_slip_step(contact, sticks, since, anchor, last, here)
                    longest = min(longest, limit)
            is_anchored += numbers[before] + numbers[after]
    numbers[head + IS_ANCHORED] = 1.0 if is_anchored > 0.0 else 0.0
    return longest


@kernel
def find_slip(body: MotionRecord, here: ContactScratch) -> None:
    """here.v <- slip velocity of the point at here.r with the velocity here.v, in the axes of the surface."""
    v, n, A, leaving = here.v, here.n, body.A, 0.0
    subtract_surface_velocity(body, here)
    for j in range(3):
        leaving += v[j] * here.f[j]
    x, y, z = v[0], v[1], v[2]
    for j in range(3):
        v[j] = A[0, j] * x + A[1, j] * y + A[2, j] * z - leaving * n[j]


@kernel
def map_anchor(
    contact: SurfaceContactRecord, before: int, after: int, taken: float, numbers: Reals, here: ContactScratch
) -> bool:
    """Anchor at ``after`` of a point in contact at here.p with the slip velocity here.v by the one at ``before``, both
    places in ``numbers``, after ``taken`` (s); return whether it has not moved.
    """
    p, n, d = here.p, here.n, contact.deflection
    slip = here.v[0], here.v[1], here.v[2]
    x, y, z = deflected_part(contact, numbers[before : before + ANCHOR_SIZE], taken, p, n, slip)
    numbers[after], sticks = 1.0, True
    if numbers[before] == 1.0:
        normal, square = 0.0, 0.0
        for j in range(3):
            normal += (p[j] - numbers[before + 1 + j]) * n[j]
        for j in range(3):
            square += (p[j] - numbers[before + 1 + j] - normal * n[j]) ** 2
        sticks = bool(square <= d * d)
    for j in range(3):
        numbers[after + POINT_PLACE + j] = p[j]
    if sticks and numbers[before] == 1.0:
        for j in range(1, POINT_PLACE):
            numbers[after + j] = numbers[before + j]
    else:
        numbers[after + 1], numbers[after + 2], numbers[after + 3] = p[0] - d * x, p[1] - d * y, p[2] - d * z
    return sticks


@kernel
def longest_slip_step(
    contact: SurfaceContactRecord, sticks: bool, taken: float, anchor: Reals, last: Reals, here: ContactScratch
) -> float:
    """Longest next step after one of ``taken`` by a point at here.p with the slip velocity here.v, s.

    ``anchor`` is its anchor. ``last`` (3,) is its slip velocity at the end of the step before, and then at the end of
    this one, in the axes of the surface.
    """
    d, scale, v, p, n = contact.deflection, contact.friction_velocity, here.v, here.p, here.n
    off = 0.0
    for j in range(3):
        off += (p[j] - anchor[1 + j]) * n[j]
    uu, ur, rr, vv, aa = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(3):
        slip = v[j]
        a = (slip - last[j]) / taken
        u, r = (p[j] - anchor[1 + j] - off * n[j]) / d + slip / scale, a / scale + (slip / d if sticks else 0.0)
        uu, ur, rr, vv, aa = uu + u * u, ur + u * r, rr + r * r, vv + slip * slip, aa + a * a
        last[j] = slip
    longest = time_to_corner(uu, ur, rr)
    return min(longest, longest_deflecting_step(d, scale, vv, aa)) if sticks else longest
