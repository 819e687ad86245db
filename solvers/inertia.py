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
contributions cancel in every motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel

INERTIA = np.dtype(
    [
        ("energy", "f8"),  # J, largest v . M v so far
        ("growth", "f8"),  # rate growth where the last step ended; 0 before the first
        ("largest", "f8"),  # rate growth so far
        ("at", "f8"),  # s, time of the largest
    ],
    align=True,
)
HARMLESS_GROWTH = 2.0  # rate growth up to which the tolerance is not changed
LARGE_GROWTH = 10.0  # rate growth from which on the mass matrix is called nearly singular
FINEST_TOLERANCE = 3e-13  # relative tolerance that rounding allows
ROUNDING = 1e-16  # the same in units of the square of the rate growth


@kernel
def update_growth(t: float, M: Any, v: Any, work: Any) -> None:
    """Update the rate growth at time t (s) with mass matrix M (n, n) and rates v (n,); ``work`` is a workspace."""
    c, energy, looped = work.inertia[0], 0.0, work.row.shape[0] > 0
    for i in range(v.shape[0]):
        for j in range(v.shape[0]):
            energy += v[i] * M[i, j] * v[j]
    c.energy = max(c.energy, energy)
    c.growth, usual = 0.0, np.sqrt(c.energy)
    for i in range(v.shape[0]):
        if not (looped and work.looped[i] == 1.0):
            root = np.sqrt(M[i, i])
            share = root * abs(v[i])
            scale = usual + root * work.pace[i] * work.size[i]
            if share > c.growth * scale:
                c.growth = share / scale
    if c.growth > c.largest:
        c.largest, c.at = c.growth, t


@inlined
def finer_tolerance(rtol: float, power: float, work: Any) -> float:
    """Return by how much tolerances must be multiplied in the next step, at most one.

    ``rtol`` is the relative tolerance of a step, as the tolerance of the motion to the ``power``.
    """
    growth = work.inertia[0].growth
    if not growth > HARMLESS_GROWTH:
        return 1.0
    finer = max(1.0 / growth, (HARMLESS_GROWTH / growth) ** 2) ** power
    return min(1.0, max(finer, max(FINEST_TOLERANCE, ROUNDING * growth * growth) / rtol))
