"""Consistent positions and velocities from approximate ones, or a sentence on the loop that cannot close.

How is in :mod:`solvers.assembly`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError
from mbfmu.mechanics.builder.bodies import CutHandle
from mbfmu.mechanics.records import State
from solvers.assembly import ASSEMBLED, Loops, Outcome, Scratch, close_positions, close_velocities, move_mass
from solvers.assembly import least_change as find_least_change
from solvers.compiled.held import hold
from solvers.system import AnySystem, Array

SENTENCES = {  # with the name of a row and its gap in SI units, or the names of coordinates
    Outcome.OPEN: "loop cannot close: {name!r} stays off by {gap:.3g} in the nearest position that was found; check "
    "lengths and start positions, or hold fewer joints fixed",
    Outcome.NOT_FINITE: "{name!r} or its slope is not finite on the way to a closed position; start elsewhere",
    Outcome.OPENS: "start velocities are not consistent: {name!r} opens at {gap:.3g} per second; hold fewer joints "
    "fixed or give consistent rates",
    Outcome.NO_MASS: "no inertia: coordinate(s) {names} can move without moving mass; give a body mass or inertia "
    "there, or drive or weld the joint",
}


def assemble_positions(
    system: AnySystem, t: float, start: Array, held: NDArray[np.bool_], given: NDArray[np.bool_] | None = None
) -> Array:
    """Return positions (nq,) with Phi = 0 near ``start``; ``held`` (n,) coordinates stay.

    ``given`` (2, n) positions and velocities change only if the loops cannot close by the others.
    """
    q = start.copy()
    if system.m == 0:
        return q
    scratch = Scratch.of(system, held, given)
    code = close_positions(Loops.of(system), t, start, q, hold(scratch))
    if code == ASSEMBLED:
        return q
    raise AssemblyError(_said(system, scratch, code))


def least_change(system: AnySystem, J: Array, gaps: Array, held: NDArray[np.bool_]) -> Array:
    """Return the shortest step (n,) of those that close the gaps (m,) best, all in their units; ``held`` ones stay."""
    scratch = Scratch.of(system, held)
    scratch.gaps[:] = gaps
    find_least_change(J, 0.0, hold(scratch))
    return scratch.step


def assemble_velocities(
    system: AnySystem,
    t: float,
    q: Array,
    start: Array,
    held: NDArray[np.bool_],
    given: NDArray[np.bool_] | None = None,
) -> Array:
    """Return velocities (n,) with J v = nu, the least change from ``start``; ``held`` coordinates stay.

    ``given`` (2, n) as for :func:`assemble_positions`.
    """
    v = start.copy()
    if system.m == 0:
        return v
    scratch = Scratch.of(system, held, given)
    code = close_velocities(Loops.of(system), t, q, start, system.rate, v, hold(scratch))
    if code != ASSEMBLED:
        raise AssemblyError(_said(system, scratch, code))
    return v


def _said(system: AnySystem, scratch: Scratch, code: int) -> str:
    """Return which row does not close, and by what."""
    row, gap = scratch.worst[0]
    return SENTENCES[Outcome(code)].format(name=system.constraint_names[row], gap=float(gap))


def frame_angles(cuts: Sequence[CutHandle], state: State) -> Array:
    """Return by what angle (cuts,), rad, the frames of each cut joint are off in the position of ``state``.

    Of a weld that of the rotation between its frames, of a hinge that between its axes; zero where none need agree.
    """
    A, angles = state.bodies["A"], np.zeros(len(cuts))
    for i, handle in enumerate(cuts):
        cut = handle.cut
        if cut.parallel:
            Ra, Rb = cut.frames()
            C = (A[handle.a.index] @ Ra).T @ A[handle.b.index] @ Rb
            cosine = C[2, 2] if cut.parallel == "z" else 0.5 * (np.trace(C) - 1.0)
            angles[i] = np.arccos(np.clip(cosine, -1.0, 1.0))
    return angles


def check_frames(cuts: Sequence[CutHandle], state: State, drawn: Array | None) -> None:
    """Raise AssemblyError where closed frames agree only in that their axes are perpendicular.

    The rows of a cut joint are products of axes, which are also zero for frames rotated by 180 or 120 degrees.
    """
    for i, (handle, angle) in enumerate(zip(cuts, frame_angles(cuts, state), strict=True)):
        if angle < 1.0:  # rad: zero; else it is pi or 2 pi / 3
            continue
        before = "" if drawn is None else f" (as drawn {np.degrees(drawn[i]):.0f} deg)"
        what = "frames" if handle.cut.parallel == "xyz" else f"{handle.cut.letters[2]} axes"
        raise AssemblyError(
            f"loop {handle.name!r} closes the wrong way round: the {what} of its cut joint are "
            f"{np.degrees(angle):.0f} deg apart{before}; turn rotation_a or rotation_b of the cut joint, or start "
            "nearer to the closed loop"
        )


def check_inertia(system: AnySystem, t: float, q: Array, v: Array) -> None:
    """Raise AssemblyError where a motion the constraints allow moves no mass.

    Of a large tree the solver finds that out.
    """
    if not system.has_matrices:
        return
    terms, scratch = system.allocate_terms(), Scratch.of(system)
    system.fill(t, q, v, terms)
    if move_mass(hold(terms), np.zeros((system.n, system.n)), hold(scratch)) != ASSEMBLED:
        names = ", ".join(repr(system.coordinate_names[i]) for i in np.flatnonzero(scratch.massless))
        raise AssemblyError(SENTENCES[Outcome.NO_MASS].format(names=names))
