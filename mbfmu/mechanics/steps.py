"""Complex steps of a body: derivatives by its motions, exact to rounding."""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import kernel

EPSILON = 1e-30  # of the step


@kernel
def displace(here: Any, twin: Any, k: int) -> None:
    """A body after an imaginary unit motion: k = 0, 1, 2 along the global axes, 3, 4, 5 about them, else none."""
    for a in range(3):
        twin.r[a] = here.r[a] + (EPSILON * 1j if a == k else 0.0)
        for b in range(3):
            twin.A[a, b] = here.A[a, b]
    if 3 <= k < 6:
        p, q = (k - 2) % 3, (k - 1) % 3  # e_k x e_p = e_q
        for b in range(3):
            twin.A[q, b] += EPSILON * 1j * here.A[p, b]
            twin.A[p, b] -= EPSILON * 1j * here.A[q, b]


@kernel
def step(here: Any, twin: Any, k: int, c1: float) -> None:
    """A body after an imaginary unit motion k, with c1 times the velocity along it, and no force on it."""
    displace(here, twin, k)
    for j in range(6):
        twin.Y[j] = here.Y[j] + (c1 * EPSILON * 1j if j == k else 0.0)
        twin.F[j] = 0.0
