"""Articulated body: forward dynamics of the tree in O(n) (Featherstone 2008, section 7.3, in global axes).

Inward, per body:   U = IA S,  D = S^T U,  u = Q - S^T (pA + IA beta)
    passed to the parent:  IA - U D^-1 U^T   and   pA + IA beta + U D^-1 u
Outward:            D v' = u - U^T B1 Y'_j,     Y'_i = B1 Y'_j + beta + S v'

A driven coordinate has its acceleration already: its joint passes IA on whole, with IA S v' in the bias. The nodes of
a flexible body share their coordinates: each passes IA on whole and adds its U and D to those of the first, the frame,
which eliminates them (flexible.modal).
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING

from mbfmu.mechanics.flexible import modal
from mbfmu.mechanics.records import SECTION
from mbfmu.mechanics.spatial import dot6, shift_motion, shift_wrench
from solvers.compiled.kernel import inlined, kernel

from .rnea import inertia_wrench

if TYPE_CHECKING:
    from mbfmu.mechanics.flexible.records import FlexibleRecord
    from mbfmu.mechanics.records import Arrays, BodyRecord, MotionRecord, State
    from solvers.compiled.record import Reals

RHS_COLUMN = -1  # column of D with the right-hand side


@kernel
def forward_dynamics(arrays: Arrays, state: State) -> int:
    """State.a for the tree alone (cut joints enter as applied forces); 1 where a coordinate moves no mass."""
    initialize_articulated_inertia(arrays, state)
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        if backward_pass(i, arrays, state) != 0:
            return 1
    for k in range(3):
        state.bodies[0].dY[k] = -arrays.world[0].gravity[k]
    for i in range(1, arrays.bodies.shape[0]):
        forward_pass(i, arrays, state)
    assign_state_rates(arrays, state)
    return 0


@inlined
def assign_state_rates(arrays: Arrays, state: State) -> None:
    """State.a of the first-order states: their rates, which the elements have added to State.Q."""
    for k in range(state.a.shape[0] - arrays.world[0].states, state.a.shape[0]):
        state.a[k] = state.Q[k]


@kernel
def drive_efforts(arrays: Arrays, state: State) -> None:
    """State.tau of the driven coordinates after :func:`forward_dynamics`, from what their joints transmit:
    S^T (IA B1 Y'_j + pA) - Q, pA being what is passed to the parent.
    """
    f = state.wrench
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        if body.drive < 0:
            continue
        parent = state.bodies[body.parent]
        for k in range(6):
            f[k] = here.pA[k]
            for j in range(6):
                f[k] += here.IA[k, j] * parent.dY[j]
        if body.parent > 0:  # propagate_to_parent has shifted both to the parent's origin
            shift_wrench(parent, here, f)
        for c in range(body.nv):
            state.tau[body.vi + c] = dot6(state.S[body.si + c], f) - state.Q[body.vi + c]
        if body.armature != 0.0:
            state.tau[body.vi] += body.armature * state.a[body.vi]


@kernel
def apply_inverse_mass_matrix(arrays: Arrays, state: State, r: Reals, x: Reals) -> None:
    """x (n,) = M^-1 r (n,) by the articulated inertias of the last :func:`forward_dynamics`: nothing but r acts."""
    for i in range(arrays.bodies.shape[0]):
        for k in range(6):
            state.bodies[i].pA[k] = 0.0
            state.bodies[i].dY[k] = 0.0
        body = arrays.bodies[i]
        for c in range(body.nv * (body.vf >= 0 and body.role != SECTION)):
            state.D[body.vi + c, RHS_COLUMN] = r[body.vf + c]
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        body, here = arrays.bodies[i], state.bodies[i]
        if body.role == SECTION:
            for c in range(body.nv):
                state.D[body.vi + c, RHS_COLUMN] -= dot6(state.S[body.si + c], here.pA)
        elif body.vf >= 0:
            D, U = state.D, state.U
            for c in range(body.nv):
                rest = D[body.vi + c, RHS_COLUMN] - dot6(state.S[body.si + c], here.pA)
                for j in range(c):
                    rest -= D[body.vi + c, j] * D[body.vi + j, RHS_COLUMN]
                D[body.vi + c, RHS_COLUMN] = rest / D[body.vi + c, c]
            for c in range(body.nv):
                for k in range(6):
                    here.pA[k] += U[body.vi + c, k] * D[body.vi + c, RHS_COLUMN]
        if body.parent > 0:
            parent = state.bodies[body.parent]
            shift_wrench(here, parent, here.pA)
            for k in range(6):
                parent.pA[k] += here.pA[k]
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        parent = state.bodies[body.parent]
        dY = here.dY
        for k in range(6):
            dY[k] = parent.dY[k]
        shift_motion(here, parent, parent.dY, dY)
        if body.vf < 0:
            continue
        for c in range(body.nv * (body.role != SECTION) - 1, -1, -1):
            rest = state.D[body.vi + c, RHS_COLUMN] - dot6(state.U[body.vi + c], dY)
            for j in range(c + 1, body.nv):
                rest -= state.D[body.vi + j, c] * x[body.vf + j]
            x[body.vf + c] = rest / state.D[body.vi + c, c]
        for k in range(6):
            for c in range(body.nv):
                dY[k] += state.S[body.si + c, k] * x[body.vf + c]
    for k in range(r.shape[0] - arrays.world[0].states, r.shape[0]):
        x[k] = r[k]  # of a first-order state the mass is 1


@kernel
def initialize_articulated_inertia(arrays: Arrays, state: State) -> None:
    """Rigid-body inertia about the origin as a 6x6 matrix, and the wrench at zero acceleration."""
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        mass, c, IA, dY = arrays.bodies[i].mass, here.com, here.IA, here.dY
        cc = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
        for k in range(3):
            for j in range(3):
                IA[k, j] = 0.0
                IA[3 + k, 3 + j] = here.Jc[k, j] - mass * c[k] * c[j]
            IA[k, k] = mass
            IA[3 + k, 3 + k] += mass * cc
            IA[k, 3 + k] = 0.0
            IA[3 + k, k] = 0.0
        IA[0, 4], IA[0, 5], IA[1, 5] = mass * c[2], -mass * c[1], mass * c[0]
        IA[1, 3], IA[2, 3], IA[2, 4] = -mass * c[2], mass * c[1], -mass * c[0]
        for k in range(3):
            for j in range(3):
                IA[3 + j, k] = IA[k, 3 + j]
        for k in range(6):
            dY[k] = 0.0
        inertia_wrench(mass, here, here.pA)
        for k in range(6):
            here.pA[k] -= here.F[k]
    for row in range(state.U.shape[0]):
        for k in range(6):
            state.U[row, k] = 0.0
        for k in range(state.D.shape[1]):
            state.D[row, k] = 0.0
    for i in range(arrays.flexibles.shape[0]):
        initialize_flexible_inertia(arrays.flexibles[i], state, arrays.numbers)


@kernel
def initialize_flexible_inertia(flexible: FlexibleRecord, state: State, numbers: Reals) -> None:
    """Inertia of a flexible body about its frame's origin, and its wrench and modal forces at zero acceleration."""
    here, vi = state.bodies[flexible.body], flexible.vi
    modal.composite(flexible, here, state.q, numbers)
    m, mc, IA = here.mass, here.mc, here.IA
    for k in range(3):
        IA[k, k] += m
        for j in range(3):
            IA[3 + k, 3 + j] += here.J[k, j]
    IA[0, 4], IA[0, 5], IA[1, 5] = mc[2], -mc[1], mc[0]
    IA[1, 3], IA[2, 3], IA[2, 4] = -mc[2], mc[1], -mc[0]
    for k in range(3):
        for j in range(3):
            IA[3 + j, k] = IA[k, 3 + j]
    for k in range(flexible.modes):
        state.a[vi + k] = 0.0
        state.tau[vi + k] = 0.0
    for k in range(6):
        here.W[k] = 0.0
    modal.inertia(flexible, here, state, numbers)
    for k in range(6):
        here.pA[k] += here.W[k]
    for k in range(flexible.modes):
        modal.coupling(flexible, k, here, state.q, numbers, state.U[vi + k])
        state.D[vi + k, k] = modal.modal_mass(flexible, k, numbers)
        state.D[vi + k, RHS_COLUMN] = -state.tau[vi + k]


@kernel
def backward_pass(i: int, arrays: Arrays, state: State) -> int:
    """Hand body i's articulated inertia and bias to its parent; 1 where D is not positive."""
    body = arrays.bodies[i]
    here = state.bodies[i]
    IA, pA, beta, S, U, D = here.IA, here.pA, here.beta, state.S, state.U, state.D
    nv, vi = body.nv, body.vi
    si = body.si
    for k in range(6):
        for j in range(6):
            pA[k] += IA[k, j] * beta[j]
    if body.role == SECTION:
        add_section_inertia(body, here, state.bodies[body.parent], state)
        propagate_to_parent(here, state.bodies[body.parent])
        return 0
    for c in range(nv):
        for k in range(6):
            for j in range(6):
                U[vi + c, k] += IA[k, j] * S[si + c, j]
    if body.drive >= 0:
        for c in range(nv):
            for k in range(6):
                pA[k] += U[vi + c, k] * state.a[vi + c]
    else:
        for c in range(nv):
            for e in range(nv):
                D[vi + c, e] += dot6(S[si + c], U[vi + e])
            D[vi + c, RHS_COLUMN] += state.Q[vi + c] - dot6(S[si + c], pA)
        if body.armature != 0.0:
            D[vi, 0] += body.armature
        if factorize_joint_inertia(D, nv, U, vi) != 0:
            return 1
        for c in range(nv):
            for k in range(6):
                pA[k] += U[vi + c, k] * D[vi + c, RHS_COLUMN]
                for j in range(6):
                    IA[k, j] -= U[vi + c, k] * U[vi + c, j]
    if body.parent > 0:
        propagate_to_parent(here, state.bodies[body.parent])
    return 0


@kernel
def add_section_inertia(body: BodyRecord, here: MotionRecord, frame: MotionRecord, state: State) -> None:
    """Add a node's U, about the frame's origin, D and u to those of the amplitudes."""
    IA, S, U, D, vi, si, f = here.IA, state.S, state.U, state.D, body.vi, body.si, state.wrench
    for e in range(body.nv):
        for k in range(6):
            f[k] = 0.0
            for j in range(6):
                f[k] += IA[k, j] * S[si + e, j]
        for c in range(body.nv):
            D[vi + c, e] += dot6(S[si + c], f)
        D[vi + e, RHS_COLUMN] -= dot6(S[si + e], here.pA)
        shift_wrench(here, frame, f)
        for k in range(6):
            U[vi + e, k] += f[k]


@kernel
def factorize_joint_inertia(D: Reals, nv: int, U: Reals, vi: int) -> int:
    """One joint's D = L L^T, in place; D[:, RIGHT] <- L^-1 u and U <- L^-1 U^T; 1 where D is not positive."""
    for c in range(nv):
        for e in range(c + 1):
            x = D[vi + c, e]
            for j in range(e):
                x -= D[vi + c, j] * D[vi + e, j]
            if e < c:
                D[vi + c, e] = x / D[vi + e, e]
            elif x > 0.0:
                D[vi + c, c] = sqrt(x)
            else:
                return 1
        for j in range(c):
            D[vi + c, RHS_COLUMN] -= D[vi + c, j] * D[vi + j, RHS_COLUMN]
            for k in range(6):
                U[vi + c, k] -= D[vi + c, j] * U[vi + j, k]
        D[vi + c, RHS_COLUMN] /= D[vi + c, c]
        for k in range(6):
            U[vi + c, k] /= D[vi + c, c]
    return 0


@kernel
def propagate_to_parent(here: MotionRecord, parent: MotionRecord) -> None:
    """Add B1^T IA B1 and B1^T pA to the parent's; rows and columns shift alike."""
    IA = here.IA
    x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
    for k in range(6):
        row = IA[k]
        row[3] += y * row[2] - z * row[1]
        row[4] += z * row[0] - x * row[2]
        row[5] += x * row[1] - y * row[0]
    for k in range(6):
        IA[3, k] += y * IA[2, k] - z * IA[1, k]
        IA[4, k] += z * IA[0, k] - x * IA[2, k]
        IA[5, k] += x * IA[1, k] - y * IA[0, k]
    shift_wrench(here, parent, here.pA)
    for k in range(6):
        parent.pA[k] += here.pA[k]
        for j in range(6):
            parent.IA[k, j] += IA[k, j]


@kernel
def forward_pass(i: int, arrays: Arrays, state: State) -> None:
    """Accelerations of body i and of its joint from its parent's."""
    body = arrays.bodies[i]
    here = state.bodies[i]
    parent = state.bodies[body.parent]
    dY, D, vi, nv = here.dY, state.D, body.vi, body.nv
    for k in range(6):
        dY[k] = parent.dY[k]
    shift_motion(here, parent, parent.dY, dY)
    if body.drive < 0 and body.role != SECTION:  # L^T v' = L^-1 u - L^-1 U^T B1 Y'_j
        for c in range(nv - 1, -1, -1):
            rest = D[vi + c, RHS_COLUMN] - dot6(state.U[vi + c], dY)
            for j in range(c + 1, nv):
                rest -= D[vi + j, c] * state.a[vi + j]
            state.a[vi + c] = rest / D[vi + c, c]
    for k in range(6):
        dY[k] += here.beta[k]
        for c in range(nv):
            dY[k] += state.S[body.si + c, k] * state.a[vi + c]
