"""The structured tangent of one mechanism, factored and solved: see the package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.records import Arrays, State, copy_state, empty_data, to_complex_state
from solvers.compiled.kernel import system_kernel
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.blocks import Factors
from solvers.system import Array, TangentCallbacks

from .assembly import TangentScratch, factor
from .border import Border
from .coupled_states import CoupledStates, StateUse
from .groups import Groups
from .inertia import count_negative
from .layout import Layout, lay_out
from .solving import TangentData, Unknowns, multiply_mass, solve
from .states import StateTerms

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.loading import Acting


@system_kernel
def factor_tangent(c1: float, c2: float, weight: Any, symmetric: bool, tangent: Any) -> bool:
    """As a solver's kernels call it, see :class:`solvers.system.TangentCallbacks`."""
    own = tangent.scratch.weight
    for i in range(own.shape[0]):
        own[i] = weight[i]
    return factor(c1, c2, symmetric, False, tangent)


@system_kernel
def solve_tangent(r: Any, tangent: Any, dq: Any) -> None:
    """The same."""
    solve(r, tangent, dq)


@system_kernel
def multiply_mass_matrix(a: Any, tangent: Any, tau: Any) -> None:
    """The same."""
    multiply_mass(a, tangent, tau)


def tangent_callbacks(tangent: Any) -> TangentCallbacks:
    """Return what solvers call of a tangent by its data, pinned."""
    return TangentCallbacks(factor_tangent, solve_tangent, multiply_mass_matrix, tangent)


def empty_tangent() -> Any:
    """Return the data of a tangent of one body, pinned: an example of the types that every tangent has."""
    (arrays, state), z, integers = empty_data(), np.zeros, np.int64
    layout = Layout(**{name: z((1, 4) if name == "along" else 1, integers) for name in Layout._fields})
    border = Border.of(layout._replace(columns=z(1, integers)), 1)
    return pin(
        TangentData(
            pin(layout), pin(arrays), pin(state), pin(copy_state(state)), pin(to_complex_state(state)),
            pin(TangentScratch.allocate([1], [1], [-1], 1, 1, 1, 6, 1)),
            pin(Unknowns.allocate([1], [z(1, integers)], 1, 1, 1)), pin(border), pin(StateTerms.allocate(1, 1)),
            pin(CoupledStates.of([], [], 1, 1)), pin(Factors.allocate([1], [-1])), z(1, integers),
        )
    )  # fmt: skip


class Tangent:
    """T of one mechanism, factored and solved as often as wanted.

    Parameters
    ----------
    arrays, state
        The mechanism, with the kernels for derivatives by the state; T is taken at ``state``.
    groups
        Of all bodies.
    acting
        The loads.
    use
        What each load reads; not needed without first-order states.

    Attributes
    ----------
    symmetric
        Whether T may be taken as symmetric by who corrects what it is off.
    data
        What its kernels work on, pinned.
    """

    def __init__(
        self, arrays: Arrays, state: State, groups: Groups, acting: Sequence[Acting], use: Sequence[StateUse] = ()
    ) -> None:
        self.symmetric = all(a.load.symmetric for a in acting)
        self.layout, kept, sizes = lay_out(arrays, groups, acting)
        free, states = int(arrays.bodies["nv"][arrays.bodies["vf"] >= 0].sum()), int(arrays.world["states"][0])
        self.n_locked = (sum(len(own) for own in kept) - free) // 2  # directions that joints lock
        inward, nv, nb = self.layout.inward.tolist(), int(arrays.bodies["nv"].sum()), len(arrays.bodies)
        counts, m = [len(own) for own in kept], int(arrays.kept.max(initial=-1)) + 1
        load_rows, columns = 6 * int(np.diff(self.layout.first_body).max(initial=0)), int(self.layout.columns.sum())
        self._border, self._factors = Border.of(self.layout, free + states), Factors.allocate(counts, inward)
        self._scratch = TangentScratch.allocate(sizes, counts, inward, nb, nv, m, load_rows, columns)
        self._count = np.zeros(1, np.int64)
        own = state._replace(S=state.S[:0], U=state.U[:0], D=state.D[:0])
        self.data = pin(
            TangentData(
                pin(self.layout), pin(arrays), pin(state), pin(copy_state(state)), pin(to_complex_state(own)),
                pin(self._scratch), pin(Unknowns.allocate(sizes, kept, nb, nv, free + states)), pin(self._border),
                pin(StateTerms.allocate(states, free + states)), pin(CoupledStates.of(acting, use, nb, free + states)),
                pin(self._factors), self._count,
            )
        )  # fmt: skip
        self.callbacks = tangent_callbacks(self.data)

    @property
    def factored(self) -> int:
        """How often T has been factored: who keeps factors must see whether they are still his."""
        return int(self._count[0])

    def factor(
        self, c1: float, c2: float, weight: Array | None = None, symmetric: bool = False, averaged: bool = False
    ) -> bool:
        """Assemble and factor T at the state of the last inverse dynamics; False where it is singular.

        ``weight`` (m,): T + J^T alpha J instead. ``symmetric``: as if it were, which costs less; see the package
        for where it is. ``averaged``: (T + T^T) / 2, whose negative eigenvalues are counted.
        """
        self._scratch.weight[:] = 0.0 if weight is None else weight
        return bool(factor(c1, c2, symmetric, averaged, self.data))

    def solve(self, r: Array) -> Array:
        """Return dq with T dq = r, both (n,) or (n, columns), by the last factors."""
        dq = np.empty((r.size // len(r), len(r)))
        for load, motion in zip(np.ascontiguousarray(r.reshape(len(r), -1).T), dq, strict=True):
            solve(load, self.data, motion)
        return dq.T.reshape(r.shape)

    @property
    def negative(self) -> int:
        """Number of negative eigenvalues of T, as it was last factored ``averaged``."""
        return count_negative(int(self._factors.negative[0]) - self.n_locked, self._border)

    def inertia(self, a: Array) -> Array:
        """Return M a (n,) at the state of the last factors."""
        tau = np.zeros(len(a))
        multiply_mass(a, self.data, tau)
        return tau
