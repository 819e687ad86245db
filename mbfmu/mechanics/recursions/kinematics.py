"""Outward recursion: positions, velocities and velocity-product accelerations of every body.

In global axes a motion is handed from a parent's origin to its child's by a shift alone, with rho = r_i - r_j:

    Y_i  = B1 Y_j + S v,         B1 = [[I, -skew(rho)], [0, I]]                            (6) of Bae and Cho 2004
    Y'_i = B1 Y'_j + S v' + beta                                                           (11)
    beta = (w_j x (w_j x rho) + 2 w_j x u ;  w_j x w_rel) + C b

S is the joint's subspace turned into global axes, (u, w_rel) = S v the relative velocity, b the joint's own bias, if it
has one, and C the axes of the joint frame. (w_j x (w_j x rho) + 2 w_j x u is B1' Y_j and the turning of S together.)
"""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import has_bias, joint_bias, place_child, signal
from mbfmu.mechanics.flexible.modal import add_section_bias, place_section
from mbfmu.mechanics.records import RIGID
from mbfmu.mechanics.spatial import multiply, rotate, rotate_row, shift_motion
from solvers.compiled.kernel import inlined

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, BodyRecord, MotionRecord, State
    from solvers.compiled.record import Reals


@inlined
def scatter_coordinates(t: float, q: Reals, v: Reals, arrays: Arrays, state: State) -> None:
    """Fill State.q, v, a from the solver's free coordinates, first-order states and the drives; free accelerations
    become zero, and the forces along all coordinates, which are the rates z' of states. Sensors are those of time t.
    """
    state.time[0] = t
    states = arrays.world[0].states
    for k in range(states):
        i = state.v.shape[0] - states + k
        state.v[i], state.a[i], state.Q[i] = v[v.shape[0] - states + k], 0.0, 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.drive >= 0:
            state.q[body.qi], state.v[body.vi], state.a[body.vi] = signal(body.drive, t, arrays)
            state.Q[body.vi] = 0.0
            continue
        for k in range(body.nq):
            state.q[body.qi + k] = q[body.qf + k]
        for k in range(body.nv):
            state.v[body.vi + k] = v[body.vf + k]
            state.a[body.vi + k] = 0.0
            state.Q[body.vi + k] = 0.0


@inlined
def update_positions(arrays: Arrays, state: State) -> None:
    """Positions r, A and the subspaces S from State.q."""
    rel, C = state.rel[0], state.frame
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        here = state.bodies[i]
        parent = state.bodies[body.parent]
        if body.role != RIGID:
            place_section(body, arrays.nodes[body.node], parent, here, state, arrays.numbers)
            continue
        place_child(body, arrays, state)
        multiply(parent.A, body.R, C)
        for k in range(3):
            for j in range(3):
                here.A[k, j] = C[k, 0] * rel.R[0, j] + C[k, 1] * rel.R[1, j] + C[k, 2] * rel.R[2, j]
            here.r[k] = (
                parent.r[k]
                + parent.A[k, 0] * body.s[0]
                + parent.A[k, 1] * body.s[1]
                + parent.A[k, 2] * body.s[2]
                + C[k, 0] * rel.p[0]
                + C[k, 1] * rel.p[1]
                + C[k, 2] * rel.p[2]
            )
        for k in range(body.nv):
            rotate_row(C, rel.S, k, state.S, body.si + k)


@inlined
def rotate_inertia(arrays: Arrays, state: State) -> None:
    """Center of mass and inertia of every body in global axes: c = A c', J = A J' A^T."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        here = state.bodies[i]
        A = here.A
        rotate(A, body.com, here.com)
        AJ = state.product
        multiply(A, body.inertia, AJ)
        for k in range(3):
            for j in range(3):
                here.Jc[k, j] = AJ[k, 0] * A[j, 0] + AJ[k, 1] * A[j, 1] + AJ[k, 2] * A[j, 2]


@inlined
def update_velocities(arrays: Arrays, state: State) -> None:
    """Velocities Y and velocity products beta, after :func:`update_positions`."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        here = state.bodies[i]
        parent = state.bodies[body.parent]
        Yj, Y, beta = parent.Y, here.Y, here.beta
        wx, wy, wz = Yj[3], Yj[4], Yj[5]
        x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
        for k in range(6):
            Y[k] = 0.0
        for j in range(body.nv):
            for k in range(6):
                Y[k] += state.S[body.si + j, k] * state.v[body.vi + j]
        # w_j x rho, then beta = w_j x (w_j x rho + 2 u), w_j x w_rel
        px, py, pz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        ux, uy, uz = px + 2.0 * Y[0], py + 2.0 * Y[1], pz + 2.0 * Y[2]
        beta[0] = wy * uz - wz * uy
        beta[1] = wz * ux - wx * uz
        beta[2] = wx * uy - wy * ux
        beta[3] = wy * Y[5] - wz * Y[4]
        beta[4] = wz * Y[3] - wx * Y[5]
        beta[5] = wx * Y[4] - wy * Y[3]
        if body.role == RIGID and has_bias(body, arrays):
            joint_bias(body, arrays, state)
            add_bias(body, parent, state.rel[0].bias, beta)
        if body.role != RIGID:
            add_section_bias(body, arrays.nodes[body.node], parent, state, arrays.numbers, beta)
        Y[0] += Yj[0] + px
        Y[1] += Yj[1] + py
        Y[2] += Yj[2] + pz
        Y[3] += wx
        Y[4] += wy
        Y[5] += wz


@inlined
def mesh_motion(dq: Reals, mask: Reals, arrays: Arrays, state: State, out: Reals) -> None:
    """out (2,) = largest displacement (m) and rotation (rad) of nodes of meshes by a small motion dq (n,).

    The coordinates of a node, relative to the node before it, have a ``mask`` (n,) of 1. Accelerations of the state are
    lost.
    """
    out[0], out[1] = 0.0, 0.0
    for k in range(6):
        state.bodies[0].dY[k] = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        parent, D = state.bodies[body.parent], here.dY
        for k in range(6):
            D[k] = parent.dY[k]
        shift_motion(here, parent, parent.dY, D)
        if body.vf < 0:
            continue
        for j in range(body.nv):
            for k in range(6):
                D[k] += state.S[body.si + j, k] * dq[body.vf + j]
        if body.nv > 0 and mask[body.vf] == 1.0:
            for half in range(2):
                size = sqrt(D[3 * half] ** 2 + D[3 * half + 1] ** 2 + D[3 * half + 2] ** 2)
                if not size <= out[half]:  # also one that is not finite
                    out[half] = size


@inlined
def add_bias(body: BodyRecord, parent: MotionRecord, b: Reals, beta: Reals) -> None:
    """beta += C b, C = A_j R."""
    A, R = parent.A, body.R
    for k in range(3):
        x = R[k, 0] * b[0] + R[k, 1] * b[1] + R[k, 2] * b[2]
        w = R[k, 0] * b[3] + R[k, 1] * b[4] + R[k, 2] * b[5]
        for i in range(3):
            beta[i] += A[i, k] * x
            beta[3 + i] += A[i, k] * w


@inlined
def update_accelerations(arrays: Arrays, state: State) -> None:
    """Accelerations Y' less gravity for State.a, after :func:`update_velocities`: the ground accelerates by -g."""
    ground = state.bodies[0]
    for k in range(3):
        ground.dY[k] = -arrays.world[0].gravity[k]
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        here = state.bodies[i]
        parent = state.bodies[body.parent]
        dY = here.dY
        for k in range(6):
            dY[k] = parent.dY[k] + here.beta[k]
        shift_motion(here, parent, parent.dY, dY)
        for j in range(body.nv):
            for k in range(6):
                dY[k] += state.S[body.si + j, k] * state.a[body.vi + j]
