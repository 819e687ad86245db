"""Jumps of the velocities by impulses on coordinates, and by the impacts of quantities that hit stops."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from solvers.system import Array

DEPENDENT_ROW_RATIO = 1e-10  # singular value of the scaled constraint Jacobian, relative to the largest: it is none
MAX_IMPULSE_ITERATIONS = 10_000  # over the impulses of one time; one stop needs one
IMPULSE_ACCURACY = 1e-15  # change of the impulses in a sweep, in units of the largest


class Impacts:
    """The quantities of a mechanism that bounce off stops.

    Parameters
    ----------
    compiled
        Mechanism.
    parts
        Numbers of the parts that are the rates of these quantities (k,).
    directions
        Sign of each rate (k,) towards the stop.

    Attributes
    ----------
    restitutions
        Coefficients of restitution (k,).
    """

    restitutions: Array

    def __init__(self, compiled: CompiledMechanism, parts: NDArray[np.int64], directions: Array) -> None:
        self._compiled, self._parts, self._directions = compiled, parts, directions

    def _rates(self, t: float, q: Array, v: Array) -> Array:
        """Return the rates (k,) towards the stops."""
        values, compiled = np.zeros(len(self._directions)), self._compiled
        watch_sensors(t, q, v, self._parts, compiled.system.pinned_data, values)
        found: Array = self._directions * values
        return found

    def slopes(self, t: float, q: Array) -> Array:
        """Return the slopes G (k, n) of the rates G v + g_t towards the stops, which are linear in v."""
        at_rest, unit = self._rates(t, q, np.zeros(self._compiled.system.n)), np.eye(self._compiled.system.n)
        return np.array([self._rates(t, q, v) - at_rest for v in unit]).T

    def jump(self, t: float, q: Array, v: Array, hit: NDArray[np.int64]) -> Array | int | None:
        """Return the jump of the velocities (n,) when the quantities ``hit`` are at their stops.

        It is sum p_i W G_i^T with the impulses p >= 0 that solve the linear complementarity problem of Newton's law of
        restitution without friction (Glocker and Pfeiffer, *Nonlinear Dynamics* 7, 1995, 471-497); W G_i^T is that of
        :func:`velocity_jump`.

        Returns
        -------
        Array, int or None
            None: what a quantity moves has no mass; a number: the rate of this quantity cannot change.
        """
        slopes, approach = self.slopes(t, q)[hit], self._rates(t, q, v)[hit]
        responses = velocity_jump(self._compiled, t, q, v, -slopes)
        if responses is None:
            return None
        demand = approach + self.restitutions[hit] * np.maximum(approach, 0.0)
        effects = -slopes @ responses.T
        fixed = np.flatnonzero((np.diag(effects) <= 0.0) & (demand > 0.0))
        if len(fixed):
            return int(hit[fixed[0]])
        found: Array = solve_complementarity(effects, demand) @ responses
        return found


def solve_complementarity(A: Array, b: Array) -> Array:
    """Return p (k,) with p >= 0, A p - b >= 0 and p (A p - b) = 0, for a symmetric positive semidefinite A (k, k).

    By the projected Gauss-Seidel iteration (Cottle, Pang and Stone, *The Linear Complementarity Problem*, 1992).
    """
    p, own = np.zeros(len(b)), np.diag(A)
    for _ in range(MAX_IMPULSE_ITERATIONS):
        before = p.copy()
        for i in np.flatnonzero(own > 0.0):
            p[i] = max(0.0, p[i] + (b[i] - A[i] @ p) / own[i])
        sizes = np.sqrt(np.maximum(own, 0.0)) * np.array((p, p - before))
        if np.abs(sizes[1]).max() <= IMPULSE_ACCURACY * np.abs(sizes[0]).max():
            break
    return p


def velocity_jump(compiled: CompiledMechanism, t: float, q: Array, v: Array, impulses: Array) -> Array | None:
    """Return the jump of the velocities by impulses on the coordinates; None: what they move has no mass.

    The jump is N (N^T M N)^-1 N^T p with a basis N of the motions that the constraints allow (J N = 0), in units of the
    coordinates and of the rows of J, so that redundant equations are recognized in mechanisms of any size. An impulse
    that no motion follows has none.

    Parameters
    ----------
    compiled, t, q, v
        Mechanism and its state, s, (nq,) and (n,).
    impulses
        Impulses p (n,), or several (k, n).

    Returns
    -------
    Array or None
        Jumps, of the shape of the impulses.
    """
    system = compiled.system
    dense = system if system.has_matrices else system.dense()
    terms, moving = dense.allocate_terms(), system.n_velocities
    dense.fill(t, q, v, terms)
    size = system.size[:moving]
    J, jump = terms.J[:, :moving] * size, np.zeros(impulses.shape)
    lengths = np.linalg.norm(J, axis=1)
    J = J[lengths > 0.0] / lengths[lengths > 0.0, None]
    free = scipy.linalg.null_space(J, rcond=DEPENDENT_ROW_RATIO) if len(J) else np.eye(moving)
    M = free.T @ (terms.M[:moving, :moving] * size * size[:, None]) @ free
    unit = np.sqrt(np.diag(M))
    if not np.all(unit > 0.0):
        return None
    values, vectors = np.linalg.eigh(M / (unit * unit[:, None]))
    if len(values) and values[0] <= len(values) * np.finfo(float).eps:
        return None
    given = size * impulses[..., :moving]
    pushed = given @ free
    acting = np.linalg.norm(pushed, axis=-1) > DEPENDENT_ROW_RATIO * np.linalg.norm(given, axis=-1)
    moved = (pushed / unit @ vectors / values) @ vectors.T * acting[..., None]
    jump[..., :moving] = size * ((moved / unit) @ free.T)
    return jump
