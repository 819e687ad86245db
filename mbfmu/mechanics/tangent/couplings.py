"""How the efforts of a coupling change with the motions of the bodies whose joints it ties."""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .joints import dual_basis

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.assembly import TangentScratch
    from solvers.compiled.record import Reals


@kernel
def stiffness(c: int, arrays: Arrays, state: State, dual: Reals, scratch: TangentScratch) -> None:
    """scratch.K (24, 24) = alpha w w^T - lambda f'' w_b w_b^T of a coupling; six rows and columns a body: a, its
    parent, b, its parent.

    w = w_a - f' w_b is its row of J over their motions, w_a and w_b what the two coordinates do; alpha, scratch.weight,
    is a spring that holds it, -lambda f'' what the effort f' lambda along the second coordinate gains.
    """
    coupling, here = arrays.couplings[c], state.coupled[c]
    for i in range(24):
        scratch.pair[i] = 0.0
        for j in range(24):
            scratch.K[i, j] = 0.0
    row = arrays.kept[coupling.row]
    if row < 0:
        return
    if coupling.fa >= 0:
        coordinate_row(coupling.a, coupling.va, 0, arrays, state, dual, scratch)
    if coupling.fb >= 0:
        coordinate_row(coupling.b, coupling.vb, 12, arrays, state, dual, scratch)
    bend = here.lam * here.bend
    for i in range(24):
        wi = scratch.pair[i] if i < 12 else -here.slope * scratch.pair[i]
        for j in range(24):
            wj = scratch.pair[j] if j < 12 else -here.slope * scratch.pair[j]
            scratch.K[i, j] = scratch.weight[row] * wi * wj
            if i >= 12 and j >= 12:
                scratch.K[i, j] -= bend * scratch.pair[i] * scratch.pair[j]


@kernel
def coordinate_row(i: int, v: int, at: int, arrays: Arrays, state: State, dual: Reals, scratch: TangentScratch) -> None:
    """scratch.pair (12 from ``at`` on): change of coordinate v of body i's joint over the motions of the body and its
    parent: d . (y_i - X y_j), d from the dual basis of the joint's subspace.
    """
    body = arrays.bodies[i]
    here, parent = state.bodies[i], state.bodies[body.parent]
    dual_basis(state.S, body.vi, body.nv, dual, scratch.N)
    d = dual[v]
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    for k in range(6):
        scratch.pair[at + k], scratch.pair[at + 6 + k] = d[k], -d[k]
    scratch.pair[at + 9] -= y * d[2] - z * d[1]
    scratch.pair[at + 10] -= z * d[0] - x * d[2]
    scratch.pair[at + 11] -= x * d[1] - y * d[0]
