"""The structured tangent of one mechanism, assembled group by group and factored: kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.steps import release_bodies
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.matrix_view import matrix_at
from solvers.linalg.blocks import block_matrices, eliminate, find_places, reset
from solvers.linalg.inversion import invert, largest_column
from solvers.system import Array

from .border import project_border, set_equations
from .condensation import condense
from .coupled_states import fill_column, fill_row, reduce_to_states
from .filling import fill
from .joints import add_own_geometric_stiffness, add_parent_geometric_stiffness
from .solving import solve_uncoupled, solve_within
from .states import add_coordinate_stiffness, set_armature_stiffness

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

    from .solving import TangentData

MAX_BORDER_CONDITION = 1e14  # condition of the border's equations from which on they are singular


class TangentScratch(NamedTuple):
    """Allocated once; W: rows of the largest two neighbors."""

    F: Array  # (W + 6, W), the last six rows for condensation
    S: Array  # (3..6, 6) dual basis of one joint
    N: Array  # (6, 6) directions a joint locks, rows
    C: Array  # (3, 3)
    turn: NDArray[Any]  # (3,) complex rotation of a quaternion joint
    G: Array  # (6, 6) joint rows by own coordinates
    g: Array  # (6, 3) joint rows by the parent's rotation
    row: Array  # (12,) one joint row over both bodies' motions
    pair: Array  # (24,) what two coupled coordinates do, over the motions of four bodies
    K: Array  # (24.., 24..) stiffness of a load, six rows a body
    weight: Array  # (m,) alpha
    along: Array  # (nv,) stiffness of forces along joint coordinates
    coupling_block: Array  # (r, 2, nb, 6) what the border is made of
    panel: Array  # columns while they are condensed, and six rows for that
    received: Array  # what groups have added to the rows of their neighbors inward, see ``received_start``
    received_start: NDArray[np.int64]  # (groups,) where it is of each; -1: no group adds to its rows

    @staticmethod
    def allocate(
        sizes: Sequence[int], kept: Sequence[int], inward: Sequence[int], nb: int, nv: int, m: int, load_rows: int,
        columns: int,
    ) -> TangentScratch:  # fmt: skip
        """Return zeroed scratch for groups with the given numbers of rows, and of rows that are ``kept``.

        ``load_rows`` are those of the stiffness of a load, ``columns`` those of the border.
        """
        widest = max(size + (sizes[k] if k >= 0 else 0) for size, k in zip(sizes, inward, strict=True))
        (places, _, count), square, z = find_places(inward), max(sizes, default=0) ** 2, np.zeros
        return TangentScratch(
            F=z((widest + 6, widest)),
            S=z((6, 6)),
            N=z((6, 6)),
            C=z((3, 3)),
            turn=z(3, complex),
            G=z((6, 6)),
            g=z((6, 3)),
            row=z(12),
            pair=z(24),
            K=z((max(24, load_rows), max(24, load_rows))),
            weight=z(m),
            along=z(nv),
            coupling_block=z((columns, 2, nb, 6)),
            panel=z((max(sizes, default=0) + 6) * max(kept, default=0)),
            received=z(count * square),
            received_start=np.where(places >= 0, places * square, -1),
        )


@kernel
def factor(c1: float, c2: float, symmetric: bool, averaged: bool, tangent: TangentData) -> bool:
    """Assemble and factor T at the present state; False where it is singular. See :meth:`.factored.Tangent.factor`."""
    scratch, state, perturbed = tangent.scratch, tangent.state, tangent.perturbed
    store_state(tangent.moving, state)
    for i in range(state.q.shape[0]):
        perturbed.q[i] = state.q[i]
    for i in range(state.v.shape[0]):
        perturbed.v[i] = state.v[i]
    if tangent.arrays.parts.shape[0] > 0:  # sensors in laws read bodies
        release_bodies(state, perturbed)
    set_armature_stiffness(c2, tangent.arrays, scratch.along)
    if not add_coordinate_stiffness(
        c1, c2, tangent.layout, tangent.arrays, state, perturbed, scratch.along, tangent.states
    ):
        return False
    clear_coupling_block(scratch.coupling_block)
    reset(symmetric, averaged, tangent.factors)
    tangent.n_factored[0] += 1
    for group in range(tangent.layout.inward.shape[0]):
        assemble(group, c1, c2, symmetric, tangent)
        if not eliminate(group, tangent.factors):
            return False
    return factor_border(tangent) and factor_coupled_states(c1, c2, tangent)


@kernel
def store_state(moving: Any, state: Any) -> None:
    """Copy what T depends on."""
    for i in range(state.bodies.shape[0]):
        state.bodies[i] = moving.bodies[i]
    for i in range(state.rows.shape[0]):
        state.rows[i] = moving.rows[i]
    for i in range(state.coupled.shape[0]):
        state.coupled[i] = moving.coupled[i]
    for i in range(state.S.shape[0]):
        for k in range(state.S.shape[1]):
            state.S[i, k] = moving.S[i, k]
    for i in range(state.q.shape[0]):
        state.q[i] = moving.q[i]
    for i in range(state.v.shape[0]):
        state.v[i], state.a[i], state.Q[i], state.tau[i] = moving.v[i], moving.a[i], moving.Q[i], moving.tau[i]
    for e in range(state.is_acting.shape[0]):
        state.is_acting[e] = moving.is_acting[e]
    state.time[0] = moving.time[0]


@inlined
def clear_coupling_block(block: Reals) -> None:
    """block <- 0."""
    for i in range(block.shape[0]):
        for k in range(block.shape[2]):
            for a in range(6):
                block[i, 0, k, a], block[i, 1, k, a] = 0.0, 0.0


@kernel
def assemble(group: int, c1: float, c2: float, symmetric: bool, tangent: TangentData) -> None:
    """Fill the matrices of a group for :func:`solvers.linalg.blocks.eliminate`.

    What outer groups have added to its rows is added, and what starts in it and belongs to its neighbor's rows is
    stored. L is left as it is where T is to be ``symmetric``.
    """
    layout, arrays, state, scratch, base = (
        tangent.layout, tangent.arrays, tangent.state, tangent.scratch, tangent.unknowns.base
    )  # fmt: skip
    F, inner, size = scratch.F, layout.inward[group], base[group + 1] - base[group]
    after = base[inner + 1] - base[inner] if inner >= 0 else 0
    D, U, L = block_matrices(group, tangent.factors)
    for i in range(size + after):
        for j in range(size + after):
            F[i, j] = 0.0
    at = scratch.received_start[group]
    if at >= 0:
        for i in range(size):
            for j in range(size):
                F[i, j] = scratch.received[at + i * size + j]
    fill(group, size, c1, c2, layout, arrays, state, tangent.perturbed, tangent.unknowns.dual, scratch)
    if after > 0:
        to, is_first = scratch.received_start[inner], tangent.factors.is_first[group] == 1
        for i in range(after):
            for j in range(after):
                before = 0.0 if is_first else scratch.received[to + i * after + j]
                scratch.received[to + i * after + j] = before + F[size + i, size + j]
    first, rows = tangent.factors.first_unknown, tangent.unknowns.kept
    kept = rows[first[group] : first[group + 1]]
    condense(F, 0, 0, size + after, group, layout, arrays, state)
    add_parent_geometric_stiffness(group, layout, arrays, state, tangent.perturbed, F, scratch)
    condense_columns(F, 0, kept, 0, size, kept, group, tangent, D)
    add_own_geometric_stiffness(group, layout, arrays, state, tangent.perturbed, D, scratch)
    if after > 0:
        kept_inner = rows[first[inner] : first[inner + 1]]
        condense_columns(F, 0, kept, size, after, kept_inner, inner, tangent, U)
        if not symmetric:
            condense(F, size, 0, size, inner, layout, arrays, state)
            condense_columns(F, size, kept_inner, 0, size, kept, group, tangent, L)


@kernel
def condense_columns(
    F: Reals, offset: int, rows: Integers, first: int, count: int, columns: Integers, group: int, tangent: Any,
    out: Reals,
) -> None:  # fmt: skip
    """out (columns, rows) <- these rows of F from ``offset`` on, and of a group's ``count`` columns from ``first`` on
    those that stay after condensation, as rows.
    """
    layout = tangent.layout
    if layout.condensed[group] == 0:
        for a in range(columns.shape[0]):
            for b in range(rows.shape[0]):
                out[a, b] = F[offset + rows[b], first + columns[a]]
        return
    panel = matrix_at(tangent.scratch.panel, 0, count + 6, rows.shape[0])
    for b in range(rows.shape[0]):
        for a in range(count):
            panel[a, b] = F[offset + rows[b], first + a]
    condense(panel, 0, 0, rows.shape[0], group, layout, tangent.arrays, tangent.state)
    for a in range(columns.shape[0]):
        for b in range(rows.shape[0]):
            out[a, b] = panel[columns[a], b]


@kernel
def factor_border(tangent: TangentData) -> bool:
    """Solve for what the border is made of; False where T is singular with it."""
    border = tangent.border
    r = border.bodies.shape[0]
    if r == 0:
        return True
    project_border(tangent.scratch.coupling_block, tangent.arrays, tangent.state, border)
    for k in range(r):
        solve_within(border.loads[k], tangent, border.columns[k])
        solve_within(border.lines[k], tangent, border.columns[r + k])
    set_equations(border)
    for a in range(2 * r):
        for b in range(2 * r):
            border.inverse[a, b] = border.units[a] * border.equations[a, b] / border.units[b]
    size = largest_column(border.inverse)
    good = invert(border.inverse, border.order, border.scratch)
    good = good and size * largest_column(border.inverse) < MAX_BORDER_CONDITION
    for a in range(2 * r):
        for b in range(2 * r):
            border.inverse[a, b] = border.inverse[a, b] / border.units[a] * border.units[b] if good else 0.0
    return good


@kernel
def factor_coupled_states(c1: float, c2: float, tangent: TangentData) -> bool:
    """Solve for the equations of the states that are not condensed; False where they are singular."""
    own, work = tangent.coupled, tangent.unknowns.motion
    count = own.numbers.shape[0]
    for j in range(count):
        fill_column(j, c1, c2, tangent.arrays, tangent.state, tangent.perturbed, own)
        fill_row(j, c1, tangent.arrays, tangent.state, tangent.perturbed, own)
        solve_uncoupled(own.columns[j], tangent, work)
        for k in range(work.shape[0]):
            own.columns[j, k] = work[k]
        for i in range(count):
            own.columns[j, work.shape[0] - tangent.arrays.world[0].states + own.numbers[i]] = 0.0
    return count == 0 or reduce_to_states(own)
