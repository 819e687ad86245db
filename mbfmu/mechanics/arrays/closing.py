"""Consistent positions and velocities from approximate ones, or the loop that cannot close.

Gauss-Newton with the least change of the free coordinates that are not held (minimum norm), the step limited so that
the loops close on the branch the user meant. Coordinates and rows are measured in their units (``System.size`` and
``row_size``), so that a mechanism closes alike at every size. Run once per start, so plain linear algebra serves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError
from mbfmu.mechanics.builder.bodies import CutHandle
from mbfmu.mechanics.records import State
from solvers.system import AnySystem, Array

CLOSED = 1e-11  # in units of the row; a loop is closed
LARGEST_STEP = 0.5  # in units of the coordinate, of one coordinate in one iteration
OPENING = 1e-8  # of a row's rate relative to the velocities: the loop opens
ROUNDING = 1e-12  # ... or of the pace of the drives, whose motion may cancel in a row
RANK = 1e-9  # singular values below this part of the largest count as zero
MASSLESS = 1e-12  # ... the same for the mass matrix
ROUNDED = 1e-28  # square of rounding: what moves by so little of the largest mass moves none


def assemble_positions(system: AnySystem, t: float, start: Array, held: NDArray[np.bool_]) -> Array:
    """Return positions (nq,) with Phi = 0 near ``start``; ``held`` (n,) coordinates stay.

    First by damped steps (Levenberg and Marquardt, the damping falling as the square of the gap), which stay near where
    redundant rows contradict each other in an open loop; then without damping, which gets on beside singular positions.
    """
    if system.m == 0:
        return start.copy()
    terms = system.allocate_terms()
    for damping in (1.0, 0.0):
        q, best, since = start.copy(), np.inf, 0
        for _ in range(200):
            system.fill_position(t, q, terms)
            gaps = terms.Phi / system.row_size
            error = float(np.abs(gaps).max(initial=0.0))
            if not np.isfinite(gaps).all() or not np.isfinite(terms.J).all():
                odd = ~np.isfinite(terms.Phi) | ~np.isfinite(terms.J).all(axis=1)
                name = system.constraint_names[int(np.argmax(odd))]
                raise AssemblyError(
                    f"{name!r} or its slope is not finite on the way to a closed position; start elsewhere"
                )
            if error < CLOSED:
                return q
            since = 0 if error < 0.5 * best else since + 1
            best = min(best, error)
            if since > 30:
                break
            step = least_change(system, terms.J, gaps, held, damping * error**2)
            step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max(initial=0.0)), 1e-300))
            system.apply(q, -system.size * step)
    worst = int(np.argmax(np.abs(gaps)))
    raise AssemblyError(
        f"loop cannot close: {system.constraint_names[worst]!r} stays off by {abs(terms.Phi[worst]):.3g} "
        "in the nearest position that was found; check lengths and start positions, or hold fewer joints fixed"
    )


def least_change(system: AnySystem, J: Array, gaps: Array, held: NDArray[np.bool_], damping: float = 0.0) -> Array:
    """Return the step (n,) of least |J step - gaps|^2 + damping |step|^2, all in their units; ``held`` ones stay.

    Without damping it is the shortest of those that close the gaps (m,) best.
    """
    step = np.zeros(system.n)
    U, sigma, V = np.linalg.svd(J[:, ~held] * system.size[~held] / system.row_size[:, np.newaxis], full_matrices=False)
    count = int(np.sum(sigma > RANK * sigma.max(initial=0.0)))
    U, sigma, V = U[:, :count], sigma[:count], V[:count]
    step[~held] = (gaps @ U * sigma / (sigma**2 + damping)) @ V
    return step


def assemble_velocities(system: AnySystem, t: float, q: Array, start: Array, held: NDArray[np.bool_]) -> Array:
    """Return velocities (n,) with J v = nu, the least change from ``start``; ``held`` coordinates stay."""
    if system.m == 0:
        return start.copy()
    terms = system.allocate_terms()
    system.fill(t, q, start, terms)
    v = start - system.size * least_change(system, terms.J, (terms.J @ start - terms.nu) / system.row_size, held)
    off = np.abs(terms.J @ v - terms.nu)
    fast = max(float(np.abs(v / system.size).max(initial=0.0)), float(np.abs(terms.nu / system.row_size).max()))
    worst = int(np.argmax(off / system.row_size))
    if off[worst] > (OPENING * fast + ROUNDING * system.rate) * system.row_size[worst]:
        raise AssemblyError(
            f"start velocities are not consistent: {system.constraint_names[worst]!r} opens at {off[worst]:.3g} "
            "per second; hold fewer joints fixed or give consistent rates"
        )
    return v


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

    The rows of a cut joint are products of axes, which vanish for frames turned by 180 or 120 degrees too.
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
    terms = system.allocate_terms()
    system.fill(t, q, v, terms)
    basis = np.diag(system.size)
    if system.m and system.n:
        _, sigma, Vt = np.linalg.svd(terms.J * system.size / system.row_size[:, np.newaxis])
        rank = int(np.sum(sigma > RANK * max(float(sigma[0]), 1e-300)))
        basis = system.size[:, np.newaxis] * Vt[rank:].T
    if basis.shape[1] == 0:
        return
    M = basis.T @ terms.M @ basis
    mass = np.diag(M)  # every motion by its own measure: a light body may move beside a heavy one
    most = max(0.0, float(mass.max())) or 1.0  # below zero is rounding
    own = np.sqrt(np.where(mass > ROUNDED * most, mass, most))
    values, vectors = np.linalg.eigh(M / np.outer(own, own))
    if values[0] <= MASSLESS * max(float(values[-1]), 1e-300):
        mode = np.abs(basis @ (vectors[:, 0] / own)) / system.size
        names = [system.coordinate_names[i] for i in np.flatnonzero(mode > 0.1 * mode.max())]
        raise AssemblyError(
            f"no inertia: coordinate(s) {', '.join(map(repr, names))} can move without moving mass; "
            "give a body mass or inertia there, or drive or weld the joint"
        )
