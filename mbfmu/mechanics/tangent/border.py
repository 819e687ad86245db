"""Bodies that loads tie to many groups at once, such as a free roller that rubs on a mesh: a border of T.

Such a body is in no cell's group, and what is between it and the others, u in its column and w in its row, is not in
the blocks. With e . dq (e: n) its coordinate, or one of its six motions where its parent moves, T + sum (u e^T + e w^T)
is solved by the factors of T (Woodbury):

    x = T^-1 (b - sum (u p + e s)),    p = e . x,  s = w . x,    two equations for each.

Without it a mesh and its free rollers are hardly moved as one by a correction: friction holds each as if the other
were at rest, and what is left of such a motion looks small to who weighs it by T.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.spatial import add_wrench, row_dot6
from solvers.compiled.kernel import kernel
from solvers.system import Array

from .layout import FIXED, Layout

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.factored import TangentScratch
    from solvers.compiled.record import Reals


class Border(NamedTuple):
    """Columns of r coordinates or motions."""

    bodies: NDArray[np.int64]  # (r,) whose they are
    motions: NDArray[np.int64]  # (r,) which of six; -1: its coordinate
    lines: Array  # (2 r, n) e, then w
    columns: Array  # (2 r, n) T^-1 u, then T^-1 e
    inverse: Array  # (2 r, 2 r) of the equations
    right: Array  # (2 r,)

    @staticmethod
    def of(layout: Layout, n: int) -> Border:
        """Return the border of a layout."""
        r, z = int(layout.columns.sum()), np.zeros
        bodies, motions = z(r, np.int64), np.full(r, -1)
        for i in np.flatnonzero(layout.columns):
            own = slice(layout.column[i], layout.column[i] + layout.columns[i])
            bodies[own] = i
            if layout.columns[i] == 6:
                motions[own] = range(6)
        return Border(bodies, motions, z((2 * r, n)), z((2 * r, n)), z((2 * r, 2 * r)), z(2 * r))


@kernel
def store_coupling(
    first: int, end: int, group: int, inner: int, layout: Layout, arrays: Arrays, state: State, scratch: TangentScratch
) -> None:
    """Add the entries of scratch.K between bodies of a group or its neighbor and bodies away from it to
    scratch.coupling_block, as wrenches.
    """
    for p in range(end - first):
        i = layout.bodies[first + p]
        k = layout.column[i]
        if k < 0 or layout.group[i] == group or layout.group[i] == inner:
            continue
        S = state.S[arrays.bodies[i].vi]
        for q in range(end - first):
            j = layout.bodies[first + q]
            if layout.role[j] == FIXED or (layout.group[j] != group and layout.group[j] != inner):
                continue
            for a in range(6):
                for b in range(6):
                    column, part = (k, S[b]) if layout.columns[i] == 1 else (k + b, 1.0)
                    scratch.coupling_block[column, 0, j, a] += scratch.K[6 * q + a, 6 * p + b] * part
                    scratch.coupling_block[column, 1, j, a] += scratch.K[6 * p + b, 6 * q + a] * part


@kernel
def project_wrenches(W: Reals, arrays: Arrays, state: State, out: Reals) -> None:
    """out (n,) <- joint forces that wrenches W (nb, 6) on bodies are worth; W is spent."""
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        body, here = arrays.bodies[i], state.bodies[i]
        if body.vf >= 0:
            for k in range(body.nv):
                out[body.vf + k] = row_dot6(state.S, body.vi + k, W[i])
        if body.parent > 0:
            parent = state.bodies[body.parent]
            add_wrench(W[body.parent], here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2], W[i])


@kernel
def add_border(border: Border, x: Reals) -> None:
    """x (n,), a solution of T alone, <- that of T with its border."""
    count, n = border.right.shape[0], x.shape[0]
    for k in range(count):
        total = 0.0
        for i in range(n):
            total += border.lines[k, i] * x[i]
        border.right[k] = total
    for k in range(count):
        part = 0.0
        for j in range(count):
            part += border.inverse[k, j] * border.right[j]
        for i in range(n):
            x[i] -= part * border.columns[k, i]
