"""Forces of a cell of a sheet against a rigid surface, by points that are fixed in the cell.

A point stands for its share w of the area. Where it is deeper than the surface by d, the pressure of Hunt and Crossley
(1975) on a law without a corner, and Coulomb's friction, regularized at the slip v_r:

    N = w k phi(d) max(0, 1 - chi v_n),    phi = d^2 / (2 d0) up to d0, d - d0 / 2 beyond,
    f = N n - mu N v_t / sqrt(v_t^2 + v_r^2),

v the velocity relative to the surface, v_n > 0 where it leaves. An impact so loses (4/3) chi v of its energy to first
order, whatever phi is. Points lie on edges of the sheet too, with half their share: an edge that no point is on would
pass through a wall. A contact with a ``deflection`` has the friction of :mod:`.bristles` instead.

``result`` of the scratch memory: the force on the sheet (0..2), N; stored energy (3), J; power of what is not stored
(4), W; depth of the deepest point (5), m.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mbfmu.mechanics.dispatch import part_value
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, step
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Integers, Record, f8, i8

from .bristles import find_friction_direction
from .patch import (
    apply_reaction,
    apply_to_nodes,
    evaluate_center,
    evaluate_line,
    evaluate_on_line,
    evaluate_weights,
    hull_radius,
    moment_arm,
    point_velocity,
    sagitta,
    squared_corner_distance,
)
from .scratch import ALL_POINTS, OWN_SHARE, contact_scratch

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from mbfmu.sheets.contact.scratch import ContactScratch
    from solvers.compiled.record import Reals, Table

GAP = 0  # number of that kernel of a surface
MAX_BIT = 62  # of a whole number: points from this one on have it in common


class SurfaceContactRecord(Record):
    """A cell of a sheet in contact with a surface."""

    body: i8  # that the surface is fixed to
    surface: i8  # its number among the parts
    scratch: i8  # place of the scratch memory
    history: i8  # place of the history, see :mod:`.bristles`
    convex: i8  # 1: it is
    samples: Annotated[Integers, (2,)]  # along x and z of the cell
    ends: Annotated[
        Integers, (2, 2)
    ]  # along x, along z: 1 where the cell begins, where it ends on an edge of the sheet
    node: Annotated[Integers, (4,)]
    a: f8  # sides of the cell, m
    b: f8
    half: f8  # thickness of the sheet, m
    passage: f8  # depth beyond which a point has passed the surface, m; infinite: none has
    stiffness: f8  # k, N/m^3
    depth: f8  # d0, m
    damping: f8  # chi, s/m
    friction: f8  # mu
    friction_velocity: f8  # v_r, m/s
    deflection: f8  # d of the bristles, m; 0: there are none
    static: f8  # mu_s
    stribeck: f8  # v_s, m/s


@kernel
def gap(contact: SurfaceContactRecord, arrays: Arrays, state: State) -> Any:
    """Distance of the sheet's face at here.r from the surface; the normal in global axes is left in here.f."""
    here, body = contact_scratch(contact, state), state.bodies[contact.body]
    here.part = 1.0
    if contact.body == 0:  # the ground
        for k in range(3):
            here.p[k] = here.r[k]
        found = part_value(contact.surface, GAP, arrays, state, here) - contact.half
        for k in range(3):
            here.f[k] = here.n[k]
        return found
    x, y, z = here.r[0] - body.r[0], here.r[1] - body.r[1], here.r[2] - body.r[2]
    for k in range(3):
        here.p[k] = body.A[0, k] * x + body.A[1, k] * y + body.A[2, k] * z
    found = part_value(contact.surface, GAP, arrays, state, here) - contact.half
    for k in range(3):
        here.f[k] = body.A[k, 0] * here.n[0] + body.A[k, 1] * here.n[1] + body.A[k, 2] * here.n[2]
    return found


@kernel
def is_separated(
    contact: SurfaceContactRecord, distance: float, bodies: Table[MotionRecord], here: ContactScratch
) -> bool:
    """Broad-phase test: whether a cell is separated, by the distance ``distance`` and the normal here.f at its center
    here.r.

    The cell is in the convex hull of its Bezier points, which is within a ball about its center. A convex surface lies
    behind its tangent plane at the nearest point. Of most cells the distances of the nodes are sufficient.
    """
    beyond = distance.real - (contact.a.real + contact.b.real) / 3.0
    if beyond > 0.0 and beyond * beyond > squared_corner_distance(contact, bodies, here.r):
        return True
    if contact.convex == 1:
        return distance.real > sagitta(contact, bodies, here.r, here.f)
    return distance.real > hull_radius(contact, bodies, here.r)


@kernel
def clearance(contact: SurfaceContactRecord, arrays: Arrays, state: State) -> Any:
    """See :mod:`mbfmu.mechanics.loads.base`: distance of a cell from a surface that is fixed to the ground."""
    here, bodies = contact_scratch(contact, state), state.bodies
    if contact.body > 0:
        return 0.0 * state.time[0]
    evaluate_center(contact, bodies, here.r)
    distance = gap(contact, arrays, state)
    if contact.convex == 1:
        return distance - sagitta(contact, bodies, here.r, here.f)
    return distance - hull_radius(contact, bodies, here.r)


@kernel
def evaluate_contact(contact: SurfaceContactRecord, t: float, arrays: Arrays, state: State) -> None:
    """Add the forces at all points to ``here.result``, and unless ``accumulate_only`` to the bodies."""
    here, bodies = contact_scratch(contact, state), state.bodies
    search = state.search[0]
    repeated = search.is_repeated == 1 and here.accumulate_only == 0 and contact.body == 0
    if contact.body > 0:  # it may act as soon as that moves
        search.has_acted = 1
    if not repeated:
        evaluate_center(contact, bodies, here.r)
        if is_separated(contact, gap(contact, arrays, state), bodies, here):
            return
    nx, nz, own = contact.samples[0], contact.samples[1], here.accumulate_only == OWN_SHARE
    for i in range(nx + (1 if own else contact.ends[0, 1])):
        has_line = False
        for k in range(nz + (1 if own else contact.ends[1, 1])):
            bit = 1 << min(i * (nz + 1) + k, MAX_BIT)
            if repeated and search.parts & bit == 0:
                continue
            if not has_line:
                evaluate_line(contact, i / nx, bodies, here.line)
                has_line = True
            evaluate_on_line(here.line, k / nz, here.r)
            d = -gap(contact, arrays, state)
            if not (d.real <= 0.0 or here.part.real <= 0.0):  # nan passes, and ends the run
                search.has_acted, search.parts = 1, search.parts | bit
                evaluate_weights(contact, i / nx, k / nz, here.c)
                point_velocity(contact, here.c, bodies, here.v)
                point_force(contact, i, k, point_area(contact, i, k, own), d, t, arrays, bodies[contact.body], here)
                if here.accumulate_only == 0:
                    apply_to_nodes(contact, here.c, bodies, here.f)
                    if contact.body > 0:
                        apply_reaction(bodies[contact.body], here.r, here.f)


@kernel
def point_area(contact: SurfaceContactRecord, i: int, k: int, own: bool) -> float:
    """Area that a point stands for, m^2; or its part of that in the cell."""
    nx, nz = contact.samples[0], contact.samples[1]
    share = contact.a * contact.b / (nx * nz)
    if (i == 0 and (own or contact.ends[0, 0] == 1)) or i == nx:
        share *= 0.5
    if (k == 0 and (own or contact.ends[1, 0] == 1)) or k == nz:
        share *= 0.5
    return share


@inlined
def subtract_surface_velocity(body: MotionRecord, here: ContactScratch) -> None:
    """here.v <- velocity of the point at here.r relative to the body of the surface."""
    r, v = here.r, here.v
    x, y, z = r[0] - body.r[0], r[1] - body.r[1], r[2] - body.r[2]
    v[0] -= body.Y[0] + body.Y[4] * z - body.Y[5] * y
    v[1] -= body.Y[1] + body.Y[5] * x - body.Y[3] * z
    v[2] -= body.Y[2] + body.Y[3] * y - body.Y[4] * x


@kernel
def point_force(
    contact: SurfaceContactRecord, i: int, k: int, share: float, d: Reals, t: float, arrays: Arrays,
    body: MotionRecord, here: ContactScratch,
) -> None:  # fmt: skip
    """here.f <- force on point i, k at here.r with the velocity here.v, the normal of the surface in here.f so far."""
    v, f, result = here.v, here.f, here.result
    subtract_surface_velocity(body, here)
    stiffness, d0 = contact.stiffness * share * here.part, contact.depth
    if d.real < d0.real:
        spring, stored = stiffness * d * d / (2.0 * d0), stiffness * d * d * d / (6.0 * d0)
    else:
        spring, stored = stiffness * (d - 0.5 * d0), stiffness * (0.5 * d * d - 0.5 * d0 * d + d0 * d0 / 6.0)
    leaving = f[0] * v[0] + f[1] * v[1] + f[2] * v[2]
    N = spring * (1.0 - contact.damping * leaving)
    if N.real < 0.0:
        N = 0.0 * N
    result[3] += stored
    result[4] += (N - spring) * leaving
    if d.real > result[5].real:
        result[5] = d
    friction = 0.0 * N
    if contact.friction.real > 0.0:
        for j in range(3):
            v[j] -= leaving * f[j]
        if contact.deflection.real > 0.0:
            friction = contact.friction * N
            point = i * (contact.samples[1] + 1) + k
            result[4] -= friction * find_friction_direction(contact, point, t, arrays.numbers, body, here.p, here.n, v)
        else:
            square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
            friction = contact.friction * N / np.sqrt(square + contact.friction_velocity * contact.friction_velocity)
            result[4] -= friction * square
    for j in range(3):
        f[j] = N * f[j] - friction * v[j]
        result[j] += f[j]


@kernel
def tangent(
    contact: SurfaceContactRecord, c1: float, arrays: Arrays, state: State, perturbed: State, K: Reals
) -> float:
    """See :mod:`mbfmu.mechanics.loads.base`: the law by complex steps of a point, the point by its weights."""
    here, there, bodies = contact_scratch(contact, state), contact_scratch(contact, perturbed), state.bodies
    body, moved, t = bodies[contact.body], perturbed.bodies[contact.body], state.time[0]
    step(body, moved, -1, c1)
    evaluate_center(contact, bodies, here.r)
    for j in range(3):
        there.r[j] = here.r[j]
    if is_separated(contact, gap(contact, arrays, perturbed), bodies, there):
        return 0.0
    met = 0.0
    nx, nz = contact.samples[0], contact.samples[1]
    for i in range(nx + contact.ends[0, 1]):
        evaluate_line(contact, i / nx, bodies, here.line)
        for k in range(nz + contact.ends[1, 1]):
            evaluate_on_line(here.line, k / nz, here.r)
            for j in range(3):
                there.r[j] = here.r[j]
            d = -gap(contact, arrays, perturbed)
            if not (d.real <= 0.0 or there.part.real <= 0.0):
                evaluate_weights(contact, i / nx, k / nz, here.c)
                share = point_area(contact, i, k, False)
                point_velocity(contact, here.c, bodies, here.v)
                nx0, ny0, nz0 = there.f[0], there.f[1], there.f[2]
                for j in range(6):
                    if j < 3:  # by the velocity: depth and normal stay
                        step_point(3 + j, here, there)
                        there.f[0], there.f[1], there.f[2] = nx0, ny0, nz0
                        point_force(contact, i, k, share, d, t, arrays, moved, there)
                    else:
                        point_force_perturbed(contact, i, k, share, j - 3, t, arrays, here, perturbed)
                    for row in range(3):
                        here.by[row, (j + 3) % 6] = -there.f[row].imag / COMPLEX_STEP_SIZE
                        here.f[row] = there.f[row].real
                if contact.body > 0:
                    for j in range(6):
                        step(body, moved, j, c1)
                        point_force_perturbed(contact, i, k, share, 6, t, arrays, here, perturbed)
                        for row in range(3):
                            here.df[row, j] = -there.f[row].imag / COMPLEX_STEP_SIZE
                            here.dr[row, j] = -1.0 if row == j else 0.0
                    add_columns(contact, 24, bodies, here, K)
                    step(body, moved, -1, c1)
                add_node_stiffness(contact, c1, bodies, here, K)
                met = 1.0
    return met


@kernel
def step_point(j: int, here: ContactScratch, there: ContactScratch) -> None:
    """Point and velocity in ``there`` <- those in ``here``, with an imaginary step of the position (j < 3), of the
    velocity (j < 6) or none.
    """
    for k in range(3):
        there.r[k] = here.r[k] + (COMPLEX_STEP_SIZE * 1j if k == j else 0.0)
        there.v[k] = here.v[k] + (COMPLEX_STEP_SIZE * 1j if k + 3 == j else 0.0)


@kernel
def point_force_perturbed(
    contact: SurfaceContactRecord, i: int, k: int, share: float, j: int, t: float, arrays: Arrays, here: Any,
    perturbed: State,
) -> None:  # fmt: skip
    """perturbed.contact.f <- force at a point after an imaginary step of position (j < 3), velocity (j < 6) or none."""
    there = contact_scratch(contact, perturbed)
    step_point(j, here, there)
    d = -gap(contact, arrays, perturbed)
    point_force(contact, i, k, share, d, t, arrays, perturbed.bodies[contact.body], there)


@kernel
def add_node_stiffness(
    contact: SurfaceContactRecord, c1: float, bodies: Table[MotionRecord], here: ContactScratch, K: Reals
) -> None:
    """Add to K what a point feels, by the motions of its nodes, from minus the derivatives of the law in here.by."""
    by, dr, df, f = here.by, here.dr, here.df, here.f
    for j in range(4):
        node = bodies[contact.node[j]]
        arm, w = moment_arm(node.A, here.c[j, 1], here.c[j, 2]), (node.Y[3], node.Y[4], node.Y[5])
        for k in range(3):
            p, q = (k + 1) % 3, (k + 2) % 3
            dr[k, k], dr[p, k], dr[q, k] = here.c[j, 0], 0.0, 0.0
            dr[k, 3 + k], dr[p, 3 + k], dr[q, 3 + k] = 0.0, -arm[q], arm[p]  # e_k x L
        for i in range(3):
            vx, vy, vz = by[i, 3], by[i, 4], by[i, 5]
            # by the velocity, which changes with c1 dr, and as the lever turns with w x dr
            gx, gy, gz = by[i, 0] + c1 * vx, by[i, 1] + c1 * vy, by[i, 2] + c1 * vz
            tx, ty, tz = vy * w[2] - vz * w[1], vz * w[0] - vx * w[2], vx * w[1] - vy * w[0]
            df[i, 0], df[i, 1], df[i, 2] = here.c[j, 0] * gx, here.c[j, 0] * gy, here.c[j, 0] * gz
            gx, gy, gz = gx + tx, gy + ty, gz + tz
            df[i, 3] = gz * arm[1] - gy * arm[2]
            df[i, 4] = gx * arm[2] - gz * arm[0]
            df[i, 5] = gy * arm[0] - gx * arm[1]
        add_columns(contact, 6 * j, bodies, here, K)
        for k in range(3, 6):  # the moment L x f turns with the node
            K[6 * j + 3, 6 * j + k] -= dr[1, k] * f[2] - dr[2, k] * f[1]
            K[6 * j + 4, 6 * j + k] -= dr[2, k] * f[0] - dr[0, k] * f[2]
            K[6 * j + 5, 6 * j + k] -= dr[0, k] * f[1] - dr[1, k] * f[0]


@kernel
def add_columns(
    contact: SurfaceContactRecord, first: int, bodies: Table[MotionRecord], here: ContactScratch, K: Reals
) -> None:
    """Add six columns from ``first`` on to K: the nodes' wrenches from minus the changes of the force, here.df, and
    that of a moving body, relative to which the point moves by here.dr.
    """
    f, dr, df = here.f, here.dr, here.df
    for j in range(4):
        x, y, z = moment_arm(bodies[contact.node[j]].A, here.c[j, 1], here.c[j, 2])
        N = here.c[j, 0]
        for k in range(6):
            K[6 * j, first + k] += N * df[0, k]
            K[6 * j + 1, first + k] += N * df[1, k]
            K[6 * j + 2, first + k] += N * df[2, k]
            K[6 * j + 3, first + k] += y * df[2, k] - z * df[1, k]
            K[6 * j + 4, first + k] += z * df[0, k] - x * df[2, k]
            K[6 * j + 5, first + k] += x * df[1, k] - y * df[0, k]
    if contact.body > 0:
        body, r = bodies[contact.body], here.r
        x, y, z = r[0] - body.r[0], r[1] - body.r[1], r[2] - body.r[2]
        for k in range(6):
            K[24, first + k] -= df[0, k]
            K[25, first + k] -= df[1, k]
            K[26, first + k] -= df[2, k]
            K[27, first + k] += dr[1, k] * f[2] - dr[2, k] * f[1] - y * df[2, k] + z * df[1, k]
            K[28, first + k] += dr[2, k] * f[0] - dr[0, k] * f[2] - z * df[0, k] + x * df[2, k]
            K[29, first + k] += dr[0, k] * f[1] - dr[1, k] * f[0] - x * df[1, k] + y * df[0, k]


@kernel
def evaluate_quantity(contact: SurfaceContactRecord, arrays: Arrays, state: State, k: int) -> Any:
    """Entry k of ``result`` by one cell alone, the bodies left as they are."""
    here = contact_scratch(contact, state)
    for j in range(8):
        here.result[j] = 0.0
    here.accumulate_only = ALL_POINTS
    evaluate_contact(contact, state.time[0].real, arrays, state)
    here.accumulate_only = 0
    return here.result[k]


@kernel
def apply(contact: SurfaceContactRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`. The dissipated power is a by-product."""
    here = contact_scratch(contact, state)
    result = here.result
    if here.accumulate_only == 0:  # else sensors add up the values of several contacts
        result[4] = 0.0
    evaluate_contact(contact, t, arrays, state)
    state.cached_power[0] += result[4]


@kernel
def potential(contact: SurfaceContactRecord, arrays: Arrays, state: State) -> float:
    """Energy that the law of pressure stores, J."""
    return evaluate_quantity(contact, arrays, state, 3)
