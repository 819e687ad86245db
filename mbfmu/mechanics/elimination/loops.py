"""Closed positions, consistent velocities and redundant equations of large mechanisms, in O(n).

Loops are closed by the least change of the coordinates in units of their sizes and weights, as in
:mod:`solvers.loop_closure`; a coordinate of weight zero is held. There the steps are found by dense matrices, and an
equation is redundant if its pivot is small relative to the largest of all. That ratio decreases with the number of
loops, also in regular positions. Here the independent part of every equation is compared with its own length.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.linalg.dense import largest_change
from solvers.loop_closure import (
    DRIVE_RATE_TOLERANCE,
    GAP_TOLERANCE,
    MAX_COORDINATE_STEP,
    MAX_ITERATIONS,
    MAX_STAGES,
    MAX_STALLED_ITERATIONS,
    VELOCITY_RESIDUAL_TOLERANCE,
    ClosureScratch,
    set_weights,
)
from solvers.system import (
    DROPPED,
    DROPPED_RESIDUAL,
    ELIMINATION_REPORT_SIZE,
    RESIDUAL,
    SHORTEST,
    AnySystem,
    Array,
)

from .eliminated import EliminationData
from .records import EliminationArrays, EliminationMemory

REDUNDANT_LENGTH = 1e-10  # of an equation that depends on others, as in solvers.projection.eliminated
HIDDEN_LENGTH_PER_RESIDUAL, HIDDEN_LENGTH_FACTOR = 1e4, 10.0  # as there
MAX_HIDDEN_LENGTH = 2e-3  # of a redundant equation where loops are off
MAX_DEPENDENT_RESIDUAL_RATIO = 1e-3  # of the equations left out, to the largest residual; theirs is of second order
MAX_DENSE_LOOP_COORDINATES = 100  # coordinates up to which loops are closed by dense matrices
DEPENDENT_LENGTH = 1e-4  # ... of one that is reported; a loop closed to 1e-11 may be so near a singular configuration


@kernel
def _correct_position(eqs: Any, t: float, q: Any, drop: float, closed: float, dq: Any, report: Any) -> None:
    eqs.correct_position(t, q, eqs.elimination, drop, closed, dq, report)


@kernel
def find_closing_change(eqs: Any, t: float, q: Any, change: Any, report: Any) -> None:
    """change (n,) of the coordinates that closes the linearized equations; none if they are closed.

    Redundant equations are as long as the positions are off. Solved for, their rounding errors would be divided by this
    length. So equations as short as that are left out if the others leave nothing of their residual.
    """
    eqs.correct_position(t, q, eqs.elimination, REDUNDANT_LENGTH, GAP_TOLERANCE, change, report)
    drop, limit = REDUNDANT_LENGTH, min(HIDDEN_LENGTH_PER_RESIDUAL * report[RESIDUAL], MAX_HIDDEN_LENGTH)
    while report[RESIDUAL] > GAP_TOLERANCE and report[SHORTEST] < limit:
        shorter, drop = drop, HIDDEN_LENGTH_FACTOR * report[SHORTEST]
        eqs.correct_position(t, q, eqs.elimination, drop, GAP_TOLERANCE, change, report)
        if report[DROPPED_RESIDUAL] > max(MAX_DEPENDENT_RESIDUAL_RATIO * report[RESIDUAL], 0.1 * GAP_TOLERANCE):
            eqs.correct_position(t, q, eqs.elimination, shorter, GAP_TOLERANCE, change, report)
            break


@kernel
def iterate_to_closed(eqs: Any, t: float, q: Any, size: Any, weight: Any, change: Any, report: Any) -> bool:
    """Close the loops by Gauss-Newton steps of limited size, q (nq,) in place; False: they do not close.

    ``size`` and ``weight`` (n,) of the coordinates; ``change`` (n,) is scratch.
    """
    own, best, stalled = eqs.elimination.own, np.inf, 0
    for i in range(size.shape[0]):
        own.size[i] = size[i] * weight[i]
    for _ in range(MAX_ITERATIONS):
        find_closing_change(eqs, t, q, change, report)
        error = report[RESIDUAL]
        if error <= GAP_TOLERANCE:
            return True
        stalled = 0 if error < 0.5 * best else stalled + 1
        best = min(best, error)
        largest = largest_change(change, size)
        if stalled > MAX_STALLED_ITERATIONS or not np.isfinite(largest):
            return False
        part = min(1.0, MAX_COORDINATE_STEP / max(largest, 1e-300))
        for i in range(size.shape[0]):
            change[i] *= part
        eqs.retract(q, change, eqs.data)
    return False


@kernel
def find_closed_velocities(
    eqs: Any, t: float, q: Any, start: Any, rate: float, v: Any, size: Any, weight: Any, change: Any, report: Any
) -> bool:
    """v (n,) = velocities with J v = nu, the least change from ``start`` (n,); False: there are none.

    ``rate`` (1/s) as that of the system; other arguments are those of :func:`iterate_to_closed`.
    """
    own = eqs.elimination.own
    for i in range(size.shape[0]):
        own.size[i], v[i] = size[i] * weight[i], start[i]
    for _ in range(2):  # the second finds what the first has left
        eqs.correct_velocity(t, q, v, eqs.elimination, REDUNDANT_LENGTH, change, report)
        for i in range(size.shape[0]):
            v[i] += change[i]
    moving = size.shape[0] - eqs.elimination.arrays.world[0].states
    speed = largest_change(v[:moving], size[:moving])
    allowed = VELOCITY_RESIDUAL_TOLERANCE * speed + DRIVE_RATE_TOLERANCE * rate
    return max(report[DROPPED_RESIDUAL], largest_change(change, size)) <= allowed


class Shortest(NamedTuple):
    """The equations at a position, relative to their original lengths."""

    independent: float  # shortest part of an equation that is independent of the others
    residual: float  # largest residual of the redundant equations, relative to the same lengths


def closes_by_elimination(system: AnySystem) -> bool:
    """Whether the loops of a system are closed by the elimination of their constraints: those of a large one."""
    large = not system.has_matrices or system.n > MAX_DENSE_LOOP_COORDINATES
    return large and system.m > 0 and system.elimination is not None


class EliminatedLoops:
    """The loops of a large mechanism.

    Parameters
    ----------
    system
        Equations of motion, with ``elimination``.
    """

    def __init__(self, system: AnySystem) -> None:
        assert system.elimination is not None  # else there is nothing to eliminate
        self._system, self._equations = system, system.elimination()
        data: EliminationData = unpin(unpin(self._equations).elimination)
        self._own: EliminationArrays = unpin(data.own)
        self._memory: EliminationMemory = unpin(data.memory)
        self._change, self._report = np.zeros(system.n), np.zeros(ELIMINATION_REPORT_SIZE)

    @staticmethod
    def of(system: AnySystem) -> EliminatedLoops | None:
        """Return the loops of a system; None if it has none, or if it is small enough for matrices."""
        return EliminatedLoops(system) if closes_by_elimination(system) else None

    def close(self, t: float, start: Array, held: NDArray[np.bool_], given: Array | None = None) -> Array | None:
        """Return closed positions (nq,) near ``start``; None if none are found.

        ``held`` (n,) coordinates stay; ``given`` (n,) ones change only if the loops cannot close by the others.
        """
        for weights in self._stages(held, given):
            q = start.copy()
            if iterate_to_closed(self._equations, t, q, self._system.size, weights, self._change, self._report):
                return q
        return None

    def find_velocities(
        self, t: float, q: Array, start: Array, held: NDArray[np.bool_], given: Array | None = None
    ) -> Array | None:
        """Return velocities (n,) with J v = nu at closed positions q, the least change from ``start``; None if none are
        found. ``held`` and ``given`` as for :meth:`close`.
        """
        for weights in self._stages(held, given):
            v, own = np.zeros(self._system.n), (self._system.size, weights, self._change, self._report)
            if find_closed_velocities(self._equations, t, q, start, self._system.rate, v, *own):
                return v
        return None

    def _stages(self, held: NDArray[np.bool_], given: Array | None) -> Iterator[Array]:
        """Yield the weights (n,) of the coordinates, of sets that are tried one after the other; see
        :mod:`solvers.loop_closure`.
        """
        work, numbers = ClosureScratch.allocate(len(held), 0), np.zeros(len(held)) if given is None else given
        work.free[held] = 0.0
        for stage in range(MAX_STAGES):
            if set_weights(stage, numbers, pin(work)):
                yield work.weight.copy()

    def measure(self, t: float, q: Array) -> Shortest:
        """Return what the equations are like at positions q (nq,)."""
        self._measure(t, q, REDUNDANT_LENGTH)
        return Shortest(float(self._report[SHORTEST]), float(self._report[DROPPED_RESIDUAL]))

    def find_redundant(self, t: float, q: Array) -> NDArray[np.int64]:
        """Return the numbers of the equations that depend on the others at closed positions q (nq,), in order."""
        self._measure(t, q, DEPENDENT_LENGTH)
        return np.sort(np.array(self._find_dropped() if self._report[DROPPED] else [], np.int64))

    def _measure(self, t: float, q: Array, drop: float) -> None:
        """Fill the change that closes the linearized equations, and the report."""
        self._own.size[:] = self._system.size
        _correct_position(self._equations, t, q, drop, -1.0, self._change, self._report)

    def _find_dropped(self) -> list[int]:
        """Return the equations that the last elimination has left out.

        The equations that a front keeps are combinations E of those that have arrived. As many of the latter, with
        independent columns of E, stand for them; the others are left out. Those that remain of a front stand for
        equations in the same way, and their combinations B are applied where they arrive.
        """
        values = self._memory.values
        remaining: list[tuple[list[int], Array]] = []  # of every front: original numbers, and B
        dropped: list[int] = []
        for front in self._own.fronts:
            senders = [remaining[k] for k in self._own.messages[front["first_message"] : front["end_message"]]]
            own = self._own.equations["kept"][front["first_row"] : front["end_row"]].tolist()
            numbers = np.array([*(number for those, _ in senders for number in those), *own], np.int64)
            rank, rows = int(front["rank"]), len(numbers)
            kept, blocks = rank + int(front["left"]), [*(B for _, B in senders), np.eye(len(own))]
            E = values[front["E"] : front["E"] + kept * rows].reshape(kept, rows) @ scipy.linalg.block_diag(*blocks)
            if kept < rows:
                chosen = _independent_columns(E)
                dropped += np.delete(numbers, chosen).tolist()
                E, numbers = E[:, chosen], numbers[chosen]
            chosen = _independent_columns(E[rank:])
            remaining.append((numbers[chosen].tolist(), E[rank:, chosen]))
        return dropped


def _independent_columns(E: Array) -> NDArray[np.int64]:
    """Return as many columns of E (k, n) as it has rows, in order, which are independent as far as possible."""
    if not len(E):
        return np.zeros(0, np.int64)
    return np.sort(scipy.linalg.qr(E, mode="r", pivoting=True)[-1][: len(E)])
