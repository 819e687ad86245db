"""Cyclic coordinates of large trees: the equations of motion do not depend on them (the angle of a free wheel)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solvers.projection.products import Products
from solvers.system import Array, TreeSystem

CYCLIC_TOLERANCE = 1e-10  # change with a coordinate, relative to the largest entry, below which there is none
CYCLIC_ROUNDING = 1e-14  # of the largest change with any motion
GENERAL_DISTANCE = 0.01  # distance of the general position from the start, in units of the coordinates
POSITION_COEFFICIENTS, ACCELERATION_COEFFICIENTS = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)  # coefficients of the products


def find_cyclic(system: TreeSystem, start: Array) -> NDArray[np.bool_]:
    """Return which coordinates (n,) are cyclic, by derivatives at a position near ``start`` (nq,).

    The forces at rest along a cyclic coordinate are constant if they have a potential. One product with a random
    motion selects these candidates, and one product each decides.
    """
    n, m = system.n, system.m
    cyclic = np.zeros(n, bool)
    if system.complex_step is None:
        return cyclic
    random, products, q = np.random.default_rng(2), Products(system), start.copy()
    system.apply(q, GENERAL_DISTANCE * random.uniform(-1.0, 1.0, n) * system.size)
    v, a, motion = (random.uniform(-1.0, 1.0, n) * system.size for _ in range(3))
    rate = system.rate or 1.0
    lam = random.uniform(-1.0, 1.0, m)
    products.set_state(0.0, q, np.zeros(n), np.zeros(n), lam)
    change = np.abs(products.apply(motion, *POSITION_COEFFICIENTS)) * system.size
    candidates = np.flatnonzero(change <= CYCLIC_TOLERANCE * change.max(initial=0.0))
    products.set_state(0.0, q, rate * v, rate**2 * a, lam)
    largest = np.abs(products.apply(motion, *POSITION_COEFFICIENTS) * system.size).max(initial=0.0)
    for k in candidates:
        unit = np.zeros(n)
        unit[k] = system.size[k]
        change, inertia = (
            np.abs(products.apply(unit, *c) * system.size).max()
            for c in (POSITION_COEFFICIENTS, ACCELERATION_COEFFICIENTS)
        )
        cyclic[k] = change <= CYCLIC_TOLERANCE * rate**2 * inertia + CYCLIC_ROUNDING * largest
    return cyclic
