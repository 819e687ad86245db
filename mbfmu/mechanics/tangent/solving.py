"""Solutions by the factors of the structured tangent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.linalg.blocks import solve_blocks
from solvers.system import Array

from .border import add_border
from .condensation import gather_motion, inertia_forces, spread_load
from .coupled_states import add_coupled_states
from .states import condense_states, expand_states

if TYPE_CHECKING:
    from solvers.compiled.record import Reals


class Unknowns(NamedTuple):
    """The rows of all groups, and those of them that are solved for."""

    base: NDArray[np.int64]  # (groups + 1,) first row of each
    rows: NDArray[np.int64]  # (unknowns,) those that stay after condensation
    kept: NDArray[np.int64]  # (unknowns,) the same as rows of their groups
    x: Array  # (unknowns,)
    b: Array  # (rows + 6,)
    dual: Array  # (nv, 6) dual bases of all joints
    motions: Array  # (nb, 6)
    motion: Array  # (n,) scratch

    @staticmethod
    def allocate(sizes: Sequence[int], kept: Sequence[NDArray[np.int64]], nb: int, nv: int, n: int) -> Unknowns:
        """Return those of groups of ``sizes`` rows, of which the ``kept`` ones stay after condensation."""
        base, z, none = np.concatenate(([0], np.cumsum(sizes))).astype(np.int64), np.zeros, np.zeros(0, np.int64)
        rows = np.concatenate([none, *(at + own for at, own in zip(base, kept, strict=False))])
        whole = np.concatenate([none, *kept])
        return Unknowns(base, rows, whole, z(len(rows)), z(base[-1] + 6), z((nv, 6)), z((nb, 6)), z(n))


class TangentData(NamedTuple):
    """All that the structured tangent of a mechanism is factored and solved with."""

    layout: Any  # .layout.Layout
    arrays: Any  # mbfmu.mechanics.records.Arrays, with the kernels for derivatives by the state
    moving: Any  # mbfmu.mechanics.records.State, which the recursions change
    state: Any  # the state at which the factors were taken
    perturbed: Any  # the same with complex numbers, scratch
    scratch: Any  # .assembly.TangentScratch
    unknowns: Any  # Unknowns
    border: Any  # .border.Border
    states: Any  # .states.StateTerms
    coupled: Any  # .coupled_states.CoupledStates
    factors: Any  # solvers.linalg.blocks.Factors
    n_factored: NDArray[np.int64]  # (1,) how often T has been factored


@kernel
def solve(r: Reals, tangent: TangentData, dq: Reals) -> None:
    """dq (n,) with T dq = r."""
    solve_uncoupled(r, tangent, dq)
    if tangent.coupled.numbers.shape[0] > 0:
        add_coupled_states(r, tangent.arrays.world[0].states, tangent.coupled, dq)


@kernel
def solve_uncoupled(r: Reals, tangent: TangentData, dq: Reals) -> None:
    """dq (n,) with T dq = r, without the states that are not condensed and their rows."""
    solve_within(r, tangent, dq)
    add_border(tangent.border, dq)


@kernel
def solve_within(r: Reals, tangent: TangentData, dq: Reals) -> None:
    """dq (n,) with T dq = r, T without its border."""
    unknowns, has_states = tangent.unknowns, tangent.arrays.world[0].states > 0
    if has_states:
        condense_states(r, tangent.layout, tangent.arrays, tangent.states)
    load = tangent.states.load if has_states else r
    spread_load(load, unknowns.base, tangent.layout, tangent.arrays, tangent.state, unknowns.dual, unknowns.b)
    for i in range(unknowns.rows.shape[0]):
        unknowns.x[i] = unknowns.b[unknowns.rows[i]]
    solve_blocks(tangent.factors, unknowns.x)
    for i in range(unknowns.rows.shape[0]):
        unknowns.b[unknowns.rows[i]] = unknowns.x[i]
    gather_motion(
        unknowns.b, unknowns.base, tangent.layout, tangent.arrays, tangent.state, unknowns.dual, unknowns.motions, dq
    )
    if has_states:
        expand_states(r, tangent.layout, tangent.arrays, tangent.states, dq)


@kernel
def multiply_mass(a: Reals, tangent: TangentData, tau: Reals) -> None:
    """tau (n,) = M a at the state of the last factors."""
    inertia_forces(tangent.arrays, tangent.state, a, tau)
