"""The structured tangent of one mechanism, factored and solved: see the package."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.records import Arrays, State, copy_state, to_complex_state
from solvers.compiled.kernel import COMPILED, callback, kernel, types
from solvers.compiled.tuple_pointer import pin, pointer_type, unpin
from solvers.linalg.blocks import BlockTree, one_thread, solve_blocks
from solvers.system import Array

from .border import Border, add_border, project_wrenches
from .condensation import condense, gather_motion, inertia_forces, spread_load
from .filling import fill
from .groups import Groups
from .inertia import count_negative
from .joints import add_own_geometric_stiffness, add_parent_geometric_stiffness
from .layout import lay_out
from .loads import joint_stiffness

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.loading import Acting
    from mbfmu.mechanics.tangent.layout import Layout
    from solvers.compiled.record import Reals


NO_BLOCK = np.zeros((0, 0))
MAX_BORDER_CONDITION = 1e14  # condition of the border's equations from which on they are


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


class Panels(NamedTuple):
    """Columns of one group and of its neighbor inward that are left after their rows are condensed, as rows, and six
    rows for condensation; the space is all groups'.
    """

    own: Array  # (size + 6, kept) what the group does in its own rows
    right: Array  # (after + 6, kept) what the neighbor does in the group's rows
    lower: Array  # (size + 6, kept of the neighbor) what the group does in the neighbor's rows
    kept: NDArray[np.int64]  # rows of the group that stay after condensation
    kept_inner: NDArray[np.int64]  # those of its neighbor


@kernel
def assemble(
    group: int, size: int, after: int, c1: float, c2: float, layout: Layout, arrays: Arrays, state: State,
    perturbed: State, dual: Reals, scratch: TangentScratch, symmetric: bool, incoming: Any, outgoing: Any, panels: Any,
    blocks: Any,
) -> None:  # fmt: skip
    """Fill the ``blocks`` of a group of ``size`` rows, and ``after`` of its neighbor inward. ``incoming`` is what outer
    groups have added to its own rows, to ``outgoing`` it adds what starts in it and belongs to its neighbor's.
    ``blocks.L`` is left as it is where T is to be ``symmetric``.
    """
    F, inner = scratch.F, layout.inward[group]
    for i in range(size + after):
        for j in range(size + after):
            F[i, j] = 0.0
    for i in range(incoming.shape[0]):
        for j in range(incoming.shape[0]):
            F[i, j] = incoming[i, j]
    fill(group, size, c1, c2, layout, arrays, state, perturbed, dual, scratch)
    for i in range(after):
        for j in range(after):
            outgoing[i, j] += F[size + i, size + j]
    condense(F, 0, 0, size + after, group, layout, arrays, state)
    add_parent_geometric_stiffness(group, layout, arrays, state, perturbed, F, scratch)
    condense_columns(F, 0, panels.kept, 0, size, panels.kept, group, layout, arrays, state, panels.own, blocks.D)
    add_own_geometric_stiffness(group, layout, arrays, state, perturbed, blocks.D, scratch)
    if after > 0:
        condense_columns(
            F, 0, panels.kept, size, after, panels.kept_inner, inner, layout, arrays, state, panels.right, blocks.U
        )
    if after > 0 and not symmetric:
        condense(F, size, 0, size, inner, layout, arrays, state)
        condense_columns(
            F, size, panels.kept_inner, 0, size, panels.kept, group, layout, arrays, state, panels.lower, blocks.L
        )


@kernel
def condense_columns(
    F: Reals, offset: int, rows: Reals, first: int, count: int, columns: Reals, group: int, layout: Layout,
    arrays: Arrays, state: State, panel: Reals, out: Reals,
) -> None:  # fmt: skip
    """out (columns, rows) <- these rows of F from ``offset`` on, and of a group's ``count`` columns from ``first`` on
    those that stay after condensation, as rows; ``panel`` is where they are condensed.
    """
    if layout.condensed[group] == 0:
        for a in range(columns.shape[0]):
            for b in range(rows.shape[0]):
                out[a, b] = F[offset + rows[b], first + columns[a]]
        return
    for b in range(rows.shape[0]):
        for a in range(count):
            panel[a, b] = F[offset + rows[b], first + a]
    condense(panel, 0, 0, rows.shape[0], group, layout, arrays, state)
    for a in range(columns.shape[0]):
        for b in range(rows.shape[0]):
            out[a, b] = panel[columns[a], b]


class Unknowns(NamedTuple):
    """The rows of all groups, and those of them that are solved for."""

    base: NDArray[np.int64]  # (groups + 1,) first row of each
    rows: NDArray[np.int64]  # (unknowns,) those that stay after condensation
    x: Array  # (unknowns,)
    b: Array  # (rows + 6,)
    dual: Array  # (nv, 6) dual bases of all joints
    motions: Array  # (nb, 6)


class SolveContext(NamedTuple):
    """What one right-hand side is solved with."""

    layout: Any
    arrays: Any
    state: Any
    factors: Any
    unknowns: Any
    border: Any


@kernel
def solve(r: Reals, context: SolveContext, dq: Reals) -> None:
    """dq (n,) with T dq = r."""
    solve_within(r, context, dq)
    add_border(context.border, dq)


@kernel
def solve_within(r: Reals, context: SolveContext, dq: Reals) -> None:
    """dq (n,) with T dq = r, T without its border."""
    unknowns = context.unknowns
    spread_load(r, unknowns.base, context.layout, context.arrays, context.state, unknowns.dual, unknowns.b)
    for i in range(unknowns.rows.shape[0]):
        unknowns.x[i] = unknowns.b[unknowns.rows[i]]
    solve_blocks(context.factors, unknowns.x)
    for i in range(unknowns.rows.shape[0]):
        unknowns.b[unknowns.rows[i]] = unknowns.x[i]
    gather_motion(
        unknowns.b, unknowns.base, context.layout, context.arrays, context.state, unknowns.dual, unknowns.motions, dq
    )


def solve_one(r: Any, context: Any, dq: Any) -> None:
    """As a solver's kernels call it."""
    solve(r, context, dq)


def inertia_one(a: Any, context: Any, tau: Any) -> None:
    """tau (n,) = M a."""
    inertia_forces(context.arrays, context.state, a, tau)


@cache
def tangent_callbacks(data: Any) -> tuple[Callable[..., None], Callable[..., None]]:
    """Return these two as a solver's kernels call them with data of this type."""
    if not COMPILED:
        return solve_one, inertia_one
    vector = types.float64[::1]
    take = callback(types.void(vector, data, vector))
    return take(solve_one), take(inertia_one)


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

    Attributes
    ----------
    factored
        How often: who keeps factors must see whether they are still his.
    symmetric
        Whether T may be taken as symmetric by who corrects what it is off.
    solve_one, inertia_one, data
        :meth:`solve` and :meth:`inertia` of one vector as kernels call them.
    """

    factored = 0

    def __init__(self, arrays: Arrays, state: State, groups: Groups, acting: Sequence[Acting]) -> None:
        self._moving = state
        self.symmetric = all(a.load.symmetric for a in acting)
        self.layout, kept, self._sizes = lay_out(arrays, groups, acting)
        inward = self.layout.inward
        widest = max(size + (self._sizes[k] if k >= 0 else 0) for size, k in zip(self._sizes, inward, strict=True))
        z = np.zeros
        most = 6 * max(4, int(np.diff(self.layout.first_body).max(initial=0)))
        self._scratch = TangentScratch(
            F=z((widest + 6, widest)),
            S=z((6, 6)),
            N=z((6, 6)),
            C=z((3, 3)),
            turn=z(3, complex),
            G=z((6, 6)),
            g=z((6, 3)),
            row=z(12),
            pair=z(24),
            K=z((most, most)),
            weight=z(int(arrays.kept.max(initial=-1)) + 1),
            along=z(len(state.v)),
            coupling_block=z((int(self.layout.columns.sum()), 2, len(arrays.bodies), 6)),
        )
        base = np.concatenate(([0], np.cumsum(self._sizes))).astype(np.int64)
        rows = np.concatenate([np.zeros(0, np.int64), *(at + own for at, own in zip(base, kept, strict=False))])
        nv = int((arrays.bodies["nv"]).sum())
        self._dual = z((nv, 6))
        self._tree = BlockTree([len(own) for own in kept], inward.tolist())
        self._panels = [pin(panels) for panels in self._share_panels(kept)]
        self._unknowns = pin(
            Unknowns(base, rows, z(len(rows)), z(base[-1] + 6), self._dual, z((len(arrays.bodies), 6)))
        )
        free = int(arrays.bodies["nv"][arrays.bodies["vf"] >= 0].sum())
        self._border = Border.of(self.layout, free)
        self._state = copy_state(state)
        self._held = tuple(map(pin, (arrays, self._state, self.layout, self._scratch)))
        arrays_, state_, layout, _ = self._held
        self.data = pin(SolveContext(layout, arrays_, state_, self._tree.factors, self._unknowns, pin(self._border)))
        self.solve_one, self.inertia_one = tangent_callbacks(pointer_type(self.data) if COMPILED else None)
        own = state._replace(S=state.S[:0], U=state.U[:0], D=state.D[:0])
        self._steps = to_complex_state(own)
        self._perturbed = pin(self._steps)

    def _share_panels(self, kept: list[NDArray[np.int64]]) -> list[Panels]:
        """Return the panels of every group."""
        none, inward = np.zeros(0, np.int64), self.layout.inward.tolist()
        widest = max((len(own) for own in kept), default=0)
        space = np.zeros((3, (max(self._sizes, default=0) + 6) * widest))

        def share(k: int, rows: int, columns: int) -> Array:
            return space[k, : (rows + 6) * columns].reshape(rows + 6, columns)

        panels = []
        for size, own, k in zip(self._sizes, kept, inward, strict=True):
            after, inner = (self._sizes[k], kept[k]) if k >= 0 else (0, none)
            panels.append(
                Panels(share(0, size, len(own)), share(1, after, len(own)), share(2, size, len(inner)), own, inner)
            )
        return panels

    def factor(
        self, c1: float, c2: float, weight: Array | None = None, symmetric: bool = False, averaged: bool = False
    ) -> bool:
        """Assemble and factor T at the state of the last inverse dynamics; False where it is singular.

        ``weight`` (m,): T + J^T alpha J instead. ``symmetric``: as if it were, which costs less; see the package
        for where it is. ``averaged``: (T + T^T) / 2, whose negative eigenvalues are counted.
        """
        self._scratch.weight[:] = 0.0 if weight is None else weight
        with one_thread():
            return self._factor(c1, c2, symmetric, averaged)

    def _factor(self, c1: float, c2: float, symmetric: bool, averaged: bool) -> bool:
        arrays, state, layout, held_scratch = self._held
        scratch, perturbed = self._scratch, self._perturbed
        received: Any = self._state
        for own, given in zip(received, self._moving, strict=True):
            own[...] = given
        self._steps.q[:], self._steps.v[:] = self._state.q, self._state.v
        joint_stiffness(c1, layout, arrays, state, perturbed, scratch.along)
        scratch.coupling_block[:] = 0.0
        self._tree.reset(symmetric, averaged)
        self.factored += 1
        incoming: dict[int, Array] = {}  # what groups have added to their neighbor's own rows
        for group, panels in enumerate(self._panels):
            inner = int(self.layout.inward[group])
            after = self._sizes[inner] if inner >= 0 else 0
            received, outgoing = incoming.pop(group, NO_BLOCK), incoming.get(inner, NO_BLOCK)
            if inner >= 0 and inner not in incoming:
                outgoing = incoming[inner] = np.zeros((after, after))
            blocks = self._tree.blocks[group]
            assemble(
                group, self._sizes[group], after, c1, c2, layout, arrays, state, perturbed, self._dual,
                held_scratch, symmetric, received, outgoing, panels, blocks,
            )  # fmt: skip
            if not self._tree.eliminate(group):
                return False
        return self._add_border()

    def _add_border(self) -> bool:
        """Solve for what the border is made of; False where T is singular with it."""
        border, (arrays, state, *_) = self._border, self._held
        r = len(border.bodies)
        if not r:
            return True
        e, w = border.lines[:r], border.lines[r:]
        u = np.zeros_like(e)
        wrench = np.zeros(self._scratch.coupling_block.shape[2:])
        for i, motion, line in zip(border.bodies, border.motions, e, strict=True):
            if motion < 0:
                line[unpin(arrays).bodies["vf"][i]] = 1.0
            else:
                wrench[:] = 0.0
                wrench[i, motion] = 1.0
                project_wrenches(wrench, arrays, state, line)
        for (column, row), out, line in zip(self._scratch.coupling_block, u, w, strict=True):
            project_wrenches(column, arrays, state, out)
            project_wrenches(row, arrays, state, line)
        u[~e.any(axis=1)] = w[~e.any(axis=1)] = 0.0  # of motions that the body does not have
        for load, motion in zip(np.vstack((u, e)), border.columns, strict=True):
            solve_within(load, self.data, motion)
        equations = np.eye(2 * r) + border.lines @ border.columns.T
        own = np.abs(np.diagonal(equations[:r, r:]))  # of a coordinate alone, one over its stiffness
        units = np.append(np.ones(r), np.where(own > 0.0, own, 1.0))
        balanced = units[:, None] * equations / units
        good = bool(np.isfinite(balanced).all()) and np.linalg.cond(balanced) < MAX_BORDER_CONDITION
        border.inverse[:] = np.linalg.inv(balanced) / units[:, None] * units if good else 0.0
        return good

    def solve(self, r: Array) -> Array:
        """Return dq with T dq = r, both (n,) or (n, columns), by the last factors."""
        dq = np.empty((r.size // len(r), len(r)))
        for load, motion in zip(np.ascontiguousarray(r.reshape(len(r), -1).T), dq, strict=True):
            solve(load, self.data, motion)
        return dq.T.reshape(r.shape)

    @property
    def negative(self) -> int:
        """Number of negative eigenvalues of T, as it was last factored ``averaged``."""
        return count_negative(self)

    def inertia(self, a: Array) -> Array:
        """Return M a (n,) at the state of the last factors."""
        tau = np.zeros(len(a))
        arrays, state, *_ = self._held
        inertia_forces(arrays, state, a, tau)
        return tau
