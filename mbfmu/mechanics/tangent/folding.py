"""Recursions of the structured tangent: rows and columns folded onto parents, loads spread inward, motions gathered
outward, and M a.
"""

from __future__ import annotations

from typing import Any

from mbfmu.mechanics.spatial import add_wrench, row_dot6, shift_motion
from solvers.compiled.kernel import kernel

from .layout import FIXED, INNER, OUTER


@kernel
def shift_rows(F: Any, i: int, j: int, x: float, y: float, z: float) -> None:
    """Rows of a wrench at body i's slot, added at body j's: X^T, with (x, y, z) from j to i."""
    for c in range(F.shape[1]):
        f0, f1, f2 = F[i, c], F[i + 1, c], F[i + 2, c]
        F[j, c] += f0
        F[j + 1, c] += f1
        F[j + 2, c] += f2
        F[j + 3, c] += F[i + 3, c] + y * f2 - z * f1
        F[j + 4, c] += F[i + 4, c] + z * f0 - x * f2
        F[j + 5, c] += F[i + 5, c] + x * f1 - y * f0


@kernel
def project_rows(F: Any, i: int, S: Any, vi: int, nv: int) -> None:
    """Rows at slot i <- S^T rows: the first nv of the six."""
    for c in range(F.shape[1]):
        f0, f1, f2, f3, f4, f5 = F[i, c], F[i + 1, c], F[i + 2, c], F[i + 3, c], F[i + 4, c], F[i + 5, c]
        for k in range(nv):
            s = S[vi + k]
            F[i + k, c] = s[0] * f0 + s[1] * f1 + s[2] * f2 + s[3] * f3 + s[4] * f4 + s[5] * f5


@kernel
def fold(F: Any, offset: int, group: int, L: Any, arrays: Any, state: Any) -> None:
    """Fold the inner bodies of a group onto their parents: rows of F from ``offset`` on; columns by the transpose."""
    for m in range(L.first[group + 1] - 1, L.first[group] - 1, -1):
        i = L.members[m]
        if L.role[i] != INNER:
            continue
        body = arrays.bodies[i]
        j = body.parent
        here, parent = state.bodies[i], state.bodies[j]
        if L.role[j] != FIXED:
            x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
            shift_rows(F, offset + L.slot[i], offset + L.slot[j], x, y, z)
        project_rows(F, offset + L.slot[i], state.S, body.vi, body.nv if body.vf >= 0 else 0)


@kernel
def spread_load(r: Any, base: Any, L: Any, arrays: Any, state: Any, dual: Any, b: Any) -> None:
    """b: joint forces r (n, columns) as wrenches where a joint is outer, folded, then as they are where it is inner."""
    for m in range(L.members.shape[0]):
        i = L.members[m]
        body = arrays.bodies[i]
        if L.role[i] != OUTER or body.vf < 0:
            continue
        here, parent = state.bodies[i], state.bodies[body.parent]
        x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
        ati, atj = base[L.group[i]] + L.slot[i], base[L.group[body.parent]] + L.slot[body.parent]
        for k in range(body.nv):
            d = dual[body.vi + k]
            for c in range(r.shape[1]):
                load = r[body.vf + k, c]
                for a in range(6):
                    b[ati + a, c] += d[a] * load
                    b[atj + a, c] -= d[a] * load
                b[atj + 3, c] -= (y * d[2] - z * d[1]) * load
                b[atj + 4, c] -= (z * d[0] - x * d[2]) * load
                b[atj + 5, c] -= (x * d[1] - y * d[0]) * load
    for group in range(L.first.shape[0] - 1):
        fold(b, base[group], group, L, arrays, state)
    for m in range(L.members.shape[0]):
        i = L.members[m]
        body = arrays.bodies[i]
        if L.role[i] == INNER and body.vf >= 0:
            for k in range(body.nv):
                for c in range(r.shape[1]):
                    b[base[L.group[i]] + L.slot[i] + k, c] += r[body.vf + k, c]


@kernel
def gather_motion(x: Any, c: int, base: Any, L: Any, arrays: Any, state: Any, dual: Any, Y: Any, dq: Any) -> None:
    """dq[:, c] from the solution x[:, c], by an outward pass through the motions Y (nb, 6) of all bodies."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        here, parent = state.bodies[i], state.bodies[body.parent]
        Yj = Y[body.parent]
        for a in range(6):
            Y[i, a] = Yj[a]
        shift_motion(here, parent, Yj, Y[i])
        if L.role[i] == FIXED:
            continue
        at = base[L.group[i]] + L.slot[i]
        if L.role[i] == OUTER:
            if body.vf >= 0:
                for k in range(body.nv):
                    dq[body.vf + k, c] = 0.0
                    for a in range(6):
                        dq[body.vf + k, c] += dual[body.vi + k, a] * (x[at + a, c] - Y[i, a])
            for a in range(6):
                Y[i, a] = x[at + a, c]
        elif body.vf >= 0:
            for k in range(body.nv):
                dq[body.vf + k, c] = x[at + k, c]
                for a in range(6):
                    Y[i, a] += state.S[body.vi + k, a] * x[at + k, c]


@kernel
def inertia_forces(arrays: Any, state: Any, a: Any, tau: Any) -> None:
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
        if body.parent > 0:
            parent = state.bodies[body.parent]
            add_wrench(parent.W, here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2], here.W)
