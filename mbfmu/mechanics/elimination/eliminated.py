"""Constraints eliminated front by front, as a solver calls it: accelerations, corrections and multipliers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbfmu.mechanics.records import Arrays, Data, State, empty_data
from mbfmu.mechanics.recursions import dynamics as recursions
from mbfmu.mechanics.recursions.aba import initialize_articulated_inertia
from mbfmu.mechanics.recursions.constraints import evaluate_constraints
from mbfmu.mechanics.recursions.dynamics import evaluate_position_rate, update_kinematics
from mbfmu.mechanics.recursions.kinematics import scatter_coordinates, update_positions, update_velocities
from solvers.compiled.kernel import inlined, kernel, system_kernel
from solvers.compiled.tuple_pointer import pin
from solvers.system import RESIDUAL, Array, EliminationEquations

from .assembly import ACCELERATION, POSITION, VELOCITY
from .records import EliminationArrays, EliminationMemory, example, lay_out
from .recursion import eliminate, multipliers, recover

# Equations shorter than this multiple of the residual are not used: redundant ones are as long as the residual.
REDUNDANT_LENGTH_PER_RESIDUAL, MAX_REDUNDANT_LENGTH = 30.0, 1e-3


class EliminationData(NamedTuple):
    """What the callbacks work on; all but the last is that of the mechanism."""

    arrays: Arrays
    state: State
    own: EliminationArrays
    memory: EliminationMemory


@kernel
def find_largest_residual(own: EliminationArrays, state: State) -> float:
    """Largest constraint residual, in units of the constraint equations."""
    largest = 0.0
    for e in range(own.equations.shape[0]):
        equation = own.equations[e]
        Phi = state.coupled[equation.coupling].Phi if equation.coupling >= 0 else state.rows[equation.row].Phi
        part = abs(Phi / own.row_size[equation.kept])
        if not (part <= largest or np.isnan(largest)):  # one that is not a number stays
            largest = part
    return largest


@inlined
def shortest_used(drop: float, residual: float) -> float:
    """Length below which equations are left out at a position with this residual."""
    return max(drop, min(REDUNDANT_LENGTH_PER_RESIDUAL * residual, MAX_REDUNDANT_LENGTH))


@system_kernel
def accelerate(
    t: float, q: Any, v: Any, elimination: Any, drop: float, loaded: bool, qdot: Any, a: Any, lam: Any, report: Any
) -> int:
    """qdot (nq,) = N v, accelerations a (n,) and, if ``loaded``, multipliers lam (m,); 1 where a motion has no mass.

    ``report``: see :func:`.recursion.eliminate`, and the largest residual.
    """
    arrays, state, own, memory = elimination.arrays, elimination.state, elimination.own, elimination.memory
    update_kinematics(t, q, v, arrays, state)
    report[RESIDUAL] = find_largest_residual(own, state)
    for k in range(3):
        state.bodies[0].dY[k] = -arrays.world[0].gravity[k]
    initialize_articulated_inertia(arrays, state)
    evaluate_position_rate(arrays, q, v, qdot)
    if not eliminate(ACCELERATION, shortest_used(drop, report[RESIDUAL]), arrays, state, own, memory, report):
        return 1
    recover(ACCELERATION, arrays, state, own, memory, a)
    if loaded:
        multipliers(own, memory, lam)
    return 0


@system_kernel
def correct_position(t: float, q: Any, elimination: Any, drop: float, closed: float, dq: Any, report: Any) -> None:
    """dq (n,): the shortest change of the coordinates, in units of their sizes, that closes the linearized constraints.

    It is zero if the largest residual is at most ``closed``, and then only that is reported.
    """
    arrays, state, own, memory = elimination.arrays, elimination.state, elimination.own, elimination.memory
    scatter_coordinates(t, q, state.v, arrays, state)
    update_positions(arrays, state)
    evaluate_constraints(arrays, state)
    report[RESIDUAL] = find_largest_residual(own, state)
    if report[RESIDUAL] <= closed:
        for i in range(dq.shape[0]):
            dq[i] = 0.0
        return
    eliminate(POSITION, shortest_used(drop, report[RESIDUAL]), arrays, state, own, memory, report)
    recover(POSITION, arrays, state, own, memory, dq)


@system_kernel
def correct_velocity(t: float, q: Any, v: Any, elimination: Any, drop: float, dv: Any, report: Any) -> None:
    """dv (n,): the shortest change of velocities, in units of the sizes of the coordinates, with J (v + dv) = nu."""
    arrays, state, own, memory = elimination.arrays, elimination.state, elimination.own, elimination.memory
    scatter_coordinates(t, q, v, arrays, state)
    update_positions(arrays, state)
    update_velocities(arrays, state)
    evaluate_constraints(arrays, state)
    report[RESIDUAL] = find_largest_residual(own, state)
    eliminate(VELOCITY, shortest_used(drop, report[RESIDUAL]), arrays, state, own, memory, report)
    recover(VELOCITY, arrays, state, own, memory, dv)


def empty_elimination() -> Any:
    """Return data of the callbacks of the types that all mechanisms have, pinned."""
    return _pinned(*empty_data(), *example())


def _pinned(*parts: Any) -> Any:
    return pin(EliminationData(*(pin(part) for part in parts)))


def find_loop_mask(arrays: Arrays, count: int) -> Array:
    """Return 1 for the free coordinates (``count``,) that constraints may contain, 0 for the others.

    Constraints may contain those of joints between the bodies of a cut joint, and coupled ones.
    """
    bodies, inside = arrays.bodies, np.zeros(len(arrays.bodies), bool)
    a, b = arrays.cuts["a"], arrays.cuts["b"]
    while len(a):  # a body has a greater number than its parent
        apart = a != b
        outer, b = np.maximum(a, b)[apart], np.minimum(a, b)[apart]
        inside[outer] = True
        a = bodies["parent"][outer]
    found = np.zeros(count)
    for body in bodies[inside & (bodies["vf"] >= 0)]:  # of a section these are the amplitudes
        found[body["vf"] : body["vf"] + body["nv"]] = 1.0
    for end in (int(coupling[name]) for coupling in arrays.couplings for name in ("fa", "fb")):
        if end >= 0:
            found[end] = 1.0
    return found


def eliminate_constraints(
    arrays: Arrays, state: State, size: Array, row_size: Array, length: float
) -> EliminationEquations:
    """Return the equations of a mechanism with its constraints eliminated, pinned; see :func:`.records.lay_out`."""
    elimination = _pinned(arrays, state, *lay_out(arrays, size, row_size, length))
    mask = find_loop_mask(arrays, len(size))
    equations: EliminationEquations = pin(
        EliminationEquations(
            accelerate,
            correct_position,
            correct_velocity,
            recursions.inverse,
            recursions.retract,
            recursions.solved_power,
            recursions.evaluate_energy_bound,
            recursions.longest_load_step,
            pin(Data(arrays, state)),
            elimination,
            mask,
        )
    )
    return equations
