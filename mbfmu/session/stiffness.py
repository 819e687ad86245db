"""Eigenvalues of the equations of motion, linearized about a state of a trajectory (estimate of stiffness).

    x' = y,    y' = A_x x + A_y y

x are small changes along the motions that the constraints allow, in units of the coordinates, y those of their rates.
First-order states z are among y; nothing depends on their x, so that each adds an eigenvalue zero.
The columns of A are central differences of accelerations, which need nothing but what a solver has: the states of a run
are not steady, and their number is more important than the last digits. Of up to ``MAX_DENSE_FREEDOM`` degrees of
freedom all eigenvalues are found, of more the largest, by Arnoldi's iteration. It is written here, because amplitudes
require all eigenvectors in the space of the state's rates, and ARPACK returns converged eigenvalues only.
The frames of bodies that turn freely are taken as if they stood still: eigenvalues of the size of their rates are not
exact.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.errors import UserError
from solvers.compiled.tuple_pointer import pin
from solvers.linalg.threads import one_thread
from solvers.outcome import Code
from solvers.projection.saddle import Accelerations
from solvers.system import Array

Found = tuple[NDArray[np.complex128], NDArray[np.complex128], Array]  # eigenvalues, motions in columns, amplitudes

MAX_DENSE_FREEDOM = 40  # degrees of freedom up to which every column of A is computed
MAX_ARNOLDI_ITERATIONS = 40  # of Arnoldi's iteration
# of differences, in units of the coordinates: truncation and rounding are both some 1e-10 of the largest
STIFFNESS_DIFFERENCE_STEP = 1e-5
# singular values below this part of the largest are those of redundant constraints
REDUNDANT_SINGULAR_VALUE_RATIO = 1e-6
WEAK_SINGULAR_VALUE_RATIO = 1e-3  # singular values that may be those of a singular configuration
MIN_SINGLE_THREAD_SIZE = 20  # coordinates from which on more threads than one get in each other's way
# damping ratio below which BDF of higher orders is unstable on motions that the steps do not resolve
UNDAMPED_RATIO = 0.6
ARNOLDI_BREAKDOWN_RATIO = 1e-9  # part of a vector of Arnoldi's: what is left of it is rounding


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """Eigenvalues about one state.

    Attributes
    ----------
    t
        When, s.
    values
        Eigenvalues (k,), 1/s, the largest first; of many degrees of freedom the largest ones only.
    amplitudes
        Amplitude of each of these modes about its quasi-static course (k,), in units of the
        coordinates; zero if unknown.
    own
        Rate of the motion by its velocities, drives and gravity, or at rest by its accelerations, 1/s.
    leading
        The coordinate that takes most part in the fastest of them, by name; empty where nothing is free.
    """

    t: float
    values: NDArray[np.complex128]
    amplitudes: Array
    own: float
    leading: str = ""

    @property
    def fastest(self) -> complex:
        """The largest eigenvalue, 1/s; of a pair the one above the real axis."""
        if not len(self.values):
            return 0j
        value = complex(self.values[0])
        return value if value.imag >= 0.0 else value.conjugate()

    def swinging(self, tolerance: float, after: float) -> float:
        """Return the largest eigenvalue, 1/s, whose mode still exceeds the tolerance ``after`` this time, s.

        It is zero where none does.
        """
        size, decay = np.abs(self.values), -self.values.real
        left = self.amplitudes * np.exp(-np.clip(decay * after, 0.0, 700.0))
        return float(size[left > tolerance].max(initial=0.0))

    @property
    def undamped(self) -> float:
        """The largest eigenvalue, 1/s, with a damping ratio below UNDAMPED; zero if there is none."""
        size = np.abs(self.values)
        return float(size[-self.values.real < UNDAMPED_RATIO * size].max(initial=0.0))

    def followed(self, tolerance: float) -> float:
        """Return the rate of what a solver has to follow at this tolerance, 1/s: the motion's own rate, or what swings
        and has not decayed when the motion itself has gone on by its own unit.
        """
        return max(self.own, self.swinging(tolerance, 1.0 / (self.own or 1.0)))


class PerturbedDynamics:
    """Accelerations of perturbed states, along the motions that the constraints allow.

    Attributes
    ----------
    count
        Degrees of freedom; of a large model its coordinates, with changes limited to what constraints allow.
    weak
        Whether some constraint equation nearly depends on others: always, or in a singular configuration.
    """

    def __init__(self, compiled: CompiledMechanism, t: float, q: Array, v: Array) -> None:
        self.system, self.t, self.q, self.v = compiled.system, t, q, v
        system = self.system
        self._terms = system.allocate_terms()
        self._held: Any = pin(self._terms)
        self._tree = None if system.has_matrices else Accelerations(system)
        system.fill(t, q, v, self._held)
        self._scaled = self._terms.J * system.size / system.row_size[:, None]
        self.weak = False
        self._tangents, self._normals = self._split(self._scaled)
        self.count = system.n if self._tree else self._tangents.shape[1]

    def _split(self, scaled: Array) -> tuple[Array, Array]:
        """Return orthonormal tangents (n, f), of a large tree none, and the pseudo-inverse (n, m) of J~ (m, n)."""
        m, n = scaled.shape
        if not m:
            return np.eye(0 if self._tree else n), np.zeros((n, 0))
        U, sigma, V = np.linalg.svd(scaled, full_matrices=self._tree is None)
        rank = int(np.sum(sigma > REDUNDANT_SINGULAR_VALUE_RATIO * max(sigma[0], 1e-300)))
        self.weak = self.weak or bool(sigma[-1] <= WEAK_SINGULAR_VALUE_RATIO * sigma[0])
        tangents = np.zeros((n, 0)) if self._tree else V[rank:].T
        return tangents, (V[:rank].T / sigma[:rank]) @ U[:, :rank].T

    def as_motion(self, x: Any) -> Any:
        """Return the change of the coordinates (n, ...), in their units, for x (count, ...)."""
        return x if self._tree else self._tangents @ x

    def as_changes(self, change: Array) -> Array:
        """Return x (count,) for what constraints allow of a change of the coordinates (n,), in their units."""
        if not self._tree:
            return np.asarray(self._tangents.T @ change)
        return change - self._normals @ (self._scaled @ change) if self.system.m else change

    def accelerations(self, x: Array, y: Array) -> Array:
        """Return those of the coordinates (n,), in their units, at the state changed by x and y (count,)."""
        system, q, v = self.system, self.q.copy(), self.v + self.system.size * self.as_motion(y)
        system.apply(q, system.size * self.as_motion(x))
        if system.m:  # rates that the loops allow there
            system.fill_position(self.t, q, self._held)
            tangents, inverse = self._split(self._terms.J * system.size / system.row_size[:, None])
            v -= system.size * (inverse @ ((self._terms.J @ v - self._terms.nu) / system.row_size))
        if self._tree:
            if self._tree.solve(self.t, q, v) is not Code.OK:
                raise UserError("the accelerations of perturbed states are not determined")
            return np.asarray(self._tree.a / system.size)
        system.fill(self.t, q, v, self._held)
        terms, a = self._terms, np.zeros(system.n)
        if system.m:
            a = system.size * (inverse @ (terms.gamma / system.row_size))
        else:
            tangents = self._tangents
        S = system.size[:, None] * tangents
        a += S @ np.linalg.solve(S.T @ terms.M @ S, -S.T @ (terms.h + terms.M @ a))
        return np.asarray(a / system.size)

    def change(self, x: Array, y: Array) -> Array:
        """Return A_x x + A_y y (count,)."""
        there = self.accelerations(STIFFNESS_DIFFERENCE_STEP * x, STIFFNESS_DIFFERENCE_STEP * y)
        back = self.accelerations(-STIFFNESS_DIFFERENCE_STEP * x, -STIFFNESS_DIFFERENCE_STEP * y)
        return self.as_changes((there - back) / (2.0 * STIFFNESS_DIFFERENCE_STEP))


def spectrum(compiled: CompiledMechanism, t: float, q: Array, v: Array) -> Spectrum:
    """Return the eigenvalues about the state (q (nq,), v (n,)) at time t, s, which must keep the constraints.

    In a singular configuration, or very near one, they are those of a nearby position. Raises UserError if the
    accelerations there are not determined or not finite.
    """
    try:
        with one_thread() if compiled.system.n > MIN_SINGLE_THREAD_SIZE else nullcontext():
            return _compute_spectrum(compiled, t, q, v)
    except np.linalg.LinAlgError as error:
        raise UserError("the accelerations of perturbed states are not determined") from error


def _compute_spectrum(compiled: CompiledMechanism, t: float, q: Array, v: Array) -> Spectrum:
    """Return what :func:`spectrum` does."""
    moving = compiled.system.n_velocities
    rate = max(compiled.system.rate, float(np.abs(v / compiled.system.size)[:moving].max(initial=0.0)))
    dynamics = PerturbedDynamics(compiled, t, q, v) if compiled.system.n else None
    if dynamics and dynamics.weak:
        dynamics = PerturbedDynamics(compiled, t, compiled.assembly.nearby(t, q), v)
    if not dynamics or not dynamics.count:  # drives leave nothing free
        return Spectrum(t=t, values=np.zeros(0, complex), amplitudes=np.zeros(0), own=rate)
    still = np.zeros(dynamics.count)
    a = dynamics.accelerations(still, still)
    if not rate > 0.0:  # else not from these: what is stiff swings a little in every run, and has large ones
        rate = float(np.sqrt(np.abs(a[:moving]).max(initial=0.0)))
    few = dynamics.count <= MAX_DENSE_FREEDOM
    values, motions, amplitudes = _all_eigenvalues(dynamics, a) if few else _largest_eigenvalues(dynamics, a, rate)
    order = np.argsort(-np.abs(values), kind="stable")
    fastest = np.abs(dynamics.as_motion(motions[:, order[0]]))
    leading = compiled.system.coordinate_names[int(np.argmax(fastest))]
    return Spectrum(t=t, values=values[order], amplitudes=amplitudes[order], own=rate, leading=leading)


def _all_eigenvalues(dynamics: PerturbedDynamics, a: Array) -> Found:
    """Return every eigenvalue, and how far its motion swings: what of the state's rates is along it, over its rate."""
    f, none, unit = dynamics.count, np.zeros(dynamics.count), np.eye(dynamics.count)
    A = np.zeros((2 * f, 2 * f))
    A[:f, f:] = unit
    for k in range(f):
        A[f:, k], A[f:, f + k] = dynamics.change(unit[k], none), dynamics.change(none, unit[k])
    if not np.isfinite(A).all():
        raise UserError("the accelerations of perturbed states are not finite")
    values, left, right = scipy.linalg.eig(A, left=True)
    y = dynamics.as_changes(dynamics.v / dynamics.system.size)
    rates = np.concatenate((y, dynamics.as_changes(a)))
    along, share = left.conj().T @ rates, np.einsum("ij,ij->j", left.conj(), right)
    n_states = dynamics.system.n_states
    moved = dynamics.as_motion(right[:f])
    if n_states:  # how far z swings
        moved[len(moved) - n_states :] = dynamics.as_motion(right[f:])[len(moved) - n_states :]
    widest = np.abs(moved).max(axis=0, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        swing = np.abs(along / (share * values)) * widest
    return values, right[:f], np.where(np.isfinite(swing), swing, 0.0)


def _largest_eigenvalues(dynamics: PerturbedDynamics, a: Array, rate: float) -> Found:
    """Return the largest eigenvalues, and of those that the state's rates set going how far they swing.

    By Arnoldi's iteration on (x, y / w), w the rate of what a push sets going: from a random start, which misses no
    motion, and from the state's own rates, which have a part in each as large as it swings.
    """
    f, random = dynamics.count, np.random.default_rng(0)
    x, y = (dynamics.as_changes(random.normal(size=dynamics.system.n)) for _ in range(2))
    x /= np.linalg.norm(x)
    w = max(rate, float(np.sqrt(np.linalg.norm(dynamics.change(x, np.zeros(f)))))) or 1.0
    values, motions = _arnoldi(dynamics, w, np.concatenate((x, y / np.linalg.norm(y))))
    rates = np.concatenate((dynamics.as_changes(dynamics.v / dynamics.system.size), dynamics.as_changes(a) / w))
    if not np.any(rates):
        return values, motions[:f], np.zeros(len(values))
    own, along = _arnoldi(dynamics, w, rates)
    share = np.linalg.lstsq(along, rates, rcond=None)[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        swing = np.abs(share / own) * np.abs(along[:f]).max(axis=0)
    amplitudes = np.concatenate((np.zeros(len(values)), np.where(np.isfinite(swing), swing, 0.0)))
    return np.concatenate((values, own)), np.hstack((motions[:f], along[:f])), amplitudes


def _arnoldi(
    dynamics: PerturbedDynamics, w: float, start: Array
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return eigenvalues (k,) and vectors (2 count, k) in the space of ``start`` and what follows from it."""
    f, turns = dynamics.count, min(MAX_ARNOLDI_ITERATIONS, len(start))
    basis, H = np.zeros((turns + 1, 2 * f)), np.zeros((turns + 1, turns))
    basis[0] = start / np.linalg.norm(start)
    for k in range(turns):
        x, y = basis[k, :f], basis[k, f:]
        new = np.concatenate((w * y, dynamics.change(x, w * y) / w))
        whole = np.linalg.norm(new)
        for _ in range(2):
            part = basis[: k + 1] @ new
            new -= part @ basis[: k + 1]
            H[: k + 1, k] += part
        H[k + 1, k] = left = np.linalg.norm(new)
        if not np.isfinite(left):
            raise UserError("the accelerations of perturbed states are not finite")
        if left <= ARNOLDI_BREAKDOWN_RATIO * whole:
            turns = k + 1
            break
        basis[k + 1] = new / left
    values, shares = scipy.linalg.eig(H[:turns, :turns])
    return values, basis[:turns].T @ shares
