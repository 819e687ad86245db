"""What a front is made of: messages, the inertia and the constraint equations of its body; and its unknowns.

The acceleration of the body is expressed by that of its parent and the coordinates of the joint (see
:mod:`mbfmu.mechanics.recursions.kinematics`), which makes them the columns of the front::

    Y'_i = X Y'_j + S v' + b

In the two modes of corrections there is no inertia and no bias, and the quadratic form is the sum of the squares of the
scaled coordinates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.recursions.aba import RHS_COLUMN
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.matrix_view import matrix_at

if TYPE_CHECKING:
    from mbfmu.mechanics.elimination.records import (
        EliminationArrays,
        EliminationMemory,
        EquationRecord,
        FrontRecord,
    )
    from mbfmu.mechanics.records import Arrays, BodyRecord, MotionRecord, State
    from solvers.compiled.record import Reals

ACCELERATION, POSITION, VELOCITY = range(3)  # modes: what is solved for
NO_PLACE = -1  # see records.NONE


@inlined
def scale_motion(Y: Reals, length: float, out: Reals) -> None:
    """out <- Y with its linear part in units of ``length``."""
    for k in range(3):
        out[k] = Y[k] / length
        out[3 + k] = Y[3 + k]


@kernel
def clear_front(rows: int, ny: int, n: int, memory: EliminationMemory) -> None:
    """Zero the front of ``rows`` equations and n columns; no operations, no rotation."""
    for i in range(n):
        memory.g[i] = 0.0
        for j in range(n):
            memory.H[i, j] = 0.0
    for i in range(rows):
        memory.r[i], memory.unit[i] = 0.0, 1.0
        for j in range(n):
            memory.R[i, j] = 0.0
        for j in range(rows):
            memory.E[i, j] = 1.0 if i == j else 0.0
    for i in range(ny):
        for j in range(ny):
            memory.Q[i, j] = 1.0 if i == j else 0.0


@kernel
def add_messages(front: FrontRecord, own: EliminationArrays, memory: EliminationMemory) -> None:
    """Add the messages of other fronts. Their delayed directions are the first columns."""
    values, begin = memory.values, front.ny - front.nv
    for m in range(front.first_message, front.end_message):
        sender = own.fronts[own.messages[m]]
        nz = sender.delayed + sender.np
        H, R = matrix_at(values, sender.H, nz, nz), matrix_at(values, sender.R, sender.left, nz)
        for i in range(nz):
            to = sender.at_delayed + i if i < sender.delayed else begin + own.places[sender.map + i - sender.delayed]
            memory.g[to] += values[sender.g + i]
            for j in range(nz):
                at = (
                    sender.at_delayed + j if j < sender.delayed else begin + own.places[sender.map + j - sender.delayed]
                )
                memory.H[to, at] += H[i, j]
            for row in range(sender.left):
                memory.R[sender.at_rows + row, to] = R[row, i]
        for row in range(sender.left):
            memory.r[sender.at_rows + row] = values[sender.r + row]
            memory.unit[sender.at_rows + row] = values[sender.unit + row]


@inlined
def is_locked(front: FrontRecord, body: BodyRecord) -> bool:
    """Whether the joint is locked but has a free coordinate (native FMUs), which is a column that moves nothing."""
    return front.vf >= 0 and body.drive >= 0


@kernel
def add_body(
    front: FrontRecord, body: BodyRecord, here: MotionRecord, state: State, own: EliminationArrays,
    memory: EliminationMemory,
) -> None:  # fmt: skip
    """Add inertia and bias of the body, columns from ``n`` on, and the inertia and the forces along the coordinates of
    its joint.
    """
    H, g, length, begin = memory.H, memory.g, own.length[0], front.ny - front.nv
    n = front.ny + front.np
    for i in range(6):
        unit = length if i < 3 else 1.0
        g[n + i] += unit * here.pA[i]
        for j in range(6):
            H[n + i, n + j] += unit * (length if j < 3 else 1.0) * here.IA[i, j]
    if is_locked(front, body):
        H[begin, begin] += 1.0
        return
    for k in range(front.nv):
        g[begin + k] -= own.size[front.vf + k] * state.Q[front.vi + k]
    if front.is_flexible == 1:
        add_amplitudes(front, state, own, memory)
    if front.nv > 0 and body.armature != 0.0:
        H[begin, begin] += own.size[front.vf] * own.size[front.vf] * body.armature


@kernel
def add_amplitudes(front: FrontRecord, state: State, own: EliminationArrays, memory: EliminationMemory) -> None:
    """Add inertia and bias of the amplitudes of a flexible body, which do not move its frame.

    They are those of :func:`mbfmu.mechanics.recursions.aba.initialize_flexible_inertia`.
    """
    H, g, length, begin, n = memory.H, memory.g, own.length[0], front.ny - front.nv, front.ny + front.np
    for c in range(front.nv):
        at, row, size = front.vi + c, begin + c, own.size[front.vf + c]
        g[row] -= size * state.D[at, RHS_COLUMN]
        H[row, row] += size * size * state.D[at, c]
        for k in range(6):
            entry = size * (length if k < 3 else 1.0) * state.U[at, k]
            H[row, n + k] += entry
            H[n + k, row] += entry


@kernel
def enter_motion(G: Reals, at: int, length: float, row: int, memory: EliminationMemory) -> float:
    """Add a wrench to equation ``row`` at the motion in column ``at``; return the square of its scaled length."""
    square = 0.0
    for k in range(6):
        entry = G[k] * (length if k < 3 else 1.0)
        memory.R[row, at + k] += entry
        square += entry * entry
    return square


@kernel
def known_motion(mode: int, body: int, G: Reals, state: State) -> float:
    """Power of the wrench G on the acceleration, or the velocity, of a body; zero in corrections of positions."""
    total = 0.0
    if mode == POSITION:
        return total
    here = state.bodies[body]
    for k in range(6):
        total += G[k] * (here.dY[k] if mode == ACCELERATION else here.Y[k])
    return total


@kernel
def add_cut_equation(
    mode: int, equation: EquationRecord, row: int, begin: int, arrays: Arrays, state: State,
    own: EliminationArrays, memory: EliminationMemory, a: int, b: int,
) -> None:  # fmt: skip
    """Equation ``row`` of the front: Ga . Y_a + Gb . Y_b = r, between bodies a and b."""
    here, length, square = state.rows[equation.row], own.length[0], 0.0
    if equation.a >= 0:
        square += enter_motion(here.Ga, begin + equation.a, length, row, memory)
    if equation.b >= 0:
        square += enter_motion(here.Gb, begin + equation.b, length, row, memory)
    if mode == ACCELERATION:
        r = -here.bias
        if equation.a < 0:
            r -= known_motion(mode, a, here.Ga, state)
        if equation.b < 0:
            r -= known_motion(mode, b, here.Gb, state)
    elif mode == POSITION:
        r = -here.Phi
    else:
        r = -known_motion(mode, a, here.Ga, state) - known_motion(mode, b, here.Gb, state)
    finish_equation(equation, r, square, row, memory)


@inlined
def finish_equation(equation: EquationRecord, r: float, square: float, row: int, memory: EliminationMemory) -> None:
    """Scale an equation to length one, and enter its right-hand side."""
    equation.length = np.sqrt(square) if square > 0.0 else 1.0
    memory.r[row], memory.unit[row] = r / equation.length, 1.0
    for c in range(memory.R.shape[1]):
        memory.R[row, c] /= equation.length


@kernel
def add_coupling_equation(
    mode: int, equation: EquationRecord, row: int, begin: int, arrays: Arrays, state: State,
    own: EliminationArrays, memory: EliminationMemory,
) -> None:  # fmt: skip
    """Equation ``row`` of the front: v'_a - f' v'_b = r (see :mod:`mbfmu.mechanics.recursions.constraints`)."""
    coupling, here, square = arrays.couplings[equation.coupling], state.coupled[equation.coupling], 0.0
    r = 0.0
    if mode == POSITION:
        r = -here.Phi
    elif mode == VELOCITY:
        r = here.slope * state.v[coupling.vb] - state.v[coupling.va]
    else:
        r = here.bend * state.v[coupling.vb] * state.v[coupling.vb]
    if equation.a >= 0 and coupling.fa >= 0:
        entry = own.size[coupling.fa]
        memory.R[row, begin + equation.a] += entry
        square += entry * entry
    elif mode == ACCELERATION:
        r -= state.a[coupling.va]
    if equation.b >= 0 and coupling.fb >= 0:
        entry = -here.slope * own.size[coupling.fb]
        memory.R[row, begin + equation.b] += entry
        square += entry * entry
    elif mode == ACCELERATION:
        r += here.slope * state.a[coupling.vb]
    finish_equation(equation, r, square, row, memory)


@kernel
def place_joint(
    mode: int, front: FrontRecord, arrays: Arrays, state: State, own: EliminationArrays, memory: EliminationMemory
) -> None:
    """Fill S of the free coordinates, and the acceleration b of the body where all unknowns are zero, both scaled."""
    length, S, bias = own.length[0], memory.S, memory.bias
    moves = 0.0 if is_locked(front, arrays.bodies[front.body]) else 1.0
    for c in range(front.ns):
        for k in range(6):
            S[c, k] = moves * state.S[front.si + c, k] * own.size[front.vf + c] / (length if k < 3 else 1.0)
    for k in range(6):
        bias[k] = 0.0
    if mode != ACCELERATION:
        return
    body, here = arrays.bodies[front.body], state.bodies[front.body]
    for k in range(6):
        bias[k] = here.beta[k]
    if front.vf < 0:
        for c in range(body.nv):
            for k in range(6):
                bias[k] += state.S[front.si + c, k] * state.a[front.vi + c]
    if front.parent == 0:
        for k in range(6):
            bias[k] += state.bodies[0].dY[k]
    scale_motion(bias, length, bias)


@kernel
def express_motion(
    front: FrontRecord, rows: int, state: State, own: EliminationArrays, memory: EliminationMemory
) -> None:
    """Express the motion of the body, the last six columns, by its coordinates and the motion of its parent."""
    H, g, R, S, bias, n = memory.H, memory.g, memory.R, memory.S, memory.bias, front.ny + front.np
    here, parent, length, begin = (
        state.bodies[front.body],
        state.bodies[front.parent],
        own.length[0],
        front.ny - front.nv,
    )
    x, y, z = (here.r[0] - parent.r[0]) / length, (here.r[1] - parent.r[1]) / length, (here.r[2] - parent.r[2]) / length
    first = begin + front.at_joint
    for i in range(n + 6):
        for k in range(6):
            g[i] += H[i, n + k] * bias[k]
    for i in range(n + 6):
        express_row(H, i, n, begin, front, x, y, z, S)
    for j in range(n):
        for c in range(front.ns):
            total = 0.0
            for k in range(6):
                total += S[c, k] * H[n + k, j]
            H[first + c, j] += total
        if front.at_parent >= 0:
            to = begin + front.at_parent
            for k in range(6):
                H[to + k, j] += H[n + k, j]
            H[to + 3, j] += y * H[n + 2, j] - z * H[n + 1, j]
            H[to + 4, j] += z * H[n, j] - x * H[n + 2, j]
            H[to + 5, j] += x * H[n + 1, j] - y * H[n, j]
    for c in range(front.ns):
        for k in range(6):
            g[first + c] += S[c, k] * g[n + k]
    if front.at_parent >= 0:
        to = begin + front.at_parent
        for k in range(6):
            g[to + k] += g[n + k]
        g[to + 3] += y * g[n + 2] - z * g[n + 1]
        g[to + 4] += z * g[n] - x * g[n + 2]
        g[to + 5] += x * g[n + 1] - y * g[n]
    for i in range(rows):
        for k in range(6):
            memory.r[i] -= R[i, n + k] * bias[k]
        express_row(R, i, n, begin, front, x, y, z, S)


@inlined
def express_row(
    A: Reals, i: int, n: int, begin: int, front: FrontRecord, x: float, y: float, z: float, S: Reals
) -> None:
    """A[i]: columns n to n + 5 expressed by the coordinates of the joint and the motion of the parent."""
    first = begin + front.at_joint
    for c in range(front.ns):
        for k in range(6):
            A[i, first + c] += A[i, n + k] * S[c, k]
    if front.at_parent >= 0:
        to = begin + front.at_parent
        for k in range(6):
            A[i, to + k] += A[i, n + k]
        A[i, to + 3] += y * A[i, n + 2] - z * A[i, n + 1]
        A[i, to + 4] += z * A[i, n] - x * A[i, n + 2]
        A[i, to + 5] += x * A[i, n + 1] - y * A[i, n]
