"""The linearised equations of motion of a large tree, assembled and solved in O(n): no matrix over all bodies.

For changes of the joint positions dq, of the velocities c1 dq and of the accelerations c2 dq, the change of the inverse
dynamics is d tau = T dq. T is dense in joint coordinates, because a joint moves everything beyond it. In the motions
y_i = (dr_i, dphi_i) of the bodies it is sparse: a plate element ties four of them, a joint two. With B y-columns of the
tree (y_i = X y_j + S dq, the same shift as in the recursions),

    T = B^T (c2 M + c1 D + K) B + G,

K the tangents of elements and pressures, D of their damping, M the bodies' inertia at their origins, and G what comes
from turning the joints while they transmit the wrench W (S and X change with the position). Velocity products are left
out: exact at rest, and as a preconditioner at the speeds of a sheet.

A cut joint adds what its reactions gain as its bodies move, lambda dG, so that T is the derivative of h + J^T lambda.
Where asked for it adds springs that hold it: T + J^T alpha J, by which a saddle system is solved where T alone is
singular (:mod:`solvers.saddle`).

**Groups.** Every body belongs to a numbered group such that joints and elements span neighbouring groups at most: the
columns of a sheet's grid. Unknowns of a group: dq of joints whose parent is in the same group or fixed (inner), and of
every other body (outer) its motion y and the multipliers of the directions N its joint locks,
N^T (y_i - X y_j) = 0. Inner bodies are folded onto their parents by the recursion itself, rows and columns alike, as in
the composite-body algorithm. What is left is block-tridiagonal over the groups (:mod:`solvers.blocks`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.blocks import BlockTridiagonal, one_thread
from solvers.held import hold
from solvers.kernel import kernel
from solvers.system import Array

from .arrays import MOTION, ROW, Data, State, complex_records
from .cuts import tangent as cut_tangent
from .dynamics import turn_quaternion
from .elastic import pressure
from .elastic.tangent import damping, stiffness
from .joints import move
from .layout import FIXED, INNER, OUTER, lay_out
from .spatial import add_wrench, multiply, row_dot6

_pressure, _cut = pressure.stiffness, cut_tangent.stiffness
EPSILON = 1e-30  # of the complex step that differentiates a joint's motion subspace


class Scratch(NamedTuple):
    """Allocated once; W rows is twice the largest group."""

    F: Array  # (W, W)
    S: Array  # (3..6, 6) dual basis of one joint
    N: Array  # (6, 6) directions a joint locks, rows
    C: Array  # (3, 3)
    qc: NDArray[Any]  # (7,) complex joint position
    vc: NDArray[Any]  # (3,) complex rotation of a quaternion joint
    rel: NDArray[Any]  # (9, 6) complex
    G: Array  # (6, 6) joint rows by own coordinates
    g: Array  # (6, 3) joint rows by the parent's rotation
    row: Array  # (12,) one joint row over both bodies' motions
    K: Array  # (24, 24) stiffness of a plate element
    D: Array  # (24, 24) damping
    twins: NDArray[Any]  # (2,) complex MOTION, the bodies of a cut joint
    rows: NDArray[Any]  # (rows,) complex ROW
    weight: Array  # (m,) alpha


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
def bodily(i: int, at: int, c2: float, arrays: Any, state: Any, F: Any) -> None:
    """A body's own rows: c2 times its inertia about its origin, and its inertia force and weight turning with it."""
    mass, here = arrays.bodies[i].mass, state.bodies[i]
    c, Jc, dY = here.com, here.Jc, here.dY
    square = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
    for k in range(3):
        F[at + k, at + k] += c2 * mass
        F[at + 3 + k, at + 3 + k] += c2 * mass * square
        for j in range(3):
            F[at + 3 + k, at + 3 + j] += c2 * (Jc[k, j] - mass * c[k] * c[j])
    for k in range(3):
        p, q = (k + 1) % 3, (k + 2) % 3  # (c x)_pq = -c_k
        F[at + 3 + p, at + q] -= c2 * mass * c[k]
        F[at + 3 + q, at + p] += c2 * mass * c[k]
        F[at + p, at + 3 + q] += c2 * mass * c[k]
        F[at + q, at + 3 + p] -= c2 * mass * c[k]
    # d(c x f) = (dphi x c) x f = c (dphi.f) - dphi (c.f), f the inertia force less the weight
    f0 = mass * (dY[0] + dY[4] * c[2] - dY[5] * c[1])
    f1 = mass * (dY[1] + dY[5] * c[0] - dY[3] * c[2])
    f2 = mass * (dY[2] + dY[3] * c[1] - dY[4] * c[0])
    along = c[0] * f0 + c[1] * f1 + c[2] * f2
    for k in range(3):
        F[at + 3 + k, at + 3] += c[k] * f0
        F[at + 3 + k, at + 4] += c[k] * f1
        F[at + 3 + k, at + 5] += c[k] * f2
        F[at + 3 + k, at + 3 + k] -= along


@kernel
def turning(i: int, arrays: Any, state: Any, s: Any) -> None:
    """s.g (nv, 3) and s.G (nv, nv): change of the joint's S^T W with the parent's rotation and with its own positions.

    The subspace turns with the parent, dS = dphi x S; its change in the joint is a complex step of the joint's kernel.
    """
    body, W = arrays.bodies[i], state.bodies[i].W
    multiply(state.bodies[body.parent].A, body.R, s.C)
    for k in range(body.nv):
        S = state.S[body.vi + k]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            s.g[k, a] = S[b] * W[c] - S[c] * W[b] + S[3 + b] * W[3 + c] - S[3 + c] * W[3 + b]
    plain = body.nq - 4 * body.quaternion
    for l in range(body.nv):
        for k in range(body.nq):
            s.qc[k] = state.q[body.qi + k]
        if l < plain:
            s.qc[l] += EPSILON * 1j
        else:
            for k in range(3):
                s.vc[k] = EPSILON * 1j if k == l - plain else 0.0
            turn_quaternion(s.qc, plain, s.vc, 0)
        move(body.joint, body.axis, s.qc, 0, s.rel)
        for k in range(body.nv):
            total = 0.0
            for a in range(3):
                pull = s.C[0, a] * W[0] + s.C[1, a] * W[1] + s.C[2, a] * W[2]
                twist = s.C[0, a] * W[3] + s.C[1, a] * W[4] + s.C[2, a] * W[5]
                total += s.rel[k, a].imag * pull + s.rel[k, 3 + a].imag * twist
            s.G[k, l] = total / EPSILON


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
def outer_joint(i: int, ati: int, atj: int, lock: int, arrays: Any, state: Any, dual: Any, F: Any, s: Any) -> None:
    """Rows and columns of a joint between two groups: what it locks, and its turning along its own directions."""
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
    turning(i, arrays, state, s)
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
def plate_element(e: int, group: int, size: int, c1: float, L: Any, arrays: Any, state: Any, s: Any) -> None:
    """Stiffness and c1 times the damping of a plate element between bodies of a group and the next."""
    plate = arrays.plates[e]
    stiffness(plate, state.bodies, state.element[0], s.K)
    if plate.damped == 1 and c1 != 0.0:
        damping(plate, state.bodies, state.element[0], s.D)
        for row in range(24):
            for column in range(24):
                s.K[row, column] += c1 * s.D[row, column]
    add_element(plate.node, group, size, L, s)


@kernel
def pressed_surface(e: int, group: int, size: int, L: Any, arrays: Any, state: Any, s: Any) -> None:
    """How a pressure turns and grows with its surface."""
    load = arrays.pressures[e]
    for row in range(24):
        for column in range(24):
            s.K[row, column] = 0.0
    _pressure(load, state.pressure[e], state.bodies, s.K)
    add_element(load.node, group, size, L, s)


@kernel
def cut_joint(c: int, group: int, size: int, L: Any, arrays: Any, state: Any, s: Any) -> None:
    """How the reactions of a cut joint turn, and the springs that hold it."""
    cut = arrays.cuts[c]
    end = arrays.cuts[c + 1].row if c + 1 < arrays.cuts.shape[0] else state.rows.shape[0]
    _cut(cut, end, arrays.kept, s.weight, state, s.twins, s.rows, s.K)
    for p in range(2):
        i = cut.a if p == 0 else cut.b
        if L.role[i] == FIXED:
            continue
        ati = L.slot[i] + (size if L.group[i] > group else 0)
        for q in range(2):
            j = cut.a if q == 0 else cut.b
            if L.role[j] == FIXED:
                continue
            atj = L.slot[j] + (size if L.group[j] > group else 0)
            for a in range(6):
                for b in range(6):
                    s.F[ati + a, atj + b] += s.K[6 * p + a, 6 * q + b]


@kernel
def add_element(node: Any, group: int, size: int, L: Any, s: Any) -> None:
    """Add s.K to s.F, between the bodies of a group and the next (offset ``size``)."""
    for p in range(4):
        i = node[p]
        if L.role[i] == FIXED:
            continue
        ati = L.slot[i] + (size if L.group[i] > group else 0)
        for q in range(4):
            j = node[q]
            if L.role[j] == FIXED:
                continue
            atj = L.slot[j] + (size if L.group[j] > group else 0)
            for a in range(6):
                for b in range(6):
                    s.F[ati + a, atj + b] += s.K[6 * p + a, 6 * q + b]


@kernel
def fill(group: int, size: int, c1: float, c2: float, L: Any, arrays: Any, state: Any, dual: Any, s: Any) -> None:
    """Add to s.F what starts in a group: bodies, elements, and joints to this and the next group (offset ``size``)."""
    for k in range(L.first_plate[group], L.first_plate[group + 1]):
        plate_element(L.plates[k], group, size, c1, L, arrays, state, s)
    for k in range(L.first_pressure[group], L.first_pressure[group + 1]):
        pressed_surface(L.pressures[k], group, size, L, arrays, state, s)
    for k in range(L.first_cut[group], L.first_cut[group + 1]):
        cut_joint(L.cuts[k], group, size, L, arrays, state, s)
    for m in range(L.first[group], L.first[min(group + 2, L.first.shape[0] - 1)]):
        i = L.members[m]
        j = arrays.bodies[i].parent
        ati = L.slot[i] + (size if L.group[i] > group else 0)
        if L.group[i] == group:
            bodily(i, ati, c2, arrays, state, s.F)
        if L.role[j] == FIXED or min(L.group[i], L.group[j]) != group:
            continue
        atj = L.slot[j] + (size if L.group[j] > group else 0)
        handed_down(i, ati, atj, arrays, state, s.F)
        if L.role[i] == OUTER:
            lock = L.lock[i] + (size if L.group[i] > group else 0)
            outer_joint(i, ati, atj, lock, arrays, state, dual, s.F, s)


@kernel
def turn_inner(group: int, L: Any, arrays: Any, state: Any, F: Any, s: Any, parents: bool) -> None:
    """Add the turning of a group's inner joints: by their ``parents`` before columns are folded, by their own after."""
    for m in range(L.first[group], L.first[group + 1]):
        i = L.members[m]
        body = arrays.bodies[i]
        if L.role[i] != INNER or body.vf < 0:
            continue
        turning(i, arrays, state, s)
        for k in range(body.nv):
            if parents:
                if L.role[body.parent] != FIXED:
                    for a in range(3):
                        F[L.slot[i] + k, L.slot[body.parent] + 3 + a] += s.g[k, a]
            else:
                for l in range(body.nv):
                    F[L.slot[i] + k, L.slot[i] + l] += s.G[k, l]


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
        px, py, pz = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
        Yj = Y[body.parent]
        for a in range(6):
            Y[i, a] = Yj[a]
        Y[i, 0] += Yj[4] * pz - Yj[5] * py
        Y[i, 1] += Yj[5] * px - Yj[3] * pz
        Y[i, 2] += Yj[3] * py - Yj[4] * px
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
        x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
        dY, dYj, W, c, m = here.dY, parent.dY, here.W, here.com, body.mass
        for k in range(6):
            dY[k] = dYj[k] if body.parent > 0 else 0.0
        if body.parent > 0:
            dY[0] += dYj[4] * z - dYj[5] * y
            dY[1] += dYj[5] * x - dYj[3] * z
            dY[2] += dYj[3] * y - dYj[4] * x
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


class Tangent:
    """T of one mechanism, factored and solved as often as wanted.

    Parameters
    ----------
    data
        The mechanism; T is taken at its state.
    groups
        Group of every body (nb,), from zero; joints and elements span neighbouring groups at most.
    """

    def __init__(self, data: Data, groups: NDArray[np.int64]) -> None:
        arrays, self._moving = data
        self.layout, self._kept, self._sizes = lay_out(arrays, groups)
        widest = max(self._sizes)
        z = np.zeros
        self._scratch = Scratch(
            z((2 * widest, 2 * widest)), z((6, 6)), z((6, 6)), z((3, 3)), z(7, complex), z(3, complex),
            z((9, 6), complex), z((6, 6)), z((6, 3)), z(12), z((24, 24)), z((24, 24)),
            complex_records(2, MOTION), complex_records(len(self._moving.rows), ROW),
            z(int(arrays.kept.max(initial=-1)) + 1),
        )  # fmt: skip
        self._base = np.concatenate(([0], np.cumsum(self._sizes)))
        nv = int((arrays.bodies["nv"]).sum())
        self._dual = z((nv, 6))
        self._motions = z((len(arrays.bodies), 6))
        self._state = State(*(array.copy() for array in self._moving))
        self._held = tuple(map(hold, (arrays, self._state, self.layout, self._scratch)))
        self._factors = BlockTridiagonal()

    def factor(self, c1: float, c2: float, weight: Array | None = None) -> bool:
        """Assemble and factor T at the state of the last inverse dynamics; False where it is singular.

        ``weight`` (m,): T + J^T alpha J instead.
        """
        self._scratch.weight[:] = 0.0 if weight is None else weight
        with one_thread():
            return self._factor(c1, c2)

    def _factor(self, c1: float, c2: float) -> bool:
        arrays, state, L, s = self._held
        kept, scratch = self._kept, self._scratch
        for own, given in zip(self._state, self._moving, strict=True):
            own[...] = given
        self._factors = BlockTridiagonal()
        last = len(self._sizes) - 1
        carry = np.zeros((0, 0))
        for group, size in enumerate(self._sizes):
            after = self._sizes[group + 1] if group < last else 0
            F = scratch.F[: size + after, : size + after]
            F[...] = 0.0
            F[: len(carry), : len(carry)] = carry
            fill(group, size, c1, c2, L, arrays, state, self._dual, s)
            carry = F[size:, size:].copy()
            top = np.ascontiguousarray(F[:size])
            fold(top, 0, group, L, arrays, state)
            turn_inner(group, L, arrays, state, top, s, True)
            left = np.ascontiguousarray(np.vstack((top[:, :size], F[size:, :size])).T)
            fold(left, 0, group, L, arrays, state)  # the columns of this group
            left = left.T
            turn_inner(group, L, arrays, state, left, s, False)
            D = left[np.ix_(kept[group], kept[group])]
            if group == last:
                U, below = np.zeros((len(kept[group]), 0)), np.zeros((0, len(kept[group])))
            else:
                right = np.ascontiguousarray(top[:, size:].T)
                fold(right, 0, group + 1, L, arrays, state)
                lower = np.ascontiguousarray(left[size:])
                fold(lower, 0, group + 1, L, arrays, state)
                U = right.T[np.ix_(kept[group], kept[group + 1])]
                below = lower[np.ix_(kept[group + 1], kept[group])]
            if not self._factors.append(D, U, below):
                return False
        return True

    def solve(self, r: Array) -> Array:
        """Return dq with T dq = r, both (n,) or (n, columns), by the last factors."""
        columns = np.ascontiguousarray(r.reshape(len(r), -1))
        (arrays, state, L, _), b = self._held, np.zeros((int(self._base[-1]), columns.shape[1]))
        spread_load(columns, self._base, L, arrays, state, self._dual, b)
        parts = [b[base + rows] for base, rows in zip(self._base, self._kept, strict=False)]
        with one_thread():
            solution = self._factors.solve(parts)
        for base, rows, x in zip(self._base, self._kept, solution, strict=False):
            b[base + rows] = x
        dq = np.zeros(columns.shape)
        for c in range(columns.shape[1]):
            gather_motion(b, c, self._base, L, arrays, state, self._dual, self._motions, dq)
        return dq.reshape(r.shape)

    def inertia(self, a: Array) -> Array:
        """Return M a (n,) at the state of the last factors."""
        tau = np.zeros(len(a))
        arrays, state, *_ = self._held
        inertia_forces(arrays, state, a, tau)
        return tau
