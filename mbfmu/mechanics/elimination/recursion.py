"""The two passes over the fronts: elimination in their order, and solution in the reverse one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.compiled.matrix_view import matrix_at
from solvers.system import DROPPED, DROPPED_LENGTH, DROPPED_RESIDUAL, RANK, SHORTEST

from .assembly import (
    ACCELERATION,
    add_body,
    add_coupling_equation,
    add_cut_equation,
    add_messages,
    clear_front,
    express_motion,
    place_joint,
)
from .front import eliminate_free, solve_equations, store_solution, substitute_pivots
from .message import store_message

if TYPE_CHECKING:
    from mbfmu.mechanics.elimination.records import EliminationArrays, EliminationMemory, FrontRecord
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


@kernel
def eliminate(
    mode: int, drop: float, arrays: Arrays, state: State, own: EliminationArrays, memory: EliminationMemory,
    report: Reals,
) -> bool:  # fmt: skip
    """Eliminate all fronts; False: a free direction moves no mass.

    Equations that become shorter than ``drop`` are left out. ``report`` (ELIMINATION_REPORT_SIZE,): the rank, the
    number of equations left out, the shortest equation or pivot, the longest equation left out and the largest residual
    of these.
    """
    report[RANK], report[DROPPED], report[SHORTEST] = 0.0, 0.0, np.inf
    report[DROPPED_LENGTH], report[DROPPED_RESIDUAL] = 0.0, 0.0
    for k in range(own.fronts.shape[0]):
        front = own.fronts[k]
        assemble_front(mode, front, arrays, state, own, memory)
        n = front.ny + front.np
        front.rank, front.delayed, front.left = solve_equations(front.rows, front.ny, n, drop, memory, report)
        report[RANK] += front.rank
        store_pivots(front, n, memory)
        substitute_pivots(front.rank, front.ny, n, memory)
        if not eliminate_free(front.rank, front.delayed, front.ny, n, memory):
            return False
        store_front(front, n, memory)
        store_message(front, memory, drop, report)
    return True


@kernel
def assemble_front(
    mode: int, front: FrontRecord, arrays: Arrays, state: State, own: EliminationArrays, memory: EliminationMemory
) -> None:
    """Assemble quadratic form and equations of a front over the coordinates to eliminate and the interface."""
    front.ny, front.rows = 0, 0
    for m in range(front.first_message, front.end_message):
        sender = own.fronts[own.messages[m]]
        sender.at_delayed, sender.at_rows = front.ny, front.rows
        front.ny += sender.delayed
        front.rows += sender.left
    first = front.rows
    front.ny += front.nv
    front.rows += front.end_row - front.first_row
    begin = front.ny - front.nv
    clear_front(front.rows, front.ny, front.ny + front.np + 6, memory)
    add_messages(front, own, memory)
    if mode == ACCELERATION:
        add_body(front, arrays.bodies[front.body], state.bodies[front.body], state, own, memory)
    else:
        for c in range(front.nv):
            memory.H[begin + c, begin + c] += 1.0
    for e in range(front.first_row, front.end_row):
        equation, row = own.equations[e], first + e - front.first_row
        if equation.coupling >= 0:
            add_coupling_equation(mode, equation, row, begin, arrays, state, own, memory)
        else:
            cut = arrays.cuts[equation.cut]
            add_cut_equation(mode, equation, row, begin, arrays, state, own, memory, cut.a, cut.b)
    place_joint(mode, front, arrays, state, own, memory)
    express_motion(front, front.rows, state, own, memory)


@kernel
def store_pivots(front: FrontRecord, n: int, memory: EliminationMemory) -> None:
    """Keep what the multipliers are made of: operations on the equations, pivots, and their rows of H and g."""
    values, rank, rows = memory.values, front.rank, front.rows
    E, L, F = (
        matrix_at(values, front.E, rows, rows),
        matrix_at(values, front.L, rank, rank),
        matrix_at(values, front.F, rank, n),
    )
    for i in range(rank + front.left):
        for c in range(rows):
            E[i, c] = memory.E[i, c]
    for a in range(rank):
        values[front.f + a] = memory.g[a]
        for b in range(a + 1):
            L[a, b] = memory.R[a, b]
        for c in range(n):
            F[a, c] = memory.H[a, c]


@kernel
def store_front(front: FrontRecord, n: int, memory: EliminationMemory) -> None:
    """Keep the solution in terms of what remains."""
    values, ny, rank, delayed, nz = memory.values, front.ny, front.rank, front.delayed, front.delayed + front.np
    gain, Q = matrix_at(values, front.gain, ny, nz), matrix_at(values, front.Q, ny, ny)
    store_solution(rank, delayed, ny, n, memory, values[front.shift : front.shift + ny], gain)
    for i in range(ny):
        for j in range(ny):
            Q[i, j] = memory.Q[i, j]


@kernel
def recover(
    mode: int, arrays: Arrays, state: State, own: EliminationArrays, memory: EliminationMemory, x: Reals
) -> None:
    """x (n,), the accelerations or the changes of the coordinates, after :func:`eliminate`.

    The accelerations of first-order states are their rates; corrections do not change states.
    """
    states = arrays.world[0].states
    for k in range(states):
        rate = state.Q[state.Q.shape[0] - states + k] if mode == ACCELERATION else 0.0
        x[x.shape[0] - states + k] = rate
    for k in range(own.fronts.shape[0] - 1, -1, -1):
        front = own.fronts[k]
        gather_interface(front, own, memory)
        ny, values, z = front.ny, memory.values, memory.z
        gain, Q = matrix_at(values, front.gain, ny, front.delayed + front.np), matrix_at(values, front.Q, ny, ny)
        for a in range(ny):
            memory.w[a] = values[front.shift + a]
            for j in range(front.delayed + front.np):
                memory.w[a] -= gain[a, j] * z[j]
        for i in range(ny):
            total = 0.0
            for a in range(ny):
                total += Q[i, a] * memory.w[a]
            values[front.y + i] = total
        begin = ny - front.nv
        for c in range(front.nv):
            memory.x[front.vf + c] = values[front.y + begin + c]
            x[front.vf + c] = memory.x[front.vf + c] * own.size[front.vf + c]
        move_body(mode, front, arrays, state, own, memory)


@kernel
def gather_interface(front: FrontRecord, own: EliminationArrays, memory: EliminationMemory) -> None:
    """z: the delayed directions and the interface of a front, from those that are solved."""
    z, at = memory.z, front.delayed
    if front.target >= 0:
        target = own.fronts[front.target]
        for j in range(front.delayed):
            z[j] = memory.values[target.y + front.at_delayed + j]
    for v in range(front.first_variable, front.end_variable):
        variable = own.variables[v]
        if variable.coordinate >= 0:
            z[at] = memory.x[variable.coordinate]
            at += 1
        else:
            for k in range(6):
                z[at + k] = memory.motions[variable.body, k]
            at += 6


@kernel
def move_body(
    mode: int, front: FrontRecord, arrays: Arrays, state: State, own: EliminationArrays, memory: EliminationMemory
) -> None:
    """Scaled motion of the body of a front, from that of its parent and its coordinates."""
    place_joint(mode, front, arrays, state, own, memory)
    here, parent, length = state.bodies[front.body], state.bodies[front.parent], own.length[0]
    Y, Yj = memory.motions[front.body], memory.motions[front.parent]
    x, y, z = (here.r[0] - parent.r[0]) / length, (here.r[1] - parent.r[1]) / length, (here.r[2] - parent.r[2]) / length
    for k in range(6):
        Y[k] = memory.bias[k] + (Yj[k] if front.parent > 0 else 0.0)
        for c in range(front.ns):
            Y[k] += memory.S[c, k] * memory.x[front.vf + c]
    if front.parent > 0:
        Y[0] += Yj[4] * z - Yj[5] * y
        Y[1] += Yj[5] * x - Yj[3] * z
        Y[2] += Yj[3] * y - Yj[4] * x


@kernel
def multipliers(own: EliminationArrays, memory: EliminationMemory, lam: Reals) -> None:
    """lam (m,) with J^T lam = -(M a + h), after :func:`recover` of accelerations; zero of equations that are left out.

    H x + g + R^T lam = 0 in the pivots of every front, with the multipliers of the equations that have remained.
    """
    values, mu = memory.values, memory.mu
    for i in range(lam.shape[0]):
        lam[i] = 0.0
    for k in range(own.fronts.shape[0] - 1, -1, -1):
        front = own.fronts[k]
        ny, rank, rows, n = front.ny, front.rank, front.rows, front.ny + front.np
        E, L, F = (
            matrix_at(values, front.E, rows, rows),
            matrix_at(values, front.L, rank, rank),
            matrix_at(values, front.F, rank, n),
        )
        gather_interface(front, own, memory)
        rotate_back(front, memory)
        for a in range(rank - 1, -1, -1):
            total = -values[front.f + a]
            for c in range(ny):
                total -= F[a, c] * memory.w[c]
            for c in range(ny, n):
                total -= F[a, c] * memory.z[front.delayed + c - ny]
            for b in range(a + 1, rank):
                total -= L[b, a] * mu[b]
            mu[a] = total / L[a, a]
        for i in range(front.left):
            mu[rank + i] = values[front.lam + i]
        for c in range(rows):
            memory.arrived[c] = 0.0
            for i in range(rank + front.left):
                memory.arrived[c] += E[i, c] * mu[i]
        hand_on(front, own, memory, lam)


@kernel
def rotate_back(front: FrontRecord, memory: EliminationMemory) -> None:
    """memory.w <- Q^T y of a front."""
    Q = matrix_at(memory.values, front.Q, front.ny, front.ny)
    for a in range(front.ny):
        memory.w[a] = 0.0
        for i in range(front.ny):
            memory.w[a] += Q[i, a] * memory.values[front.y + i]


@kernel
def hand_on(front: FrontRecord, own: EliminationArrays, memory: EliminationMemory, lam: Reals) -> None:
    """Multipliers of the equations that have arrived at a front, to where they come from."""
    at = 0
    for m in range(front.first_message, front.end_message):
        sender = own.fronts[own.messages[m]]
        gather_interface(sender, own, memory)
        nz = sender.delayed + sender.np
        lost = matrix_at(memory.values, sender.lost, sender.left, nz)
        for i in range(sender.left):
            memory.values[sender.lam + i] = memory.arrived[at + i] - memory.values[sender.known + i]
            for c in range(nz):
                memory.values[sender.lam + i] -= lost[i, c] * memory.z[c]
        at += sender.left
    for e in range(front.first_row, front.end_row):
        equation = own.equations[e]
        lam[equation.kept] = memory.arrived[at + e - front.first_row] / equation.length
