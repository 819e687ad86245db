"""The structured tangent of one mechanism, factored and solved: see the package."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.records import Arrays, State, complex_state
from solvers.compiled.held import hold
from solvers.compiled.kernel import kernel
from solvers.linalg.blocks import BlockTree, one_thread, solve_blocks
from solvers.system import Array

from .filling import fill
from .folding import fold, gather_motion, inertia_forces, spread_load
from .groups import Groups
from .joints import turn_inner
from .layout import lay_out
from .loads import along_joints

if TYPE_CHECKING:
    from mbfmu.mechanics.builder.mechanism import Acting


class Scratch(NamedTuple):
    """Allocated once; W: rows of the largest two neighbors."""

    F: Array  # (W, W)
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


class Unknowns(NamedTuple):
    """The rows of all groups, and those of them that are solved for."""

    base: NDArray[np.int64]  # (groups + 1,) first row of each
    rows: NDArray[np.int64]  # (unknowns,) those that stay after folding
    x: Array  # (unknowns,)
    dual: Array  # (nv, 6) dual bases of all joints
    motions: Array  # (nb, 6)


@kernel
def solve(r: Any, L: Any, arrays: Any, state: Any, factors: Any, s: Any, b: Any, dq: Any) -> None:
    """dq (n, columns) with T dq = r; b (rows, columns) is zero, and used up."""
    spread_load(r, s.base, L, arrays, state, s.dual, b)
    for c in range(r.shape[1]):
        for i in range(s.rows.shape[0]):
            s.x[i] = b[s.rows[i], c]
        solve_blocks(factors, s.x)
        for i in range(s.rows.shape[0]):
            b[s.rows[i], c] = s.x[i]
        gather_motion(b, c, s.base, L, arrays, state, s.dual, s.motions, dq)


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
    """

    factored = 0

    def __init__(self, arrays: Arrays, state: State, groups: Groups, acting: Sequence[Acting]) -> None:
        self._moving = state
        self.layout, self._kept, self._sizes = lay_out(arrays, groups, acting)
        inward = self.layout.inward
        widest = max(size + (self._sizes[k] if k >= 0 else 0) for size, k in zip(self._sizes, inward, strict=True))
        z = np.zeros
        most = 6 * max(4, int(np.diff(self.layout.first_body).max(initial=0)))
        self._scratch = Scratch(
            F=z((widest, widest)),
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
        )
        base = np.concatenate(([0], np.cumsum(self._sizes))).astype(np.int64)
        rows = np.concatenate([np.zeros(0, np.int64), *(at + own for at, own in zip(base, self._kept, strict=False))])
        nv = int((arrays.bodies["nv"]).sum())
        self._dual = z((nv, 6))
        self._rows = int(base[-1])
        self._tree = BlockTree([len(own) for own in self._kept], inward)
        self._unknowns = hold(Unknowns(base, rows, z(len(rows)), self._dual, z((len(arrays.bodies), 6))))
        self._state = State(*(array.copy() for array in state))
        self._held = tuple(map(hold, (arrays, self._state, self.layout, self._scratch)))
        own = state._replace(S=state.S[:0], U=state.U[:0], D=state.D[:0])
        if not len(self.layout.steps) and not len(arrays.cuts):
            own = own._replace(bodies=state.bodies[:0])  # no complex step moves any
        self._steps = complex_state(own)
        self._twin = hold(self._steps)

    def factor(self, c1: float, c2: float, weight: Array | None = None) -> bool:
        """Assemble and factor T at the state of the last inverse dynamics; False where it is singular.

        ``weight`` (m,): T + J^T alpha J instead.
        """
        self._scratch.weight[:] = 0.0 if weight is None else weight
        with one_thread():
            return self._factor(c1, c2)

    def _factor(self, c1: float, c2: float) -> bool:
        arrays, state, L, s = self._held
        kept, scratch, twin = self._kept, self._scratch, self._twin
        for own, given in zip(self._state, self._moving, strict=True):
            own[...] = given
        self._steps.q[:], self._steps.v[:] = self._state.q, self._state.v
        along_joints(c1, L, arrays, state, twin, scratch.along)
        self._tree.begin()
        self.factored += 1
        carried: dict[int, Array] = {}  # what groups have added to their neighbor's own rows
        for group, size in enumerate(self._sizes):
            inner = int(self.layout.inward[group])
            after = self._sizes[inner] if inner >= 0 else 0
            F = scratch.F[: size + after, : size + after]
            F[...] = 0.0
            if group in carried:
                F[:size, :size] = carried.pop(group)
            fill(group, size, c1, c2, L, arrays, state, twin, self._dual, s)
            if inner >= 0:
                carried[inner] = F[size:, size:] + carried.get(inner, 0.0)
            top = np.ascontiguousarray(F[:size])
            fold(top, 0, group, L, arrays, state)
            turn_inner(group, L, arrays, state, twin, top, s, True)
            left = np.ascontiguousarray(np.vstack((top[:, :size], F[size:, :size])).T)
            fold(left, 0, group, L, arrays, state)  # the columns of this group
            left = left.T
            turn_inner(group, L, arrays, state, twin, left, s, False)
            D = left[np.ix_(kept[group], kept[group])]
            if inner < 0:
                U, below = np.zeros((len(kept[group]), 0)), np.zeros((0, len(kept[group])))
            else:
                right = np.ascontiguousarray(top[:, size:].T)
                fold(right, 0, inner, L, arrays, state)
                lower = np.ascontiguousarray(left[size:])
                fold(lower, 0, inner, L, arrays, state)
                U = right.T[np.ix_(kept[group], kept[inner])]
                below = lower[np.ix_(kept[inner], kept[group])]
            if not self._tree.append(D, U, below):
                return False
        return True

    def solve(self, r: Array) -> Array:
        """Return dq with T dq = r, both (n,) or (n, columns), by the last factors."""
        columns = np.ascontiguousarray(r.reshape(len(r), -1))
        (arrays, state, L, _), b = self._held, np.zeros((self._rows, columns.shape[1]))
        dq = np.zeros(columns.shape)
        solve(columns, L, arrays, state, self._tree.factors, self._unknowns, b, dq)
        return dq.reshape(r.shape)

    def inertia(self, a: Array) -> Array:
        """Return M a (n,) at the state of the last factors."""
        tau = np.zeros(len(a))
        arrays, state, *_ = self._held
        inertia_forces(arrays, state, a, tau)
        return tau
