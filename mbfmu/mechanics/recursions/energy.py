"""Kinetic and potential energy, the power that changes them, and what takes their place where a drive does work."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.flexible import modal
from mbfmu.mechanics.records import RIGID, SECTION
from mbfmu.mechanics.spatial import add_wrench, row_dot6, shift_motion, shift_wrench
from solvers.compiled.kernel import inlined

from .applied import stored_energy, sum_load_powers
from .crba import composite_inertia, momentum_of

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals


@inlined
def twice_energy(mass: float, here: MotionRecord, Y: Reals) -> float:
    """Twice the kinetic energy of a body that moves with Y (6,), J."""
    Jc, c = here.Jc, here.com
    x, y, z = Y[4] * c[2] - Y[5] * c[1], Y[5] * c[0] - Y[3] * c[2], Y[3] * c[1] - Y[4] * c[0]
    total = mass * ((Y[0] + x) * (Y[0] + x) + (Y[1] + y) * (Y[1] + y) + (Y[2] + z) * (Y[2] + z))
    for k in range(3):
        total += Y[3 + k] * (Jc[k, 0] * Y[3] + Jc[k, 1] * Y[4] + Jc[k, 2] * Y[5])
    return total


@inlined
def kinetic_energy(arrays: Arrays, state: State) -> float:
    """sum m v_c.v_c / 2 + w.Jc w / 2, J."""
    total = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        total += 0.5 * twice_energy(body.mass, state.bodies[i], state.bodies[i].Y)
        if body.armature != 0.0:
            total += 0.5 * body.armature * state.v[body.vi] * state.v[body.vi]
    for i in range(arrays.flexibles.shape[0]):
        flexible = arrays.flexibles[i]
        total += modal.kinetic(flexible, state.bodies[flexible.body], state, arrays.numbers, state.wrench)
    return total


@inlined
def potential_energy(arrays: Arrays, state: State) -> float:
    """Energy in the gravity field (zero at the global origin) and in the springs, J."""
    total = stored_energy(arrays, state)
    g = arrays.world[0].gravity
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        for k in range(3):
            total -= arrays.bodies[i].mass * g[k] * (here.r[k] + here.com[k])
    for i in range(arrays.flexibles.shape[0]):
        flexible = arrays.flexibles[i]
        total += modal.gravity_potential(flexible, state.bodies[flexible.body], state, g, arrays.numbers)
    return total


@inlined
def body_momentum(mass: float, here: MotionRecord, p: Reals) -> None:
    """p (6,) = momentum of a body about its origin."""
    Y, c, Jc = here.Y, here.com, here.Jc
    p[0] = mass * (Y[0] + Y[4] * c[2] - Y[5] * c[1])
    p[1] = mass * (Y[1] + Y[5] * c[0] - Y[3] * c[2])
    p[2] = mass * (Y[2] + Y[3] * c[1] - Y[4] * c[0])
    for k in range(3):
        p[3 + k] = Jc[k, 0] * Y[3] + Jc[k, 1] * Y[4] + Jc[k, 2] * Y[5]
    p[3] += c[1] * p[2] - c[2] * p[1]
    p[4] += c[2] * p[0] - c[0] * p[2]
    p[5] += c[0] * p[1] - c[1] * p[0]


@inlined
def generalized_momenta(arrays: Arrays, state: State) -> float:
    """State.tau = p = dT/dv over every coordinate, and the joint wrenches W as scratch; return T = p v / 2, J."""
    for i in range(1, arrays.bodies.shape[0]):
        body_momentum(arrays.bodies[i].mass, state.bodies[i], state.bodies[i].W)
    for i in range(arrays.flexibles.shape[0]):
        flexible = arrays.flexibles[i]
        here = state.bodies[flexible.body]
        for k in range(flexible.modes):
            state.tau[flexible.vi + k] = modal.modal_momentum(flexible, k, here, state, arrays.numbers)
        modal.momentum(flexible, here, state, arrays.numbers, here.W)
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        body, here = arrays.bodies[i], state.bodies[i]
        for k in range(body.nv):
            p = row_dot6(state.S, body.si + k, here.W)
            if body.role == RIGID:
                state.tau[body.vi + k] = p
            else:  # sections share their coordinates
                state.tau[body.vi + k] += p
        if body.armature != 0.0:
            state.tau[body.vi] += body.armature * state.v[body.vi]
        if body.parent > 0:
            parent = state.bodies[body.parent]
            x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
            add_wrench(parent.W, x, y, z, here.W)
    total = 0.0
    for k in range(state.tau.shape[0] - arrays.world[0].states):
        total += 0.5 * state.tau[k] * state.v[k]
    return total


@inlined
def evaluate_energy_bound(rtol: float, q_tol: Reals, v_tol: Reals, arrays: Arrays, state: State, out: Reals) -> None:
    """out = (root of the sum over all coordinates of (h dq)^2 + (p dv)^2, kinetic energy), J.

    h is State.tau, the bias; dq = rtol |q| + q_tol and dv = rtol |v| + v_tol with the absolute tolerances (n,) of the
    free coordinates, and the largest of them for driven ones. First-order states z count by the change of the stored
    energy for dz = rtol |z| + z_tol, whose tolerance is among v_tol. State.tau and the joint wrenches are lost.

    A longer out (5 + 2 n,) gets the extent of the motion, see :func:`update_motion_extent`.
    """
    max_q_tol, max_v_tol = 0.0, 0.0
    for k in range(q_tol.shape[0]):
        max_q_tol, max_v_tol = max(max_q_tol, q_tol[k]), max(max_v_tol, v_tol[k])
    square = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        plain = body.nq - 4 * body.quaternion
        for k in range(body.nv * (body.role != SECTION)):  # the sections of a flexible body share its coordinates
            magnitude = abs(state.q[body.qi + k]) if k < plain else 2.0  # a quaternion turns by half the angle
            square += (
                state.tau[body.vi + k] * (rtol * magnitude + (max_q_tol if body.vf < 0 else q_tol[body.vf + k]))
            ) ** 2
    out[1] = generalized_momenta(arrays, state)
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        for k in range(body.nv * (body.role != SECTION)):
            speed = rtol * abs(state.v[body.vi + k]) + (max_v_tol if body.vf < 0 else v_tol[body.vf + k])
            square += (state.tau[body.vi + k] * speed) ** 2
    states = arrays.world[0].states
    if states > 0:
        stored, first = stored_energy(arrays, state), state.v.shape[0] - states
        for k in range(states):
            z = state.v[first + k]
            state.v[first + k] = z + rtol * abs(z) + v_tol[v_tol.shape[0] - states + k]
            square += (stored_energy(arrays, state) - stored) ** 2
            state.v[first + k] = z
    out[0] = np.sqrt(square)
    if out.shape[0] > 2:
        update_motion_extent(q_tol, v_tol, max_q_tol, max_v_tol, arrays, state, out)


@inlined
def update_motion_extent(
    q_tol: Reals, v_tol: Reals, max_q_tol: float, max_v_tol: float, arrays: Arrays, state: State, out: Reals
) -> None:
    """out[2:5] = the largest displacement and velocity of a coordinate in absolute tolerances, and the momentum,
    State.tau, times the velocities before, out[5 + n:] (n,), which become those of this state.

    Displacements are those from out[5:5 + n], which is set where it is nan, of a quaternion those of twice its vector
    part. For driven coordinates, which have no entry there, velocities stand for both.
    """
    out[2], out[3], out[4], before = 0.0, 0.0, 0.0, 5 + q_tol.shape[0]
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        plain = body.nq - 4 * body.quaternion
        for k in range(body.nv * (body.role != SECTION)):
            free, v = body.vf >= 0, abs(state.v[body.vi + k])
            scaled_speed = v / (v_tol[body.vf + k] if free else max_v_tol) if v > 0.0 else 0.0
            out[3] = max(out[3], scaled_speed)
            if not free:
                out[2] = max(out[2], scaled_speed)
                continue
            at = state.q[body.qi + k] if k < plain else 2.0 * state.q[body.qi + k + 1]
            if not out[5 + body.vf + k] == out[5 + body.vf + k]:
                out[5 + body.vf + k] = at
            out[2] = max(out[2], abs(at - out[5 + body.vf + k]) / q_tol[body.vf + k])
            out[4] += state.tau[body.vi + k] * out[before + body.vf + k]
            out[before + body.vf + k] = state.v[body.vi + k]


@inlined
def inertia_parts(arrays: Arrays, state: State, out: Reals) -> None:
    """out (1 + n,) = v . M v, J, and the diagonal of M over the free coordinates v (n,) of a tree; zero for
    first-order states.

    Composite inertias, joint wrenches and accelerations of the state are lost.
    """
    f, out[0] = state.wrench, 0.0
    composite_inertia(arrays, state)
    for k in range(6):
        state.bodies[0].dY[k] = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        parent = state.bodies[body.parent]
        for k in range(6):
            here.dY[k] = parent.dY[k]
        shift_motion(here, parent, parent.dY, here.dY)
        if body.vf >= 0:
            for c in range(body.nv):
                momentum_of(here, state.S, body.si + c, f)
                own = row_dot6(state.S, body.si + c, f)
                if body.role == SECTION:  # sections share their coordinates
                    own += out[1 + body.vf + c]
                out[1 + body.vf + c] = own
                for k in range(6):
                    here.dY[k] += state.S[body.si + c, k] * state.v[body.vi + c]
            if body.armature != 0.0:
                out[1 + body.vf] += body.armature
                out[0] += body.armature * state.v[body.vi] * state.v[body.vi]
        out[0] += twice_energy(body.mass, here, here.dY)
    for e in range(arrays.flexibles.shape[0]):
        flexible = arrays.flexibles[e]
        first, here = arrays.bodies[flexible.body].vf, state.bodies[flexible.body]
        for k in range(6):
            here.W[k] = here.Y[k]
            here.Y[k] = here.dY[k]
        out[0] += 2.0 * modal.kinetic(flexible, here, state, arrays.numbers, f)
        for k in range(6):
            here.Y[k] = here.W[k]
        for k in range(flexible.modes):
            out[1 + first + k] += modal.modal_mass(flexible, k, arrays.numbers)
    for k in range(out.shape[0] - arrays.world[0].states, out.shape[0]):
        out[k] = 0.0


@inlined
def power(t: float, arrays: Arrays, state: State) -> float:
    """dE/dt, W: what drives, whose effort is in State.tau, and forces without a potential bring."""
    total = sum_load_powers(t, arrays, state)
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.drive >= 0:
            for k in range(body.nv):
                total += state.tau[body.vi + k] * state.v[body.vi + k]
    return total


@inlined
def driven_action(arrays: Arrays, state: State) -> float:
    """Sum of p v over the driven coordinates, p the generalized momentum, J.

    Energy less this is the Jacobi integral: with drives at constant speed about which the mechanism is symmetric
    and without damping it stays constant, while the energy grows by the work of the drives.
    """
    total = 0.0
    for i in range(1, arrays.bodies.shape[0]):
        p = state.wrench
        body = arrays.bodies[i]
        body_momentum(body.mass, state.bodies[i], p)
        total += power_on_drives(i, p, arrays, state)
        if body.armature != 0.0 and body.drive >= 0:
            total += body.armature * state.v[body.vi] * state.v[body.vi]
    for e in range(arrays.flexibles.shape[0]):
        p = state.wrench
        for k in range(6):
            p[k] = 0.0
        i = arrays.flexibles[e].body
        modal.momentum(arrays.flexibles[e], state.bodies[i], state, arrays.numbers, p)
        total += power_on_drives(i, p, arrays, state)
    return total


@inlined
def power_on_drives(i: int, p: Reals, arrays: Arrays, state: State) -> float:
    """Sum over the driven coordinates between body i and the ground of p v, p the momentum about the body's origin."""
    total = 0.0 * p[0]
    while i > 0:
        body = arrays.bodies[i]
        for k in range(body.nv * (body.drive >= 0)):
            total += state.v[body.vi + k] * row_dot6(state.S, body.si + k, p)
        shift_wrench(state.bodies[i], state.bodies[body.parent], p)
        i = body.parent
    return total
