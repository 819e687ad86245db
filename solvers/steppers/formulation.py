"""A formulation: the equations of motion of a system as a one-step method in Python requires them.

    q' = N(q) v,   v' = a(t, q, v),   W' = P(t, q, v, v', lambda)

with accelerations that are tangent to the constraints (:mod:`solvers.projection.projection`), so that a method for
ordinary differential equations applies. The end of every step is projected onto the constraints. W is the work of all
forces without a potential (:mod:`solvers.energy_account`).

There are two formulations: :class:`solvers.steppers.dense.DenseFormulation` factors the matrices of small mechanisms,
:class:`solvers.steppers.tree.TreeFormulation` calls the recursions of large ones.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.energy_account import EnergyScales, add_energy_error_bound
from solvers.options import Options
from solvers.outcome import Code
from solvers.system import AnySystem, Array, System, TreeSystem


@kernel
def compute_power(eqs: Any, t: float, q: Array, v: Array, a: Array, lam: Array) -> float:
    """W' at the state that was evaluated last, W."""
    return eqs.power(t, q, v, a, lam, eqs.data)


@kernel
def record_work(accounts: Any, done: float, error: float, taken: float) -> None:
    """Record the work of a step of ``taken`` (s), J, and its estimated error, J. accounts (1,) with ACCOUNT_FIELDS."""
    account = accounts[0]
    account.work_total_variation += abs(done)
    add_energy_error_bound(account, error, taken)


class Formulation(ABC):
    """Equations of motion, constraints and energy of one system.

    Attributes
    ----------
    qdot, a, lam
        N v (nq,), v' (n,) and lambda (m,) of the state that was evaluated last.
    equations, work
        Callbacks with ``power`` and ``data``, and scratch, as kernels take them (pinned).
    rate
        Rate of the motion, 1/s.
    position_units, rate_units
        What the absolute tolerances of q (nq,) and v (n,) are measured in.
    status
        Result of the projection of the initial state.
    starts_singular
        Whether the initial state is a singular configuration.
    rank
        Number of independent constraints.
    """

    rate: float
    position_units: Array
    rate_units: Array
    status: Code
    starts_singular: bool = False
    rank: int
    equations: Any
    work: Any

    def __init__(self, system: AnySystem) -> None:
        self.system = system
        self.qdot, self.a, self.lam = np.zeros(system.nq), np.zeros(system.n), np.zeros(system.m)

    @abstractmethod
    def evaluate(self, t: float, q: Array, v: Array) -> Code:
        """Evaluate :attr:`qdot`, :attr:`a` and :attr:`lam` at a state on the constraints."""

    def evaluate_stage(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`evaluate`, at a state off the constraints, which may be changed in place."""
        return self.evaluate(t, q, v)

    def power(self, t: float, q: Array, v: Array) -> float:
        """Return W' at the state that was evaluated last, W."""
        return float(compute_power(self.equations, t, q, v, self.a, self.lam))

    @abstractmethod
    def project(self, t: float, q: Array, v: Array) -> Code:
        """Project a state onto the constraints in place, and quaternions to unit length."""

    @abstractmethod
    def tolerance_scale(self, rtol: float, exponent: float) -> float:
        """Return the factor of all tolerances in the norm of the error, the root of the sum of squares.

        ``rtol`` is the relative tolerance of a step, as the tolerance of the motion to the ``exponent``.
        """

    @abstractmethod
    def energy_scales(self, options: Options) -> EnergyScales:
        """Return the tolerances and scales of the energy bound."""

    @abstractmethod
    def record_energy(self, t: float, q: Array, v: Array, accounts: Any, scales: Any, is_scheduled: bool) -> None:
        """Update rate growth at the state that was evaluated last, and if ``is_scheduled`` the energy bound.

        accounts (1,) with ACCOUNT_FIELDS; scales as :meth:`energy_scales`, pinned.
        """

    def is_on_branch(self, t: float, q: Array) -> bool:
        """Whether a step to the state that was projected last has stayed on its branch of the motion."""
        return True

    def record_step(self, t: float, q: Array, v: Array, taken: float, following: float) -> float:
        """Record the end of a step of ``taken`` (s), evaluated last; return the longest next step, s.

        ``following`` is the step that accuracy allows next, s. A step of 0 s: the motion starts here.
        """
        return np.inf

    def has_unresolved_forces(self, rtol: float) -> bool:
        """Whether the forces that were evaluated last are not resolved."""
        return False

    @property
    @abstractmethod
    def freedom(self) -> int:
        """Largest number of degrees of freedom."""

    @abstractmethod
    def growth(self) -> NDArray[Any]:
        """Return the record (1,) of the rate growth, see :mod:`solvers.inertia`."""

    @abstractmethod
    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that are needed to continue a motion."""


def formulate(system: AnySystem, t: float, q: Array, v: Array, options: Options) -> Formulation:
    """Return the formulation of a system, and project its initial state (q, v) onto the constraints in place.

    Raises
    ------
    ValueError
        Time or positions are too large for the tolerance.
    """
    from .dense import DenseFormulation
    from .tree import TreeFormulation

    if isinstance(system, TreeSystem):
        return TreeFormulation(system, t, q, v, options)
    assert isinstance(system, System)  # there is no third kind
    return DenseFormulation(system, t, q, v, options)
