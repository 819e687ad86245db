"""How errors grow where the mass matrix is nearly singular, and how much finer the tolerance must be there.

Where the mass matrix M becomes nearly singular along the motion, rates become large although the energy does not, since
their contributions cancel. A cart of 1e-6 kg that carries a pendulum of 1 kg passes below it at 1000 times the speed of
the pendulum. An error of r |v_i| in such a rate, r the relative tolerance, changes the momentum by r M_ii |v_i|, while
the momentum itself is of the size of (E M_ii)^1/2, E the largest v . M v so far. An error of the position has the same
effect, as M changes with it. Errors therefore grow by the *rate growth*

    max_i |v_i| / (E / M_ii)^1/2,    M_ii the composite inertia of coordinate i.

It has no unit, is about 1 in most motions, and is at most 3 in a chain of 59 links. Tolerances are divided by it where
it is large, as far as rounding allows: M is known to 2e-16, accelerations only to that times the square of the growth.

Rates below the unit of their absolute tolerance are not considered. Neither are the coordinates of loops, where
contributions cancel in every motion, first-order states, which have no inertia, and large trees with loops or meshes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, Table, f8, i8

from .system import Array, TreeSystem

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.projection.workspace import Workspace


class InertiaRecord(Record):
    """What is observed of the mass matrix."""

    watched: i8  # 1: of a large tree, whether the rate growth is computed
    energy: f8  # J, largest v . M v so far
    growth: f8  # rate growth where the last step ended; 0 before the first
    largest: f8  # rate growth so far
    at: f8  # s, time of the largest
    large_since: f8  # s, when it was above LARGE_GROWTH first; meaningless where the largest is not


MAX_HARMLESS_GROWTH = 2.0  # rate growth up to which the tolerance is not changed
LARGE_GROWTH = 10.0  # rate growth from which on the mass matrix is called nearly singular
MIN_TOLERANCE = 3e-13  # relative tolerance that rounding allows
GROWTH_ROUNDING = 1e-16  # the same in units of the square of the rate growth


class Growth(NamedTuple):
    """What the rate growth of a large tree is computed with."""

    size: Array  # (n,) units of the coordinates
    coordinate_rates: Array  # (n,) 1/s, of their rates
    parts: Array  # (1 + n,) see solvers.system.TreeSystem.inertia_parts
    inertia: Table[InertiaRecord]  # (1,)

    @staticmethod
    def of(system: TreeSystem, rate: float) -> Growth:
        """Return the growth of a tree that moves at this rate, 1/s."""
        growth = Growth(system.size, np.full(system.n, rate), np.zeros(1 + system.n), InertiaRecord.zeros(1))
        growth.inertia["watched"] = system.can_compute_rate_growth
        return growth


@kernel
def clear_growth(work: Growth) -> None:
    """Discard the rate growth of the motion so far."""
    record = work.inertia[0]
    record.energy, record.growth, record.largest, record.at = 0.0, 0.0, 0.0, 0.0


@inlined
def growth_of_rate(inertia: float, v: float, unit: float, energy: float) -> float:
    """Return the growth of the errors of one rate v, whose absolute tolerance has this ``unit``."""
    root = np.sqrt(inertia)
    scale = np.sqrt(energy) + root * unit
    return root * abs(v) / scale if scale > 0.0 else 0.0


@inlined
def record_growth(t: float, growth: float, inertia: InertiaRecord) -> None:
    """Record the rate growth at time t (s)."""
    inertia.growth = growth
    if growth > LARGE_GROWTH and not inertia.largest > LARGE_GROWTH:
        inertia.large_since = t
    if growth > inertia.largest:
        inertia.largest, inertia.at = growth, t


@kernel
def update_growth(t: float, M: Reals, v: Reals, work: Workspace) -> None:
    """Update the rate growth at time t (s) with mass matrix M (n, n) and rates v (n,); ``work`` is a workspace."""
    record, energy, growth, has_loops = work.inertia[0], 0.0, 0.0, work.row.shape[0] > 0
    moving = v.shape[0] - work.states.shape[0]
    for i in range(moving):
        for j in range(moving):
            energy += v[i] * M[i, j] * v[j]
    record.energy = max(record.energy, energy)
    for i in range(moving):
        if not (has_loops and work.in_loops[i] == 1.0):
            growth = max(growth, growth_of_rate(M[i, i], v[i], work.coordinate_rates[i] * work.size[i], record.energy))
    record_growth(t, growth, record)


@kernel
def update_tree_growth(t: float, parts: Reals, v: Reals, work: Any) -> None:
    """As :func:`update_growth`, from v . M v and the diagonal of M in ``parts`` (1 + n,)."""
    record, growth = work.inertia[0], 0.0
    record.energy = max(record.energy, parts[0])
    for i in range(v.shape[0]):
        growth = max(growth, growth_of_rate(parts[1 + i], v[i], work.coordinate_rates[i] * work.size[i], record.energy))
    record_growth(t, growth, record)


@inlined
def tolerance_factor(rtol: float, power: float, work: Growth | Workspace) -> float:
    """Return by how much tolerances must be multiplied in the next step, at most one.

    ``rtol`` is the relative tolerance of a step, as the tolerance of the motion to the ``power``.
    """
    growth = work.inertia[0].growth
    if not growth > MAX_HARMLESS_GROWTH:
        return 1.0
    finer = max(1.0 / growth, (MAX_HARMLESS_GROWTH / growth) ** 2) ** power
    return min(1.0, max(finer, max(MIN_TOLERANCE, GROWTH_ROUNDING * growth * growth) / rtol))


def describe_large_growth(inertia: NDArray[Any]) -> str:
    """Return the message of an InertiaRecord on a nearly singular mass matrix; empty: none."""
    record = inertia[0]
    if not record["largest"] > LARGE_GROWTH:
        return ""
    return (
        f"the mass matrix is nearly singular at times from t = {record['large_since']:.6g} s on, as if a light body "
        f"carries a heavy one; errors of velocities are amplified by a factor above {LARGE_GROWTH:g}"
    )
