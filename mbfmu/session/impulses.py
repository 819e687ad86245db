"""Jumps of the velocities by impulses on coordinates, and by the impacts of quantities that hit stops."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from solvers.system import Array

DEPENDENT_ROW_RATIO = 1e-10  # singular value of the scaled constraint Jacobian, relative to the largest: it is none
CONTRADICTION = 1e-10  # square of the inverse of the jump that stops require, in units of that which one requires


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
            None: what a quantity moves has no mass; a number: the rate of this quantity cannot change as its stop
            requires.
        """
        slopes, approach = self.slopes(t, q)[hit], self._rates(t, q, v)[hit]
        responses = velocity_jump(self._compiled, t, q, v, -slopes)
        if responses is None:
            return None
        demand = approach + self.restitutions[hit] * np.maximum(approach, 0.0)
        effects = -slopes @ responses.T
        p = solve_complementarity(effects, demand)
        if p is None:
            return int(hit[np.argmin(np.diag(effects))])
        found: Array = p @ responses
        return found


def solve_complementarity(A: Array, b: Array) -> Array | None:
    """Return p (k,) with p >= 0, A p - b >= 0 and p (A p - b) = 0, for a symmetric positive semidefinite A (k, k).

    With A = C C^T, x = C^T p is the shortest vector with C x >= b: the problem of least distance, which is solved by
    nonnegative least squares (Lawson and Hanson, *Solving Least Squares Problems*, 1995, chapter 23). Rows may depend
    on each other. None: they contradict each other.
    """
    unit = np.sqrt(np.maximum(np.diag(A), 0.0))
    moving = unit > 0.0
    p, largest = np.zeros(len(b)), float(np.max(b[moving] / unit[moving], initial=0.0))
    if np.any(b[~moving] > 0.0):
        return None
    if largest == 0.0:
        return p
    values, vectors = np.linalg.eigh(A[np.ix_(moving, moving)] / np.outer(unit[moving], unit[moving]))
    C, h = vectors * np.sqrt(np.maximum(values, 0.0)), b[moving] / (unit[moving] * largest)
    u = scipy.optimize.nnls(np.vstack([C.T, h]), np.append(np.zeros(len(values)), 1.0))[0]
    rest = 1.0 - h @ u
    if rest <= CONTRADICTION:
        return None
    p[moving] = u / rest * largest / unit[moving]
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
