"""Consistent positions and velocities from approximate ones, or an error that names the loop that cannot close.

The method is that of :mod:`solvers.assembly`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.builder.handles import CutHandle
from mbfmu.mechanics.records import State
from mbfmu.util.codes import coded
from mbfmu.util.errors import AssemblyError
from solvers.assembly import (
    ASSEMBLED,
    Loops,
    Outcome,
    Scratch,
    check_mobile_mass,
    find_closed_positions,
    find_consistent_velocities,
)
from solvers.assembly import solve_least_change as find_least_change
from solvers.compiled.tuple_pointer import pin
from solvers.system import AnySystem, Array

CLOSURE_MESSAGES = {  # with the name of a constraint and its violation in SI units, or the names of coordinates
    Outcome.OPEN: coded(
        "cannot-assemble",
        "loop cannot close: constraint {name!r} is violated by {gap:.3g} (SI units) in the nearest position that was "
        "found; check lengths and start positions, or keep fewer start values fixed",
    ),
    Outcome.NOT_FINITE: coded(
        "cannot-assemble",
        "constraint {name!r} or its derivative is not finite during the assembly of the loops; choose other start "
        "positions",
    ),
    Outcome.OPENS: coded(
        "cannot-assemble",
        "start velocities are not consistent: constraint {name!r} changes by {gap:.3g} (SI units) per second; "
        "keep fewer start values fixed, or give consistent rates",
    ),
    Outcome.NO_MASS: coded(
        "no-inertia",
        "no inertia: coordinate(s) {names} can move without moving mass; give the body a mass or inertia, or drive or "
        "weld the joint",
    ),
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
    code = find_closed_positions(Loops.of(system), t, start, q, pin(scratch))
    if code == ASSEMBLED:
        return q
    raise AssemblyError(_failure_message(system, scratch, code))


def least_change(system: AnySystem, J: Array, gaps: Array, held: NDArray[np.bool_]) -> Array:
    """Return the shortest step (n,) of those that close the gaps (m,) best, all in their units; ``held`` ones stay."""
    scratch = Scratch.of(system, held)
    scratch.gaps[:] = gaps
    find_least_change(J, 0.0, pin(scratch))
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
    code = find_consistent_velocities(Loops.of(system), t, q, start, system.rate, v, pin(scratch))
    if code != ASSEMBLED:
        raise AssemblyError(_failure_message(system, scratch, code))
    return v


def _failure_message(system: AnySystem, scratch: Scratch, code: int) -> str:
    """Return which row does not close, and by what."""
    row, gap = scratch.worst[0]
    return CLOSURE_MESSAGES[Outcome(code)].format(name=system.constraint_names[row], gap=float(gap))


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

    The equations of a cut joint are products of axes, which are also zero for frames rotated by 180 or 120 degrees.
    """
    for i, (handle, angle) in enumerate(zip(cuts, frame_angles(cuts, state), strict=True)):
        if angle < 1.0:  # rad: zero; else it is pi or 2 pi / 3
            continue
        before = "" if drawn is None else f" ({np.degrees(drawn[i]):.0f} deg in the start positions)"
        what = "frames" if handle.cut.parallel == "xyz" else f"{handle.cut.letters[2]} axes"
        raise AssemblyError(
            f"loop {handle.name!r} closes with a wrong orientation: the {what} of its cut joint are rotated by "
            f"{np.degrees(angle):.0f} deg from each other{before}; allowed: 0 deg. Change rotation_a or rotation_b of "
            "the cut joint, or start nearer to the closed loop"
        )


def check_inertia(system: AnySystem, t: float, q: Array, v: Array) -> None:
    """Raise AssemblyError where a motion the constraints allow moves no mass.

    Of a large tree the solver finds that out.
    """
    if not system.has_matrices:
        return
    terms, scratch = system.allocate_terms(), Scratch.of(system)
    system.fill(t, q, v, terms)
    if check_mobile_mass(pin(terms), np.zeros((system.n, system.n)), pin(scratch)) != ASSEMBLED:
        names = ", ".join(repr(system.coordinate_names[i]) for i in np.flatnonzero(scratch.massless))
        raise AssemblyError(CLOSURE_MESSAGES[Outcome.NO_MASS].format(names=names))
