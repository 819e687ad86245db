"""How the efforts of a coupling change with the motions of the bodies whose joints it ties."""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import kernel

from .joints import dual_basis


@kernel
def stiffness(c: int, arrays: Any, state: Any, dual: Any, s: Any) -> None:
    """s.K (24, 24) = alpha w w^T - lambda f'' w_b w_b^T of a coupling; six rows and columns a body: a, its parent, b,
    its parent.

    w = w_a - f' w_b is its row of J over their motions, w_a and w_b what the two coordinates do; alpha, s.weight, is a
    spring that holds it, -lambda f'' what the effort f' lambda along the second coordinate gains.
    """
    coupling, here = arrays.couplings[c], state.coupled[c]
    for i in range(24):
        s.pair[i] = 0.0
        for j in range(24):
            s.K[i, j] = 0.0
    row = arrays.kept[coupling.row]
    if row < 0:
        return
    if coupling.fa >= 0:
        measure(coupling.a, coupling.va, 0, arrays, state, dual, s)
    if coupling.fb >= 0:
        measure(coupling.b, coupling.vb, 12, arrays, state, dual, s)
    bend = here.lam * here.bend
    for i in range(24):
        wi = s.pair[i] if i < 12 else -here.slope * s.pair[i]
        for j in range(24):
            wj = s.pair[j] if j < 12 else -here.slope * s.pair[j]
            s.K[i, j] = s.weight[row] * wi * wj
            if i >= 12 and j >= 12:
                s.K[i, j] -= bend * s.pair[i] * s.pair[j]


@kernel
def measure(i: int, v: int, at: int, arrays: Any, state: Any, dual: Any, s: Any) -> None:
    """s.pair (12 from ``at`` on): change of coordinate v of body i's joint over the motions of the body and its parent:
    d . (y_i - X y_j), d from the dual basis of the joint's subspace.
    """
    body = arrays.bodies[i]
    here, parent = state.bodies[i], state.bodies[body.parent]
    dual_basis(state.S, body.vi, body.nv, dual, s.N)
    d = dual[v]
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    for k in range(6):
        s.pair[at + k], s.pair[at + 6 + k] = d[k], -d[k]
    s.pair[at + 9] -= y * d[2] - z * d[1]
    s.pair[at + 10] -= z * d[0] - x * d[2]
    s.pair[at + 11] -= x * d[1] - y * d[0]
