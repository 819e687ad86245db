"""How loads change with the motions of what they act on, where their kind does not say: by complex steps.

T takes minus the derivative, by positions and c1 times by velocities.
"""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.steps import EPSILON, step
from solvers.compiled.kernel import kernel


@kernel
def stiffness(e: int, c1: float, L: Any, arrays: Any, state: Any, twin: Any, K: Any) -> None:
    """K of load e, six rows and columns for each of its bodies; ``twin`` is a complex state, scratch."""
    first, end = L.first_body[e], L.first_body[e + 1]
    for j in range(6 * (end - first)):
        for p in range(end - first):
            i = L.bodies[first + p]
            step(state.bodies[i], twin.bodies[i], j - 6 * p, c1)
        apply_load(arrays.loads[e], state.time[0], arrays, twin)
        for p in range(end - first):
            F = twin.bodies[L.bodies[first + p]].F
            for k in range(6):
                K[6 * p + k, j] = -F[k].imag / EPSILON


@kernel
def along_joints(c1: float, L: Any, arrays: Any, state: Any, twin: Any, along: Any) -> None:
    """along (nv,): stiffness of the loads that act along coordinates, by the coordinate itself."""
    for i in range(along.shape[0]):
        along[i] = 0.0
    for k in range(L.along.shape[0]):
        body = arrays.bodies[L.along[k, 1]]
        q, v = body.qi, body.vi
        twin.q[q] = state.q[q] + EPSILON * 1j
        twin.v[v] = state.v[v] + c1 * EPSILON * 1j
        twin.Q[v] = 0.0
        apply_load(arrays.loads[L.along[k, 0]], state.time[0], arrays, twin)
        along[v] -= twin.Q[v].imag / EPSILON
        twin.q[q], twin.v[v] = state.q[q], state.v[v]
