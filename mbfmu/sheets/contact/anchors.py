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
    IS_ANCHORED,
    POINT_HISTORY_SIZE,
    SLIP,
    TIME,
    anchor_place,
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
                    sticks = map_anchor(contact, before, after, numbers, here)
                    evaluate_weights(contact, i / nx, k / nz, here.c)
                    point_velocity(contact, here.c, bodies, here.v)
                    since = taken if numbers[before] == 1.0 else np.inf  # in contact
                    anchor, last = numbers[after : before + SLIP], numbers[before + SLIP : before + POINT_HISTORY_SIZE]
                    limit = longest_slip_step(contact, sticks, since, anchor, last, bodies[contact.body], here)
                    longest = min(longest, limit)
            is_anchored += numbers[before] + numbers[after]
    numbers[head + IS_ANCHORED] = 1.0 if is_anchored > 0.0 else 0.0
    return longest


@kernel
def map_anchor(contact: SurfaceContactRecord, before: int, after: int, numbers: Reals, here: ContactScratch) -> bool:
    """Anchor at ``after`` of a point in contact at here.p by the one at ``before``, both places in ``numbers``; return
    whether it has not moved.
    """
    p, n = here.p, here.n  # axes of the surface
    numbers[after] = 1.0
    if numbers[before] == 0.0:
        for j in range(3):
            numbers[after + 1 + j] = p[j]
        return True
    normal, square = 0.0, 0.0
    for j in range(3):
        normal += (p[j] - numbers[before + 1 + j]) * n[j]
    for j in range(3):
        square += (p[j] - numbers[before + 1 + j] - normal * n[j]) ** 2
    size, d = np.sqrt(square), contact.deflection
    for j in range(3):
        a = numbers[before + 1 + j]
        if size > d:
            a = p[j] - d / size * (p[j] - a - normal * n[j])
        numbers[after + 1 + j] = a
    return bool(size <= d)


@kernel
def longest_slip_step(
    contact: SurfaceContactRecord, sticks: bool, taken: float, anchor: Reals, last: Reals, body: MotionRecord,
    here: ContactScratch,
) -> float:  # fmt: skip
    """Longest next step after one of ``taken`` by a point at here.r with the velocity here.v, s.

    ``anchor`` is its anchor. ``last`` (3,) is its slip velocity at the end of the step before, and then at the end of
    this one, in the axes of the surface.
    """
    d, scale, v, p, n, A = contact.deflection, contact.friction_velocity, here.v, here.p, here.n, body.A
    subtract_surface_velocity(body, here)
    leaving, off = 0.0, 0.0
    for j in range(3):
        leaving, off = leaving + v[j] * here.f[j], off + (p[j] - anchor[1 + j]) * n[j]
    uu, ur, rr, vv, aa = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(3):
        slip = A[0, j] * v[0] + A[1, j] * v[1] + A[2, j] * v[2] - leaving * n[j]
        a = (slip - last[j]) / taken
        u, r = (p[j] - anchor[1 + j] - off * n[j]) / d + slip / scale, a / scale + (slip / d if sticks else 0.0)
        uu, ur, rr, vv, aa = uu + u * u, ur + u * r, rr + r * r, vv + slip * slip, aa + a * a
        last[j] = slip
    longest = time_to_corner(uu, ur, rr)
    return min(longest, longest_deflecting_step(d, scale, vv, aa)) if sticks else longest
