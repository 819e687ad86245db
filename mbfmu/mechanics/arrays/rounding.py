"""Loops with rounded numbers: they are corrected within the assembly tolerance, otherwise reported.

A truss cannot move, and no nearby geometry of it can. A loop is locked by its numbers if some of its equations are
nearly redundant: without them it can move by finite steps, along which they stay almost closed.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.builder.mechanism import MAX_ASSEMBLY_TOLERANCE, Mechanism
from mbfmu.mechanics.elimination import EliminatedLoops
from mbfmu.mechanics.records import Data
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import AnySystem, Array

from .assembly import held_coordinates, start_positions
from .corrected import Placements, correct, describe_correction
from .redundant import DriveMotion, Part, Redundancy, find_regular_limit
from .rounded import Measures, measure_rows
from .rows import MAX_LISTED, VANISHING_TOLERANCE, row_names

DEPENDENT_SINGULAR_RATIO = 1e-9  # singular values below this part of the largest are zero
# Part of a coordinate in a unit motion: of one that cannot move, and of one that can
FIXED_PART_LIMIT, MOBILE_PART_LIMIT = 1e-6, 0.05
# Positions of a large mechanism that are examined, and their distances from the start, in units of the coordinates
MAX_EXAMINED_POSITIONS, EXAMINED_DISTANCE = 3, (0.02, 0.05)


class Rounding:
    """Equations of a mechanism that are redundant except for rounding of its numbers.

    Parameters
    ----------
    row_size
        Units of the residuals of all rows.
    drive_motions
        How drives move.
    loops
        The loops of a large system.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        data: Data,
        system: AnySystem,
        row_size: Array,
        drive_motions: list[DriveMotion],
        loops: EliminatedLoops | None = None,
    ) -> None:
        self._mechanism, self._data, self._system, self._loops = mechanism, data, system, loops
        self._row_size, self._drive_motions = row_size, drive_motions

    def correct(self) -> list[Diagnostic]:
        """Correct joint frames so that equations which are redundant within the tolerance close; return warnings."""
        mechanism, tolerance, messages = self._mechanism, self._mechanism.assembly_tolerance, list[Diagnostic]()
        if not self._system.m or tolerance == 0.0:
            return []
        start, rows = start_positions(mechanism), self._rows
        if self._is_exact(0.0, start, held_coordinates(mechanism), tolerance):
            return []
        measures = self._measures(0.0, start)
        search = self._search(measures, tolerance)
        handles: list[CutHandle | None] = [handle for handle in mechanism.cuts for _ in handle.rows]
        handles += [None] * len(mechanism.couplings)
        for part in search.find(start, held_coordinates(mechanism)):
            own = rows[part.rows]
            placements = Placements(mechanism, self._data, [handles[row] for row in own])
            done = correct(search, placements, part, measures.units[own], own, tolerance)
            if done is not None and part.gap.max() > VANISHING_TOLERANCE:
                messages.append(describe_correction(mechanism, measures, own, part, done))
        return messages

    def explain_open(self, t: float) -> list[str]:
        """Return messages on nearly redundant equations that keep loops from closing at the start."""
        mechanism, start = self._mechanism, start_positions(self._mechanism)
        measures = self._measures(t, start)
        parts = self._search(measures, MAX_ASSEMBLY_TOLERANCE).find(start, held_coordinates(mechanism))
        return [". ".join(_explain(mechanism, measures, self._rows[part.rows], part)[:2]) for part in parts]

    def explain_lock(self, t: float, q: Array) -> list[Diagnostic]:
        """Return warnings about joints that cannot move at q (nq,) because of nearly redundant equations."""
        system, found = self._system, list[Diagnostic]()
        if not system.m or self._is_exact(t, q, np.zeros(system.n, bool), MAX_ASSEMBLY_TOLERANCE):
            return []
        measures = self._measures(t, q)
        search = self._search(measures, MAX_ASSEMBLY_TOLERANCE)
        if not _has_fixed(search, t, q):
            return []
        for part in search.find(q, np.zeros(system.n, bool)):
            locked = _locked(search, t, q, part)
            if len(locked):
                why, remedy, row = _explain(self._mechanism, measures, self._rows[part.rows], part)
                names = _listed(system.coordinate_names[k] for k in locked)
                text = f"joints {names} cannot move: {why}"
                found.append(Diagnostic.warning("locked-loop", text, remedy, subject=row))
        return found

    def _is_exact(self, t: float, start: Array, held: NDArray[np.bool_], tolerance: float) -> bool:
        """Return whether no equation of a large system is nearly redundant near ``start`` (nq,); ``held`` (n,)
        coordinates stay. An equation that is redundant but for rounding is so at every closed position, hence one
        position decides: at a singular start another one.
        """
        if self._loops is None:
            return False
        shortest, random, q = find_regular_limit(tolerance), np.random.default_rng(0), start.copy()
        for _ in range(MAX_EXAMINED_POSITIONS):
            closed = self._loops.close(t, q, held)
            if closed is not None:
                found = self._loops.measure(t, closed)
                if found.independent > shortest and found.residual < VANISHING_TOLERANCE:
                    return True
            q = start.copy()
            moved = random.uniform(*EXAMINED_DISTANCE, len(held)) * random.choice((-1.0, 1.0), len(held))
            self._system.apply(q, np.where(held, 0.0, moved * self._system.size))
        return False

    @property
    def _rows(self) -> NDArray[np.int64]:
        """Numbers of the rows of the system among all."""
        return np.flatnonzero(self._data.arrays.kept >= 0)

    def _measures(self, t: float, q: Array) -> Measures:
        self._system.fill_position(t, q, self._system.allocate_terms())  # places the bodies
        return measure_rows(self._mechanism, self._data.state, self._row_size)

    def _search(self, measures: Measures, tolerance: float) -> Redundancy:
        rows = self._rows
        return Redundancy(self._system, measures.units[rows], measures.relative[rows] * tolerance, self._drive_motions)


def _locked(search: Redundancy, t: float, q: Array, part: Part) -> NDArray[np.int64]:
    """Return the coordinates of a part that cannot move at q (nq,) but could without its nearly redundant equations."""
    J = search.evaluate(q, t)[0][np.ix_(part.rows, part.coordinates)]
    _, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    rank = int(np.count_nonzero(sigma > DEPENDENT_SINGULAR_RATIO * sigma[0])) if len(sigma) else 0
    fixed = _mobility(Vt[:rank]) < FIXED_PART_LIMIT
    return part.coordinates[fixed & (_mobility(Vt[: part.rank]) > MOBILE_PART_LIMIT)]


def _has_fixed(search: Redundancy, t: float, q: Array) -> bool:
    """Return whether the equations leave some coordinate that they know no motion at q (nq,)."""
    J = search.evaluate(q, t)[0]
    for rows, columns in search.parts(q):
        _, sigma, Vt = np.linalg.svd(J[np.ix_(rows, columns)], full_matrices=False)
        rank = int(np.count_nonzero(sigma > DEPENDENT_SINGULAR_RATIO * sigma.max(initial=0.0)))
        if np.any(_mobility(Vt[:rank]) < FIXED_PART_LIMIT):
            return True
    return False


def _mobility(V: Array) -> Array:
    """Return by how much each coordinate can move (n,) in the complement of orthonormal rows V (rank, n)."""
    return np.sqrt(np.maximum(0.0, 1.0 - np.sum(V * V, axis=0)))


def _explain(mechanism: Mechanism, measures: Measures, rows: NDArray[np.int64], part: Part) -> tuple[str, str, str]:
    """Return what the nearly redundant equations of a part are, what to do, and the name of the one that is violated
    most; ``rows`` are their numbers.
    """
    names, worst = row_names(mechanism.constraints), int(part.gap.argmax())
    row, needed = rows[worst], float(part.gap.max())
    count = len(rows) - part.rank
    which = "1 constraint is" if count == 1 else f"{count} constraints are"
    axes = next((measures.axes[i] for i in (row, *rows) if measures.axes[i]), "")
    return (
        f"{which} redundant except for errors of the given numbers: {names[row]!r} is violated by up to "
        f"{measures.describe(row, needed)} as the loop moves{', and ' + axes if axes else ''}",
        "Give lengths and directions with more digits, use a cut joint with fewer equations, or set the "
        f"assembly_tolerance of the Mechanism to at least {_rounded_up(needed):g} "
        f"(now {mechanism.assembly_tolerance:g})",
        names[row],
    )


def _listed(coordinates: Iterable[str]) -> str:
    """Return the names of coordinates in quotes, few where there are many."""
    names = [repr(name) for name in coordinates]
    more = f" and {len(names) - MAX_LISTED} more" if len(names) > MAX_LISTED else ""
    return ", ".join(names[:MAX_LISTED]) + more


def _rounded_up(x: float) -> float:
    """Return a number of two digits that is a little larger."""
    scale = 10.0 ** (np.floor(np.log10(x)) - 1)
    return min(float(np.ceil(1.2 * x / scale) * scale), MAX_ASSEMBLY_TOLERANCE)
