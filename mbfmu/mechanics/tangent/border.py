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
    from mbfmu.mechanics.tangent.assembly import TangentScratch
    from solvers.compiled.record import Reals


class Border(NamedTuple):
    """Columns of r coordinates or motions."""

    bodies: NDArray[np.int64]  # (r,) whose they are
    motions: NDArray[np.int64]  # (r,) which of six; -1: its coordinate
    lines: Array  # (2 r, n) e, then w
    loads: Array  # (r, n) u
    columns: Array  # (2 r, n) T^-1 u, then T^-1 e
    equations: Array  # (2 r, 2 r)
    units: Array  # (2 r,) which balance them
    inverse: Array  # (2 r, 2 r) of the equations
    scratch: Array  # (2 r, 2 r)
    order: NDArray[np.int64]  # (2 r,) scratch
    right: Array  # (2 r,)
    wrenches: Array  # (nb, 6) scratch

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
        square, nb = (2 * r, 2 * r), len(layout.columns) if r else 0
        return Border(
            bodies, motions, z((2 * r, n)), z((r, n)), z((2 * r, n)), z(square), z(2 * r), z(square), z(square),
            z(2 * r, np.int64), z(2 * r), z((nb, 6)),
        )  # fmt: skip


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
def project_border(coupling_block: Reals, arrays: Arrays, state: State, border: Border) -> None:
    """Fill the lines and loads of the border from the wrenches of the couplings, which are spent."""
    r, n, wrenches = border.bodies.shape[0], border.lines.shape[1], border.wrenches
    for k in range(r):
        i, moves = border.bodies[k], False
        for column in range(n):
            border.lines[k, column] = 0.0
        if border.motions[k] < 0:
            border.lines[k, arrays.bodies[i].vf] = 1.0
        else:
            for body in range(wrenches.shape[0]):
                for a in range(6):
                    wrenches[body, a] = 1.0 if body == i and a == border.motions[k] else 0.0
            project_wrenches(wrenches, arrays, state, border.lines[k])
        project_wrenches(coupling_block[k, 0], arrays, state, border.loads[k])
        project_wrenches(coupling_block[k, 1], arrays, state, border.lines[r + k])
        for column in range(n):
            moves = moves or border.lines[k, column] != 0.0
        for column in range(n if not moves else 0):  # a motion that the body does not have
            border.loads[k, column], border.lines[r + k, column] = 0.0, 0.0


@kernel
def set_equations(border: Border) -> None:
    """Fill the equations and their units, from the solutions for the loads and for the lines e."""
    count, n = border.right.shape[0], border.lines.shape[1]
    r = count // 2
    for a in range(count):
        for b in range(count):
            total = 1.0 if a == b else 0.0
            for i in range(n):
                total += border.lines[a, i] * border.columns[b, i]
            border.equations[a, b] = total
    for k in range(r):
        own = abs(border.equations[k, r + k])  # of a coordinate alone, one over its stiffness
        border.units[k], border.units[r + k] = 1.0, own if own > 0.0 else 1.0


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
