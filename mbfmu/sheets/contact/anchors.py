"""Anchors of the bristles of a contact, which are moved at the end of every accepted step; see :mod:`.bristles`.

Two events within a step are not seen in its error. A load may exceed the friction for a while: implicit methods follow
a point that sticks as if its deflection were a function of the load. So a step is limited to MAX_DEFLECTION_CHANGE d /
|v| by every point that sticks with |v| < 2 v_r. And a point that slides may stop and return, while its deflection is
mapped from that at the beginning. So a step is limited to (|v| + v_r) |v| / (-a . v) by every point that slides with
|v| > v_r, where a is the mean acceleration of the last step: it ends when the point has about stopped.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel

from .bristles import (
    ANCHOR_SIZE,
    IS_ANCHORED,
    MAX_DEFLECTION_CHANGE,
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
    from solvers.compiled.record import Reals, Table


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
                    last = numbers[before + SLIP : before + POINT_HISTORY_SIZE]
                    longest = min(longest, longest_slip_step(contact, sticks, taken, bodies, last, here))
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
    contact: SurfaceContactRecord, sticks: bool, taken: float, bodies: Table[MotionRecord], last: Reals,
    here: ContactScratch,
) -> float:  # fmt: skip
    """Longest next step after one of ``taken`` by a point at here.r with the weights here.c and the normal here.f, s.

    ``last`` (3,) is its slip velocity at the end of the step before, and then at the end of this one.
    """
    v, n, rate = here.v, here.f, contact.friction_velocity
    point_velocity(contact, here.c, bodies, v)
    subtract_surface_velocity(bodies[contact.body], here)
    leaving, square, change = v[0] * n[0] + v[1] * n[1] + v[2] * n[2], 0.0, 0.0
    for j in range(3):
        slip = v[j] - leaving * n[j]
        square, change = square + slip * slip, change + (slip - last[j]) * slip
        last[j] = slip
    size = np.sqrt(square)
    if sticks and 0.0 < size < 2.0 * rate:
        return MAX_DEFLECTION_CHANGE * contact.deflection / size
    if not sticks and size > rate and change < 0.0:
        return taken * (square + rate * size) / -change
    return np.inf
