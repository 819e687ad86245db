"""Complex steps of a body: derivatives by its motions, exact to rounding."""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import MotionRecord, State

COMPLEX_STEP_SIZE = 1e-30  # of the step
NO_MOTION = 6  # number of the motion of a body that is not displaced


@kernel
def displace(here: MotionRecord, perturbed: MotionRecord, k: int) -> None:
    """A body after an imaginary unit motion: k = 0, 1, 2 along the global axes, 3, 4, 5 about them, else none."""
    for a in range(3):
        perturbed.r[a] = here.r[a] + (COMPLEX_STEP_SIZE * 1j if a == k else 0.0)
        for b in range(3):
            perturbed.A[a, b] = here.A[a, b]
    if 3 <= k < 6:
        p, q = (k - 2) % 3, (k - 1) % 3  # e_k x e_p = e_q
        for b in range(3):
            perturbed.A[q, b] += COMPLEX_STEP_SIZE * 1j * here.A[p, b]
            perturbed.A[p, b] -= COMPLEX_STEP_SIZE * 1j * here.A[q, b]


@kernel
def step(here: MotionRecord, perturbed: MotionRecord, k: int, c1: float) -> None:
    """A body after an imaginary unit motion k, with c1 times the velocity along it, and no force on it."""
    displace(here, perturbed, k)
    for j in range(6):
        perturbed.Y[j] = here.Y[j] + (c1 * COMPLEX_STEP_SIZE * 1j if j == k else 0.0)
        perturbed.F[j] = 0.0


@kernel
def release_bodies(state: State, perturbed: State) -> None:
    """Place all bodies without an imaginary part, and without forces on them and along coordinates."""
    for i in range(state.bodies.shape[0]):
        step(state.bodies[i], perturbed.bodies[i], NO_MOTION, 0.0)
    for i in range(perturbed.Q.shape[0]):
        perturbed.Q[i] = 0.0
