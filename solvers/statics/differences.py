"""Steady states of a mechanism with dense matrices without complex numbers: as kernels, for native FMUs.

Residuals, damping and limits are those of :mod:`.dense` and :mod:`.newton`. The Jacobian consists of
central differences. Its error, about 1e-11 of the largest entry, makes Newton's method converge linearly with a small
factor instead of quadratically; the state that it converges to is the same. A pivot that this error may cause does not
determine an unknown: such unknowns stay as they are, as those of zero pivots do in :mod:`.dense`. Coordinates that are
known to be cyclic are left out, and stay where they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.template import specialize
from solvers.system import Array, Equations

from .dense import NewtonScratch, factor_jacobian_template, find_constraint_forces, max_stiffness, newton_template
from .newton import FOUND, MAX_STATE_DISTANCE, NO_PROGRESS, UNDETERMINED, Outcome

if TYPE_CHECKING:
    from solvers.compiled.record import Integers, Reals

TOO_FAR = len(Outcome)  # another result of a search
DIFFERENCE_STEP = 1e-5  # of a coordinate to either side, in its unit
# pivot of K relative to the first, below which it may be an error of the differences, amplified by the elimination
MIN_PIVOT_RATIO = 1e-7


class SteadyScratch(NamedTuple):
    """What a search needs; allocated once. N = n + rank unknowns."""

    newton: Any  # NewtonScratch of real numbers
    rows: NDArray[np.int64]  # (rank,) independent constraints
    lam: Array  # (rank,) multipliers
    report: Array  # (1,) factorized Jacobians

    @staticmethod
    def allocate(nq: int, size: Array, row: Array, rows: NDArray[np.int64], cyclic: NDArray[np.bool_]) -> SteadyScratch:
        """Return scratch for these units of coordinates (n,) and of the independent constraints (rank,)."""
        n, rank, z = len(size), len(row), np.zeros
        newton = NewtonScratch.allocate(nq, size.copy(), row.copy())
        newton = newton._replace(q=z(nq), v=z(n), dq=z(n), ahead=z(n + rank), cyclic=cyclic.astype(np.int64))
        return SteadyScratch(newton, rows.astype(np.int64), z(rank), z(1))


@kernel
def fill_residual(
    eqs: Equations,
    t: float,
    q: Reals,
    lam: Reals,
    moved: Reals,
    rows: Integers,
    c2: float,
    scale: float,
    scratch: Any,
    out: Reals,
) -> None:
    """out = f at (q, lam), in units: see :func:`solvers.statics.dense.linearize`."""
    n, rank, terms = scratch.v.shape[0], rows.shape[0], eqs.terms
    eqs.dynamics(t, q, scratch.v, eqs.data, terms)
    for i in range(n):
        balance = terms.h[i]
        for r in range(rank):
            balance += terms.J[rows[r], i] * lam[r]
        if c2 != 0.0:
            for j in range(n):
                balance += terms.M[i, j] * c2 * moved[j]
        out[i] = balance * scratch.size[i] / scale
    for r in range(rank):
        out[n + r] = terms.Phi[rows[r]] / scratch.row[r]


@kernel
def move_coordinate(eqs: Equations, q: Reals, k: int, step: float, scratch: Any) -> None:
    """scratch.q = q with coordinate k moved by ``step``."""
    for i in range(q.shape[0]):
        scratch.q[i] = q[i]
    for i in range(scratch.dq.shape[0]):
        scratch.dq[i] = 0.0
    scratch.dq[k] = step
    eqs.retract(scratch.q, scratch.dq, eqs.data)


@kernel
def linearize_by_differences(
    eqs: Equations,
    t: float,
    q: Reals,
    lam: Reals,
    moved: Any,
    rows: Integers,
    c2: float,
    mass: float,
    scale: float,
    scratch: Any,
) -> None:
    """As :func:`solvers.statics.dense.linearize`, with central differences."""
    n, rank, terms, ahead = scratch.v.shape[0], rows.shape[0], eqs.terms, scratch.ahead
    for k in range(n):
        if scratch.cyclic[k] == 1:
            for i in range(n + rank):
                scratch.K[i, k] = 0.0
            continue
        step = DIFFERENCE_STEP * scratch.size[k]
        move_coordinate(eqs, q, k, step, scratch)
        fill_residual(eqs, t, scratch.q, lam, moved, rows, c2, scale, scratch, ahead)
        for i in range(n + rank):
            scratch.K[i, k] = ahead[i]
        move_coordinate(eqs, q, k, -step, scratch)
        fill_residual(eqs, t, scratch.q, lam, moved, rows, c2, scale, scratch, ahead)
        for i in range(n + rank):
            scratch.K[i, k] = (scratch.K[i, k] - ahead[i]) / (2.0 * DIFFERENCE_STEP)
    fill_residual(eqs, t, q, lam, moved, rows, c2, scale, scratch, scratch.f)
    for i in range(n):
        for k in range(n):
            scratch.K[i, k] += mass * terms.M[i, k] * scratch.size[i] * scratch.size[k] / scale
        for r in range(rank):
            scratch.K[i, n + r] = terms.J[rows[r], i] * scratch.size[i] / scratch.row[r]
    for r in range(rank):
        for other in range(rank):
            scratch.K[n + other, n + r] = 0.0


factor_jacobian = specialize(factor_jacobian_template, __name__, {"UNDETERMINED_PIVOT_RATIO": MIN_PIVOT_RATIO})
hooks = {"linearize": linearize_by_differences, "factor_jacobian": factor_jacobian}
newton = specialize(newton_template, __name__, hooks)


@kernel
def find_start_multipliers(eqs: Equations, t: float, q: Reals, work: SteadyScratch) -> bool:
    """work.lam = multipliers of least residual at q; return whether they are determined."""
    eqs.dynamics(t, q, work.newton.v, eqs.data, eqs.terms)
    found: bool = find_constraint_forces(work.rows, eqs.terms, work.newton, work.lam)
    return found


@kernel
def find_farthest(moved: Reals, size: Reals) -> int:
    """Return which coordinate has changed most, in its unit."""
    farthest, largest = 0, 0.0
    for i in range(size.shape[0]):
        if abs(moved[i] / size[i]) > largest:
            farthest, largest = i, abs(moved[i] / size[i])
    return farthest


@kernel
def find_steady_state(eqs: Equations, t: float, q: Reals, work: SteadyScratch) -> int:
    """Move closed positions q (nq,) to a steady state with the velocities work.newton.v; return an Outcome.

    As :meth:`solvers.statics.newton.EquilibriumSolver.solve`, by Newton's method alone. There is no continuation: where
    a mechanism has several steady states, rounding decides which one a continuation reaches. For the same reason a
    search that begins where K is singular, as that of a body that nothing holds yet, is NO_PROGRESS, and a state that
    is not the one next to the start is TOO_FAR: then work.newton.moved are the changes. UNDETERMINED, too: the search
    begins in a singular configuration, or the state found has others next to it. On failure q is where the search
    ended.
    """
    scratch = work.newton
    if not find_start_multipliers(eqs, t, q, work):
        return UNDETERMINED
    if not is_isolated(eqs, t, q, work):
        return NO_PROGRESS
    code = newton(eqs, t, q, work.lam, work.rows, 0.0, 0.0, scratch, work.report)
    farthest = find_farthest(scratch.moved, scratch.size)
    if code == FOUND and abs(scratch.moved[farthest]) > MAX_STATE_DISTANCE * scratch.size[farthest]:
        return TOO_FAR
    return UNDETERMINED if code == FOUND and not is_isolated(eqs, t, q, work) else code


@kernel
def is_isolated(eqs: Equations, t: float, q: Reals, work: SteadyScratch) -> bool:
    """Whether K determines all unknowns but the cyclic coordinates, at q and the multipliers of the search."""
    scratch, free = work.newton, 0
    for i in range(scratch.moved.shape[0]):
        scratch.moved[i] = 0.0
        free += scratch.cyclic[i]
    linearize_by_differences(eqs, t, q, work.lam, scratch.moved, work.rows, 0.0, 0.0, 1.0, scratch)
    scale, n, N = max_stiffness(scratch), scratch.v.shape[0], scratch.z.shape[0]
    for i in range(n):
        for k in range(n):
            scratch.K[i, k] /= scale
    return bool(factor_jacobian(scratch)) and scratch.rank[0] == N - free
