"""Friction that sticks: an elastic bristle between every contact point of a sheet and the surface.

A bristle is anchored in the surface at a. Its deflection e is the tangential part of x - a, where x is the point. With
the Coulomb force mu N, the tangential velocity v and the projection onto the unit ball P(u) = u / max(1, |u|)

    f = -mu N P(P(e / d) + v / v_r).

d is the deflection at which the point slides, and v_r the velocity at which the damping alone has the force mu N. A
point at rest does not creep: v = 0 and e = d F / (mu N) hold a load F < mu N. A point that slides faster than 2 v_r has
the Coulomb force for any e. All is scaled by N, so that a point slides if N is zero. With a coefficient of static
friction mu_s larger than mu, f is multiplied by g(v) = 1 + (mu_s / mu - 1) exp(-(|v| / v_s)^2), the law of Stribeck
(:mod:`mbfmu.mechanics.loads.bristle`): a point breaks away under mu_s N at the same deflection d.

The anchor is moved where |e| > d: the elasto-plastic law of Simo, Laursen (1992, Computers & Structures 42), but
integrated along the path of the point instead of its chord, see :mod:`.sliding`. It is moved at the ends of accepted
steps (:mod:`.anchors`). Within a step the same mapping of the deflection at the beginning of the step gives the force.
The force therefore is a function of time, positions and velocities, and solvers need no additional unknowns. A point
that was not in contact at the beginning of the step has e = 0.

**History** of a contact, in ``Arrays.numbers`` from its field ``history`` on: TIME of the end of the last accepted
step and of its BEGINNING, s; whether any point IS_ANCHORED; and for every point two anchors, of the beginning and of
the end of this step: 1 if it has one, its place, and that of the point, m; and its slip velocity at the end, m/s; all
in the axes of the surface. The first anchor is used up to TIME, the second one after it: solvers evaluate states within
the last step, for outputs, and continue from there after a change of an input.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.loads.bristle import stribeck_factor
from solvers.compiled.kernel import inlined, kernel

from .sliding import draw_bristle

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from mbfmu.sheets.contact.surface_force import SurfaceContactRecord
    from solvers.compiled.record import Reals

TIME, IS_ANCHORED, BEGINNING, FIRST_ANCHOR = 0, 1, 2, 3  # places in the history of a contact
ANCHOR_SIZE = 7  # numbers of an anchor
POINT_PLACE = 4  # place of the point among them
SLIP = 2 * ANCHOR_SIZE  # place of the slip velocity among the numbers of a point
POINT_HISTORY_SIZE = SLIP + 3
MIN_STEP_BACK_RATIO = 1e-3  # of a step: it began earlier than the last one ended, by more than rounding


def history_size(samples: tuple[int, int]) -> int:
    """Return how many numbers the history of a cell with these numbers of points has."""
    return FIRST_ANCHOR + POINT_HISTORY_SIZE * (samples[0] + 1) * (samples[1] + 1)


@inlined
def replaces_last_step(last: float, t: float, taken: float) -> bool:
    """Whether a step of ``taken`` to t began before the time ``last`` at which the last step ended, s: it replaces the
    rest of that step, whose beginning remains that of the history.
    """
    return last - (t - taken) > MIN_STEP_BACK_RATIO * taken


@inlined
def anchor_place(contact: SurfaceContactRecord, point: int) -> int:
    """Place of the first anchor of a point in ``Arrays.numbers``."""
    return contact.history + FIRST_ANCHOR + POINT_HISTORY_SIZE * point


@kernel
def limit_to_unit(x: float, y: float, z: float) -> Any:
    """P(u) of a vector u."""
    square = x * x + y * y + z * z
    if square.real > 1.0:
        size = np.sqrt(square)
        return x / size, y / size, z / size
    return x, y, z


@kernel
def deflected_part(contact: SurfaceContactRecord, anchor: Reals, taken: float, p: Reals, n: Reals, slip: Any) -> Any:
    """e / d of a point at p that has moved for ``taken`` (s) since the beginning of a step, where its anchor was
    ``anchor`` (ANCHOR_SIZE,); in the axes of the surface, with the normal n and the slip velocity ``slip``, m/s.
    """
    d, zero = contact.deflection, 0.0 * p[0]
    if anchor[0].real == 0.0:
        return zero, zero, zero
    k = 0 if abs(n[0].real) < abs(n[1].real) else 1
    if abs(n[2].real) < abs(n[k].real):
        k = 2
    # two unit vectors in the surface: of the axis least along the normal
    tx, ty, tz = -n[k] * n[0], -n[k] * n[1], -n[k] * n[2]
    if k == 0:
        tx += 1.0
    elif k == 1:
        ty += 1.0
    else:
        tz += 1.0
    size = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / size, ty / size, tz / size
    sx, sy, sz = n[1] * tz - n[2] * ty, n[2] * tx - n[0] * tz, n[0] * ty - n[1] * tx
    x, y, z = anchor[4] - anchor[1], anchor[5] - anchor[2], anchor[6] - anchor[3]
    e = (x * tx + y * ty + z * tz) / d, (x * sx + y * sy + z * sz) / d
    x, y, z = p[0] - anchor[4], p[1] - anchor[5], p[2] - anchor[6]
    moved = (x * tx + y * ty + z * tz) / d, (x * sx + y * sy + z * sz) / d
    x, y, z = slip
    velocity = (x * tx + y * ty + z * tz) / d, (x * sx + y * sy + z * sz) / d
    a, b = draw_bristle(e, moved, velocity, taken)
    return a * tx + b * sx, a * ty + b * sy, a * tz + b * sz


@kernel
def elastic_part(
    contact: SurfaceContactRecord, point: int, t: float, numbers: Reals, body: MotionRecord, p: Reals, v: Reals,
    n: Reals,
) -> Any:  # fmt: skip
    """e / d of a point at p in the axes of the surface, where the normal is n, with the slip velocity v in global axes;
    global axes.
    """
    at, A = anchor_place(contact, point), body.A
    start = numbers[contact.history + BEGINNING].real
    if t > numbers[contact.history + TIME].real:
        at, start = at + ANCHOR_SIZE, numbers[contact.history + TIME].real
    slip = (
        A[0, 0] * v[0] + A[1, 0] * v[1] + A[2, 0] * v[2],
        A[0, 1] * v[0] + A[1, 1] * v[1] + A[2, 1] * v[2],
        A[0, 2] * v[0] + A[1, 2] * v[1] + A[2, 2] * v[2],
    )
    x, y, z = deflected_part(contact, numbers[at : at + ANCHOR_SIZE], t - start, p, n, slip)
    return (
        A[0, 0] * x + A[0, 1] * y + A[0, 2] * z,
        A[1, 0] * x + A[1, 1] * y + A[1, 2] * z,
        A[2, 0] * x + A[2, 1] * y + A[2, 2] * z,
    )


@kernel
def find_friction_direction(
    contact: SurfaceContactRecord, point: int, t: float, numbers: Reals, body: MotionRecord, p: Reals, n: Reals,
    v: Reals,
) -> Any:  # fmt: skip
    """v <- -f / (mu N) of a point with the tangential velocity v; return its product with v, m/s. The place p and the
    normal n are in the axes of the surface.
    """
    x, y, z = elastic_part(contact, point, t, numbers, body, p, v, n)
    x, y, z = limit_to_unit(
        x + v[0] / contact.friction_velocity, y + v[1] / contact.friction_velocity, z + v[2] / contact.friction_velocity
    )
    if contact.static.real > contact.friction.real:
        square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
        g = stribeck_factor(contact.friction, contact.static, contact.stribeck, square)
        x, y, z = g * x, g * y, g * z
    slip = x * v[0] + y * v[1] + z * v[2]
    v[0], v[1], v[2] = x, y, z
    return slip
