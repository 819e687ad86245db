"""What joints contribute to the structured tangent: they turn while they transmit wrenches, and lock directions."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics.dispatch import place_child
from mbfmu.mechanics.recursions.dynamics import rotate_quaternion
from mbfmu.mechanics.spatial import multiply
from mbfmu.mechanics.steps import EPSILON
from solvers.compiled.kernel import kernel

from .layout import FIXED, INNER


@kernel
def turning(i: int, arrays: Any, state: Any, twin: Any, s: Any) -> None:
    """s.g (nv, 3) and s.G (nv, nv): change of the joint's S^T W with the parent's rotation and with its own positions,
    with the stiffness along its coordinates, s.along.

    The subspace turns with the parent, dS = dphi x S; its change in the joint is a complex step of the joint's kernel.
    """
    body, W = arrays.bodies[i], state.bodies[i].W
    multiply(state.bodies[body.parent].A, body.R, s.C)
    for k in range(body.nv):
        S = state.S[body.vi + k]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            s.g[k, a] = S[b] * W[c] - S[c] * W[b] + S[3 + b] * W[3 + c] - S[3 + c] * W[3 + b]
    C = s.C
    pull = (
        C[0, 0] * W[0] + C[1, 0] * W[1] + C[2, 0] * W[2],
        C[0, 1] * W[0] + C[1, 1] * W[1] + C[2, 1] * W[2],
        C[0, 2] * W[0] + C[1, 2] * W[1] + C[2, 2] * W[2],
    )
    twist = (
        C[0, 0] * W[3] + C[1, 0] * W[4] + C[2, 0] * W[5],
        C[0, 1] * W[3] + C[1, 1] * W[4] + C[2, 1] * W[5],
        C[0, 2] * W[3] + C[1, 2] * W[4] + C[2, 2] * W[5],
    )
    plain = body.nq - 4 * body.quaternion
    for l in range(body.nv):
        if l < plain:
            twin.q[body.qi + l] += EPSILON * 1j
        else:
            for k in range(3):
                s.turn[k] = EPSILON * 1j if k == l - plain else 0.0
            rotate_quaternion(twin.q, body.qi + plain, s.turn, 0)
        place_child(body, arrays, twin)
        for k in range(body.nq):
            twin.q[body.qi + k] = state.q[body.qi + k]
        for k in range(body.nv):
            total = 0.0
            for a in range(3):
                total += twin.rel[k, a].imag * pull[a] + twin.rel[k, 3 + a].imag * twist[a]
            s.G[k, l] = total / EPSILON
        s.G[l, l] += s.along[body.vi + l]


@kernel
def dual_basis(S: Any, vi: int, nv: int, dual: Any, N: Any) -> None:
    """dual[vi:vi + nv] spans S with dual_k . S_l = 1 or 0; the first 6 - nv rows of N are unit vectors normal to S.

    Gram and Schmidt: N holds the orthonormal rows of S last, where they are out of the way.
    """
    for k in range(6):
        best, longest = 0, -1.0
        if k < nv:
            best = k
        else:  # the unit vector furthest from what is there
            for e in range(6):
                rest = 1.0
                for r in range(k):
                    rest -= N[5 - r, e] * N[5 - r, e]
                if rest > longest:
                    best, longest = e, rest
        row = 5 - k
        for a in range(6):
            if k < nv:
                N[row, a] = S[vi + best, a]
            else:
                N[row, a] = 1.0 if a == best else 0.0
        for _ in range(2):
            for r in range(k):
                along = 0.0
                for a in range(6):
                    along += N[row, a] * N[5 - r, a]
                for a in range(6):
                    N[row, a] -= along * N[5 - r, a]
        square = 0.0
        for a in range(6):
            square += N[row, a] * N[row, a]
        for a in range(6):
            N[row, a] /= np.sqrt(square)
    for k in range(nv - 1, -1, -1):  # S_l = sum_k R_lk Q_k with R lower triangular: R^T dual = Q
        for a in range(6):
            dual[vi + k, a] = N[5 - k, a]
        for l in range(k + 1, nv):
            R = 0.0
            for a in range(6):
                R += S[vi + l, a] * N[5 - k, a]
            for a in range(6):
                dual[vi + k, a] -= R * dual[vi + l, a]
        R = 0.0
        for a in range(6):
            R += S[vi + k, a] * N[5 - k, a]
        for a in range(6):
            dual[vi + k, a] /= R


@kernel
def handed_down(i: int, ati: int, atj: int, arrays: Any, state: Any, F: Any) -> None:
    """The moment arm of the wrench a joint transmits to the parent: (dr_i - dr_j) x force."""
    W = state.bodies[i].W
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3  # (dr x f)_a = dr_b f_c - dr_c f_b
        F[atj + 3 + a, ati + b] += W[c]
        F[atj + 3 + a, ati + c] -= W[b]
        F[atj + 3 + a, atj + b] -= W[c]
        F[atj + 3 + a, atj + c] += W[b]


@kernel
def outer_joint(
    i: int, ati: int, atj: int, lock: int, arrays: Any, state: Any, twin: Any, dual: Any, F: Any, s: Any
) -> None:
    """Rows and columns of an outer body's joint: what it locks, and its turning along its own directions."""
    body = arrays.bodies[i]
    nv = body.nv if body.vf >= 0 else 0
    here, parent = state.bodies[i], state.bodies[body.parent]
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    dual_basis(state.S, body.vi, nv, dual, s.N)
    for r in range(6 - nv):
        n = s.N[r]
        for a in range(6):
            F[lock + r, ati + a] += n[a]
            F[ati + a, lock + r] += n[a]
            F[lock + r, atj + a] -= n[a]
            F[atj + a, lock + r] -= n[a]
        tx, ty, tz = y * n[2] - z * n[1], z * n[0] - x * n[2], x * n[1] - y * n[0]
        F[lock + r, atj + 3] -= tx
        F[lock + r, atj + 4] -= ty
        F[lock + r, atj + 5] -= tz
        F[atj + 3, lock + r] -= tx
        F[atj + 4, lock + r] -= ty
        F[atj + 5, lock + r] -= tz
    if nv == 0:
        return
    turning(i, arrays, state, twin, s)
    for k in range(nv):  # one joint row at a time: L_k (g_k . dphi_j + sum_l G_kl L_l . (y_i - X y_j))
        for a in range(6):
            s.row[a] = 0.0
        for l in range(nv):
            for a in range(6):
                s.row[a] += s.G[k, l] * dual[body.vi + l, a]
        w = s.row
        tx, ty, tz = y * w[2] - z * w[1], z * w[0] - x * w[2], x * w[1] - y * w[0]
        for a in range(6):
            s.row[6 + a] = -w[a]
        s.row[9] += s.g[k, 0] - tx
        s.row[10] += s.g[k, 1] - ty
        s.row[11] += s.g[k, 2] - tz
        d = dual[body.vi + k]
        dx, dy, dz = y * d[2] - z * d[1], z * d[0] - x * d[2], x * d[1] - y * d[0]
        for c in range(12):
            at = ati + c if c < 6 else atj + c - 6
            for a in range(6):
                F[ati + a, at] += d[a] * s.row[c]
                F[atj + a, at] -= d[a] * s.row[c]
            F[atj + 3, at] -= dx * s.row[c]
            F[atj + 4, at] -= dy * s.row[c]
            F[atj + 5, at] -= dz * s.row[c]


@kernel
def turn_with_parents(group: int, L: Any, arrays: Any, state: Any, twin: Any, F: Any, s: Any) -> None:
    """Add the turning of a group's inner joints by their parents, before columns are folded."""
    for m in range(L.first[group], L.first[group + 1]):
        i = L.members[m]
        body = arrays.bodies[i]
        if L.role[i] == INNER and body.vf >= 0 and L.role[body.parent] != FIXED:
            turning(i, arrays, state, twin, s)
            for k in range(body.nv):
                for a in range(3):
                    F[L.slot[i] + k, L.slot[body.parent] + 3 + a] += s.g[k, a]


@kernel
def turn_themselves(group: int, L: Any, arrays: Any, state: Any, twin: Any, columns: Any, s: Any) -> None:
    """Add the turning of a group's inner joints by their own positions, after that, to what is kept, by columns."""
    for m in range(L.first[group], L.first[group + 1]):
        i = L.members[m]
        body = arrays.bodies[i]
        if L.role[i] == INNER and body.vf >= 0:
            turning(i, arrays, state, twin, s)
            for k in range(body.nv):
                for l in range(body.nv):
                    columns[L.kept[i] + l, L.kept[i] + k] += s.G[k, l]
