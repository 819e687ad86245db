"""The equations of motion as a solver calls them: the recursions in their order.

Most functions here are those of a :class:`solvers.system.System` or :class:`solvers.system.TreeSystem`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.dispatch import longest_step, part_sensor_value, read_sensor, signal
from mbfmu.mechanics.records import Data
from mbfmu.mechanics.spatial import quaternion_rate
from solvers.compiled.kernel import inlined, kernel, system_kernel
from solvers.system import Terms

from . import active_loads
from .aba import apply_inverse_mass_matrix, drive_efforts, forward_dynamics
from .applied import apply_loads
from .constraints import evaluate_constraints, jacobian, load_constraints, right_hand_side
from .crba import composite_inertia, mass_matrix
from .energy import evaluate_energy_bound as energy_bound_of
from .energy import inertia_parts as inertia_parts_of
from .energy import kinetic_energy, potential_energy
from .energy import power as power_of
from .kinematics import mesh_motion as mesh_motion_of
from .kinematics import rotate_inertia, scatter_coordinates, update_accelerations, update_positions, update_velocities
from .reaction_friction import (
    clear_reaction_friction,
    solve_reaction_friction,
    store_bearing_loads,
    update_reaction_friction,
)
from .rnea import inverse_dynamics

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, BodyRecord, State
    from solvers.compiled.record import Reals


@inlined
def update_kinematics(t: float, q: Reals, v: Reals, arrays: Arrays, state: State) -> None:
    """Positions, velocities and applied forces at (t, q, v)."""
    scatter_coordinates(t, q, v, arrays, state)
    update_positions(arrays, state)
    update_velocity_level(t, arrays, state)


@inlined
def update_velocity_level(t: float, arrays: Arrays, state: State) -> None:
    """Velocities and applied forces of the bodies as they are placed."""
    rotate_inertia(arrays, state)
    update_velocities(arrays, state)
    clear_reaction_friction(state)
    apply_loads(t, arrays, state)
    evaluate_constraints(arrays, state)


@inlined
def evaluate_position_rate(arrays: Arrays, q: Reals, v: Reals, qdot: Reals) -> None:
    """qdot (nq,) = N(q) v over the free coordinates."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.vf < 0:
            continue
        plain = body.nq - 4 * body.quaternion
        for k in range(plain):
            qdot[body.qf + k] = v[body.vf + k]
        if body.quaternion == 1:
            quaternion_rate(q, body.qf + plain, v, body.vf + plain, qdot)


@inlined
def gather_free(values: Reals, arrays: Arrays, out: Reals) -> None:
    """out (n,) = values (nv,) at the free coordinates."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.vf >= 0:
            for k in range(body.nv):
                out[body.vf + k] = values[body.vi + k]
    states = arrays.world[0].states
    for k in range(states):
        out[out.shape[0] - states + k] = values[values.shape[0] - states + k]


@inlined
def evaluate_motion_terms(q: Reals, v: Reals, arrays: Arrays, state: State, terms: Terms) -> None:
    """The terms of the bodies as they move; the free accelerations are zero while the bias is taken."""
    update_accelerations(arrays, state)
    inverse_dynamics(arrays, state)
    gather_free(state.tau, arrays, terms.h)
    store_bearing_loads(arrays, state)
    composite_inertia(arrays, state)
    mass_matrix(arrays, state, terms.M)
    right_hand_side(arrays, state, terms.gamma)
    evaluate_position_rate(arrays, q, v, terms.qdot)
    decouple_locked_joints(arrays, terms)
    solve_reaction_friction(arrays, state, terms)


@kernel
def decouple_locked_joints(arrays: Arrays, terms: Terms) -> None:
    """Let the accelerations of locked joints be zero, which follow signals and have free coordinates (native FMUs)."""
    if arrays.world[0].drives == 0:
        return
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.drive < 0 or body.vf < 0:
            continue
        k = body.vf
        for j in range(terms.M.shape[0]):
            if j != k:
                terms.M[k, j], terms.M[j, k] = 0.0, 0.0
        terms.h[k] = 0.0


@system_kernel
def dynamics(t: float, q: Any, v: Any, data: Any, terms: Any) -> None:
    """Every term of the equations of motion."""
    arrays, state = data.arrays, data.state
    update_kinematics(t, q, v, arrays, state)
    jacobian(arrays, state, terms.Phi, terms.J, terms.nu)
    evaluate_motion_terms(q, v, arrays, state, terms)


@system_kernel
def motion(t: float, q: Any, v: Any, data: Any, terms: Any) -> None:
    """Every term but Phi, J and nu, at the position :func:`position` was called for last."""
    arrays, state = data.arrays, data.state
    scatter_coordinates(t, q, v, arrays, state)
    update_velocity_level(t, arrays, state)
    evaluate_motion_terms(q, v, arrays, state, terms)


@system_kernel
def inverse(t: float, q: Any, v: Any, a: Any, lam: Any, data: Any, qdot: Any, tau: Any) -> None:
    """qdot (nq,) = N v and tau (n,) = M a + h + J^T lambda, by the recursions alone."""
    inverse_dynamics_at_solution(t, q, v, a, lam, data)
    gather_free(data.state.tau, data.arrays, tau)
    evaluate_position_rate(data.arrays, q, v, qdot)


@system_kernel
def forward(t: float, q: Any, v: Any, data: Any, qdot: Any, a: Any) -> int:
    """qdot (nq,) = N v and a (n,) with M a + h = 0, by articulated bodies; 1 where a coordinate moves no mass."""
    arrays, state = data.arrays, data.state
    update_kinematics(t, q, v, arrays, state)
    code = forward_dynamics(arrays, state)
    if arrays.world[0].drives == 1:
        drive_efforts(arrays, state)
    gather_free(state.a, arrays, a)
    evaluate_position_rate(arrays, q, v, qdot)
    return code


@system_kernel
def mobility(r: Any, data: Any, x: Any) -> None:
    """x (n,) = M^-1 r (n,) where :func:`forward` was called for last."""
    apply_inverse_mass_matrix(data.arrays, data.state, r, x)


@system_kernel
def constraints(t: float, q: Any, v: Any, data: Any, terms: Any) -> None:
    """Phi, J, nu and gamma alone."""
    arrays, state = data.arrays, data.state
    update_kinematics(t, q, v, arrays, state)
    jacobian(arrays, state, terms.Phi, terms.J, terms.nu)
    update_accelerations(arrays, state)
    right_hand_side(arrays, state, terms.gamma)


@system_kernel
def position(t: float, q: Any, data: Any, terms: Any) -> None:
    """Phi, J and nu alone; free velocities left in the state do not enter."""
    arrays, state = data.arrays, data.state
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.drive >= 0:
            scatter_drive(t, body, arrays, state)
        else:
            for k in range(body.nq):
                state.q[body.qi + k] = q[body.qf + k]
    update_positions(arrays, state)
    evaluate_constraints(arrays, state)
    jacobian(arrays, state, terms.Phi, terms.J, terms.nu)


@system_kernel
def retract(q: Any, dq: Any, data: Any) -> None:
    """q <- q + N(q) dq, quaternions brought back to unit length."""
    arrays = data.arrays
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.vf < 0:
            continue
        plain = body.nq - 4 * body.quaternion
        for k in range(plain):
            q[body.qf + k] += dq[body.vf + k]
        if body.quaternion == 1:
            rotate_quaternion(q, body.qf + plain, dq, body.vf + plain)


@system_kernel
def energy(t: float, q: Reals, v: Reals, data: Data) -> float:
    """Kinetic and potential energy, J."""
    arrays, state = data.arrays, data.state
    scatter_coordinates(t, q, v, arrays, state)
    update_positions(arrays, state)
    rotate_inertia(arrays, state)
    update_velocities(arrays, state)
    return placed_energy(data)


@kernel
def placed_energy(data: Data) -> float:
    """Kinetic and potential energy of the bodies as they are placed and move, J."""
    arrays, state = data.arrays, data.state
    return kinetic_energy(arrays, state) + potential_energy(arrays, state)


@kernel
def watch_sensors(t: float, q: Reals, v: Reals, parts: Any, data: Data, values: Reals) -> None:
    """Values of parts that are sensors of positions, velocities and states, at (t, q, v)."""
    arrays, state = data.arrays, data.state
    scatter_coordinates(t, q, v, arrays, state)
    update_positions(arrays, state)
    rotate_inertia(arrays, state)
    update_velocities(arrays, state)
    for k in range(parts.shape[0]):
        values[k] = part_sensor_value(parts[k], arrays, state)


@system_kernel
def power(t: float, q: Any, v: Any, a: Any, lam: Any, data: Any) -> float:
    """dE/dt at the solution (q, v, a, lam), W; :func:`dynamics` or :func:`motion` was called last for (t, q, v)."""
    arrays, state = data.arrays, data.state
    if arrays.world[0].nonconservative == 0:
        return 0.0
    if arrays.world[0].drives == 1:
        update_acceleration_level(a, lam, arrays, state)
    return power_of(t, arrays, state)


@system_kernel
def solved_power(t: float, q: Any, v: Any, a: Any, lam: Any, data: Any) -> float:
    """dE/dt, W, at the solution that :func:`inverse` or :func:`forward` was called last for."""
    arrays, state = data.arrays, data.state
    return power_of(t, arrays, state) if arrays.world[0].nonconservative == 1 else 0.0


@system_kernel
def evaluate_energy_bound(rtol: float, q_tol: Any, v_tol: Any, data: Any, out: Any) -> None:
    """See :func:`.energy.evaluate_energy_bound`; the last call was :func:`dynamics`, or :func:`inverse` of a = 0
    and lam = 0.
    """
    energy_bound_of(rtol, q_tol, v_tol, data.arrays, data.state, out)


@system_kernel
def inertia_parts(data: Any, out: Any) -> None:
    """See :func:`.energy.inertia_parts`; :func:`inverse` or :func:`forward` was called last."""
    inertia_parts_of(data.arrays, data.state, out)


@system_kernel
def longest_load_step(taken: float, data: Data) -> float:
    """See :func:`.active_loads.longest_load_step`; the bodies move as in the last evaluation."""
    longest: float = active_loads.longest_load_step(taken, data.arrays, data.state)
    return longest


@kernel
def begin_histories(t: float, data: Data) -> None:
    """Let loads begin their histories where the bodies were placed last, at time t (s): as at the end of a step."""
    data.state.time[0] = t
    active_loads.longest_load_step(np.inf, data.arrays, data.state)


@system_kernel
def mesh_motion(dq: Any, mask: Any, data: Any, out: Any) -> None:
    """See :func:`.kinematics.mesh_motion`, at the last position."""
    mesh_motion_of(dq, mask, data.arrays, data.state, out)


@inlined
def scatter_free(a: Reals, arrays: Arrays, state: State) -> None:
    """Combine the free accelerations a (n,) with those of the drives."""
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.vf >= 0:
            for k in range(body.nv):
                state.a[body.vi + k] = a[body.vf + k]
    states = arrays.world[0].states
    for k in range(states):
        state.a[state.a.shape[0] - states + k] = a[a.shape[0] - states + k]


@kernel
def inverse_dynamics_at_solution(t: float, q: Reals, v: Reals, a: Reals, lam: Reals, data: Data) -> None:
    """Put the solution (q, v, a, lam) into the state: motion of all bodies, joint wrenches, drive efforts."""
    update_kinematics(t, q, v, data.arrays, data.state)
    update_acceleration_level(a, lam, data.arrays, data.state)


@inlined
def update_acceleration_level(a: Reals, lam: Reals, arrays: Arrays, state: State) -> None:
    """Accelerations, joint wrenches and drive efforts of the solution, bodies moving and loaded as they do there."""
    scatter_free(a, arrays, state)
    update_accelerations(arrays, state)
    load_constraints(lam, arrays, state)
    inverse_dynamics(arrays, state)
    update_reaction_friction(arrays, state)


@kernel
def observe(t: float, q: Reals, v: Reals, a: Reals, lam: Reals, data: Data, out: Reals) -> None:
    """The first outputs, up to the length of the array, at the solution (q, v, a, lam)."""
    update_kinematics(t, q, v, data.arrays, data.state)
    evaluate_outputs(a, lam, data, out)


@system_kernel
def evaluate_outputs(a: Reals, lam: Reals, data: Data, out: Reals) -> None:
    """:func:`observe` where the bodies move as at that solution."""
    arrays, state = data.arrays, data.state
    update_acceleration_level(a, lam, arrays, state)
    for i in range(out.shape[0]):
        if arrays.sensors[i].energy == 1:
            state.energy[0], state.energy[1] = kinetic_energy(arrays, state), potential_energy(arrays, state)
            break
    for i in range(out.shape[0]):
        out[i] = read_sensor(arrays.sensors[i], lam, arrays, state)


@kernel
def observe_all(times: Reals, q: Reals, v: Reals, a: Reals, lam: Reals, data: Data, out: Reals) -> None:
    """:func:`observe` at each of ``times``, in a row of ``out`` each."""
    for i in range(times.shape[0]):
        observe(times[i], q[i], v[i], a[i], lam[i], data, out[i])


@kernel
def input_step_limit(t: float, data: Data) -> tuple[float, float]:
    """The longest step from t on that misses no signal, and until when it does not, s."""
    longest, until = np.inf, np.inf
    for k in range(data.arrays.signals.shape[0]):
        step, end = longest_step(k, t, data.arrays)
        longest, until = min(longest, step), min(until, end)
    return longest, until


@kernel
def scatter_drive(t: float, body: BodyRecord, arrays: Arrays, state: State) -> None:
    """Position and velocity of a driven coordinate."""
    state.q[body.qi], state.v[body.vi], _ = signal(body.drive, t, arrays)


@kernel
def rotate_quaternion(q: Reals, i: int, dq: Reals, j: int) -> None:
    """e <- e + e (0, dq) / 2, normalized."""
    w, x, y, z = q[i], q[i + 1], q[i + 2], q[i + 3]
    a, b, c = 0.5 * dq[j], 0.5 * dq[j + 1], 0.5 * dq[j + 2]
    q[i] = w - x * a - y * b - z * c
    q[i + 1] = x + w * a + y * c - z * b
    q[i + 2] = y + w * b + z * a - x * c
    q[i + 3] = z + w * c + x * b - y * a
    norm = np.sqrt(q[i] * q[i] + q[i + 1] * q[i + 1] + q[i + 2] * q[i + 2] + q[i + 3] * q[i + 3])
    for k in range(4):
        q[i + k] /= norm
