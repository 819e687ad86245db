"""What joints contribute to the structured tangent: they turn while they transmit wrenches, and lock directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.dispatch import place_child
from mbfmu.mechanics.recursions.dynamics import rotate_quaternion
from mbfmu.mechanics.spatial import multiply
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE
from solvers.compiled.kernel import kernel

from .layout import FIXED, INNER

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from mbfmu.mechanics.tangent.assembly import TangentScratch
    from mbfmu.mechanics.tangent.layout import Layout
    from solvers.compiled.record import Reals


@kernel
def geometric_stiffness(i: int, arrays: Arrays, state: State, perturbed: State, scratch: TangentScratch) -> None:
    """scratch.g (nv, 3) and scratch.G (nv, nv): change of the joint's S^T W with the parent's rotation and with its own
    positions, with the stiffness along its coordinates, scratch.along.

    The subspace turns with the parent, dS = dphi x S; its change in the joint is a complex step of the joint's kernel.
    """
    body, W = arrays.bodies[i], state.bodies[i].W
    multiply(state.bodies[body.parent].A, body.R, scratch.C)
    for k in range(body.nv):
        S = state.S[body.vi + k]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            scratch.g[k, a] = S[b] * W[c] - S[c] * W[b] + S[3 + b] * W[3 + c] - S[3 + c] * W[3 + b]
    C = scratch.C
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
            perturbed.q[body.qi + l] += COMPLEX_STEP_SIZE * 1j
        else:
            for k in range(3):
                scratch.turn[k] = COMPLEX_STEP_SIZE * 1j if k == l - plain else 0.0
            rotate_quaternion(perturbed.q, body.qi + plain, scratch.turn, 0)
        place_child(body, arrays, perturbed)
        for k in range(body.nq):
            perturbed.q[body.qi + k] = state.q[body.qi + k]
        S = perturbed.rel[0].S
        for k in range(body.nv):
            total = 0.0
            for a in range(3):
                total += S[k, a].imag * pull[a] + S[k, 3 + a].imag * twist[a]
            scratch.G[k, l] = total / COMPLEX_STEP_SIZE
        scratch.G[l, l] += scratch.along[body.vi + l]


@kernel
def dual_basis(S: Reals, vi: int, nv: int, dual: Reals, N: Reals) -> None:
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
def add_moment_arm_stiffness(i: int, ati: int, atj: int, arrays: Arrays, state: State, F: Reals) -> None:
    """The moment arm of the wrench a joint transmits to the parent: (dr_i - dr_j) x force."""
    W = state.bodies[i].W
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3  # (dr x f)_a = dr_b f_c - dr_c f_b
        F[atj + 3 + a, ati + b] += W[c]
        F[atj + 3 + a, ati + c] -= W[b]
        F[atj + 3 + a, atj + b] -= W[c]
        F[atj + 3 + a, atj + c] += W[b]


@kernel
def add_outer_joint(
    i: int,
    ati: int,
    atj: int,
    lock: int,
    arrays: Arrays,
    state: State,
    perturbed: State,
    dual: Reals,
    F: Reals,
    scratch: TangentScratch,
) -> None:
    """Rows and columns of an outer body's joint: what it locks, and its turning along its own directions."""
    body = arrays.bodies[i]
    nv = body.nv if body.vf >= 0 else 0
    here, parent = state.bodies[i], state.bodies[body.parent]
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    dual_basis(state.S, body.vi, nv, dual, scratch.N)
    for r in range(6 - nv):
        n = scratch.N[r]
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
    geometric_stiffness(i, arrays, state, perturbed, scratch)
    for k in range(nv):  # one joint row at a time: L_k (g_k . dphi_j + sum_l G_kl L_l . (y_i - X y_j))
        for a in range(6):
            scratch.row[a] = 0.0
        for l in range(nv):
            for a in range(6):
                scratch.row[a] += scratch.G[k, l] * dual[body.vi + l, a]
        w = scratch.row
        tx, ty, tz = y * w[2] - z * w[1], z * w[0] - x * w[2], x * w[1] - y * w[0]
        for a in range(6):
            scratch.row[6 + a] = -w[a]
        scratch.row[9] += scratch.g[k, 0] - tx
        scratch.row[10] += scratch.g[k, 1] - ty
        scratch.row[11] += scratch.g[k, 2] - tz
        d = dual[body.vi + k]
        dx, dy, dz = y * d[2] - z * d[1], z * d[0] - x * d[2], x * d[1] - y * d[0]
        for c in range(12):
            at = ati + c if c < 6 else atj + c - 6
            for a in range(6):
                F[ati + a, at] += d[a] * scratch.row[c]
                F[atj + a, at] -= d[a] * scratch.row[c]
            F[atj + 3, at] -= dx * scratch.row[c]
            F[atj + 4, at] -= dy * scratch.row[c]
            F[atj + 5, at] -= dz * scratch.row[c]


@kernel
def add_parent_geometric_stiffness(
    group: int, layout: Layout, arrays: Arrays, state: State, perturbed: State, F: Reals, scratch: TangentScratch
) -> None:
    """Add the turning of a group's inner joints by their parents, before columns are condensed."""
    for m in range(layout.first[group], layout.first[group + 1]):
        i = layout.members[m]
        body = arrays.bodies[i]
        if layout.role[i] == INNER and body.vf >= 0 and layout.role[body.parent] != FIXED:
            geometric_stiffness(i, arrays, state, perturbed, scratch)
            for k in range(body.nv):
                for a in range(3):
                    F[layout.slot[i] + k, layout.slot[body.parent] + 3 + a] += scratch.g[k, a]


@kernel
def add_own_geometric_stiffness(
    group: int, layout: Layout, arrays: Arrays, state: State, perturbed: State, columns: Reals, scratch: TangentScratch
) -> None:
    """Add the turning of a group's inner joints by their own positions, after that, to what is kept, by columns."""
    for m in range(layout.first[group], layout.first[group + 1]):
        i = layout.members[m]
        body = arrays.bodies[i]
        if layout.role[i] == INNER and body.vf >= 0:
            geometric_stiffness(i, arrays, state, perturbed, scratch)
            for k in range(body.nv):
                for l in range(body.nv):
                    columns[layout.kept[i] + l, layout.kept[i] + k] += scratch.G[k, l]
