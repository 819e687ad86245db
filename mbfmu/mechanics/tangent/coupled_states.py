"""First-order states that are not condensed onto a coordinate, such as those of controllers: a Schur complement.

With the terms of :mod:`.states`, y for the coordinates and condensed states, and z for the k states that are left,

    [ T_yy  T_yz ] [ dy ]   [ r_y ]      X = T_yy^-1 T_yz,    (T_zz - T_zy X) dz = r_z - T_zy T_yy^-1 r_y,
    [ T_zy  T_zz ] [ dz ] = [ r_z ]      dy = T_yy^-1 r_y - X dz,

which takes k more solutions by the factors of T_yy, and the inverse of a matrix of k rows. The columns T_yz are
derivatives of the loads that read a state. The rows T_zy are derivatives of the rate of a state by what its load reads:
condensed states, joint coordinates, and motions of bodies, which are projected onto the coordinates as wrenches are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.dispatch import apply_load
from mbfmu.mechanics.kind import kernel_of
from mbfmu.mechanics.steps import COMPLEX_STEP_SIZE, NO_MOTION, release_bodies, step
from solvers.compiled.kernel import kernel
from solvers.linalg.inversion import invert
from solvers.system import Array

from .border import project_wrenches
from .layout import flat_list, is_local, offsets

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.loading import Acting
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


class StateUse(NamedTuple):
    """What a load reads besides its own states; only what it acts on and what its sensors observe are bodies."""

    states: Sequence[int]  # numbers of first-order states
    coordinates: Sequence[tuple[int, int]]  # bodies, and the numbers of coordinates of their joints
    bodies: Sequence[int]


class CoupledStates(NamedTuple):
    """The k states, what their rates read, and the equations that are left for them."""

    numbers: NDArray[np.int64]  # (k,) among all states
    loads: NDArray[np.int64]  # (k,) whose state it is
    first_body: NDArray[np.int64]  # (k + 1,) into ``bodies``
    bodies: NDArray[np.int64]  # that the rate of each reads
    first_coordinate: NDArray[np.int64]  # (k + 1,) into ``coordinates``
    coordinates: NDArray[np.int64]  # (..., 2) body and number of the coordinate
    first_condensed: NDArray[np.int64]  # (k + 1,) into ``condensed``
    condensed: NDArray[np.int64]  # numbers of the condensed states that the rate of each reads
    first_reader: NDArray[np.int64]  # (k + 1,) into ``readers``
    readers: NDArray[np.int64]  # loads that read each state
    columns: Array  # (k, n) T_yz, then X
    rows: Array  # (k, n) T_zy
    inverse: Array  # (k, k) of T_zz - T_zy X
    scratch: Array  # (k, k)
    order: NDArray[np.int64]  # (k,) scratch
    right: Array  # (k,)
    wrenches: Array  # (nb, 6) scratch

    @staticmethod
    def of(acting: Sequence[Acting], use: Sequence[StateUse], nb: int, n: int) -> CoupledStates:
        """Return the states that are not condensed of these loads, with what each load reads."""
        coupled, owner, condensed = coupled_states(acting), list[int](), set[int]()
        for k, a in enumerate(acting):
            if is_local(a.load):
                condensed |= set(range(len(owner), len(owner) + len(a.load.states)))
            owner += [k] * len(a.load.states)
        loads = [owner[number] for number in coupled]
        stepped = [kernel_of(a.load, "tangent") is None for a in acting] if coupled else []
        readers = [
            [k for k, own in enumerate(use) if stepped[k] and (k == load or number in own.states)]
            for number, load in zip(coupled, loads, strict=True)
        ]
        k, z, reads = len(coupled), np.zeros, [use[load] for load in loads]
        bodies, places = [list(own.bodies) for own in reads], [list(own.coordinates) for own in reads]
        within = [[number for number in own.states if number in condensed] for own in reads]
        return CoupledStates(
            numbers=np.array(coupled, np.int64),
            loads=np.array(loads, np.int64),
            first_body=offsets(bodies),
            bodies=flat_list(bodies),
            first_coordinate=offsets(places),
            coordinates=np.array([place for own in places for place in own], np.int64).reshape(-1, 2),
            first_condensed=offsets(within),
            condensed=flat_list(within),
            first_reader=offsets(readers),
            readers=flat_list(readers),
            columns=z((k, n)),
            rows=z((k, n)),
            inverse=z((k, k)),
            scratch=z((k, k)),
            order=z(k, np.int64),
            right=z(k),
            wrenches=z((nb if k else 0, 6)),
        )


def coupled_states(acting: Sequence[Acting]) -> list[int]:
    """Return the numbers of the states that are not condensed."""
    found, first = list[int](), 0
    for a in acting:
        found += [] if is_local(a.load) else range(first, first + len(a.load.states))
        first += len(a.load.states)
    return found


@kernel
def fill_column(
    j: int, c1: float, c2: float, arrays: Arrays, state: State, perturbed: State, own: CoupledStates
) -> None:
    """own.columns[j] (n,) <- T_yz of state j, own.inverse[:, j] <- T_zz."""
    column, n = own.columns[j], own.columns.shape[1]
    states = arrays.world[0].states
    first, z = state.v.shape[0] - states, state.v.shape[0] - states + own.numbers[j]
    release_bodies(state, perturbed)
    perturbed.v[z] = state.v[z] + c1 * COMPLEX_STEP_SIZE * 1j
    for r in range(own.first_reader[j], own.first_reader[j + 1]):
        apply_load(arrays.loads[own.readers[r]], state.time[0], arrays, perturbed)
    perturbed.v[z] = state.v[z]
    for i in range(state.bodies.shape[0]):
        for a in range(6):
            own.wrenches[i, a] = -perturbed.bodies[i].F[a].imag / COMPLEX_STEP_SIZE
    project_wrenches(own.wrenches, arrays, state, column)
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        for k in range(body.nv if body.vf >= 0 else 0):
            column[body.vf + k] -= perturbed.Q[body.vi + k].imag / COMPLEX_STEP_SIZE
    for k in range(states):
        column[n - states + k] = -perturbed.Q[first + k].imag / COMPLEX_STEP_SIZE
    column[n - states + own.numbers[j]] += c2
    for i in range(own.numbers.shape[0]):
        own.inverse[i, j] = column[n - states + own.numbers[i]]
        column[n - states + own.numbers[i]] = 0.0


@kernel
def change_of_rate(j: int, z: int, arrays: Arrays, state: State, perturbed: State, own: CoupledStates) -> float:
    """Minus the derivative of the rate of state j, which is at z in State.v, along the imaginary step."""
    perturbed.Q[z] = 0.0
    apply_load(arrays.loads[own.loads[j]], state.time[0], arrays, perturbed)
    return float(-perturbed.Q[z].imag / COMPLEX_STEP_SIZE)


@kernel
def fill_row(j: int, c1: float, arrays: Arrays, state: State, perturbed: State, own: CoupledStates) -> None:
    """own.rows[j] (n,) <- T_zy of state j."""
    row, n, states = own.rows[j], own.rows.shape[1], arrays.world[0].states
    first = state.v.shape[0] - states
    z = first + own.numbers[j]
    for k in range(n):
        row[k] = 0.0
    release_bodies(state, perturbed)
    for i in range(own.wrenches.shape[0]):
        for a in range(6):
            own.wrenches[i, a] = 0.0
    for b in range(own.first_body[j], own.first_body[j + 1]):
        i = own.bodies[b]
        for a in range(6):
            step(state.bodies[i], perturbed.bodies[i], a, c1)
            own.wrenches[i, a] = change_of_rate(j, z, arrays, state, perturbed, own)
        step(state.bodies[i], perturbed.bodies[i], NO_MOTION, 0.0)
    project_wrenches(own.wrenches, arrays, state, row)
    for b in range(own.first_coordinate[j], own.first_coordinate[j + 1]):
        body, k = arrays.bodies[own.coordinates[b, 0]], own.coordinates[b, 1]
        if body.vf < 0:
            continue
        q, v = body.qi + k, body.vi + k
        if k < body.nq - 4 * body.quaternion:
            perturbed.q[q] = state.q[q] + COMPLEX_STEP_SIZE * 1j
        perturbed.v[v] = state.v[v] + c1 * COMPLEX_STEP_SIZE * 1j
        row[body.vf + k] += change_of_rate(j, z, arrays, state, perturbed, own)
        perturbed.q[q], perturbed.v[v] = state.q[q], state.v[v]
    for b in range(own.first_condensed[j], own.first_condensed[j + 1]):
        number = own.condensed[b]
        perturbed.v[first + number] = state.v[first + number] + c1 * COMPLEX_STEP_SIZE * 1j
        row[n - states + number] = change_of_rate(j, z, arrays, state, perturbed, own)
        perturbed.v[first + number] = state.v[first + number]


@kernel
def reduce_to_states(own: CoupledStates) -> bool:
    """own.inverse <- (T_zz - T_zy X)^-1, where X are own.columns; False: it is singular."""
    for i in range(own.numbers.shape[0]):
        for j in range(own.numbers.shape[0]):
            total = 0.0
            for k in range(own.rows.shape[1]):
                total += own.rows[i, k] * own.columns[j, k]
            own.inverse[i, j] -= total
    return invert(own.inverse, own.order, own.scratch)


@kernel
def add_coupled_states(r: Reals, states: int, own: CoupledStates, dq: Reals) -> None:
    """dq (n,), the solution by T_yy alone, <- that of T for r (n,); ``states`` is the number of all states."""
    count, first = own.numbers.shape[0], dq.shape[0] - states
    for i in range(count):
        dq[first + own.numbers[i]] = 0.0
    for i in range(count):
        total = r[first + own.numbers[i]]
        for k in range(dq.shape[0]):
            total -= own.rows[i, k] * dq[k]
        own.right[i] = total
    for j in range(count):
        change = 0.0
        for i in range(count):
            change += own.inverse[j, i] * own.right[i]
        for k in range(dq.shape[0]):
            dq[k] -= own.columns[j, k] * change
        dq[first + own.numbers[j]] = change
