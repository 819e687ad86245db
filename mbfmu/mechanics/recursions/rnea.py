"""Recursive Newton-Euler: inverse dynamics, F = B^T (M Y' - Q), (14) of Bae and Cho 2004 without its constraints.

Featherstone 2008, section 5.3, in global axes. Per body, with c from its origin to its center of mass:

    f = m (r'' + w' x c + w x (w x c)),     n = c x f + Jc w' + w x Jc w

The wrench W the joint transmits is that, less the applied wrench, plus what the children take; tau = S^T W.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.flexible import modal
from mbfmu.mechanics.records import RIGID
from mbfmu.mechanics.spatial import add_wrench, cross, rotate, row_dot6
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals


@kernel
def inertia_wrench(mass: float, here: MotionRecord, out: Reals) -> None:
    """out = rate of change of a body's momentum about its origin, accelerations less gravity."""
    dY, Y, c, Jc = here.dY, here.Y, here.com, here.Jc
    wx, wy, wz = Y[3], Y[4], Y[5]
    # w x c, then a_c = r'' + w' x c + w x (w x c)
    px, py, pz = wy * c[2] - wz * c[1], wz * c[0] - wx * c[2], wx * c[1] - wy * c[0]
    out[0] = mass * (dY[0] + dY[4] * c[2] - dY[5] * c[1] + wy * pz - wz * py)
    out[1] = mass * (dY[1] + dY[5] * c[0] - dY[3] * c[2] + wz * px - wx * pz)
    out[2] = mass * (dY[2] + dY[3] * c[1] - dY[4] * c[0] + wx * py - wy * px)
    hx = Jc[0, 0] * wx + Jc[0, 1] * wy + Jc[0, 2] * wz
    hy = Jc[1, 0] * wx + Jc[1, 1] * wy + Jc[1, 2] * wz
    hz = Jc[2, 0] * wx + Jc[2, 1] * wy + Jc[2, 2] * wz
    for k in range(3):
        out[3 + k] = Jc[k, 0] * dY[3] + Jc[k, 1] * dY[4] + Jc[k, 2] * dY[5]
    out[3] += wy * hz - wz * hy + c[1] * out[2] - c[2] * out[1]
    out[4] += wz * hx - wx * hz + c[2] * out[0] - c[0] * out[2]
    out[5] += wx * hy - wy * hx + c[0] * out[1] - c[1] * out[0]


@inlined
def inverse_dynamics(arrays: Arrays, state: State) -> None:
    """State.tau and the joint wrenches W, from velocities, accelerations and applied forces F, Q."""
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        inertia_wrench(arrays.bodies[i].mass, here, here.W)
        for k in range(6):
            here.W[k] -= here.F[k]
    for i in range(arrays.flexibles.shape[0]):
        flexible = arrays.flexibles[i]
        for k in range(flexible.vi, flexible.vi + flexible.modes):
            state.tau[k] = -state.Q[k]
        modal.inertia(flexible, state.bodies[flexible.body], state, arrays.numbers)
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        body = arrays.bodies[i]
        here = state.bodies[i]
        for k in range(body.nv):
            power = row_dot6(state.S, body.si + k, here.W)
            if body.role == RIGID:
                state.tau[body.vi + k] = power - state.Q[body.vi + k]
            else:  # sections share their coordinates
                state.tau[body.vi + k] += power
        if body.armature != 0.0:
            state.tau[body.vi] += body.armature * state.a[body.vi]
        if body.parent > 0:
            parent = state.bodies[body.parent]
            x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
            add_wrench(parent.W, x, y, z, here.W)
    for k in range(state.tau.shape[0] - arrays.world[0].states, state.tau.shape[0]):
        state.tau[k] = state.a[k] - state.Q[k]  # z' less the rates of all elements


@kernel
def momentum(arrays: Arrays, state: State, out: Reals) -> None:
    """out = linear momentum and angular momentum about the global origin, N s and N m s."""
    for k in range(6):
        out[k] = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        mass = arrays.bodies[i].mass
        Y, c, r, Jc = here.Y, here.com, here.r, here.Jc
        p = here.W  # scratch: momentum of this body about its center of mass
        cross(Y[3:6], c, p)
        for k in range(3):
            p[k] = mass * (Y[k] + p[k])
        rotate(Jc, Y[3:6], p[3:6])
        add_wrench(out, r[0] + c[0], r[1] + c[1], r[2] + c[2], p)
    for i in range(arrays.flexibles.shape[0]):
        here = state.bodies[arrays.flexibles[i].body]
        for k in range(6):
            here.W[k] = 0.0
        modal.momentum(arrays.flexibles[i], here, state, arrays.numbers, here.W)
        add_wrench(out, here.r[0], here.r[1], here.r[2], here.W)
