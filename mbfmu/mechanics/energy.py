"""Kinetic and potential energy."""

from __future__ import annotations

from typing import Any

from solvers.kernel import kernel

from .forces import potential
from .spatial import cross


@kernel
def kinetic_energy(arrays: Any, state: Any) -> float:
    """sum m v_c.v_c / 2 + w.Jc w / 2, J."""
    total = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        Y, Jc = here.Y, here.Jc
        v = here.W  # scratch
        cross(Y[3:6], here.com, v)
        square = 0.0
        for k in range(3):
            square += (Y[k] + v[k]) * (Y[k] + v[k])
        total += 0.5 * arrays.bodies[i].mass * square
        for k in range(3):
            total += 0.5 * Y[3 + k] * (Jc[k, 0] * Y[3] + Jc[k, 1] * Y[4] + Jc[k, 2] * Y[5])
    return total


@kernel
def potential_energy(arrays: Any, state: Any) -> float:
    """Energy in the gravity field (zero at the global origin) and in the springs, J."""
    total = potential(arrays, state)
    g = arrays.world[0].gravity
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        for k in range(3):
            total -= arrays.bodies[i].mass * g[k] * (here.r[k] + here.com[k])
    return total
