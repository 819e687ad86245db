"""Joint wrenches of a mechanism without friction that follows reactions, and those by a unit friction of each joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.spatial import add_wrench, shift_motion
from solvers.compiled.kernel import inlined, kernel
from solvers.system import Terms

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals

MIN_SADDLE_PIVOT = 1e-13  # of equations in units in which the diagonal of M and the rows of J are 1


@kernel
def eliminate(n: int, m: int, arrays: Arrays, state: State, terms: Terms) -> bool:
    """Fill column n + m of State.saddle with (a, lambda) without friction, and the next ones with the responses to unit
    forces on the coordinates with friction; False if the equations are singular.
    """
    A, count, size = state.saddle, state.bearings.shape[0], n + m
    last = size + count + 1  # column of the scale of each unknown
    for i in range(n):
        A[i, last] = 1.0 / np.sqrt(terms.M[i, i].real) if terms.M[i, i].real > 0.0 else 1.0
    for r in range(m):
        square = 0.0
        for i in range(n):
            square += (terms.J[r, i].real * A[i, last].real) ** 2
        A[n + r, last] = 1.0 / np.sqrt(square) if square > 0.0 else 1.0
    for i in range(n):
        for j in range(n):
            A[i, j] = terms.M[i, j] * A[i, last] * A[j, last]
        for r in range(m):
            A[i, n + r] = terms.J[r, i] * A[i, last] * A[n + r, last]
            A[n + r, i] = A[i, n + r]
        A[i, size] = -terms.h[i] * A[i, last]
    for r in range(m):
        for j in range(m):
            A[n + r, n + j] = 0.0
        A[n + r, size] = terms.gamma[r] * A[n + r, last]
        if is_zero_row(r, n, terms):  # of joints that are locked: it has no force
            A[n + r, n + r], A[n + r, size] = 1.0, 0.0
    for k in range(count):
        body = arrays.bodies[state.bearings[k].body]
        for i in range(size):
            A[i, size + 1 + k] = 0.0
        if body.vf >= 0 and body.drive < 0:
            free = body.vf + state.bearings[k].v - body.vi
            A[free, size + 1 + k] = A[free, last]
    if not solve_columns(A, size, size + 1 + count, MIN_SADDLE_PIVOT):
        return False
    for i in range(size):
        for c in range(size, last):
            A[i, c] *= A[i, last]
    return True


@inlined
def is_zero_row(r: int, n: int, terms: Terms) -> bool:
    """Whether no coordinate changes a constraint equation."""
    for i in range(n):
        if terms.J[r, i] != 0.0:
            return False
    return True


@inlined
def solve_columns(A: Reals, size: int, columns: int, min_pivot: float) -> bool:
    """Replace columns size to ``columns`` - 1 of A by the solutions of A[:size, :size] x = column; False if a pivot is
    not larger than ``min_pivot``.
    """
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(A[i, k].real) > abs(A[best, k].real):
                best = i
        if not abs(A[best, k].real) > min_pivot:
            return False
        if best != k:
            for c in range(k, columns):
                A[k, c], A[best, c] = A[best, c], A[k, c]
        for i in range(k + 1, size):
            if A[i, k] != 0.0:
                factor = A[i, k] / A[k, k]
                for c in range(k + 1, columns):
                    A[i, c] -= factor * A[k, c]
    for c in range(size, columns):
        for back in range(size):
            i = size - 1 - back
            total = A[i, c]
            for j in range(i + 1, size):
                total -= A[i, j] * A[j, c]
            A[i, c] = total / A[i, i]
    return True


@kernel
def respond(at: int, n: int, arrays: Arrays, state: State) -> None:
    """Wrenches W of all joints by the accelerations and multipliers in column ``at`` of State.saddle alone.

    Velocities, weight, loads and driven accelerations have no part in them.
    """
    A = state.saddle
    for i in range(state.bodies.shape[0]):
        here = state.bodies[i]
        for k in range(6):
            here.dY[k], here.W[k] = 0.0, 0.0
    for i in range(1, arrays.bodies.shape[0]):
        body, here = arrays.bodies[i], state.bodies[i]
        parent = state.bodies[body.parent]
        for k in range(6):
            here.dY[k] = parent.dY[k]
        shift_motion(here, parent, parent.dY, here.dY)
        if body.vf >= 0:
            for c in range(body.nv):
                for k in range(6):
                    here.dY[k] += state.S[body.si + c, k] * A[body.vf + c, at]
        resist_acceleration(body.mass, here)
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        for r in range(cut.row, cut.end):
            row = arrays.kept[r]
            if row >= 0:
                for k in range(6):
                    state.bodies[cut.a].W[k] += A[n + row, at] * state.rows[r].Ga[k]
                    state.bodies[cut.b].W[k] += A[n + row, at] * state.rows[r].Gb[k]
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        body, here = arrays.bodies[i], state.bodies[i]
        if body.parent > 0:
            parent = state.bodies[body.parent]
            x, y, z = here.r[0] - parent.r[0], here.r[1] - parent.r[1], here.r[2] - parent.r[2]
            add_wrench(parent.W, x, y, z, here.W)


@inlined
def resist_acceleration(mass: float, here: MotionRecord) -> None:
    """Add to W the wrench of a body's inertia by its accelerations."""
    dY, c, Jc, W = here.dY, here.com, here.Jc, here.W
    fx = mass * (dY[0] + dY[4] * c[2] - dY[5] * c[1])
    fy = mass * (dY[1] + dY[5] * c[0] - dY[3] * c[2])
    fz = mass * (dY[2] + dY[3] * c[1] - dY[4] * c[0])
    W[0] += fx
    W[1] += fy
    W[2] += fz
    for k in range(3):
        W[3 + k] += Jc[k, 0] * dY[3] + Jc[k, 1] * dY[4] + Jc[k, 2] * dY[5]
    W[3] += c[1] * fz - c[2] * fy
    W[4] += c[2] * fx - c[0] * fz
    W[5] += c[0] * fy - c[1] * fx
