"""Constraint equations that are redundant except for rounding of the geometry.

With exact numbers J has the rank r at every closed position, and m - r equations are redundant. With rounded numbers
these equations do not close exactly, and J has m - r singular values of the size of the rounding. They would lock the
mechanism or keep it from being assembled. Small singular values also occur near singular configurations. The two are
distinguished by finite motions: the loops are closed in the least-squares sense with the r largest singular values, and
moved in steps. If all closure errors stay within the assembly tolerance, m - r equations are redundant.

    minimize |Phi~(q)|^2   by steps   -S V_r diag(1 / sigma_r) U_r^T Phi~,      J~ = R^-1 J S = U diag(sigma) V^T

with the units S of coordinates and R of equations; V beyond r spans the motions, U beyond r the redundant combinations
of equations. Parts of a mechanism that no equation ties to each other are examined one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.signals import InUse
from solvers.system import AnySystem, Array

from .inputs import Drives, Inputs

ROUNDING_TOLERANCE = 1e-12  # of singular values and gaps, in units: what is zero to rounding
REGULAR_RATIO = 50.0  # singular values beyond this many tolerances are no rounding
MIN_REGULAR, MAX_REGULAR = 1e-3, 0.1  # ... within these limits
ENTRY_TOLERANCE = 1e-13  # entries of J~ that tie no equation to a coordinate
WALK_STEP, WALK_STEPS = 0.3, 12  # of a move, in units; steps of a walk: about a turn, forwards and backwards
MAX_WALKS = 3  # walks, each forwards and backwards, if there are several degrees of freedom
MAX_NEWTON_STEP = 0.5  # of a coordinate in one iteration, in units
MAX_CLOSING_ITERATIONS, CLOSING_TOLERANCE = 60, 1e-12
MAX_RANKS = 4  # that are tried at most in one part
MAX_PART_EQUATIONS = 400  # equations of a part that is examined


class DriveMotion(NamedTuple):
    """How drives move along a walk."""

    time: Callable[[int], float]  # (step): s
    place: Callable[[int], None]  # (step): moves the inputs that drive; backwards where it is negative


def drive_motions(drives: Drives, inputs: Inputs, signals: list[InUse]) -> list[DriveMotion]:
    """Return how drives can move: functions of time by their time scales, inputs anywhere."""
    given = [k for k in drives.signals if k in inputs.signals]
    centers = {k: float(signals[k].record["c"][0]) for k in given}

    def place(step: int) -> None:
        for k in given:
            signals[k].record["c"][0] = centers[k] + WALK_STEP * step * drives.sizes[k]

    def drive_motion(time_scale: float) -> DriveMotion:
        return DriveMotion(lambda step: WALK_STEP * step * time_scale, place)

    time_scales = {drives.time_scale(k) for k in drives.signals if k not in given}
    return [drive_motion(time_scale) for time_scale in sorted(time_scales)] or [drive_motion(0.0)]


class Position(NamedTuple):
    """A position of one part that is closed in the least-squares sense."""

    q: Array  # (nq,) of all parts
    drive_motion: int  # how the drives move
    step: int  # how far they have moved
    J: Array  # (rows, coordinates) in units
    gaps: Array  # (rows,) in units
    regular: float  # smallest singular value of J that counts; gaps grow with its inverse


class Part(NamedTuple):
    """Loops with common coordinates, some equations of which are redundant except for rounding."""

    rows: NDArray[np.int64]  # numbers of its equations
    coordinates: NDArray[np.int64]
    rank: int  # of the equations with exact numbers
    gap: Array  # (rows,) the most that equations open in the least-squares sense, in units
    positions: list[Position]


class Redundancy:
    """Search for redundant equations of a system.

    Parameters
    ----------
    system
        The equations.
    units
        (m,) what each residual is measured by: 1 rad, or the length of its loop in m.
    allowed
        (m,) the most that a redundant equation may open, in its unit.
    drive_motions
        How drives move; one that stays where no drive moves.
    """

    def __init__(self, system: AnySystem, units: Array, allowed: Array, drive_motions: list[DriveMotion]) -> None:
        self._system, self._units, self._drive_motions = system, units, drive_motions
        self._allowed = np.maximum(allowed, ROUNDING_TOLERANCE)
        self._terms, self._random = system.allocate_terms(), np.random.default_rng(0)
        self._regular = find_regular_limit(float(allowed.max(initial=0.0)))

    def find(self, start: Array, held: NDArray[np.bool_]) -> Iterator[Part]:
        """Yield every part with redundant equations that open by more than rounding; ``held`` (n,) coordinates stay
        where they are at ``start`` (nq,) until the loops are closed.
        """
        for rows, columns in self.parts(start):
            q = start.copy()
            if len(rows) <= MAX_PART_EQUATIONS and len(columns) and self.close(q, 0.0, rows, columns[~held[columns]]):
                part = self._examine(q, rows, columns)
                if part is not None:
                    yield part

    def evaluate(self, q: Array, t: float) -> tuple[Array, Array]:
        """Return J (m, n) and gaps (m,) at q (nq,), in units; the bodies are placed."""
        s, terms = self._system, self._terms
        s.fill_position(t, q, terms)
        terms.J[s.nonholonomic] = 0.0  # what restricts velocities only ties no positions
        return terms.J * (s.size / self._units[:, np.newaxis]), terms.Phi / self._units

    def close(
        self, q: Array, t: float, rows: NDArray[np.int64], columns: NDArray[np.int64], rank: int | None = None
    ) -> bool:
        """Close ``rows`` by ``columns`` in the least-squares sense, q in place, with the ``rank`` largest singular
        values or those that are regular; False if it does not converge.
        """
        largest = np.inf
        for _ in range(MAX_CLOSING_ITERATIONS):
            J, gaps = self.evaluate(q, t)
            if not (np.isfinite(J).all() and np.isfinite(gaps).all()):
                return False
            U, sigma, Vt = np.linalg.svd(J[np.ix_(rows, columns)], full_matrices=False)
            r = int(np.count_nonzero(sigma > self._regular)) if rank is None else min(rank, len(sigma))
            step = np.zeros(self._system.n)
            step[columns] = -Vt[:r].T @ ((U[:, :r].T @ gaps[rows]) / np.maximum(sigma[:r], ROUNDING_TOLERANCE))
            largest = float(np.abs(step).max(initial=0.0))
            step *= min(1.0, MAX_NEWTON_STEP / max(largest, 1e-300))
            self._system.apply(q, step * self._system.size)
            if largest < CLOSING_TOLERANCE:
                return True
        return largest < ROUNDING_TOLERANCE

    def positions(
        self, start: Array, rows: NDArray[np.int64], columns: NDArray[np.int64], rank: int
    ) -> list[Position] | None:
        """Return closed positions along random motions from ``start``; None: an equation opens too far."""
        found: list[Position] = []
        walks = MAX_WALKS * len(self._drive_motions) if len(columns) - rank > 1 else len(self._drive_motions)
        for k in range(2 * walks):
            drive_motion, sign, q = k // 2 % len(self._drive_motions), 1 - 2 * (k % 2), start.copy()
            if k % 2 == 0:
                wanted = self._random.normal(size=len(columns))
            along = sign * wanted
            for step in range(WALK_STEPS + 1):
                position = self.position_at(q, rows, columns, rank, drive_motion, sign * step)
                if position is None:
                    break  # the end of the range of the motion
                found.append(position)
                if np.any(near_singular(position, found[0]) * np.abs(position.gaps) > self._allowed[rows]):
                    return None
                q = position.q.copy()
                along = self._move(q, position.J, columns, rank, along)
        return found or None

    def position_at(
        self,
        q: Array,
        rows: NDArray[np.int64],
        columns: NDArray[np.int64],
        rank: int,
        drive_motion: int,
        step: int,
    ) -> Position | None:
        """Return the closed position near q (nq,), the drives moved by ``step``; None: there is none."""
        drives, near = self._drive_motions[drive_motion], q.copy()
        drives.place(step)
        t = drives.time(abs(step))
        closed = self.close(near, t, rows, columns, rank)
        J, gaps = self.evaluate(near, t)
        drives.place(0)
        if not closed:
            return None
        own = J[np.ix_(rows, columns)]
        regular = np.linalg.svdvals(own)[rank - 1] if rank else 1.0
        return Position(near, drive_motion, step, own, gaps[rows], float(regular))

    def parts(self, q: Array) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """Yield the equations and the coordinates of every part of the mechanism that they tie together."""
        m, n = self._system.m, self._system.n
        tied = np.zeros((m, n), bool)
        for _ in range(3):  # an entry may be zero at one position
            near = q.copy()
            self._system.apply(near, 0.1 * self._system.size * self._random.normal(size=n))
            tied |= np.abs(self.evaluate(near, 0.0)[0]) > ENTRY_TOLERANCE
        yield from connected_parts(tied)

    def _examine(self, q: Array, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Part | None:
        """Return a part with redundant equations; None if none is redundant, or if they close exactly."""
        J, gaps = self.evaluate(q, 0.0)
        sigma = np.zeros(len(rows))
        own = np.linalg.svdvals(J[np.ix_(rows, columns)])
        sigma[: len(own)] = own
        first = int(np.count_nonzero(sigma > self._regular))
        if first == len(rows) or (
            sigma[first:].max() < ROUNDING_TOLERANCE and np.abs(gaps[rows]).max() < ROUNDING_TOLERANCE
        ):
            return None
        for rank in _likely_ranks(sigma, first):
            positions = self.positions(q, rows, columns, rank)
            if positions is not None:
                gap = np.max([near_singular(p, positions[0]) * np.abs(p.gaps) for p in positions], axis=0)
                return Part(rows, columns, rank, gap, positions) if gap.max() > ROUNDING_TOLERANCE else None
        return None

    def _move(self, q: Array, J: Array, columns: NDArray[np.int64], rank: int, along: Array) -> Array:
        """Move q in place by ``WALK_STEP`` in the allowed direction nearest to ``along``; return that."""
        T = np.linalg.svd(J)[2][rank:]
        direction = T.T @ (T @ along)
        largest = float(np.abs(direction).max(initial=0.0))
        if not largest > 0.0:
            return along
        step = np.zeros(self._system.n)
        step[columns] = WALK_STEP * direction / largest
        self._system.apply(q, step * self._system.size)
        return direction


def connected_parts(tied: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield equations and coordinates of every connected part of a graph, in the order of their first equations.

    ``tied`` (m, n): whether an equation contains a coordinate. SciPy's graphs take longer to import than a model to
    compile.
    """
    m, n = tied.shape
    found = np.zeros(m, bool)
    for first in range(m):
        if found[first]:
            continue
        rows, columns, added = np.zeros(m, bool), np.zeros(n, bool), np.arange(m) == first
        while added.any():
            rows |= added
            reached = tied[added].any(axis=0) & ~columns
            columns |= reached
            added = tied[:, reached].any(axis=1) & ~rows
        found |= rows
        yield np.flatnonzero(rows), np.flatnonzero(columns)


def find_regular_limit(allowed: float) -> float:
    """Return the singular value, or length of an equation, beyond which none is rounding; ``allowed`` is the most that
    a redundant equation may open, all in units.
    """
    return max(MIN_REGULAR, min(MAX_REGULAR, REGULAR_RATIO * allowed))


def near_singular(position: Position, other: Position) -> float:
    """Return the ratio of the smallest singular values of two positions, at most 1; gaps grow with its inverse."""
    return min(1.0, position.regular / other.regular)


def _likely_ranks(sigma: Array, first: int) -> list[int]:
    """Return ranks from ``first`` on, in order: those before the largest gaps of the singular values (m,)."""
    floor = np.maximum(sigma, 1e-2 * ROUNDING_TOLERANCE)
    gaps = {r: (floor[r - 1] if r else 1.0) / floor[r] for r in range(first, len(sigma))}
    return sorted(sorted((r for r in gaps if r == first or gaps[r] > 1.0), key=lambda r: -gaps[r])[:MAX_RANKS])
