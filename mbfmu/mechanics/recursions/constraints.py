"""Constraints of the free coordinates: Phi, J = Phi_q, nu and gamma; those of cut joints, then of couplings.

An equation of a cut joint is a pair of wrenches on two bodies (see ``cuts``); carried inward to the root it meets every
joint whose coordinate moves the body, and J[row, k] is its power on that joint's motion subspace. A coupling has one
equation, of two coordinates (see ``couplings``):

    Phi = q_a - f(q_b),    Phi' = v_a - f' v_b,    Phi'' = v'_a - f' v'_b - f'' v_b^2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbfmu.mechanics.dispatch import evaluate_coupling, evaluate_cut
from mbfmu.mechanics.spatial import add_wrench, dot6, row_dot6, shift_wrench
from solvers.compiled.kernel import inlined, kernel

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, State
    from solvers.compiled.record import Reals


@inlined
def evaluate_constraints(arrays: Arrays, state: State) -> None:
    """Fill State.rows from positions and velocities, State.coupled from positions."""
    for i in range(arrays.cuts.shape[0]):
        evaluate_cut(arrays.cuts[i], arrays, state)
    for i in range(arrays.couplings.shape[0]):
        coupling, here = arrays.couplings[i], state.coupled[i]
        value, here.slope, here.bend = evaluate_coupling(coupling, arrays, state)
        here.Phi = state.q[coupling.qa] - value


@inlined
def common_ancestor(i: int, k: int, arrays: Arrays) -> int:
    """The outermost body that carries both. Its motion changes no cut between them, whose rows live in their frames: of
    the two powers on a joint further in only rounding would be left, which is no constraint that moves.
    """
    while i != k:
        if i > k:
            i = arrays.bodies[i].parent
        else:
            k = arrays.bodies[k].parent
    return i


@inlined
def propagate_row(i: int, end: int, G: Reals, row: int, arrays: Arrays, state: State, J: Reals) -> float:
    """Add to J[row] the power of the wrench G on body i for every free coordinate between it and the body ``end``.

    Driven coordinates move at their known velocity, also those of locked joints, which have free coordinates in native
    FMUs; returns the power on them.
    """
    f = state.wrench
    driven = 0.0 * G[0]
    for k in range(6):
        f[k] = G[k]
    while i != end:
        body = arrays.bodies[i]
        for k in range(body.nv):
            power = row_dot6(state.S, body.si + k, f)
            if body.vf < 0 or body.drive >= 0:
                driven += power * state.v[body.vi + k]
            else:
                J[row, body.vf + k] += power
        shift_wrench(state.bodies[i], state.bodies[body.parent], f)
        i = body.parent
    return driven


@inlined
def jacobian(arrays: Arrays, state: State, Phi: Reals, J: Reals, nu: Reals) -> None:
    """Phi (m,), J (m, n) and nu (m,), after :func:`evaluate_constraints`; State.v holds the driven velocities."""
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        ancestor = common_ancestor(cut.a, cut.b, arrays)
        for r in range(cut.row, cut.end):
            row = arrays.kept[r]
            if row >= 0:
                Phi[row] = state.rows[r].Phi
                for k in range(J.shape[1]):
                    J[row, k] = 0.0
                nu[row] = -propagate_row(cut.a, ancestor, state.rows[r].Ga, row, arrays, state, J)
                nu[row] -= propagate_row(cut.b, ancestor, state.rows[r].Gb, row, arrays, state, J)
    for i in range(arrays.couplings.shape[0]):
        coupling, here = arrays.couplings[i], state.coupled[i]
        row = arrays.kept[coupling.row]
        if row >= 0:
            Phi[row] = here.Phi
            for k in range(J.shape[1]):
                J[row, k] = 0.0
            nu[row] = 0.0
            if coupling.fa >= 0:
                J[row, coupling.fa] += 1.0
            else:
                nu[row] -= state.v[coupling.va]
            if coupling.fb >= 0:
                J[row, coupling.fb] -= here.slope
            else:
                nu[row] += here.slope * state.v[coupling.vb]


@inlined
def right_hand_side(arrays: Arrays, state: State, gamma: Reals) -> None:
    """gamma of J v' = gamma; State holds velocities, and accelerations at zero free v'."""
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        A, B = state.bodies[cut.a], state.bodies[cut.b]
        for r in range(cut.row, cut.end):
            row = arrays.kept[r]
            if row >= 0:
                here = state.rows[r]
                gamma[row] = -dot6(here.Ga, A.dY) - dot6(here.Gb, B.dY) - here.bias
    for i in range(arrays.couplings.shape[0]):
        coupling, bent = arrays.couplings[i], state.coupled[i]
        row = arrays.kept[coupling.row]
        if row >= 0:
            v = state.v[coupling.vb]
            gamma[row] = bent.slope * state.a[coupling.vb] + bent.bend * v * v - state.a[coupling.va]


@kernel
def load_constraints(lam: Reals, arrays: Arrays, state: State) -> None:
    """Add the cut-joint forces -lambda G to the applied wrenches F, those of couplings to the coordinate forces Q."""
    f = state.wrench
    for i in range(arrays.cuts.shape[0]):
        cut = arrays.cuts[i]
        for r in range(cut.row, cut.end):
            row = arrays.kept[r]
            if row >= 0:
                state.rows[r].lam = lam[row]
                for k in range(6):
                    f[k] = -lam[row] * state.rows[r].Ga[k]
                add_wrench(state.bodies[cut.a].F, 0.0, 0.0, 0.0, f)
                for k in range(6):
                    f[k] = -lam[row] * state.rows[r].Gb[k]
                add_wrench(state.bodies[cut.b].F, 0.0, 0.0, 0.0, f)
    for i in range(arrays.couplings.shape[0]):
        coupling, here = arrays.couplings[i], state.coupled[i]
        row = arrays.kept[coupling.row]
        if row >= 0:
            here.lam = lam[row]
            state.Q[coupling.va] -= lam[row]
            state.Q[coupling.vb] += here.slope * lam[row]
