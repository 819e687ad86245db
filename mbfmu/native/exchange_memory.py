"""Memory of model exchange: states, derivatives and times, and what is known of the branch of the motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.projection.eliminated import NearSingularRecord
from solvers.projection.workspace import BranchHistoryRecord, CriticalRecord
from solvers.system import Array

if TYPE_CHECKING:
    from solvers.compiled.record import Reals, Table
    from solvers.positions import Positions

# Codes in addition to those of solvers.outcome: the state is on another branch of the motion; it is not finite; two
# branches of the motion cross there, so that P has no derivative
LEFT_BRANCH, STATES_NOT_FINITE, NOT_DIFFERENTIABLE = -1, -2, -3
# Entries of ``Exchange.times``
JUMP, JUMP_END, NEXT_EVENT, COMPLETED, PREVIOUS, COMPARED, EVALUATED, INTERPOLATES, RESTART = range(9)
TIMES = 9


class Branch(NamedTuple):
    """What is known by matrices of the branch of the motion: fields of
    :class:`solvers.projection.workspace.Workspace`.
    """

    critical: Table[CriticalRecord]
    q_c: Array
    u: Array
    C: Array
    C_tau: Array
    C_pivots: NDArray[np.int64]
    J_last: Array
    branch_history: Table[BranchHistoryRecord]
    frame: Array
    frame_tau: Array
    frame_pivots: NDArray[np.int64]
    q_last: Array
    nu_last: Array

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> Branch:
        """Return zeroed arrays for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        z, i = np.zeros, np.int64
        critical = CriticalRecord.zeros(1), z(nq), z(m), z((m, n)), z(m), z(m, i)
        frame = z((m, n)), BranchHistoryRecord.zeros(1), z((m, n)), z(m), z(m, i), z(nq), z(m)
        return Branch._make((*critical, *frame))


class EliminatedBranch(NamedTuple):
    """What is known of it where constraints are eliminated: fields of
    :class:`solvers.projection.eliminated.EliminationScratch`.
    """

    near: Table[NearSingularRecord]
    q_c: Array

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> EliminatedBranch:
        """Return zeroed arrays for ``nq`` positions."""
        return EliminatedBranch(NearSingularRecord.zeros(1), np.zeros(nq))


class Exchange(NamedTuple):
    """What model exchange has in addition to co-simulation.

    Attributes
    ----------
    x, derivatives, nominal
        (nq + n,) states that the importing tool has set, their derivatives and nominal values.
    times
        (TIMES,) times, s: the last event, and the end of a jump of signals there; the next event; the last completed
        step; the previous and the present position that branches are compared with; the last evaluation. Then 1.0 if
        the importing tool reports points at which it interpolates, and 1.0 if the next update of events restarts the
        comparison of branches.
    counts
        (3,) of completed steps, discarded evaluations, and evaluations, as the first of COUNTERS.
    before, completed, previous
        What is known of the branch before an evaluation or a report, at the last completed step, and at the previous
        position that branches were compared with: named tuples of arrays.
    """

    x: Array
    derivatives: Array
    nominal: Array
    times: Array
    counts: NDArray[np.int64]
    before: Any
    completed: Any
    previous: Any

    @staticmethod
    def allocate(nq: int, n: int, make_branch: Callable[[], Any]) -> Exchange:
        """Return zeroed arrays for ``nq`` positions and ``n`` velocities; ``make_branch`` returns those of a branch."""
        states, branches = (np.zeros(nq + n) for _ in range(3)), (make_branch() for _ in range(3))
        return Exchange._make((*states, np.zeros(TIMES), np.zeros(3, np.int64), *branches))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save; the first is never empty."""
        return [self.times, self.x, self.nominal, self.counts, *self.completed, *self.previous]


@kernel
def unpack_states(exchange: Exchange, q: Reals, v: Reals) -> bool:
    """(q, v) = x; False if x is not finite."""
    nq, total = q.shape[0], 0.0
    for i in range(nq):
        q[i] = exchange.x[i]
        total += 0.0 * q[i]
    for i in range(v.shape[0]):
        v[i] = exchange.x[nq + i]
        total += 0.0 * v[i]
    return bool(np.isfinite(total))


@kernel
def pack_states(q: Reals, v: Reals, exchange: Exchange) -> None:
    """x = (q, v)."""
    nq = q.shape[0]
    for i in range(nq):
        exchange.x[i] = q[i]
    for i in range(v.shape[0]):
        exchange.x[nq + i] = v[i]


@kernel
def fill_derivatives(
    exchange: Exchange, qdot: Reals, a: Reals, q: Reals, v: Reals, attraction: float, positions: Positions
) -> None:
    """Fill x' by qdot (nq,) and a (n,) at P(x) = (q, v); ``attraction`` is kappa, 1/s."""
    nq, x, out = q.shape[0], exchange.x, exchange.derivatives
    for i in range(nq):
        out[i] = qdot[i] - attraction * (x[i] - q[i])
    for i in range(v.shape[0]):
        out[nq + i] = a[i] - attraction * (x[nq + i] - v[i])
    for k in range(positions.turning.shape[0]):
        first, square = positions.turning[k, 0], 0.0
        for i in range(first, first + 4):
            square += x[i] * x[i]
        norm = np.sqrt(square)
        for i in range(first, first + 4):
            out[i] = norm * qdot[i] - attraction * (x[i] - norm * q[i])


@kernel
def fill_nominals(work: Any, exchange: Exchange) -> None:
    """Fill the nominal values: units of positions, and of velocities these times the rates of their coordinates."""
    nq = work.size_q.shape[0]
    for i in range(nq):
        exchange.nominal[i] = work.size_q[i]
    for i in range(work.size.shape[0]):
        exchange.nominal[nq + i] = work.coordinate_rates[i] * work.size[i]
