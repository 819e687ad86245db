"""How the forces of a cut joint change with the motions of its two bodies: by complex steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.dispatch import evaluate_cut
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, displace
from solvers.compiled.kernel import kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, CutRecord, RowRecord, State
    from solvers.compiled.record import Reals


@kernel
def stiffness(cut: CutRecord, weight: Reals, arrays: Arrays, state: State, perturbed: State, K: Reals) -> None:
    """K (12, 12) = sum over the rows of lambda dG + weight G G^T, G = (Ga, Gb), six rows and columns a body.

    lambda dG is what the reactions gain as the bodies move, weight G G^T a spring that holds the row. ``weight`` (m,)
    is by constraint; ``perturbed`` is a complex state, scratch.
    """
    kept, bodies = arrays.kept, state.bodies
    for i in range(12):
        for j in range(12):
            K[i, j] = 0.0
    for r in range(cut.row, cut.end):
        if kept[r] >= 0:
            for i in range(12):
                for j in range(12):
                    K[i, j] += weight[kept[r]] * wrench(state.rows[r], i) * wrench(state.rows[r], j)
    for j in range(12):
        displace(bodies[cut.a], perturbed.bodies[cut.a], j)
        displace(bodies[cut.b], perturbed.bodies[cut.b], j - 6)
        evaluate_cut(cut, arrays, perturbed)
        for r in range(cut.row, cut.end):
            if kept[r] >= 0:
                for i in range(12):
                    K[i, j] += state.rows[r].lam * wrench(perturbed.rows[r], i).imag / COMPLEX_STEP_SIZE


@kernel
def wrench(row: RowRecord, i: int) -> Any:
    """Component i of (Ga, Gb)."""
    return row.Ga[i] if i < 6 else row.Gb[i - 6]
