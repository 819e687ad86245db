"""Jumps of the velocities by impulses on coordinates, and by the impacts of quantities that hit stops."""

from __future__ import annotations

import weakref
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.recursions.dynamics import watch_sensors
from mbfmu.util.diagnostics import Diagnostic
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.positions import position_sizes
from solvers.projection.eliminated import EliminationScratch
from solvers.projection.eliminated import find_normal_rank as find_rank_of_motion
from solvers.projection.projection import UNRESOLVED_PIVOT_RATIO
from solvers.projection.rank import find_normal_rank
from solvers.projection.workspace import Workspace
from solvers.steppers import eliminates_constraints
from solvers.system import AnySystem, Array, Equations, System, Terms, TreeSystem

from .kernels.eliminated_jumps import DEPENDENT_ROW_RATIO, DETERMINED, IMMOBILE, find_jump
from .run_messages import MASSLESS_EVENT, SINGULAR_EVENT

# Singular value of the constraint Jacobian, relative to the largest, below which the velocities after an impulse, and
# the positions of a loop in which a joint is locked, are not resolved; where constraints are eliminated, length of the
# shortest equation
IMPULSE_PIVOT_RATIO, LOCK_PIVOT_RATIO = UNRESOLVED_PIVOT_RATIO, 1e-4
SAME_JUMP_RATIO = 1e-9  # difference of two jumps, relative to the largest change of a velocity, that is none
UNSOLVED, MAX_PIVOTS = 1e-11, 50  # rate of a stop, relative to the largest, that is none; pivots, per stop
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
    directions
        As given.
    """

    restitutions: Array

    def __init__(self, compiled: CompiledMechanism, parts: NDArray[np.int64], directions: Array) -> None:
        self._compiled, self._parts, self.directions = compiled, parts, directions

    def rates(self, t: float, q: Array, v: Array) -> Array:
        """Return the rates (k,) towards the stops."""
        values, compiled = np.zeros(len(self.directions)), self._compiled
        watch_sensors(t, q, v, self._parts, compiled.system.pinned_data, values)
        found: Array = self.directions * values
        return found

    def slopes(self, t: float, q: Array) -> Array:
        """Return the slopes G (k, n) of the rates G v + g_t towards the stops, which are linear in v."""
        n = self._compiled.system.n
        at_rest = self.rates(t, q, np.zeros(n))
        found = np.empty((len(at_rest), n))
        for k, unit in enumerate(np.eye(n)):
            found[:, k] = self.rates(t, q, unit) - at_rest
        return found

    def jump(self, t: float, q: Array, v: Array, hit: NDArray[np.int64]) -> Array | int:
        """Return the jump of the velocities (n,) when the quantities ``hit`` are at their stops.

        It is sum p_i W G_i^T with the impulses p >= 0 that solve the linear complementarity problem of Newton's law of
        restitution without friction (Glocker and Pfeiffer, *Nonlinear Dynamics* 7, 1995, 471-497); W G_i^T is that of
        :func:`velocity_jump`.

        Returns
        -------
        Array or int
            A number: the rate of this quantity cannot change as its stop requires.

        Raises
        ------
        UndeterminedJumpError
            As for :func:`velocity_jump`.
        """
        slopes, approach = self.slopes(t, q)[hit], self.rates(t, q, v)[hit]
        responses = velocity_jump(self._compiled, t, q, v, -slopes)
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
    scaled = A[np.ix_(moving, moving)] / np.outer(unit[moving], unit[moving])
    values, vectors = np.linalg.eigh(scaled)
    C, h = vectors * np.sqrt(np.maximum(values, 0.0)), b[moving] / (unit[moving] * largest)
    u = scipy.optimize.nnls(np.vstack([C.T, h]), np.append(np.zeros(len(values)), 1.0))[0]
    rest = 1.0 - h @ u
    if rest <= CONTRADICTION:
        return None
    p[moving] = refine(scaled, h, u / rest) * largest / unit[moving]
    return p


def refine(A: Array, b: Array, p: Array) -> Array:
    """Return a solution (k,) of the problem of :func:`solve_complementarity`, from an approximate one.

    Principal pivoting with the least index from the set of p > 0 (Murty, *Linear Complementarity, Linear and Nonlinear
    Programming*, 1988, section 4.1), if p is not a solution: least squares are not accurate for light bodies between
    heavy ones. A has a unit diagonal. Rows that depend on each other may have no such set: p is returned.
    """
    rest = A @ p - b
    active = p > 0.0
    if np.all(np.where(active, np.abs(rest), -rest) <= UNSOLVED):
        return p
    for _ in range(MAX_PIVOTS * len(b)):
        found = np.zeros(len(b))
        found[active] = np.linalg.lstsq(A[np.ix_(active, active)], b[active])[0]
        rest = A @ found - b
        wrong = np.flatnonzero(np.where(active, found < 0.0, rest < -UNSOLVED))
        if not len(wrong):
            return found
        active[wrong[0]] = not active[wrong[0]]
    return p


class UndeterminedJumpError(Exception):
    """The velocities after an impulse are not determined; ``reason`` is a template of :mod:`.run_messages`."""

    def __init__(self, reason: Diagnostic) -> None:
        super().__init__(reason.text)
        self.reason = reason


class Motions(NamedTuple):
    """The motions that the constraints allow at a state, in units of the coordinates."""

    rows: Array  # (n, n) orthonormal rows; those from ``rank`` on are a basis of these motions
    rank: int  # of the constraint Jacobian at regular positions nearby
    resolved_rank: int  # at this position; less than ``rank`` in a singular configuration
    mass: Array  # (n, n) mass matrix


def allowed_motions(dense: System, t: float, q: Array, v: Array, resolution: float) -> Motions:
    """Return the motions that the constraints allow at the state (q, v) of time t, s.

    The units of the constraint equations are those at positions far from q, so that a singular configuration is
    recognized, and the rank of their Jacobian is that of regular positions, so that redundant equations are not taken
    for one. Singular values below ``resolution``, relative to the largest, are not resolved.
    """
    sizes, moving = (dense.nq, dense.n, dense.m), dense.n_velocities
    terms, work = Terms.allocate(*sizes), pin(Workspace.allocate(*sizes, dense.n_states, dense.nonholonomic))
    workspace, equations = unpin(work), Equations.of(dense, terms)
    workspace.size[:] = dense.size
    workspace.size_q[:] = dense.position_sizes(dense.size)
    rank = int(find_normal_rank(equations, t, q, v, work)) if dense.m else 0
    dense.fill(t, q, v, terms)
    size = dense.size[:moving]
    mass = terms.M[:moving, :moving] * size * size[:, None]
    if rank == 0:
        return Motions(np.eye(moving), 0, 0, mass)
    _, sigma, rows = np.linalg.svd(terms.J[:, :moving] * size / workspace.row[:, None])
    resolved = int(np.count_nonzero(sigma[:rank] > resolution * sigma[0]))
    return Motions(rows, rank, resolved, mass)


def velocity_jump(
    compiled: CompiledMechanism, t: float, q: Array, v: Array, impulses: Array, resolution: float = IMPULSE_PIVOT_RATIO
) -> Array:
    """Return the jump of the velocities by impulses on the coordinates.

    The jump is N (N^T M N)^-1 N^T p with a basis N of the motions that the constraints allow (J N = 0), in units of the
    coordinates and of the rows of J. An impulse that no motion follows has none. In large models without constraints it
    is M^-1 p, by the recursions along the tree; in other large models constraints are eliminated along the tree, see
    :mod:`.kernels.eliminated_jumps`.

    Parameters
    ----------
    compiled, t, q, v
        Mechanism and its state, s, (nq,) and (n,).
    impulses
        Impulses p (n,), or several (k, n).
    resolution
        Singular value of the constraint Jacobian, relative to the largest, below which the configuration is singular.

    Returns
    -------
    Array
        Jumps, of the shape of the impulses.

    Raises
    ------
    UndeterminedJumpError
        What an impulse moves has no mass, or the jump depends on what the constraints do not determine in a singular
        configuration.
    """
    system = compiled.system
    if isinstance(system, TreeSystem) and not system.m:
        return tree_jump(system, t, q, v, impulses)
    if eliminates_constraints("adams", system):
        return EliminatedJumps.of(system, t, q, v).find(t, q, v, impulses, resolution)
    dense: Any = system if system.has_matrices else system.dense()
    moving, motions, jump = dense.n_velocities, allowed_motions(dense, t, q, v, resolution), np.zeros(impulses.shape)
    size = dense.size[:moving]
    given = size * impulses[..., :moving]
    found = respond(motions, motions.rank, given)
    if motions.resolved_rank < motions.rank:
        others = respond(motions, motions.resolved_rank, given)
        if np.any(np.abs(others - found) > SAME_JUMP_RATIO * np.abs(others).max(axis=-1, keepdims=True, initial=0.0)):
            raise UndeterminedJumpError(SINGULAR_EVENT)
    jump[..., :moving] = size * found
    return jump


def tree_jump(system: TreeSystem, t: float, q: Array, v: Array, impulses: Array) -> Array:
    """Return M^-1 p for impulses p (n,) or (k, n) on a large tree, by its articulated inertias.

    Raises
    ------
    UndeterminedJumpError
        A free motion has no mass.
    """
    jumps, given = np.zeros_like(np.atleast_2d(impulses)), np.atleast_2d(impulses)
    if system.forward(t, q, v, system.pinned_data, np.zeros(system.nq), np.zeros(system.n)):
        raise UndeterminedJumpError(MASSLESS_EVENT)
    for p, jump in zip(given, jumps, strict=True):
        system.mobility(p, system.pinned_data, jump)
    return jumps.reshape(impulses.shape)


class EliminatedJumps:
    """Jumps of the velocities of a large model with loops.

    Parameters
    ----------
    system
        Equations of motion, with ``elimination``.
    t, q, v
        Closed state at which the number of independent constraint equations is found, s, (nq,) and (n,).
    """

    _last: ClassVar[tuple[weakref.ref[AnySystem], EliminatedJumps] | None] = None  # planning costs 50 jumps

    def __init__(self, system: AnySystem, t: float, q: Array, v: Array) -> None:
        assert system.elimination is not None  # else matrices are used
        scratch = EliminationScratch.allocate(system.nq, system.n, system.m, system.placed)
        scratch.size[:] = system.size
        position_sizes(scratch.positions, scratch.size, scratch.size_q)
        self._equations, self._work = system.elimination(), pin(scratch)
        scratch.near["rank"] = find_rank_of_motion(self._equations, t, q, v, self._work)

    @staticmethod
    def of(system: AnySystem, t: float, q: Array, v: Array) -> EliminatedJumps:
        """Return those of a system; they are kept until those of another one are requested."""
        kept = EliminatedJumps
        if kept._last is None or kept._last[0]() is not system:
            kept._last = weakref.ref(system), EliminatedJumps(system, t, q, v)
        return kept._last[1]

    def find(self, t: float, q: Array, v: Array, impulses: Array, resolution: float) -> Array:
        """Return the jumps by impulses (n,) or (k, n), both as in :func:`velocity_jump`."""
        jumps, given = np.zeros_like(np.atleast_2d(impulses)), np.atleast_2d(impulses)
        for p, jump in zip(given, jumps, strict=True):
            code = find_jump(self._equations, t, q, v, p, resolution, self._work, jump)
            if code != DETERMINED:
                raise UndeterminedJumpError(MASSLESS_EVENT if code == IMMOBILE else SINGULAR_EVENT)
        return jumps.reshape(impulses.shape)


def respond(motions: Motions, rank: int, given: Array) -> Array:
    """Return the jumps by impulses ``given``, both (n,) or (k, n), in units of the coordinates, for constraints of this
    rank.
    """
    free = motions.rows[rank:].T
    M = free.T @ motions.mass @ free
    unit = np.sqrt(np.maximum(np.diag(M), 0.0))
    if not np.all(unit > 0.0):
        raise UndeterminedJumpError(MASSLESS_EVENT)
    values, vectors = np.linalg.eigh(M / (unit * unit[:, None]))
    if len(values) and values[0] <= len(values) * np.finfo(float).eps:
        raise UndeterminedJumpError(MASSLESS_EVENT)
    pushed = given @ free
    largest = [np.max(np.abs(part), axis=-1, initial=0.0) for part in (pushed, given)]  # no squares, which overflow
    acting = largest[0] > DEPENDENT_ROW_RATIO * largest[1]
    moved = (pushed / unit @ vectors / values) @ vectors.T * acting[..., None]
    found: Array = (moved / unit) @ free.T
    return found
