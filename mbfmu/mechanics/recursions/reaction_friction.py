"""Friction of joints in proportion to the force and the moment that they transmit.

The loads of the bearings of joint k are linear in the friction forces x of all such joints, and its normal force N is a
sum of their lengths (see :mod:`mbfmu.mechanics.loads.reaction`):

    y_k = y_k0 - sum_j Y_kj x_j,        N_k = |y_k[0:3]| + |y_k[3:6]| + |y_k[6] + s_k x_k| + P_k

y_k0 are the loads without friction. Y_kj are those by a unit force on the coordinate of joint j: both follow from one
elimination in the equations of motion, M a + J^T lambda = -h + e_j and J a = gamma. With the bristle force
F z + ..., F = mu N, of :mod:`mbfmu.mechanics.loads.bristle` the friction forces are the solution of

    x_k = a_k R_k(N_k(x)),      R(N) = F z + z' c F^(3/2) / (F + f),      c = tau F^(1/2), f = (tau v / d)^2 F

with the arm a_k of the slip, by Newton's method from x = 0: N is convex in x, so that for one joint it converges to the
solution that a growing coefficient of friction leads to. If it does not converge, the friction grows in parts.
I - dR/dx is singular where friction amplifies the reaction without a bound (Painleve 1895); beyond there is no
solution, or none that a growing friction leads to. The equations are then not finite, and the joint is named.

If the accelerations are given, the loads of the bearings are too: :func:`update_reaction_friction`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbfmu.mechanics.loads.reaction import BALL, GUIDE, JOURNAL, PLANE, SLEEVE, THREAD
from mbfmu.mechanics.spatial import arm
from solvers.compiled.kernel import inlined, kernel
from solvers.system import Terms

from .reaction_responses import eliminate, respond

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, BearingRecord, State
    from solvers.compiled.record import Reals

MAX_NEWTON_ITERATIONS = 20
N_PARTS = 20  # of the friction, where Newton's method from zero does not converge
NEWTON_TOLERANCE = 1e-6  # of corrections, relative to the friction: that of the next one is of the order of its square
MIN_DETERMINANT = 1e-3  # of I - dR/dx, which is 1 without friction
N_LOADS = 7  # numbers that describe the loads of the bearings of one joint


@inlined
def clear_reaction_friction(state: State) -> None:
    """Let loads apply no friction that follows reactions."""
    for k in range(state.bearings.shape[0]):
        state.bearings[k].resistance = 0.0


@inlined
def store_bearing_loads(arrays: Arrays, state: State) -> None:
    """Store the loads of all bearings by the joint wrenches of the last inverse dynamics, as those without friction."""
    count = state.bearings.shape[0]
    for k in range(count):
        place_bearings(k, arrays, state)
        fill_bearing_loads(k, k * (count + 1), state)


@inlined
def solve_reaction_friction(arrays: Arrays, state: State, terms: Terms) -> None:
    """Add the friction that follows reactions to the terms and to the forces of the state, after
    :func:`store_bearing_loads` for zero free accelerations.
    """
    if state.bearings.shape[0] > 0:
        determine_friction(arrays, state, terms)


@inlined
def update_reaction_friction(arrays: Arrays, state: State) -> None:
    """Make the friction that of the joint wrenches of the last inverse dynamics, at a solution."""
    count = state.bearings.shape[0]
    for k in range(count):
        place_bearings(k, arrays, state)
        fill_bearing_loads(k, k * (count + 1), state)
        here = state.bearings[k]
        before, x = here.resistance, 0.0 * here.resistance
        y, row = state.bearing_loads, k * (count + 1)
        for _ in range(MAX_NEWTON_ITERATIONS):
            both = length(y[row, 0], y[row, 1], y[row, 2]) + length(y[row, 3], y[row, 4], y[row, 5])
            here.normal = both + magnitude(y[row, 6] + here.tilt * x) + offset(here)
            value, slope = friction_of_normal(here)
            change = (value - x) / (1.0 - slope * here.tilt * sign(y[row, 6] + here.tilt * x))
            x += change
            if here.tilt.real == 0.0 or not abs(change.real) > NEWTON_TOLERANCE * abs(value.real):
                break
        here.resistance = x
        state.Q[here.v] -= x - before
        state.tau[here.v] += x - before


@inlined
def magnitude(x: float) -> float:
    """|x|, analytic but at zero."""
    return x if x.real >= 0.0 else -x


@inlined
def sign(x: float) -> float:
    """Derivative of :func:`magnitude`."""
    return 1.0 if x.real >= 0.0 else -1.0


@inlined
def length(x: float, y: float, z: float) -> float:
    """Length of a vector, analytic but at zero."""
    square = x * x + y * y + z * z
    return np.sqrt(square) if square.real > 0.0 else 0.0 * square


@inlined
def offset(here: BearingRecord) -> float:
    """Part of the normal force that the preload gives."""
    return here.preload * here.radius if is_angle(here) else here.preload


@inlined
def is_angle(here: BearingRecord) -> bool:
    """Whether the normal force is multiplied by a radius."""
    return here.bearing_type in (JOURNAL, THREAD, BALL)


@inlined
def friction_of_normal(here: BearingRecord) -> tuple[float, float]:
    """Force on the coordinate and its derivative with respect to N: R and dR/dN times the arm of the slip."""
    F = here.coulomb * here.normal
    if F.real <= 0.0:
        return 0.0 * F, here.arm * here.coulomb * here.z
    root, total = np.sqrt(F), F + here.fading
    damping = here.rate * here.damping * root / total
    slope = here.coulomb * (here.z + damping * (1.5 - F / total))
    return here.arm * F * (here.z + damping), here.arm * slope


@kernel
def place_bearings(k: int, arrays: Arrays, state: State) -> None:
    """Axis and center of the bearings of joint k in global axes, and the slope of its thread."""
    here = state.bearings[k]
    body, child = arrays.bodies[here.body], state.bodies[here.body]
    row, first = body.si + here.v - body.vi, 0 if here.bearing_type == GUIDE else 3
    if here.bearing_type == SLEEVE:
        row = body.si
    elif here.bearing_type == PLANE:
        row = body.si + 2
    for c in range(3):
        here.axis[c] = state.S[row, first + c]
    here.tilt = 0.0
    if here.bearing_type == THREAD:
        for c in range(3):
            here.tilt += here.axis[c] * state.S[body.si, c] / here.radius
    if (here.is_on_b == 1) == (body.reversed == 0):  # in the child of the tree
        x, y, z = arm(child, body.child_s)
        here.center[0], here.center[1], here.center[2] = x, y, z
        return
    parent = state.bodies[body.parent]
    x, y, z = arm(parent, body.s)
    here.center[0] = parent.r[0] + x - child.r[0]
    here.center[1] = parent.r[1] + y - child.r[1]
    here.center[2] = parent.r[2] + z - child.r[2]


@kernel
def fill_bearing_loads(k: int, row: int, state: State) -> None:
    """bearing_loads[row] = loads of the bearings of joint k by the wrench that the joint transmits."""
    here, y = state.bearings[k], state.bearing_loads
    W, a, c = state.bodies[here.body].W, here.axis, here.center
    mx = W[3] - (c[1] * W[2] - c[2] * W[1])
    my = W[4] - (c[2] * W[0] - c[0] * W[2])
    mz = W[5] - (c[0] * W[1] - c[1] * W[0])
    along = W[0] * a[0] + W[1] * a[1] + W[2] * a[2]
    about = mx * a[0] + my * a[1] + mz * a[2]
    if here.bearing_type == THREAD:
        for i in range(6):
            y[row, i] = 0.0
        y[row, 6] = here.radius * along * (1.0 + here.tilt * here.tilt)
        return
    if here.bearing_type == PLANE:
        for i in range(6):
            y[row, i] = 0.0
        y[row, 6] = along
        return
    if here.bearing_type == BALL:
        for i in range(3):
            y[row, i], y[row, 3 + i] = here.radius * W[i], 0.0
        y[row, 6] = 0.0
        return
    couple = (
        (my * a[2] - mz * a[1]) * here.inverse_length,
        (mz * a[0] - mx * a[2]) * here.inverse_length,
        (mx * a[1] - my * a[0]) * here.inverse_length,
    )
    for i in range(3):
        half = 0.5 * (W[i] - along * a[i])
        y[row, i], y[row, 3 + i] = half + couple[i], half - couple[i]
    y[row, 6] = 2.0 * about * here.inverse_width
    if here.bearing_type == JOURNAL:
        for i in range(6):
            y[row, i] *= here.radius
        y[row, 6] = here.thrust_radius * along


@kernel
def determine_friction(arrays: Arrays, state: State, terms: Terms) -> None:
    """Solve for the friction of all joints and add it; not a number if there is no solution."""
    count, is_needed = state.bearings.shape[0], False
    for k in range(count):
        is_needed = is_needed or state.bearings[k].z != 0.0 or state.bearings[k].rate != 0.0
    if not is_needed:
        return
    n, m = terms.M.shape[0] - arrays.world[0].states, terms.J.shape[0]
    solved = eliminate(n, m, arrays, state, terms)
    if solved:
        for column in range(count + 1):
            respond(n + m + column, n, arrays, state)
            for k in range(count):
                row = k * (count + 1) + column
                if column == 0:
                    add_bearing_loads(k, row, state)
                else:
                    fill_bearing_loads(k, row, state)
        solved = iterate_friction(state)
    elif has_finite_loads(state):  # those of the accelerations that are zero
        state.bearings[0].undetermined_time = state.time[0]
    for k in range(count):
        here = state.bearings[k]
        x = state.friction[k, count + 1] if solved else np.nan * here.z
        here.resistance = x
        state.Q[here.v] -= x
        state.tau[here.v] += x
        body = arrays.bodies[here.body]
        if body.vf >= 0 and body.drive < 0:
            terms.h[body.vf + here.v - body.vi] += x


@inlined
def add_bearing_loads(k: int, row: int, state: State) -> None:
    """Add to bearing_loads[row] the loads by the wrench that joint k transmits."""
    last, y = state.bearing_loads.shape[0] - 1, state.bearing_loads
    fill_bearing_loads(k, last, state)
    for i in range(N_LOADS):
        y[row, i] += y[last, i]


@kernel
def iterate_friction(state: State) -> bool:
    """Fill the last column of State.friction with the friction forces: by Newton's method from zero, and if that fails,
    for a friction that grows in parts. False, and the time of the jam with the joint whose friction amplifies its
    reaction most, if there is no solution.
    """
    A, last, worst = state.friction, state.bearings.shape[0] + 1, 0
    for attempt in range(2):
        for k in range(A.shape[0]):
            A[k, last] = 0.0
        solved, first = True, N_PARTS if attempt == 0 else 1
        for step in range(first, N_PARTS + 1):
            solved, worst = correct_friction(step / N_PARTS, state)
            if not solved:
                break
        if solved:
            return True
    if has_finite_loads(state):
        state.bearings[worst].jam_time = state.time[0]
    return False


@inlined
def has_finite_loads(state: State) -> bool:
    """Whether the bearings have finite loads without friction, and finite bristles."""
    count, total = state.bearings.shape[0], 0.0
    for k in range(count):
        here = state.bearings[k]
        total += here.z.real + here.rate.real
        for i in range(N_LOADS):
            total += state.bearing_loads[k * (count + 1), i].real
    return np.isfinite(total)


@inlined
def correct_friction(part: float, state: State) -> tuple[bool, int]:
    """Newton's method for x = part R, from the friction in the last column: whether it converges to a regular solution,
    and the joint whose friction amplifies its reaction most.
    """
    A, count, worst = state.friction, state.bearings.shape[0], 0
    for _ in range(MAX_NEWTON_ITERATIONS):
        largest, converged = 0.0, True
        for k in range(count):
            amplified = fill_newton_row(k, part, state)
            if amplified > largest:
                largest, worst = amplified, k
        determinant = solve_newton(A, count)
        if not abs(determinant) > 0.0:
            break
        for k in range(count):
            change, here = A[k, count], state.bearings[k]
            A[k, count + 1] += change
            scale = max(abs(A[k, count + 1].real), abs((here.arm * here.coulomb * here.normal).real))
            converged = converged and abs(change.real) <= NEWTON_TOLERANCE * scale
        if converged:
            return determinant > MIN_DETERMINANT, worst
    return False, worst


@inlined
def fill_newton_row(k: int, part: float, state: State) -> float:
    """Row k of I - s dR/dx and s R - x at the friction in the last column, s the part; return sum_j |s dR_k/dx_j|."""
    A, y, count, here = state.friction, state.bearing_loads, state.bearings.shape[0], state.bearings[k]
    last, row = count + 1, k * (count + 1)
    ax, ay, az = y[row, 0], y[row, 1], y[row, 2]
    bx, by, bz, c = y[row, 3], y[row, 4], y[row, 5], y[row, 6] + here.tilt * A[k, last]
    for j in range(count):
        x, r = A[j, last], row + 1 + j
        ax, ay, az = ax - y[r, 0] * x, ay - y[r, 1] * x, az - y[r, 2] * x
        bx, by, bz, c = bx - y[r, 3] * x, by - y[r, 4] * x, bz - y[r, 5] * x, c - y[r, 6] * x
    first, second, along = length(ax, ay, az), length(bx, by, bz), sign(c)
    here.normal = first + second + magnitude(c) + offset(here)
    value, slope = friction_of_normal(here)
    slope *= part
    by_first = slope / first if first.real > 0.0 else 0.0 * slope
    by_second = slope / second if second.real > 0.0 else 0.0 * slope
    ax, ay, az, bx, by, bz = by_first * ax, by_first * ay, by_first * az, by_second * bx, by_second * by, by_second * bz
    along *= slope
    amplified = 0.0
    for j in range(count):
        r = row + 1 + j
        change = along * here.tilt if j == k else 0.0 * slope
        change -= ax * y[r, 0] + ay * y[r, 1] + az * y[r, 2] + along * y[r, 6]
        change -= bx * y[r, 3] + by * y[r, 4] + bz * y[r, 5]
        A[k, j] = (1.0 if j == k else 0.0) - change
        amplified += abs(change.real)
    A[k, count] = part * value - A[k, last]
    return amplified


@inlined
def solve_newton(A: Reals, count: int) -> float:
    """Replace column ``count`` by the solution of the first columns; return their determinant, 0: they are singular."""
    determinant = 1.0
    for k in range(count):
        best = k
        for i in range(k + 1, count):
            if abs(A[i, k].real) > abs(A[best, k].real):
                best = i
        if best != k:
            determinant = -determinant
            for c in range(count + 1):
                A[k, c], A[best, c] = A[best, c], A[k, c]
        determinant *= A[k, k].real
        if not abs(determinant) > 0.0:
            return 0.0
        for i in range(k + 1, count):
            factor = A[i, k] / A[k, k]
            for c in range(k + 1, count + 1):
                A[i, c] -= factor * A[k, c]
    for back in range(count):
        k = count - 1 - back
        for j in range(k + 1, count):
            A[k, count] -= A[k, j] * A[j, count]
        A[k, count] /= A[k, k]
    return determinant
