"""Recursions of the structured tangent: rows and columns condensed onto parents, loads spread inward, motions gathered
outward, and M a.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mbfmu.mechanics.spatial import add_wrench, row_dot6, shift_motion
from solvers.compiled.kernel import inlined, kernel

from .layout import FIXED, INNER, OUTER

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.layout import Layout
    from solvers.compiled.record import Reals


@inlined
def add_row(x: Reals, y: Reals) -> None:
    """y += x."""
    for c in range(y.shape[0]):
        y[c] += x[c]


@inlined
def add_moment(m: Reals, y: float, z: float, fy: Reals, fz: Reals, out: Reals) -> None:
    """out += m + y fz - z fy: one axis of a moment about another point."""
    for c in range(out.shape[0]):
        out[c] += m[c] + y * fz[c] - z * fy[c]


@inlined
def combine(s: Reals, f: Reals, out: Reals) -> None:
    """out <- s . f, of six rows f."""
    f0, f1, f2, f3, f4, f5 = f
    s0, s1, s2, s3, s4, s5 = s[0], s[1], s[2], s[3], s[4], s[5]
    for c in range(out.shape[0]):
        out[c] = s0 * f0[c] + s1 * f1[c] + s2 * f2[c] + s3 * f3[c] + s4 * f4[c] + s5 * f5[c]


@inlined
def six_rows(F: Reals, i: int, begin: int, end: int) -> Any:
    """Rows i to i + 5 of F, these columns."""
    return (
        F[i, begin:end], F[i + 1, begin:end], F[i + 2, begin:end],
        F[i + 3, begin:end], F[i + 4, begin:end], F[i + 5, begin:end],
    )  # fmt: skip


@kernel
def shift_rows(F: Reals, i: int, j: int, begin: int, end: int, x: float, y: float, z: float) -> None:
    """Rows of a wrench at body i's slot, added at body j's: X^T, with (x, y, z) from j to i."""
    f, out = six_rows(F, i, begin, end), six_rows(F, j, begin, end)
    for k in range(3):
        add_row(f[k], out[k])
    add_moment(f[3], y, z, f[1], f[2], out[3])
    add_moment(f[4], z, x, f[2], f[0], out[4])
    add_moment(f[5], x, y, f[0], f[1], out[5])


@kernel
def project_rows(F: Reals, i: int, begin: int, end: int, S: Reals, vi: int, nv: int) -> None:
    """Rows at slot i <- S^T rows: the first nv of the six."""
    f, projected = six_rows(F, i, begin, end), six_rows(F, F.shape[0] - 6, begin, end)
    for k in range(nv):
        combine(S[vi + k], f, projected[k])
    for k in range(nv):
        for c in range(end - begin):
            f[k][c] = projected[k][c]


@kernel
def condense(
    F: Reals, offset: int, begin: int, end: int, group: int, layout: Layout, arrays: Arrays, state: State
) -> None:
    """Condense a group's inner bodies onto their parents: rows of F from ``offset`` on, columns ``begin`` to ``end``.

    The last six rows of F are scratch. Columns are condensed as rows of the transpose.
    """
    for m in range(layout.first[group + 1] - 1, layout.first[group] - 1, -1):
        i = layout.members[m]
        if layout.role[i] != INNER:
            continue
        body = arrays.bodies[i]
        j = body.parent
        here, parent = state.bodies[i], state.bodies[j]
        if layout.role[j] != FIXED:
            x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
            shift_rows(F, offset + layout.slot[i], offset + layout.slot[j], begin, end, x, y, z)
        project_rows(F, offset + layout.slot[i], begin, end, state.S, body.vi, body.nv if body.vf >= 0 else 0)


@kernel
def spread_load(r: Reals, base: Reals, layout: Layout, arrays: Arrays, state: State, dual: Reals, b: Reals) -> None:
    """b: joint forces r (n,) as wrenches where a joint is outer, condensed, then as they are where it is inner.

    Its last six rows are scratch.
    """
    for i in range(b.shape[0]):
        b[i] = 0.0
    for m in range(layout.members.shape[0]):
        i = layout.members[m]
        body = arrays.bodies[i]
        if layout.role[i] != OUTER or body.vf < 0:
            continue
        here, parent = state.bodies[i], state.bodies[body.parent]
        x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
        ati, atj = base[layout.group[i]] + layout.slot[i], base[layout.group[body.parent]] + layout.slot[body.parent]
        for k in range(body.nv):
            d, load = dual[body.vi + k], r[body.vf + k]
            for a in range(6):
                b[ati + a] += d[a] * load
                b[atj + a] -= d[a] * load
            b[atj + 3] -= (y * d[2] - z * d[1]) * load
            b[atj + 4] -= (z * d[0] - x * d[2]) * load
            b[atj + 5] -= (x * d[1] - y * d[0]) * load
    for group in range(layout.first.shape[0] - 1):
        condense_load(r, base[group], group, layout, arrays, state, b)


@kernel
def condense_load(r: Reals, base: int, group: int, layout: Layout, arrays: Arrays, state: State, b: Reals) -> None:
    """Condense the wrenches on the inner bodies of a group, and add the forces of their joints."""
    scratch = b.shape[0] - 6
    for m in range(layout.first[group + 1] - 1, layout.first[group] - 1, -1):
        i = layout.members[m]
        if layout.role[i] != INNER:
            continue
        body = arrays.bodies[i]
        at, here, parent = base + layout.slot[i], state.bodies[i], state.bodies[body.parent]
        f = b[at : at + 6]
        if layout.role[body.parent] != FIXED:
            to = base + layout.slot[body.parent]
            x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
            add_wrench(b[to : to + 6], x, y, z, f)
        if body.vf >= 0:
            for k in range(body.nv):
                b[scratch + k] = r[body.vf + k] + row_dot6(state.S, body.vi + k, f)
            for k in range(body.nv):
                f[k] = b[scratch + k]


@kernel
def gather_motion(
    x: Reals, base: Reals, layout: Layout, arrays: Arrays, state: State, dual: Reals, Y: Reals, dq: Reals
) -> None:
    """dq (n,) from the solution x, by an outward pass through the motions Y (nb, 6) of all bodies."""
    for i in range(1, arrays.bodies.shape[0]):
        if layout.role[i] == FIXED:
            continue
        body = arrays.bodies[i]
        here, parent, Yi, Yj = state.bodies[i], state.bodies[body.parent], Y[i], Y[body.parent]
        at = base[layout.group[i]] + layout.slot[i]
        for a in range(6):
            Yi[a] = Yj[a]
        shift_motion(here, parent, Yj, Yi)
        if layout.role[i] == OUTER:
            if body.vf >= 0:
                for k in range(body.nv):
                    total = 0.0
                    for a in range(6):
                        total += dual[body.vi + k, a] * (x[at + a] - Yi[a])
                    dq[body.vf + k] = total
            for a in range(6):
                Yi[a] = x[at + a]
        elif body.vf >= 0:
            for k in range(body.nv):
                dq[body.vf + k] = x[at + k]
                for a in range(6):
                    Yi[a] += state.S[body.vi + k, a] * x[at + k]


@kernel
def inertia_forces(arrays: Arrays, state: State, a: Reals, tau: Reals) -> None:
    """tau (n,) = M a, positions as they are: the recursions with velocities and gravity left out."""
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        parent = state.bodies[body.parent]
        dY, W, c, m = here.dY, here.W, here.com, body.mass
        for k in range(6):
            dY[k] = parent.dY[k] if body.parent > 0 else 0.0
        if body.parent > 0:
            shift_motion(here, parent, parent.dY, dY)
        if body.vf >= 0:
            for k in range(body.nv):
                for e in range(6):
                    dY[e] += state.S[body.vi + k, e] * a[body.vf + k]
        W[0] = m * (dY[0] + dY[4] * c[2] - dY[5] * c[1])
        W[1] = m * (dY[1] + dY[5] * c[0] - dY[3] * c[2])
        W[2] = m * (dY[2] + dY[3] * c[1] - dY[4] * c[0])
        for k in range(3):
            W[3 + k] = here.Jc[k, 0] * dY[3] + here.Jc[k, 1] * dY[4] + here.Jc[k, 2] * dY[5]
        W[3] += c[1] * W[2] - c[2] * W[1]
        W[4] += c[2] * W[0] - c[0] * W[2]
        W[5] += c[0] * W[1] - c[1] * W[0]
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        body, here = arrays.bodies[i], state.bodies[i]
        if body.vf >= 0:
            for k in range(body.nv):
                tau[body.vf + k] = row_dot6(state.S, body.vi + k, here.W)
            if body.armature != 0.0:
                tau[body.vf] += body.armature * a[body.vf]
        if body.parent > 0:
            parent = state.bodies[body.parent]
            add_wrench(parent.W, here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2], here.W)
    for k in range(a.shape[0] - arrays.world[0].states, a.shape[0]):
        tau[k] = a[k]
