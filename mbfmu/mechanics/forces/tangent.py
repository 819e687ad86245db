"""How forces change with the motions of what they act on, for :mod:`mbfmu.mechanics.tangent`: by complex steps.

T takes minus the derivative, by positions and c1 times by velocities.
"""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.cuts.tangent import EPSILON, displace
from solvers.kernel import kernel

from . import exert


@kernel
def stiffness(force: Any, c1: float, arrays: Any, state: Any, twin: Any, K: Any) -> None:
    """K (12, 12) of a force on bodies a and b, six rows and columns a body; ``twin`` is a complex state, scratch."""
    for j in range(12):
        for p in range(2):
            i = force.a if p == 0 else force.b
            displace(state.bodies[i], twin.bodies[i], j - 6 * p)
            for k in range(6):
                twin.bodies[i].Y[k] = state.bodies[i].Y[k] + (c1 * EPSILON * 1j if k == j - 6 * p else 0.0)
                twin.bodies[i].F[k] = 0.0
        exert(force, state.time[0], arrays, twin)
        for i in range(12):
            F = twin.bodies[force.a].F if i < 6 else twin.bodies[force.b].F
            K[i, j] = -F[i % 6].imag / EPSILON


@kernel
def along_joints(c1: float, arrays: Any, state: Any, twin: Any, along: Any) -> None:
    """along (nv,): stiffness of the forces that act along coordinates, by the coordinate itself."""
    for i in range(along.shape[0]):
        along[i] = 0.0
    for e in range(arrays.forces.shape[0]):
        force = arrays.forces[e]
        if force.v >= 0:
            twin.q[force.q] = state.q[force.q] + EPSILON * 1j
            twin.v[force.v] = state.v[force.v] + c1 * EPSILON * 1j
            twin.Q[force.v] = 0.0
            exert(force, state.time[0], arrays, twin)
            along[force.v] -= twin.Q[force.v].imag / EPSILON
