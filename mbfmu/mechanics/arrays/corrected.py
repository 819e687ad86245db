"""Corrections of joint frames with which redundant constraint equations close exactly.

The frames of joints and cut joints are shifted and turned by p, in units of the length and in rad. p is the shortest
solution of

    U_d(q_s)^T Phi~(q_s, p) = 0    at many positions q_s,

U_d the redundant combinations of equations, see :mod:`.redundant`.

Gauss-Newton steps, damped: U_d^T (Phi~ + A p) = 0. A = d Phi~ / d p follows from the wrenches of the equations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.joints.section import Section
from mbfmu.mechanics.kind import record_of
from mbfmu.mechanics.records import Data
from mbfmu.util.diagnostics import Diagnostic
from solvers.system import Array

from .redundant import Part, Position, Redundancy, near_singular
from .rounded import Measures, loop_path
from .rows import row_names

MAX_CORRECTION_ITERATIONS = 40
CLOSURE_TARGET, CLOSURE_LIMIT = 1e-13, 1e-11  # closure errors in units: no further steps; small enough for all solvers
CLOSURE_NOISE = 1e-14  # of closure errors; a step from noise is damped so that it is no longer than the closure error
MAX_ROUNDS = 3  # each with new motions, along which the corrected equations must stay closed
MAX_CORRECTION_RATIO = 20.0  # largest shift or turn of a joint frame, in tolerances
MAX_AMPLIFICATION = 100.0  # ... and in closure errors


class JointPoint(NamedTuple):
    """Frame of a joint or of a cut joint: the body that it is fixed to, and its placement there."""

    body: int  # number of the body
    point: Array  # (3,) on that body, in the arrays
    axes: Array  # (3, 3) columns, in the arrays


class Correction(NamedTuple):
    """Largest shift and largest turn of a joint frame."""

    shift: float  # m
    turn: float  # rad


Saved = list[tuple[Array, Array]]


class Placements:
    """Joint frames in the loops of one part, as views of the arrays of a mechanism."""

    def __init__(self, mechanism: Mechanism, data: Data, handles: list[CutHandle | None]) -> None:
        self._mechanism, self._data, self._handles = mechanism, data, handles
        self.places: list[JointPoint] = []
        self._joints: dict[int, int] = {}  # body, number of its joint's place
        self._cuts: dict[int, int] = {}  # index of a cut joint, number of its place
        for handle in {h.index: h for h in self._handles if h is not None}.values():
            self._add(handle)

    def _add(self, handle: CutHandle) -> None:
        arrays, mechanism = self._data.arrays, self._mechanism
        for k in self._ways(handle)[0] | self._ways(handle)[1]:
            record = arrays.bodies[k]
            if k not in self._joints and not isinstance(mechanism.bodies[k].joint, Section):
                self._joints[k] = len(self.places)
                self.places.append(JointPoint(int(record["parent"]), record["s"], record["R"]))
        dtype = record_of(handle.cut)
        if {"Pb", "Rb"} <= set(dtype.names or ()):
            at = int(arrays.cuts[handle.index]["at"])
            record = arrays.memory[at : at + dtype.itemsize].view(dtype)[0]
            self._cuts[handle.index] = len(self.places)
            self.places.append(JointPoint(handle.b.index, record["Pb"], record["Rb"]))

    def _ways(self, handle: CutHandle) -> tuple[set[int], set[int]]:
        """Return the bodies whose joints move body a but not body b, and those whose joints move b but not a."""
        path, bodies = set(loop_path(self._mechanism, handle)), self._mechanism.bodies
        ways = []
        for k in (handle.a.index, handle.b.index):
            way, at = set(), k
            while at > 0 and at in path and bodies[at].parent in path:
                way.add(at)
                at = bodies[at].parent
            ways.append(way)
        return ways[0] - ways[1], ways[1] - ways[0]

    def slopes(self, units: Array, length: float, kept: NDArray[np.int64]) -> Array:
        """Return A (rows, 6 places) where the state places the bodies; ``kept`` are numbers in State.rows."""
        state = self._data.state
        r, axes = state.bodies["r"], state.bodies["A"]
        A = np.zeros((len(self._handles), len(self.places), 6))
        for i, handle in enumerate(self._handles):
            if handle is None:
                continue
            row = state.rows[kept[i]]
            sides = zip(self._ways(handle), (handle.a.index, handle.b.index), (row["Ga"], row["Gb"]), strict=True)
            for way, body, G in sides:
                for k in way:
                    if k in self._joints:
                        self._add_slope(A[i], self._joints[k], r, axes, body, G)
            if handle.index in self._cuts:
                self._add_slope(A[i], self._cuts[handle.index], r, axes, handle.b.index, row["Gb"])
        A[:, :, :3] *= length
        return A.reshape(len(A), -1) / units[:, np.newaxis]

    def _add_slope(self, A: Array, number: int, r: Array, axes: Array, body: int, G: Array) -> None:
        place = self.places[number]
        R = axes[place.body]
        arm = r[body] - (r[place.body] + R @ place.point)
        A[number, :3] += G[:3] @ R
        A[number, 3:] += (G[3:] + np.cross(arm, G[:3])) @ R

    def change(self, p: Array, length: float) -> None:
        """Shift and turn the frames by p (6 places,)."""
        for place, (shift, turn) in zip(self.places, p.reshape(-1, 2, 3), strict=True):
            place.point[:] += length * shift
            place.axes[:] = scipy.linalg.expm(_cross_matrix(turn)) @ place.axes

    def corrected(self, given: Saved) -> Correction:
        """Return the largest differences from the frames as given."""
        pairs = list(zip(self.places, given, strict=True))
        shift = max((float(np.linalg.norm(p.point - point)) for p, (point, _) in pairs), default=0.0)
        turn = max((float(np.linalg.norm(p.axes - axes)) for p, (_, axes) in pairs), default=0.0)
        return Correction(shift, turn / np.sqrt(2.0))

    def save(self) -> Saved:
        """Return copies of all frames."""
        return [(p.point.copy(), p.axes.copy()) for p in self.places]

    def restore(self, saved: Saved) -> None:
        """Restore all frames from copies."""
        for place, (point, axes) in zip(self.places, saved, strict=True):
            place.point[:], place.axes[:] = point, axes


def correct(
    search: Redundancy, placements: Placements, part: Part, units: Array, kept: NDArray[np.int64], tolerance: float
) -> Correction | None:
    """Correct the joint frames of a part so that its redundant equations close; None if no correction is found."""
    length, positions, given = float(units.max()), part.positions, placements.save()
    for _ in range(MAX_ROUNDS):
        closed = _close(search, placements, part, positions, units, kept)
        if closed is None:
            break
        fresh = search.positions(closed[0].q, part.rows, part.coordinates, part.rank)
        if fresh is None:
            break
        if max(near_singular(p, fresh[0]) * float(np.abs(p.gaps).max()) for p in fresh) < CLOSURE_LIMIT:
            found = placements.corrected(given)
            allowed = min(MAX_CORRECTION_RATIO * tolerance, MAX_AMPLIFICATION * float(part.gap.max()))
            if max(found.shift / length, found.turn) <= allowed:
                return found
            break
        positions = [*closed, *fresh]
    placements.restore(given)
    return None


def describe_correction(
    mechanism: Mechanism, measures: Measures, rows: NDArray[np.int64], part: Part, done: Correction
) -> Diagnostic:
    """Return a warning about the redundant equations of a part, their closure error and the correction.

    ``rows`` are the numbers of the part's equations among all.
    """
    names = row_names(mechanism.constraints)
    worst = int(part.gap.argmax())
    axes = measures.axes[rows[worst]]
    count = len(rows) - part.rank
    redundant = "1 redundant constraint is" if count == 1 else f"{count} redundant constraints are"
    why = f": {axes}" if axes else ""
    return Diagnostic.warning(
        "corrected-geometry",
        f"{redundant} not satisfied by the given numbers: {names[rows[worst]]!r} is violated by up to "
        f"{measures.describe(rows[worst], part.gap[worst])}, which is within the assembly tolerance of "
        f"{mechanism.assembly_tolerance:g}{why}",
        f"The joint frames of these loops are shifted by at most {done.shift:.2g} m and rotated by at most "
        f"{done.turn:.2g} rad so that they close. Give lengths and directions with more digits to avoid this",
        subject=names[rows[worst]],
    )


class _ClosureErrors(NamedTuple):
    """Closure errors of the redundant equations at the positions of a part."""

    positions: list[Position]
    gaps: Array  # (k,) U_d^T Phi~ of all positions
    slopes: Array  # (k, 6 places) U_d^T A


def _close(
    search: Redundancy,
    placements: Placements,
    part: Part,
    positions: list[Position],
    units: Array,
    kept: NDArray[np.int64],
) -> list[Position] | None:
    """Close the redundant equations at ``positions``; return the corrected positions, None if they do not close.

    The steps are damped (Levenberg and Marquardt): conditions such as equal sides of a parallelogram are double roots.
    """
    length = float(units.max())

    def measure() -> _ClosureErrors:
        found: list[Position] = []
        gaps, slopes = [], []
        for old in positions:
            at = search.position_at(old.q, part.rows, part.coordinates, part.rank, old.drive_motion, old.step)
            if at is not None:
                U = scipy.linalg.svd(at.J)[0][:, part.rank :] * near_singular(at, positions[0])
                gaps.append(U.T @ at.gaps)
                slopes.append(U.T @ placements.slopes(units, length, kept))
                found.append(at)
        return _ClosureErrors(
            found, np.concatenate(gaps or [np.full(1, np.inf)]), np.vstack(slopes or [np.zeros((1, 1))])
        )

    now, damping, least = measure(), 0.0, CLOSURE_NOISE / float(part.gap.max())
    for _ in range(MAX_CORRECTION_ITERATIONS):
        largest = float(np.abs(now.gaps).max(initial=0.0))
        if not CLOSURE_TARGET < largest < np.inf:
            break
        before = placements.save()
        left, sigma, right = scipy.linalg.svd(now.slopes, full_matrices=False)
        damping = max(damping, largest, least)
        placements.change(-right.T @ (left.T @ now.gaps * sigma / (sigma**2 + damping**2)), length)
        then = measure()
        if len(then.positions) == len(now.positions) and np.linalg.norm(then.gaps) < np.linalg.norm(now.gaps):
            now, damping = then, 0.1 * damping
        else:
            placements.restore(before)
            damping *= 10.0
    return now.positions if np.abs(now.gaps).max(initial=0.0) < CLOSURE_LIMIT else None


def _cross_matrix(w: Array) -> Array:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
