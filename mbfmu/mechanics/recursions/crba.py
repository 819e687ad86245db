"""Composite body: the mass matrix of the free coordinates, M = B^T M_abs B (Featherstone 2008, section 6.2).

A composite inertia about an origin O is kept as mass m, first moment mc and second moment J. Shifting O by -rho:

    mc += m rho,    J += m (rho.rho I - rho rho^T) + 2 (rho.mc) I - rho mc^T - mc rho^T     (mc before the shift)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.flexible import modal
from mbfmu.mechanics.records import MODAL, SECTION
from mbfmu.mechanics.spatial import row_dot6, shift_wrench
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Reals


@inlined
def composite_inertia(arrays: Arrays, state: State) -> None:
    """Composite inertia of each body with its descendants, about its origin."""
    for i in range(1, arrays.bodies.shape[0]):
        here = state.bodies[i]
        mass, c = arrays.bodies[i].mass, here.com
        cc = mass * (c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
        here.mass = mass
        for k in range(3):
            here.mc[k] = mass * c[k]
            for j in range(3):
                here.J[k, j] = here.Jc[k, j] - mass * c[k] * c[j]
            here.J[k, k] += cc
    for i in range(arrays.flexibles.shape[0]):
        modal.composite(arrays.flexibles[i], state.bodies[arrays.flexibles[i].body], state.q, arrays.numbers)
    for i in range(arrays.bodies.shape[0] - 1, 0, -1):
        j = arrays.bodies[i].parent
        if j > 0:
            accumulate_composite_inertia(state.bodies[i], state.bodies[j])


@kernel
def accumulate_composite_inertia(here: MotionRecord, parent: MotionRecord) -> None:
    """Add a child's composite inertia to its parent's."""
    m, mc, J = here.mass, here.mc, here.J
    rho = here.W  # scratch
    for k in range(3):
        rho[k] = here.r[k] - parent.r[k]
    diagonal = 0.0
    for k in range(3):
        diagonal += rho[k] * (m * rho[k] + 2.0 * mc[k])
    for k in range(3):
        for j in range(3):
            parent.J[k, j] += J[k, j] - m * rho[k] * rho[j] - rho[k] * mc[j] - mc[k] * rho[j]
        parent.J[k, k] += diagonal
        parent.mc[k] += mc[k] + m * rho[k]
    parent.mass += m


@kernel
def momentum_of(here: MotionRecord, S: Reals, i: int, out: Reals) -> None:
    """out = composite inertia times the motion S[i]: the momentum wrench about the body's origin."""
    m, mc, J = here.mass, here.mc, here.J
    out[0] = m * S[i, 0] + S[i, 4] * mc[2] - S[i, 5] * mc[1]
    out[1] = m * S[i, 1] + S[i, 5] * mc[0] - S[i, 3] * mc[2]
    out[2] = m * S[i, 2] + S[i, 3] * mc[1] - S[i, 4] * mc[0]
    out[3] = mc[1] * S[i, 2] - mc[2] * S[i, 1] + J[0, 0] * S[i, 3] + J[0, 1] * S[i, 4] + J[0, 2] * S[i, 5]
    out[4] = mc[2] * S[i, 0] - mc[0] * S[i, 2] + J[1, 0] * S[i, 3] + J[1, 1] * S[i, 4] + J[1, 2] * S[i, 5]
    out[5] = mc[0] * S[i, 1] - mc[1] * S[i, 0] + J[2, 0] * S[i, 3] + J[2, 1] * S[i, 4] + J[2, 2] * S[i, 5]


@inlined
def set_symmetric(row: int, column: int, power: float, add: bool, M: Reals) -> None:
    """M[row, column] and its mirror image; ``add`` to what is there."""
    if add:
        power += M[row, column]
    M[row, column] = power
    M[column, row] = power


@inlined
def propagate_force(i: int, row: int, f: Reals, add: bool, arrays: Arrays, state: State, M: Reals) -> None:
    """Enter the power of the momentum wrench f of coordinate ``row`` at body i on every free coordinate further in."""
    while arrays.bodies[i].parent > 0:
        up = arrays.bodies[i].parent
        shift_wrench(state.bodies[i], state.bodies[up], f)
        i = up
        body = arrays.bodies[i]
        if body.vf >= 0 and body.role != MODAL:
            for c in range(body.nv):
                set_symmetric(row, body.vf + c, row_dot6(state.S, body.si + c, f), add, M)


@inlined
def mass_matrix(arrays: Arrays, state: State, M: Reals) -> None:
    """M (n, n) over the free coordinates, after :func:`composite_inertia`; zero between branches, and left so.

    The amplitudes of a flexible body get its inertia first, then that of the bodies on each of its sections.
    """
    f = state.wrench
    for k in range(M.shape[0] - arrays.world[0].states, M.shape[0]):
        M[k, k] = 1.0  # of a first-order state
    for e in range(arrays.flexibles.shape[0]):
        flexible = arrays.flexibles[e]
        first = arrays.bodies[flexible.body].vf
        for k in range(flexible.modes):
            for j in range(k):
                set_symmetric(first + k, first + j, 0.0, False, M)
            set_symmetric(first + k, first + k, modal.modal_mass(flexible, k, arrays.numbers), False, M)
            modal.coupling(flexible, k, state.bodies[flexible.body], state.q, arrays.numbers, f)
            propagate_force(flexible.body, first + k, f, False, arrays, state, M)
    for i in range(1, arrays.bodies.shape[0]):
        body = arrays.bodies[i]
        if body.vf < 0 or body.role == MODAL:
            continue
        shared = body.role == SECTION
        for k in range(body.nv):
            momentum_of(state.bodies[i], state.S, body.si + k, f)
            row = body.vf + k
            for j in range(k + 1):
                set_symmetric(row, body.vf + j, row_dot6(state.S, body.si + j, f), shared, M)
            propagate_force(i, row, f, shared, arrays, state, M)
        if body.armature != 0.0:
            M[body.vf, body.vf] += body.armature
