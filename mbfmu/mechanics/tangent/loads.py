"""How loads change with the motions of what they act on, where their kind does not say: by complex steps.

T takes minus the derivative, by positions and c1 times by velocities.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, step
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.layout import Layout
    from solvers.compiled.record import Reals


@kernel
def stiffness(e: int, c1: float, layout: Layout, arrays: Arrays, state: State, perturbed: State, K: Reals) -> None:
    """K of load e, six rows and columns for each of its bodies; ``perturbed`` is a complex state, scratch."""
    first, end = layout.first_body[e], layout.first_body[e + 1]
    for j in range(6 * (end - first)):
        for p in range(end - first):
            i = layout.bodies[first + p]
            step(state.bodies[i], perturbed.bodies[i], j - 6 * p, c1)
        apply_load(arrays.loads[e], state.time[0], arrays, perturbed)
        for p in range(end - first):
            F = perturbed.bodies[layout.bodies[first + p]].F
            for k in range(6):
                K[6 * p + k, j] = -F[k].imag / COMPLEX_STEP_SIZE
