"""Steady states of a mechanism with dense matrices without complex numbers: as kernels, for native FMUs.

Residuals, damping and limits are those of :mod:`.dense` and :mod:`.newton`. The Jacobian consists of
central differences. Its error, about 1e-11 of the largest entry, makes Newton's method converge linearly with a small
factor instead of quadratically; the state that it converges to is the same. A pivot that this error may cause does not
determine an unknown: such unknowns stay as they are, as those of zero pivots do in :mod:`.dense`. Coordinates that are
known to be cyclic are left out, and stay where they are.

First-order states z are positions q* = (q, z), with equations that are weighted as those of :mod:`.states`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.template import specialize
from solvers.system import Array, Equations

from .dense import NewtonScratch, factor_jacobian_template, find_constraint_forces, max_stiffness, newton_template
from .newton import FOUND, MAX_STATE_DISTANCE, NO_PROGRESS, UNDETERMINED, Outcome
from .states import MAX_RESTING_RATE, SLIPPING_START

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
    position: Array  # (nq + k,) q* = (q, z) with k first-order states
    can_hold: NDArray[np.int64]  # (k,) 1: the state keeps its start value if its rate is zero for every value
    lam: Array  # (rank,) multipliers
    report: Array  # (1,) factorized Jacobians

    @staticmethod
    def allocate(
        nq: int,
        size: Array,
        row: Array,
        rows: NDArray[np.int64],
        cyclic: NDArray[np.bool_],
        can_hold: NDArray[np.bool_],
    ) -> SteadyScratch:
        """Return scratch for these units of coordinates (n,) and of the independent constraints (rank,), with the
        first-order states (k,) that can be held among the last coordinates.
        """
        n, rank, k, z = len(size), len(row), len(can_hold), np.zeros
        newton = NewtonScratch.allocate(nq + k, size.copy(), row.copy())
        newton = newton._replace(q=z(nq + k), v=z(n), dq=z(n), ahead=z(n + rank), cyclic=cyclic.astype(np.int64))
        newton = newton._replace(weights=z(k), holding=z(k), held_values=z(k))
        return SteadyScratch(newton, rows.astype(np.int64), z(nq + k), can_hold.astype(np.int64), z(rank), z(1))


@kernel
def evaluate_at(eqs: Equations, t: float, q: Reals, scratch: Any) -> None:
    """The terms at q* (nq + k,), and the velocities ``scratch.v`` with the values of the states."""
    k = scratch.weights.shape[0]
    first, last = scratch.v.shape[0] - k, q.shape[0] - k
    for i in range(k):
        scratch.v[first + i] = q[last + i]
    eqs.dynamics(t, q, scratch.v, eqs.data, eqs.terms)


@kernel
def retract_with_states(eqs: Equations, q: Reals, dq: Reals, scratch: Any) -> None:
    """q* <- q* (+) dq."""
    k = scratch.weights.shape[0]
    eqs.retract(q, dq, eqs.data)
    for i in range(k):
        q[q.shape[0] - k + i] += dq[dq.shape[0] - k + i]


@inlined
def weighted_rate(i: int, balance: float, scratch: Any) -> float:
    """Equation of coordinate i with this entry of h + J^T lambda: a force, or -w g of a first-order state, or
    w rate (z - z0) of one that keeps its start value.
    """
    k = i - scratch.v.shape[0] + scratch.weights.shape[0]
    if k < 0:
        return balance
    if scratch.holding[k] > 0.0:
        return scratch.holding[k] * (scratch.v[i] - scratch.held_values[k])
    return scratch.weights[k] * balance


@kernel
def weigh_states(eqs: Equations, t: float, q: Reals, rate: float, work: SteadyScratch) -> None:
    """Set the weights of the states at q (nq,) with their start values in ``work.newton.v``, which of them keep these,
    and where the search begins for others: see :func:`solvers.statics.states.with_states_as_positions`,
    ``hold_states`` and ``start_values``; ``rate`` in 1/s.
    """
    scratch, terms, inertia = work.newton, eqs.terms, 0.0
    k, n = scratch.weights.shape[0], scratch.v.shape[0]
    if k == 0:
        return
    for i in range(k):
        scratch.held_values[i], scratch.v[n - k + i] = scratch.v[n - k + i], 0.0
    eqs.dynamics(t, q, scratch.v, eqs.data, terms)
    for i in range(n - k):
        for j in range(n - k):
            inertia = max(inertia, abs(terms.M[i, j]) * scratch.size[i] * scratch.size[j])
    frequency = rate if rate > 0.0 else 1.0
    for i in range(k):
        size = scratch.size[n - k + i]
        scratch.weights[i] = (inertia if inertia > 0.0 else 1.0) * frequency / (size * size)
        rests = abs(terms.h[n - k + i]) / size <= MAX_RESTING_RATE * frequency
        scratch.holding[i] = scratch.weights[i] * frequency if work.can_hold[i] == 1 and rests else 0.0
        slips = work.can_hold[i] == 1 and not rests
        scratch.v[n - k + i] = -SLIPPING_START * size * np.sign(terms.h[n - k + i]) if slips else scratch.held_values[i]


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
    evaluate_at(eqs, t, q, scratch)
    for i in range(n):
        balance = terms.h[i]
        for r in range(rank):
            balance += terms.J[rows[r], i] * lam[r]
        balance = weighted_rate(i, balance, scratch)
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
    retract_with_states(eqs, scratch.q, scratch.dq, scratch)


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


@kernel
def apply_correction(eqs: Equations, q: Reals, lam: Reals, damping: float, scale: float, scratch: Any) -> None:
    """As :func:`solvers.statics.dense.apply_correction`."""
    n = scratch.v.shape[0]
    for i in range(q.shape[0]):
        scratch.q_try[i] = q[i]
    for i in range(n):
        step = damping * scratch.size[i] * scratch.z[i]
        scratch.dq[i], scratch.moved_try[i] = step, scratch.moved[i] + step
    retract_with_states(eqs, scratch.q_try, scratch.dq, scratch)
    for r in range(lam.shape[0]):
        scratch.lam_try[r] = lam[r] + damping * scale / scratch.row[r] * scratch.z[n + r]


factor_jacobian = specialize(factor_jacobian_template, __name__, {"UNDETERMINED_PIVOT_RATIO": MIN_PIVOT_RATIO})
hooks = {
    "linearize": linearize_by_differences,
    "factor_jacobian": factor_jacobian,
    "apply_correction": apply_correction,
}
newton = specialize(newton_template, __name__, hooks)


@kernel
def find_start_multipliers(eqs: Equations, t: float, q: Reals, work: SteadyScratch) -> bool:
    """work.lam = multipliers of least residual at q; return whether they are determined."""
    evaluate_at(eqs, t, q, work.newton)
    found: bool = find_constraint_forces(work.rows, eqs.terms, work.newton, work.lam)
    return found


@kernel
def find_farthest(moved: Reals, size: Reals, n: int) -> int:
    """Return which of the first n coordinates has changed most, in its unit."""
    farthest, largest = 0, 0.0
    for i in range(n):
        if abs(moved[i] / size[i]) > largest:
            farthest, largest = i, abs(moved[i] / size[i])
    return farthest


@kernel
def find_steady_state(eqs: Equations, t: float, q: Reals, work: SteadyScratch) -> int:
    """Move closed positions q (nq,) to a steady state with the velocities work.newton.v, whose last entries are the
    first-order states and change, too; return an Outcome. :func:`weigh_states` comes first.

    As :meth:`solvers.statics.newton.EquilibriumSolver.solve`, by Newton's method alone. There is no continuation: where
    a mechanism has several steady states, rounding decides which one a continuation reaches. For the same reason a
    search that begins where K is singular, as that of a body that nothing holds yet, is NO_PROGRESS, and a state that
    is not the one next to the start is TOO_FAR: then work.newton.moved are the changes. UNDETERMINED, too: the search
    begins in a singular configuration, or the state found has others next to it. On failure q is where the search
    ended.
    """
    scratch, position = work.newton, work.position
    k, nq = scratch.weights.shape[0], q.shape[0]
    first = scratch.v.shape[0] - k
    for i in range(nq):
        position[i] = q[i]
    for i in range(k):
        position[nq + i] = scratch.v[first + i]
    code = search_from(eqs, t, position, work)
    for i in range(nq):
        q[i] = position[i]
    for i in range(k):
        scratch.v[first + i] = position[nq + i]
    return code


@kernel
def search_from(eqs: Equations, t: float, q: Reals, work: SteadyScratch) -> int:
    """As :func:`find_steady_state`, from q* = (q, z)."""
    scratch = work.newton
    if not find_start_multipliers(eqs, t, q, work):
        return UNDETERMINED
    if not is_isolated(eqs, t, q, work):
        return NO_PROGRESS
    code = newton(eqs, t, q, work.lam, work.rows, 0.0, 0.0, scratch, work.report)
    moving = scratch.v.shape[0] - scratch.weights.shape[0]
    farthest = find_farthest(scratch.moved, scratch.size, moving)
    if code == FOUND and moving > 0 and abs(scratch.moved[farthest]) > MAX_STATE_DISTANCE * scratch.size[farthest]:
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
