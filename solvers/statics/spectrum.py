"""Eigenvalues of the linearized motion, (s^2 M + s C + K) x = 0, each with what rounding leaves open of it.

Where C is zero and K symmetric s^2 are the eigenvalues of a symmetric pencil; otherwise s are those of the state
matrix. Each is then improved by a Newton step of the scalar quadratic y^H (s^2 M + s C + K) x, with the left and the
right eigenvector: an error of these counts by its square only. A bound follows from the rounding of the matrices: that
of the quadratic's value e, its slope p and its leading coefficient a leave open

    |ds| = 2 e / (|p| + sqrt(|p|^2 + 4 |a| e)),

which is e / |p| for a single root and sqrt(e / |a|) for a double one, such as that of a motion which nothing resists.
No threshold depends on how fast other modes are.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from solvers.system import Array

from .matrices import MACHINE_EPSILON, Matrices, is_symmetric, is_undamped

# what is left of a motion, relative, when those before it are taken away, below which it is not independent
MIN_INDEPENDENT_PART = 1e-6
UNCERTAIN_PART = 0.1  # of a step that improves an eigenvalue of a motion with first-order states
MAX_IMPROVEMENT_RATIO = 1e-3  # longest step that improves an eigenvalue, relative to the fastest one


class Stability(StrEnum):
    """Stability of a linearized motion as a word, from the most to the least stable."""

    STABLE = "stable"
    UNDAMPED = "undamped"
    NEUTRAL = "neutral"
    UNSTABLE = "unstable"
    UNKNOWN = "unknown"

    @property
    def text(self) -> str:
        """Description for people."""
        return DESCRIPTIONS[self]

    @property
    def stays(self) -> bool:
        """Whether small deviations are known to stay small."""
        return self in (Stability.STABLE, Stability.UNDAMPED)


DESCRIPTIONS = {
    Stability.STABLE: "stable: all modes are damped",
    Stability.UNDAMPED: "marginally stable: undamped oscillation",
    Stability.NEUTRAL: "neutral: some modes have neither stiffness nor growth",
    Stability.UNSTABLE: "UNSTABLE: some modes grow",
    Stability.UNKNOWN: "stability is not determined, see the note",
}


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """Eigenvalues, slowest first; of a conjugate pair the one above the real axis.

    Attributes
    ----------
    values
        (k,) 1/s; zero within their rounding error for each motion without resistance.
    motions
        (n, k) how the coordinates take part: real and of unit modal mass where nothing damps or turns, else complex and
        of any scale.
    doubts
        (k,) bounds, 1/s, of what rounding leaves open.
    complete
        Whether these are all eigenvalues.
    growing
        Motions that grow, where their number is known otherwise.
    """

    values: NDArray[np.complex128]
    motions: NDArray[Any]
    doubts: Array
    complete: bool = True
    growing: int | None = None

    @property
    def stability(self) -> Stability:
        """Stability of the motion; never unknown."""
        s, doubt = self.values, self.doubts
        if self.growing or (s.real > doubt).any():
            return Stability.UNSTABLE
        if (s == 0.0).any():
            return Stability.NEUTRAL
        return Stability.STABLE if (s.real < -doubt).all() else Stability.UNDAMPED


def spectrum_of(matrices: Matrices) -> Spectrum:
    """Return all eigenvalues; LinAlgError where a motion has no inertia."""
    if not len(matrices.K):
        return Spectrum(values=np.zeros(0, complex), motions=np.zeros((len(matrices.basis), 0)), doubts=np.zeros(0))
    if not matrices.n_states and is_undamped(matrices) and is_symmetric(matrices):
        return solve_conservative(matrices)
    return solve_general(matrices)


def solve_conservative(matrices: Matrices) -> Spectrum:
    """Return those of s^2 M + K, both symmetric."""
    K, M = 0.5 * (matrices.K + matrices.K.T), matrices.M
    unit = 1.0 / np.sqrt(np.diag(M))
    if not np.isfinite(unit).all():
        raise np.linalg.LinAlgError("a motion has no inertia")
    scale = np.outer(unit, unit)
    x = unit[:, np.newaxis] * scipy.linalg.eigh(K * scale, M * scale)[1]
    squares = np.einsum("ik,ij,jk->k", x, K, x, optimize=True)
    parts = np.abs(x)
    open_by = np.einsum("ik,ij,jk->k", parts, matrices.rounding[0], parts, optimize=True)
    values, doubts, motions = [], [], []
    for square, doubt, motion in zip(squares, open_by, x.T, strict=True):
        if abs(square) <= doubt:
            found = [0.0]
        elif square > 0.0:
            found = [1j * np.sqrt(square)]
        else:
            found = [-np.sqrt(-square), np.sqrt(-square)]
        for s in found:
            values.append(s)
            doubts.append(np.sqrt(doubt) if s == 0.0 else doubt / abs(s))
            motions.append(motion)
    return order_spectrum(np.array(values, complex), matrices.basis @ np.array(motions).T, np.array(doubts))


def solve_general(matrices: Matrices) -> Spectrum:
    """Return those of s^2 M + s C + K.

    Of a first-order state x' = z neither x nor the eigenvalue zero that it would add is part of the state matrix.
    """
    L = scipy.linalg.cholesky(matrices.M, lower=True)
    K, C = (scipy.linalg.solve_triangular(L, scipy.linalg.solve_triangular(L, A, lower=True).T, lower=True).T
            for A in (matrices.K, matrices.C))  # fmt: skip
    f = len(K)
    unit = float(np.sqrt(np.linalg.norm(K, 2))) or 1.0  # of time
    state = np.block([[np.zeros((f, f)), unit * np.eye(f)], [-K / unit, -C]])
    moving = f - matrices.n_states
    if matrices.n_states:
        state = np.delete(np.delete(state, np.s_[moving:f], 0), np.s_[moving:f], 1)
    values, left, right = scipy.linalg.eig(state, left=True)
    motions = np.vstack((right[:moving], unit * right[2 * moving :]))  # of coordinates, and z of states
    x, y = motions, left[moving:]
    if matrices.n_states:  # x = z / s of states, and all of it times s
        changes = np.any(motions[moving:] != 0.0, axis=0)
        x = np.vstack((motions[:moving] * np.where(changes, values, 1.0), motions[moving:]))
    motions, x, y = (scipy.linalg.solve_triangular(L, part, lower=True, trans="T") for part in (motions, x, y))
    values, doubts = improve_eigenvalues(matrices, values, x, y, float(np.abs(values).max()))
    upper = values.imag >= 0.0
    return order_spectrum(values[upper], matrices.basis @ motions[:, upper], doubts[upper])


def spectrum_of_states(A: Array, coordinates: Array, n_moving: int) -> Spectrum:
    """Return the eigenvalues of state matrices A (s, s): positions (f,), rates, and first-order states from the place
    ``n_moving`` on. Coordinates change as ``coordinates`` (n, f) with the positions.

    Positions on which nothing depends and rates that nothing changes are taken out first: their eigenvalue is zero.
    """
    states, f = np.arange(len(A)), coordinates.shape[1]
    scale = scipy.linalg.matrix_balance(A, permute=False, separate=True)[1][0]
    balanced = np.abs(A * scale / scale[:, np.newaxis])
    least = MACHINE_EPSILON * len(A) * balanced.max(initial=0.0)
    while len(states):
        part = balanced[np.ix_(states, states)] > least
        kept = part.any(axis=0) & part.any(axis=1)
        if kept.all():
            break
        states = states[kept]
    own = A[np.ix_(states, states)]
    values, left, right = scipy.linalg.eig(own, left=True) if len(own) else (np.zeros(0), own, own)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    rounding = MACHINE_EPSILON * (16.0 + len(own)) * float(np.linalg.norm(own, 2) if len(own) else 0.0)
    doubts = np.minimum(
        rounding / np.maximum(overlap, MACHINE_EPSILON), np.sqrt(rounding * np.abs(own).max(initial=0.0))
    )
    vectors = np.zeros((len(A), len(values)), complex)
    vectors[states] = right
    motions = coordinates @ vectors[:f]
    motions[len(motions) - (len(A) - n_moving) :] = vectors[n_moving:]
    values = np.where(np.abs(values) <= doubts, 0.0, values)
    values = np.where(np.abs(values.imag) <= doubts, values.real, values)
    upper, still = values.imag >= 0.0, np.setdiff1d(np.arange(f), states)
    return order_spectrum(
        np.append(values[upper], np.zeros(len(still))),
        np.column_stack((motions[:, upper], coordinates[:, still])),
        np.append(doubts[upper], np.zeros(len(still))),
    )


def improve_eigenvalues(
    matrices: Matrices, values: NDArray[np.complex128], x: Array, y: Array, fastest: float
) -> tuple[NDArray[np.complex128], Array]:
    """Return eigenvalues by the quadratics of right and left eigenvectors x, y (f, k), and their doubts."""
    M, C, K = matrices.M, matrices.C, matrices.K
    x, y = (part / np.linalg.norm(part, axis=0) for part in (x, y))
    a, b, c = (np.einsum("ik,ij,jk->k", y.conj(), A, x, optimize=True) for A in (M, C, K))
    bounds = MACHINE_EPSILON * (16.0 + len(K)) * np.abs(M), matrices.rounding[1], matrices.rounding[0]
    sizes = [np.einsum("ik,ij,jk->k", np.abs(y), A, np.abs(x), optimize=True) for A in bounds]
    found, doubts = values.copy(), np.zeros(len(values))
    for k in range(len(values)):
        s = values[k]
        slope = 2.0 * a[k] * s + b[k]
        step = ((a[k] * s + b[k]) * s + c[k]) / slope if slope else np.inf  # Newton's
        if abs(step) <= MAX_IMPROVEMENT_RATIO * fastest:
            found[k] -= step
        s, size = found[k], abs(found[k])
        error = sizes[0][k] * size**2 + sizes[1][k] * size + sizes[2][k]
        slope = abs(2.0 * a[k] * s + b[k])
        bound = slope + np.sqrt(slope**2 + 4.0 * abs(a[k]) * error)
        doubts[k] = 2.0 * error / bound if bound else (np.inf if error else 0.0)
        if matrices.n_states and abs(step) <= MAX_IMPROVEMENT_RATIO * fastest:  # x contains the value before the step
            doubts[k] = max(doubts[k], UNCERTAIN_PART * abs(step))
        found[k] = complex(s.real, s.imag if abs(s.imag) > doubts[k] else 0.0)
        if size <= doubts[k]:
            found[k] = 0.0
    return found, doubts


def order_spectrum(values: NDArray[np.complex128], motions: NDArray[Any], doubts: Array) -> Spectrum:
    """Return a spectrum, slowest first, with one zero for each independent motion that nothing resists."""
    order = np.argsort(np.abs(values), kind="stable")
    values, motions, doubts = values[order], motions[:, order], doubts[order]
    kept, basis = np.ones(len(values), bool), np.zeros((len(motions), 0))
    for k in np.flatnonzero(values == 0.0):
        motion = motions[:, k] / np.linalg.norm(motions[:, k])
        rest = motion - basis @ (basis.conj().T @ motion)
        kept[k] = np.linalg.norm(rest) > MIN_INDEPENDENT_PART
        if kept[k]:
            basis = np.column_stack((basis, rest / np.linalg.norm(rest)))
    return Spectrum(values=values[kept], motions=motions[:, kept], doubts=doubts[kept])
