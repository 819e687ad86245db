"""How long a step may be such that a sheet does not pass through a thin surface.

A step that begins on one side of a guide and ends on the other meets no force. Seen from the surface a point moves with
the velocity v, of which v_n leads into the surface, and the acceleration a of a surface that turns. The distance from a
convex surface is a convex function, so that after the time h the point is no deeper than v_n h + a h^2 / 2 - d, where d
is its distance. The step is limited to

    v_n h + (a + |v_n| / h0) h^2 / 2 <= d + PASSAGE_RATIO p,

where p is the depth of the middle of the surface. |v_n| / h0 is the acceleration of a point that was at rest before the
last step, h0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel

from .anchors import move_anchors
from .patch import (
    evaluate_center,
    evaluate_line,
    evaluate_on_line,
    evaluate_weights,
    hull_radius,
    point_velocity,
    sagitta,
)
from .scratch import contact_scratch
from .surface_force import gap, is_separated, subtract_surface_velocity

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from mbfmu.sheets.contact.scratch import ContactScratch
    from mbfmu.sheets.contact.surface_force import SurfaceContactRecord

PASSAGE_RATIO = 0.5


@kernel
def passing_time(distance: float, taken: float, body: MotionRecord, here: ContactScratch) -> float:
    """Time, s, in which a point at here.r with the velocity here.v moves by ``distance`` (m) into a surface with the
    normal here.f, at the earliest.
    """
    v, f = here.v, here.f
    own = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    subtract_surface_velocity(body, here)
    turning = body.Y[3] * body.Y[3] + body.Y[4] * body.Y[4] + body.Y[5] * body.Y[5]
    relative = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    approach = -(f[0] * v[0] + f[1] * v[1] + f[2] * v[2])
    # a point that moves uniformly has the acceleration -w x (v + v_r)
    a = np.sqrt(turning) * (np.sqrt(own) + np.sqrt(relative)) + abs(approach) / taken
    root = np.sqrt(approach * approach + 2.0 * a * distance)
    if approach > 0.0:
        return 2.0 * distance / (approach + root)
    return (root - approach) / a if a > 0.0 else np.inf


@kernel
def longest_step(contact: SurfaceContactRecord, taken: float, arrays: Arrays, state: State) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: no point of the cell is to be deeper than the middle of the surface. The
    anchors of its bristles are moved first.
    """
    longest = move_anchors(contact, taken, arrays, state) if contact.deflection > 0.0 else np.inf
    if not contact.passage < np.inf:
        return longest
    here, bodies = contact_scratch(contact, state), state.bodies
    body = bodies[contact.body]
    evaluate_center(contact, bodies, here.r)
    distance = gap(contact, arrays, state)
    if is_separated(contact, distance, bodies, here):
        reach = (
            sagitta(contact, bodies, here.r, here.f) if contact.convex == 1 else hull_radius(contact, bodies, here.r)
        )
        allowed = max(distance - reach, 0.0) + PASSAGE_RATIO * contact.passage
        for j in range(4):
            node = bodies[contact.node[j]]
            for k in range(3):
                here.r[k], here.v[k] = node.r[k], node.Y[k]
            longest = min(longest, passing_time(allowed, taken, body, here))
        return longest
    nx, nz = contact.samples[0], contact.samples[1]
    for i in range(nx + contact.ends[0, 1]):
        evaluate_line(contact, i / nx, bodies, here.line)
        for k in range(nz + contact.ends[1, 1]):
            evaluate_on_line(here.line, k / nz, here.r)
            distance = gap(contact, arrays, state)
            if here.part > 0.0:
                evaluate_weights(contact, i / nx, k / nz, here.c)
                point_velocity(contact, here.c, bodies, here.v)
                allowed = max(distance, 0.0) + PASSAGE_RATIO * contact.passage
                longest = min(longest, passing_time(allowed, taken, body, here))
    return longest
