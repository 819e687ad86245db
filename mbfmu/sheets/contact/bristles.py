"""Friction that sticks: an elastic bristle between every contact point of a sheet and the surface.

A bristle is anchored in the surface at a. Its deflection e is the tangential part of x - a, where x is the point. With
the Coulomb force mu N, the tangential velocity v and the projection onto the unit ball P(u) = u / max(1, |u|)

    f = -mu N P(P(e / d) + v / v_r).

d is the deflection at which the point slides, and v_r the velocity at which the damping alone has the force mu N. A
point at rest does not creep: v = 0 and e = d F / (mu N) hold a load F < mu N. A point that slides faster than 2 v_r has
the Coulomb force for any e. All is scaled by N, so that a point slides if N is zero. With a coefficient of static
friction mu_s larger than mu, f is multiplied by g(v) = 1 + (mu_s / mu - 1) exp(-(|v| / v_s)^2), the law of Stribeck
(:mod:`mbfmu.mechanics.loads.bristle`): a point breaks away under mu_s N at the same deflection d.

The anchor is moved where |e| > d, to a + (1 - d / |e|) e: the return mapping of elasto-plasticity (Simo, Laursen 1992,
Computers & Structures 42). It is moved at the ends of accepted steps (:mod:`.anchors`). Within a step the same mapping
from the anchor at the beginning of the step, P(e / d), gives the force. The force therefore is a function of time,
positions and velocities, and solvers need no additional unknowns. A point that was not in contact at the beginning of
the step has e = 0.

**History** of a contact, in ``Arrays.numbers`` from its field ``history`` on: TIME of the end of the last accepted
step, s; whether any point IS_ANCHORED; and for every point two anchors, of the beginning and of the end of this step: 1
if it has one, and its place, m; and its slip velocity at the end, m/s; both in the axes of the surface. The first
anchor is used up to TIME, the second one after it: solvers evaluate states within the last step, for outputs, and
continue from there after a change of an input.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.loads.bristle import stribeck_factor
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord
    from mbfmu.sheets.contact.surface_force import SurfaceContactRecord
    from solvers.compiled.record import Reals

TIME, IS_ANCHORED, FIRST_ANCHOR = 0, 1, 2  # places in the history of a contact
ANCHOR_SIZE = 4  # numbers of an anchor
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
def elastic_part(
    contact: SurfaceContactRecord, point: int, t: float, numbers: Reals, body: MotionRecord, p: Reals, n: Reals
) -> Any:
    """P(e / d) of a point at p, in the axes of the surface, with the normal n; global axes."""
    zero, at = 0.0 * p[0], anchor_place(contact, point)
    if t > numbers[contact.history + TIME].real:
        at += ANCHOR_SIZE
    if numbers[at].real == 0.0:
        return zero, zero, zero
    d, A = contact.deflection, body.A
    x, y, z = (p[0] - numbers[at + 1]) / d, (p[1] - numbers[at + 2]) / d, (p[2] - numbers[at + 3]) / d
    x, y, z = (
        A[0, 0] * x + A[0, 1] * y + A[0, 2] * z,
        A[1, 0] * x + A[1, 1] * y + A[1, 2] * z,
        A[2, 0] * x + A[2, 1] * y + A[2, 2] * z,
    )
    normal = x * n[0] + y * n[1] + z * n[2]
    return limit_to_unit(x - normal * n[0], y - normal * n[1], z - normal * n[2])


@kernel
def find_friction_direction(
    contact: SurfaceContactRecord, point: int, t: float, numbers: Reals, body: MotionRecord, p: Reals, n: Reals,
    v: Reals,
) -> Any:  # fmt: skip
    """v <- -f / (mu N) of a point with the tangential velocity v; return its product with v, m/s."""
    x, y, z = elastic_part(contact, point, t, numbers, body, p, n)
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
