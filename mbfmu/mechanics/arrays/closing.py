"""Consistent positions and velocities from approximate ones, or an error that names the loop that cannot close.

The method is that of :mod:`solvers.loop_closure`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.elimination import EliminatedLoops, closes_by_elimination
from mbfmu.mechanics.kind import record_of
from mbfmu.mechanics.records import Arrays
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import AssemblyError
from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.loop_closure import (
    ASSEMBLED,
    ClosureScratch,
    Loops,
    Outcome,
    check_mobile_mass,
    find_closed_positions,
    find_consistent_velocities,
)
from solvers.loop_closure import solve_least_change as find_least_change
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, AnySystem, Array

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Data

PARALLEL_AXES = ("", "z", "xyz")  # see CutJoint.parallel
Z_AXIS = PARALLEL_AXES.index("z")
MAX_CLOSED_ANGLE = 1.0  # rad; closed frames are rotated by zero, or by 120 degrees at least
MIN_CLOSED_COSINE = float(np.cos(MAX_CLOSED_ANGLE))

CLOSURE_MESSAGES = {  # with the name of a constraint and its violation in SI units, or the names of coordinates
    Outcome.OPEN: Diagnostic.error(
        "cannot-assemble",
        "loop cannot close: constraint {name!r} is violated by {gap:.3g} (SI units) in the nearest position that was "
        "found",
        "Check lengths and start positions, or keep fewer start values fixed",
    ),
    Outcome.NOT_FINITE: Diagnostic.error(
        "cannot-assemble",
        "constraint {name!r} or its derivative is not finite during the assembly of the loops",
        "Choose other start positions",
    ),
    Outcome.OPENS: Diagnostic.error(
        "cannot-assemble",
        "start velocities are not consistent: constraint {name!r} changes by {gap:.3g} (SI units) per second",
        "Keep fewer start values fixed, or give consistent rates",
    ),
    Outcome.NO_MASS: Diagnostic.error(
        "no-inertia",
        "no inertia: coordinate(s) {names} can move without moving mass",
        "Give the body a mass or inertia, or drive or weld the joint",
    ),
}


def assemble_positions(
    system: AnySystem,
    t: float,
    start: Array,
    held: NDArray[np.bool_],
    given: Array | None = None,
    loops: EliminatedLoops | None = None,
) -> Array:
    """Return positions (nq,) with Phi = 0 near ``start``; ``held`` (n,) coordinates stay.

    ``given`` (2, n) positions and velocities change only if the loops cannot close by the others. ``loops`` are those
    of a large system: only if they cannot close them, matrices are used, which are slower and find what is wrong.
    """
    q = start.copy()
    if system.m == 0:
        return q
    if loops is not None:
        found = loops.close(t, start, held, None if given is None else given[0])
        if found is not None:
            return found
    scratch = ClosureScratch.of(system, held, given)
    code = find_closed_positions(Loops.of(system), t, start, q, pin(scratch))
    if code == ASSEMBLED:
        return q
    raise AssemblyError(_failure_message(system, scratch, code))


def least_change(system: AnySystem, J: Array, gaps: Array, held: NDArray[np.bool_]) -> Array:
    """Return the shortest step (n,) of those that close the gaps (m,) best, all in their units; ``held`` ones stay."""
    scratch = ClosureScratch.of(system, held)
    scratch.gaps[:] = gaps
    find_least_change(J, 0.0, pin(scratch))
    return scratch.step


def assemble_velocities(
    system: AnySystem,
    t: float,
    q: Array,
    start: Array,
    held: NDArray[np.bool_],
    given: Array | None = None,
    loops: EliminatedLoops | None = None,
) -> Array:
    """Return velocities (n,) with J v = nu, the least change from ``start``; ``held`` coordinates stay.

    ``given`` (2, n) and ``loops`` as for :func:`assemble_positions`.
    """
    v = start.copy()
    if system.m == 0:
        return v
    if loops is not None:
        found = loops.find_velocities(t, q, start, held, None if given is None else given[1])
        if found is not None:
            return found
    scratch = ClosureScratch.of(system, held, given)
    code = find_consistent_velocities(Loops.of(system), t, q, start, system.rate, v, pin(scratch))
    if code != ASSEMBLED:
        raise AssemblyError(_failure_message(system, scratch, code))
    return v


def _failure_message(system: AnySystem, scratch: ClosureScratch, code: int) -> str:
    """Return which row does not close, and by what."""
    worst = scratch.worst[0]
    name = system.constraint_names[worst["row"]]
    return str(CLOSURE_MESSAGES[Outcome(code)]).format(name=name, gap=float(worst["gap"]))


class CutFrames(NamedTuple):
    """The frames of cut joints that are parallel in closed loops, as kernels read them."""

    parallel: NDArray[np.int64]  # (cuts,) which axes are, by their place in PARALLEL_AXES
    Ra: NDArray[np.int64]  # (cuts,) place of the axes in body a among the numbers, see CutJointRecord
    Rb: NDArray[np.int64]  # (cuts,) place of those in body b
    numbers: Array  # the records of all element types

    @staticmethod
    def of(cuts: Sequence[CutHandle], arrays: Arrays) -> CutFrames:
        """Return those of the cut joints of compiled arrays."""
        places = np.zeros((2, len(cuts)), np.int64)
        for k, handle in enumerate(cuts):
            fields: Any = record_of(type(handle.cut)).fields
            places[:, k] = [(int(arrays.cuts[k]["at"]) + fields[name][1]) // 8 for name in ("Ra", "Rb")]
        parallel = [PARALLEL_AXES.index(handle.cut.parallel) for handle in cuts]
        return CutFrames(np.array(parallel, np.int64), places[0], places[1], arrays.memory.view(np.float64))

    @staticmethod
    def example() -> CutFrames:
        """Return frames of the types that all mechanisms have."""
        one = np.zeros(1, np.int64)
        return CutFrames(one, one, one, np.zeros(1))


@kernel
def frame_cosine(frames: CutFrames, k: int, data: Data) -> float:
    """Cosine of the angle between the z axes of a cut joint's frames, or of the rotation between frames that are
    parallel in all axes; 1 if none need be parallel.
    """
    cut, numbers, total = data.arrays.cuts[k], frames.numbers, 0.0
    A, B, Ra, Rb = data.state.bodies[cut.a].A, data.state.bodies[cut.b].A, frames.Ra[k], frames.Rb[k]
    if frames.parallel[k] == 0:
        return 1.0
    for axis in range(2 if frames.parallel[k] == Z_AXIS else 0, 3):
        for i in range(3):
            a, b = 0.0, 0.0
            for j in range(3):
                a += A[i, j] * numbers[Ra + 3 * j + axis]
                b += B[i, j] * numbers[Rb + 3 * j + axis]
            total += a * b
    return total if frames.parallel[k] == Z_AXIS else 0.5 * (total - 1.0)


@kernel
def fill_frame_angles(frames: CutFrames, data: Data, angles: Any) -> int:
    """Put the angles of :func:`frame_cosine` into ``angles`` (cuts,), rad; return the first cut joint that is closed
    with a wrong orientation, the number of cut joints if none is.

    The equations of a cut joint are products of axes, which are also zero for frames rotated by 180 or 120 degrees.
    """
    count = frames.parallel.shape[0]
    first = count
    for k in range(count - 1, -1, -1):
        cosine = frame_cosine(frames, k, data)
        angles[k] = np.arccos(min(1.0, max(-1.0, cosine)))
        if not cosine > MIN_CLOSED_COSINE:
            first = k
    return first


def check_frames(cuts: Sequence[CutHandle], frames: Any, data: Any, drawn: Array | None) -> None:
    """Raise AssemblyError where frames are closed with a wrong orientation; ``drawn`` (cuts,) are their angles in the
    start positions, rad.
    """
    angles = np.zeros(len(cuts))
    k = fill_frame_angles(frames, data, angles)
    if k == len(cuts):
        return
    handle, before = cuts[k], "" if drawn is None else f" ({np.degrees(drawn[k]):.0f} deg in the start positions)"
    what = "frames" if handle.cut.parallel == "xyz" else f"{handle.cut.letters[2]} axes"
    raise AssemblyError(
        f"loop {handle.name!r} closes with a wrong orientation: the {what} of its cut joint are rotated by "
        f"{np.degrees(angles[k]):.0f} deg from each other{before}; allowed: 0 deg. Change rotation_a or rotation_b of "
        "the cut joint, or start nearer to the closed loop"
    )


def check_inertia(system: AnySystem, t: float, q: Array, v: Array) -> None:
    """Raise AssemblyError where a motion the constraints allow moves no mass.

    Of a large model the solver finds that out.
    """
    if not system.has_matrices or system.n > MAX_SOLVER_DENSE_COORDINATES or closes_by_elimination(system):
        return
    terms, scratch = system.allocate_terms(), ClosureScratch.of(system)
    system.fill(t, q, v, terms)
    if check_mobile_mass(pin(terms), np.zeros((system.n, system.n)), pin(scratch)) != ASSEMBLED:
        names = ", ".join(repr(system.coordinate_names[i]) for i in np.flatnonzero(scratch.massless))
        raise AssemblyError(str(CLOSURE_MESSAGES[Outcome.NO_MASS]).format(names=names))
