"""Messages on the free motions of a large model: those without stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import update_kinematics
from mbfmu.steady.modes import shapes
from mbfmu.util.errors import EquilibriumError
from solvers.system import Array

EVALUATED_MODES = 8  # modes evaluated: the six rigid ones of a free body, and two for its stiffness
RIGID_TOLERANCE = 1e-3  # what is left of a motion, relative, when the nearest rigid one is taken away
ZERO_COMPONENT_TOLERANCE = 1e-3  # components of directions below which they are nought

Matrix = NDArray[np.float64]


def free_motions(compiled: CompiledMechanism, q: Array, lam: Array) -> Matrix:
    """Return the motions (n, k) about a state q (nq,), lam (m,) that nothing resists, of unit modal mass."""
    found = [in_phase(s.motion) for s in shapes(compiled, q, EVALUATED_MODES, lam) if s.mode.eigenvalue == 0.0]
    return np.array(found).reshape(len(found), compiled.system.n).T


def in_phase(motion: NDArray[Any]) -> Matrix:
    """Return a motion (n,) whose parts are in phase by real numbers."""
    return np.asarray((motion * np.exp(-1j * np.angle(motion[np.argmax(np.abs(motion))]))).real)


def describe_motions(compiled: CompiledMechanism, q: Array, motions: Matrix) -> str:
    """Describe motions (n, k) about positions q (nq,), rigid ones together by what spans them."""
    names = compiled.system.coordinate_names
    place, size, twists = _twists(compiled, q, motions)
    words: list[str] = []
    rigid = [twist for twist in twists if twist is not None]
    if rigid:
        words += _rigid(np.array(rigid), place, size)
    for motion, twist in zip(motions.T, twists, strict=True):
        if twist is None:
            largest = np.argsort(-np.abs(motion), kind="stable")[:3]
            largest = largest[np.abs(motion[largest]) > ZERO_COMPONENT_TOLERANCE * np.abs(motion).max()]
            words.append(f"a motion that is largest in {', '.join(repr(names[k]) for k in sorted(largest))}")
    return "; ".join(words)


def describe_pushed(compiled: CompiledMechanism, q: Array, forces: Array, least: float) -> str:
    """Return a message on the motion about q (nq,) on which forces (n,) act without resistance; empty: none.

    ``least``: share of the forces from which on they act on a motion.
    """
    try:
        motions = free_motions(compiled, q, np.zeros(compiled.system.m))
    except EquilibriumError:  # what failed first is what there is to report
        return ""
    along = motions.T @ forces
    if np.abs(along).max(initial=0.0) <= least * float(np.linalg.norm(forces)):
        return ""
    return describe_motions(compiled, q, motions @ along[:, np.newaxis])


def _twists(compiled: CompiledMechanism, q: Array, motions: Matrix) -> tuple[Matrix, float, list[Matrix | None]]:
    """Return the middle of the bodies, their reach from it, and the twist (6,) of every motion about that middle.

    A twist is (velocity, angular velocity times reach); None: the motion is none of a rigid body.
    """
    n, data = compiled.system.n, compiled.data
    massive = data.arrays.bodies["mass"] > 0.0
    update_kinematics(0.0, q, np.zeros(n), *compiled.kernel_data)
    drift, r = data.state.bodies["Y"][massive].copy(), data.state.bodies["r"][massive].copy()
    place = r.mean(axis=0)
    size = float(np.linalg.norm(r - place, axis=1).max()) or 1.0
    arms = (r - place) / size
    map_ = np.zeros((len(r), 6, 6))  # from a twist to the velocities of the bodies
    map_[:, :3, :3] = map_[:, 3:, 3:] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        map_[:, :3, 3 + k] = np.cross(axis, arms)
    flat = map_.reshape(-1, 6)
    found: list[Matrix | None] = []
    for motion in motions.T:
        update_kinematics(0.0, q, motion, *compiled.kernel_data)
        Y = data.state.bodies["Y"][massive] - drift
        Y[:, 3:] *= size
        twist = np.linalg.lstsq(flat, Y.reshape(-1), rcond=None)[0]
        left = np.linalg.norm(flat @ twist - Y.reshape(-1))
        found.append(twist if left <= RIGID_TOLERANCE * np.linalg.norm(Y) else None)
    return place, size, found


def _rigid(twists: Matrix, place: Matrix, size: float) -> list[str]:
    """Describe the rigid motions that twists (k, 6) span: translations first, then rotations."""
    basis = np.linalg.svd(twists, full_matrices=False)[2]
    left, turning, _ = np.linalg.svd(basis[:, 3:])
    turns, sorted_ = int(np.sum(turning > RIGID_TOLERANCE)), left.T @ basis  # those that turn, then those that do not
    slides = _reduced(sorted_[turns:, :3])
    words = [f"translation along {_axis(d)}" for d in slides]
    if turns == 3 and len(slides) == 3:
        return [*words, "rotation about every axis"]
    for row in _reduced(sorted_[:turns, [3, 4, 5, 0, 1, 2]]):
        w, v = row[:3], row[3:]
        if len(slides):
            v = v - np.linalg.pinv(slides) @ slides @ v  # what translations do anyway
        point = place + size * np.cross(w, v) / (w @ w)
        text = ", ".join(f"{x:.4g}" for x in np.round(point, 12) + 0.0)
        pitch = (
            f", with {size * (w @ v) / (w @ w):.4g} m along it a radian"
            if abs(w @ v) > RIGID_TOLERANCE * (w @ w)
            else ""
        )
        words.append(f"rotation about {_axis(w)} through ({text}) m{pitch}")
    return words


def _reduced(rows: Matrix) -> Matrix:
    """Return rows that span the same, each with a one where the others have nought: along the axes if they can be."""
    rows = rows.copy()
    for k in range(len(rows)):
        column = int(np.argmax(np.abs(rows[k:, :3]).max(axis=0)))
        best = k + int(np.argmax(np.abs(rows[k:, column])))
        rows[[k, best]] = rows[[best, k]]
        rows[k] /= rows[k, column]
        for other in range(len(rows)):
            if other != k:
                rows[other] -= rows[other, column] * rows[k]
    order: Sequence[int] = np.argsort([int(np.argmax(np.abs(row[:3]))) for row in rows]).tolist()
    return rows[list(order)]


def _axis(d: Matrix) -> str:
    """Return ``x``, ``y``, ``z``, or the direction by its components."""
    unit = d / np.linalg.norm(d)
    k = int(np.argmax(np.abs(unit)))
    if np.abs(np.delete(unit, k)).max() < ZERO_COMPONENT_TOLERANCE:
        return "xyz"[k]
    return "(" + ", ".join(f"{x:.3g}" for x in np.where(np.abs(unit) < ZERO_COMPONENT_TOLERANCE, 0.0, unit)) + ")"
