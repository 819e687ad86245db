"""How the forces of a cut joint change with the motions of its two bodies, for :mod:`mbfmu.mechanics.tangent`."""

from __future__ import annotations

from typing import Any

from solvers.kernel import kernel

from . import close

EPSILON = 1e-30  # of the complex step


@kernel
def stiffness(cut: Any, end: int, kept: Any, weight: Any, state: Any, twins: Any, rows: Any, K: Any) -> None:
    """K (12, 12) = sum over the rows of lambda dG + weight G G^T, G = (Ga, Gb), six rows and columns a body.

    lambda dG is what the reactions gain as the bodies move, weight G G^T a spring that holds the row.
    ``end`` is the row after the last, ``weight`` (m,) by constraint; ``twins`` (2,) and ``rows`` are complex scratch.
    """
    A, B = state.bodies[cut.a], state.bodies[cut.b]
    for i in range(12):
        for j in range(12):
            K[i, j] = 0.0
    for r in range(cut.row, end):
        if kept[r] >= 0:
            for i in range(12):
                for j in range(12):
                    K[i, j] += weight[kept[r]] * wrench(state.rows[r], i) * wrench(state.rows[r], j)
    for j in range(12):
        displace(A, twins[0], j)
        displace(B, twins[1], j - 6)
        close(cut, twins[0], twins[1], rows)
        for r in range(cut.row, end):
            if kept[r] >= 0:
                for i in range(12):
                    K[i, j] += state.rows[r].lam * wrench(rows[r], i).imag / EPSILON


@kernel
def wrench(row: Any, i: int) -> Any:
    """Component i of (Ga, Gb)."""
    return row.Ga[i] if i < 6 else row.Gb[i - 6]


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
