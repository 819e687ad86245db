"""Interface between solvers and mechanisms: arrays and callables, not bodies.

The equations of motion of a constrained mechanical system in relative coordinates::

    q' = N(q) v                               positions q (nq), velocities v (n)
    M(q) v' + h(t, q, v) + J(q)^T lambda = 0  (14) of Bae and Cho 2004, h holds every force but M v'
    Phi(t, q) = 0                             m constraints of cut joints and couplings, J = dPhi/dq N
    J v = nu,  J v' = gamma                   its first and second time derivative

Nonholonomic constraints, such as those of a rolling wheel, restrict velocities only: of these rows J v = nu is given,
Phi is zero everywhere, and J is not its derivative.

Where an orientation is held as a unit quaternion there are four positions for three velocities; then ``N`` is not
square and a change of position is applied by :attr:`System.retract`.

First-order states z with z' = g(t, q, v, z) are the last ``n_states`` entries of v. They have no positions: N has no
rows for them, J has zero columns, M a unit diagonal, and h is -g. Their unit in ``size`` is their nominal value.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.default_callbacks import (
    energy_callbacks,
    mesh_motion_callback,
    outputs_callback,
    parts_callback,
    step_limit_callback,
)
from solvers.extrapolation import StressExtrapolation
from solvers.positions import Positions, place_states, position_sizes

Array = NDArray[np.float64]

MAX_SOLVER_DENSE_COORDINATES = 1000  # coordinates of a large tree with constraints whose matrices the partitions factor
# Entries of the report of an elimination of constraints: number of independent equations, number of those left out,
# shortest independent part of an equation relative to its original length, or smallest pivot, which is at least 0.5,
# so that it decreases without a jump, longest part left out, largest residual left
# out in the same units, and largest residual in units of the constraint equations
RANK, DROPPED, SHORTEST, DROPPED_LENGTH, DROPPED_RESIDUAL, RESIDUAL = range(6)
ELIMINATION_REPORT_SIZE = 6


class Terms(NamedTuple):
    """The terms of the equations at one state; allocated once, filled by :attr:`System.dynamics`.

    Terms that are always zero may remain as allocated.
    """

    qdot: Array  # (nq,)   N(q) v
    M: Array  # (n, n)  mass matrix
    h: Array  # (n,)    bias: inertia at v' = 0 less applied forces
    Phi: Array  # (m,)    constraint residual
    J: Array  # (m, n)  constraint Jacobian with respect to v
    nu: Array  # (m,)    J v = nu
    gamma: Array  # (m,)    J v' = gamma

    @staticmethod
    def allocate(nq: int, n: int, m: int, scalar: type = float) -> Terms:
        """Return zeroed terms for ``nq`` positions, ``n`` velocities and ``m`` constraints."""
        return Terms(*(np.zeros(shape, scalar) for shape in (nq, (n, n), n, m, (m, n), m, m)))

    @staticmethod
    def allocate_constraints(n: int, m: int, scalar: type = float) -> Terms:
        """Return zeroed terms of ``m`` constraints alone: the others have no entries."""
        return Terms(*(np.zeros(shape, scalar) for shape in (0, (0, 0), 0, m, (m, n), m, m)))


def is_never_true() -> bool:
    """Default of a system without work of forces."""
    return False


# A compiled callback can be called from a kernel only; these kernels call one for Python.


@kernel
def _dynamics(function: Any, t: float, q: Array, v: Array, data: Any, terms: Terms) -> None:
    function(t, q, v, data, terms)


@kernel
def _position(function: Any, t: float, q: Array, data: Any, terms: Terms) -> None:
    function(t, q, data, terms)


@kernel
def _retract(function: Any, q: Array, dq: Array, data: Any) -> None:
    function(q, dq, data)


@kernel
def _inverse(
    function: Any, t: float, q: Array, v: Array, a: Array, lam: Array, data: Any, qdot: Array, tau: Array
) -> None:
    function(t, q, v, a, lam, data, qdot, tau)


def no_rows() -> NDArray[np.int64]:
    """Default of a system all of whose constraints restrict positions."""
    return np.zeros(0, np.int64)


def no_step_limit(t: float) -> tuple[float, float]:
    """Default of a system that does not depend on time: no step is too long, at any time."""
    return inf, inf


@dataclass(frozen=True, kw_only=True)
class AnySystem(ABC):
    """Interface of a mechanism for solvers, independent of its size.

    The callables are kernels or callbacks (see :mod:`solvers.compiled.kernel`); ``data`` is whatever named tuple of
    arrays, or array, they need and is passed through untouched. They get pointers to pinned tuples (see
    :mod:`solvers.compiled.tuple_pointer`).
    """

    has_matrices: ClassVar[bool]  # M and J as arrays: what state matrices and partitions are made of

    nq: int
    n: int
    m: int = 0
    data: Any
    position: Callable[[float, Array, Any, Terms], None]  # (t, q, data, terms): fills Phi, J, nu only
    retract: Callable[[Array, Array, Any], None]  # (q, dq, data): q <- q (+) N dq in place, dq (n,)
    power: Callable[..., float] | None = None  # (t, q, v, a, lam, data): dE/dt, W
    evaluate_energy_bound: Callable[..., None] | None = (
        None  # (rtol, place, rate, data, out): see solvers.energy_account
    )
    # (taken, data): longest step after one of ``taken`` in which bodies do not pass places where forces act, s, as they
    # moved when they were evaluated last; None: of any length
    longest_load_step: Callable[[float, Any], float] | None = None
    observe: Callable[..., None] | None = None  # (times, q, v, a, lam, data, out): outputs at solutions, a row each
    works: Callable[[], bool] = is_never_true  # (): whether power can differ from zero, as things are now
    # (t) -> (h_max, t_valid): largest step that resolves the explicitly time-dependent inputs from t on, valid up to
    # t_valid, s
    input_step_limit: Callable[[float], tuple[float, float]] = no_step_limit
    # (n,) unit of each coordinate: 1 rad, or a length of the mechanism in m; of v per second. Nominal value of a state
    size: Array
    n_states: int = 0  # number of first-order states, the last entries of v
    row_size: Array  # (m,) unit of each constraint residual, see size
    nonholonomic: NDArray[np.int64] = field(default_factory=no_rows)  # (k,) rows that restrict velocities only
    positions: Positions | None = None  # which positions are quaternions; None: none is
    rate: float = 0.0  # 1/s, of motions of that size, as far as it is known beforehand: by gravity, by drives
    nonsmooth_reason: str = ""  # why forces change sharply within the tolerance, as where bodies touch; empty: smooth
    stiffness_reason: str = ""  # why explicit solvers are unsuitable; empty: they are suitable
    stick_reason: str = ""  # why explicit solvers need many steps, but are allowed; empty: they do not
    # of each first-order state whether it keeps its start value in steady states; none: they are unknowns
    held_states: tuple[bool, ...] = ()
    coordinate_names: tuple[str, ...] = ()  # (n,)
    constraint_names: tuple[str, ...] = ()  # (m,)
    # coordinates and constraint equations of the model without locked joints: they decide on the formulation
    model_size: tuple[int, int] = (0, 0)
    # (): the equations with their constraints eliminated in O(n), pinned; None: they are solved by matrices only
    elimination: Callable[[], EliminationEquations] | None = None

    @abstractmethod
    def allocate_terms(self) -> Terms:
        """Return zeroed terms of this system's size."""

    @abstractmethod
    def fill(self, t: float, q: Array, v: Array, terms: Terms) -> None:
        """Fill the terms at (t, q, v), as many as the system has."""

    def observe_all(self, times: Array, q: Array, v: Array, a: Array, lam: Array, out: Array) -> None:
        """Fill ``out`` (k, outputs) with the outputs at the solutions at k times, if there are any."""
        if self.observe is not None:
            self.observe(times, q, v, a, lam, self.pinned_data, out)

    @cached_property
    def placed(self) -> Positions:
        """Places of positions and velocities; ValueError if positions are quaternions and ``positions`` is missing."""
        if self.positions is not None:
            return self.positions
        moving = self.n_velocities
        if self.nq != moving:
            raise ValueError(f"a system of {self.nq} positions and {moving} velocities must have its `positions`")
        places = np.arange(moving)
        return Positions(places, places, np.zeros((0, 2), np.int64), self.states)

    @cached_property
    def holonomic(self) -> NDArray[np.int64]:
        """Constraint equations that restrict positions, ascending."""
        return np.setdiff1d(np.arange(self.m), self.nonholonomic)

    @property
    def n_velocities(self) -> int:
        """Number of velocities in v: its entries before the first-order states."""
        return self.n - self.n_states

    @property
    def states(self) -> NDArray[np.int64]:
        """Places of first-order states in v."""
        return place_states(self.n, self.n_states)

    def position_sizes(self, sizes: Array) -> Array:
        """Return sizes of positions (nq,) from those of motions (n,)."""
        found = np.zeros(self.nq)
        position_sizes(pin(self.placed), sizes, found)
        return found

    @cached_property
    def pinned_data(self) -> Any:
        """``data`` as the callbacks get it."""
        return pin(self.data)

    def fill_position(self, t: float, q: Array, terms: Terms) -> None:
        """Fill Phi, J and nu at (t, q)."""
        _position(self.position, t, q, self.pinned_data, pin(terms))

    def apply(self, q: Array, dq: Array) -> None:
        """Change the positions in place by dq (n,): q <- q (+) N dq."""
        _retract(self.retract, q, dq, self.pinned_data)


@dataclass(frozen=True, kw_only=True)
class System(AnySystem):
    """Mechanism by the matrices of its equations of motion.

    ``motion`` may rely on ``position`` having been called last, for the same t and q. If there is nothing to
    gain from that it is ``dynamics``. ``power`` may rely on ``dynamics`` or ``motion`` having been called last for the
    same (t, q, v), ``evaluate_outputs`` and ``evaluate_energy_bound`` too, which leaves nothing ``power`` needs undone.
    """

    has_matrices: ClassVar[bool] = True

    dynamics: Callable[[float, Array, Array, Any, Terms], None]  # (t, q, v, data, terms): fills all terms
    motion: Callable[[float, Array, Array, Any, Terms], None]  # (t, q, v, data, terms): those that position leaves out
    energy: Callable[[float, Array, Array, Any], float]  # (t, q, v, data): kinetic and potential energy, J
    evaluate_outputs: Callable[[Array, Array, Any, Array], None] | None = None  # (a, lam, data, out): of one solution
    # (): the same equations by recursions, for large systems; None: they are solved by matrices only
    recursions: Callable[[], TreeSystem] | None = None
    has_tangent: bool = False  # whether these have a structured tangent, which implicit solvers require
    loop_rate: float = (
        0.0  # 1/s, as ``rate``, of the coordinates in constraints: by gravity and the drives that move it
    )

    def allocate_terms(self, scalar: type = float) -> Terms:
        """Return zeroed terms of this system's size."""
        return Terms.allocate(self.nq, self.n, self.m, scalar)

    def fill(self, t: float, q: Array, v: Array, terms: Terms) -> None:
        """Fill all terms at (t, q, v)."""
        _dynamics(self.dynamics, t, q, v, self.pinned_data, pin(terms))


class Equations(NamedTuple):
    """Callbacks and data of a :class:`System`, and the ``terms`` they fill, as kernels take them."""

    dynamics: Any
    position: Any
    motion: Any
    retract: Any
    energy: Any
    power: Any
    evaluate_energy_bound: Any
    longest_load_step: Any
    evaluate_outputs: Any
    data: Any
    terms: Any

    @staticmethod
    def of(system: System, terms: Terms) -> Any:
        """Return the equations of a system and the terms they are to fill, pinned."""
        s = system
        callbacks = s.dynamics, s.position, s.motion, s.retract, s.energy, *energy_callbacks(s)
        return pin(Equations(*callbacks, step_limit_callback(s), outputs_callback(s), s.pinned_data, pin(terms)))


class TangentCallbacks(NamedTuple):
    """What kernels call of a :class:`Tangent`."""

    # (c1, c2, weight, symmetric, data) -> whether T is regular; weight (m,), zero: T itself
    factor_tangent: Callable[[float, float, Array, bool, Any], bool]
    solve_tangent: Callable[[Array, Any, Array], None]  # (r, data, dq): as Tangent.solve, all (n,)
    multiply_mass_matrix: Callable[[Array, Any, Array], None]  # (a, data, tau): as Tangent.inertia
    tangent: Any  # their data, pinned, with n_factored (1,): how often T has been factored


class EliminationEquations(NamedTuple):
    """Callbacks and data of a system that eliminates its constraints along its structure, as kernels take them.

    In the first three, equations whose independent part is shorter than ``drop``, relative to their original length,
    are left out. They fill a report (ELIMINATION_REPORT_SIZE,).
    """

    # (t, q, v, elimination, drop, loaded, q', v', lam, report) -> code: v', and the multipliers if ``loaded``; not 0: a
    # motion has no inertia
    accelerate: Any
    # (t, q, elimination, drop, closed, dq, report): least change dq (n,), in units of size, that closes the linearized
    # constraints; zero if the largest residual is at most ``closed``
    correct_position: Any
    correct_velocity: Any  # (t, q, v, elimination, drop, dv, report): least change dv (n,) with J (v + dv) = nu
    inverse: Any  # as those of a TreeSystem, as the three that follow
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    longest_load_step: Any
    data: Any
    elimination: Any  # data of the first three, pinned
    in_loops: Array  # (n,) 1: of coordinates that constraints may contain; 0: of others


class Tangent(Protocol):
    """The linearized equations of motion of a tree, T = c2 M + c1 D + K, in a form that is solved in O(n).

    K is the derivative of h + J^T lambda.
    """

    symmetric: bool  # whether T is symmetric up to terms that an outer iteration corrects
    callbacks: TangentCallbacks

    @property
    def factored(self) -> int:
        """Number of factorizations, by which a user of the factors detects that they have changed."""

    @property
    def negative(self) -> int:
        """Number of negative eigenvalues of T, as it was last factored ``averaged``."""

    def factor(
        self, c1: float, c2: float, weight: Array | None = None, symmetric: bool = False, averaged: bool = False
    ) -> bool:
        """Assemble and factor T, or T + J^T weight J, at the last :attr:`TreeSystem.inverse`; False where singular.

        ``symmetric``: T is taken as symmetric, which costs less; an outer iteration must correct the difference.
        ``averaged``: the mean of T and its transpose is factored.
        """

    def solve(self, r: Array) -> Array:
        """Return dq with T dq = r, both (n,) or (n, columns)."""

    def inertia(self, a: Array) -> Array:
        """Return M a (n,)."""


class ComplexStepSystem(NamedTuple):
    """Callbacks of a :class:`TreeSystem` on complex numbers: an imaginary step of the state, however small, leaves the
    derivative along it in the imaginary part, without a difference.
    """

    inverse: Callable[..., None]
    position: Callable[[float, Array, Any, Terms], None]
    retract: Callable[[Array, Array, Any], None]
    data: Any


@dataclass(frozen=True, kw_only=True)
class TreeSystem(AnySystem):
    """A large tree by recursions and a structured tangent: no matrix but J of few constraints.

    q' = N(q) v,   M v' + h + J^T lambda = 0,   given as inverse and, without J, as forward dynamics. ``power`` may rely
    on either having been called last for the same (t, q, v, a, lam), ``evaluate_energy_bound`` on inverse for a = 0 and
    lambda = 0.
    """

    has_matrices: ClassVar[bool] = False

    inverse: Callable[..., None]  # (t, q, v, a, lam, data, q', tau): fills N v and tau = M a + h + J^T lambda
    forward: Callable[[float, Array, Array, Any, Array, Array], int]  # (t, q, v, data, q', v'); not 0: no inertia
    mobility: Callable[[Array, Any, Array], None]  # (r, data, x): x = M^-1 r where forward was called for last
    constraints: Callable[[float, Array, Array, Any, Terms], None]  # (t, q, v, data, terms): Phi, J, nu and gamma
    make_tangent: Callable[[], Tangent]
    # (): in place of the tangent for solvers that factor none; None: the tangent
    make_missing_tangent: Callable[[], Tangent] | None = None
    positions: Positions
    dense: Callable[[], System] | None = None  # (): the same mechanism with its matrices
    complex_step: Callable[[], ComplexStepSystem] | None = None  # (): the same on complex numbers
    mesh_mask: NDArray[np.bool_] | None = None  # (n,) coordinates of which a mesh has many like them; None: all
    mesh_motion: Callable[..., None] | None = None  # (dq, mask, data, out): largest displacement (m) and rotation (rad)
    # of nodes of meshes by dq (n,), at the last position; a mask (n,) is 1 at the coordinates of nodes
    mesh_length: float = 0.0  # m, of the largest mesh, by which these displacements are measured; 0: there is none
    friction_velocity: Array | None = None  # (n,) rates at which friction turns over; infinite: at none
    inertia_parts: Callable[..., None] | None = None  # (data, out): v . M v and the diagonal of M where inverse or
    # forward was called for last; it may overwrite their results
    stress_extrapolation: StressExtrapolation | None = None  # None: no element has strains
    moves: Callable[[], bool] = is_never_true  # (): whether drives move: then inertia forces change with the positions

    @cached_property
    def tangent(self) -> Tangent:
        """The linearized equations, which only solvers need."""
        return self.make_tangent()

    def without_tangent(self) -> TreeSystem:
        """Return the system for explicit solvers: the tangent is not made, which may be refused for its size."""
        return self if self.make_missing_tangent is None else replace(self, make_tangent=self.make_missing_tangent)

    @cached_property
    def equations(self) -> Any:
        """A :class:`TreeEquations`, pinned."""
        callbacks = self.forward, self.inverse, self.retract, *energy_callbacks(self), step_limit_callback(self)
        motions = parts_callback(self), mesh_motion_callback(self), self.mobility
        constraints = self.constraints, self.position
        return pin(TreeEquations(*callbacks, *motions, *constraints, self.pinned_data, *self.tangent.callbacks))

    @property
    def can_compute_rate_growth(self) -> bool:
        """Whether the rate growth can be computed, see :mod:`solvers.inertia`: not with loops, and not in meshes."""
        return self.inertia_parts is not None and not self.m and not (self.mesh_mask is None or self.mesh_mask.any())

    def allocate_terms(self, scalar: type = float) -> Terms:
        """Return zeroed terms; those of the constraints are the only ones a tree fills, and M has no entries."""
        return Terms.allocate_constraints(self.n, self.m, scalar)

    def fill(self, t: float, q: Array, v: Array, terms: Terms) -> None:
        """Fill Phi, J, nu and gamma at (t, q, v)."""
        _dynamics(self.constraints, t, q, v, self.pinned_data, pin(terms))

    def residual(self, t: float, q: Array, v: Array, a: Array, lam: Array | None = None) -> Array:
        """Return M a + h + J^T lambda (n,)."""
        qdot, tau = np.zeros(self.nq), np.zeros(self.n)
        loaded = np.zeros(self.m) if lam is None else lam
        _inverse(self.inverse, t, q, v, a, loaded, self.pinned_data, qdot, tau)
        return tau


class TreeEquations(NamedTuple):
    """Callbacks and data of a :class:`TreeSystem`, as kernels take them."""

    forward: Any
    inverse: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    longest_load_step: Any
    inertia_parts: Any
    mesh_motion: Any
    mobility: Any
    constraints: Any
    position: Any
    data: Any
    factor_tangent: Any  # see TangentCallbacks
    solve_tangent: Any
    multiply_mass_matrix: Any
    tangent: Any
