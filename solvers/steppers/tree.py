"""The formulation by recursions: large trees, with constraints or without."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales, update_energy_bound
from solvers.inertia import Growth, tolerance_factor, update_tree_growth
from solvers.options import Options
from solvers.outcome import Code
from solvers.projection.saddle import Accelerations, count_freedom, motion_rate, project
from solvers.stepper import require_resolved_position, require_resolved_time
from solvers.system import Array, TreeSystem, energy_callbacks

from .formulation import Formulation

# Absolute tolerance of a rate to that of its coordinate, in units of the motion's rate: where stability limits the
# steps of an explicit method, a looser one lets the fastest modes grow.
RATE_TOLERANCE_RATIO = 1.5


class Callbacks(NamedTuple):
    """What the kernels call."""

    inverse: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    inertia_parts: Any
    data: Any

    @staticmethod
    def of(system: TreeSystem) -> Any:
        """Return the callbacks of a system, pinned."""
        callbacks = system.inverse, system.retract, *energy_callbacks(system), system.parts_callback
        return pin(Callbacks(*callbacks, system.pinned_data))


class Scratch(NamedTuple):
    """Results and arguments of inverse dynamics."""

    zero: Array  # (n,)
    no_multipliers: Array  # (m,) zero
    qdot: Array  # (nq,)
    tau: Array  # (n,)


@kernel
def compute_tree_power(eqs: Any, t: float, q: Any, v: Any, a: Any, lam: Any, scratch: Any) -> float:
    """W' at a state with accelerations a (n,) and multipliers lam (m,), W; this costs an inverse dynamics."""
    eqs.inverse(t, q, v, a, lam, eqs.data, scratch.qdot, scratch.tau)
    return eqs.power(t, q, v, a, lam, eqs.data)


@kernel
def record_tree_energy(
    eqs: Any, t: float, q: Any, v: Any, accounts: Any, scales: Any, is_scheduled: bool, growth: Any, scratch: Any
) -> None:
    """Update the rate growth if it is watched, and if ``is_scheduled`` the energy bound, at (t, q, v)."""
    is_watched = growth.inertia[0].watched == 1
    if is_scheduled or is_watched:
        eqs.inverse(t, q, v, scratch.zero, scratch.no_multipliers, eqs.data, scratch.qdot, scratch.tau)
    if is_scheduled:
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, accounts[0], scales)
    if is_watched:
        eqs.inertia_parts(eqs.data, growth.parts)
        update_tree_growth(t, growth.parts, v, growth)


@kernel
def tree_growth_factor(rtol: float, exponent: float, growth: Any) -> float:
    """:func:`solvers.inertia.tolerance_factor` for Python."""
    return tolerance_factor(rtol, exponent, growth)


class TreeFormulation(Formulation):
    """The equations of motion of a large tree by its recursions."""

    system: TreeSystem

    def __init__(self, system: TreeSystem, t: float, q: Array, v: Array, options: Options) -> None:
        super().__init__(system)
        self._motion, self._eqs = Accelerations(system), Callbacks.of(system)
        self.rate = motion_rate(self._motion, t, q, v, options.duration)
        require_resolved_time(t, self.rate, options.rtol)
        self.position_units = system.position_sizes(system.size)
        require_resolved_position(q, self.position_units, options.rtol, system.coordinate_names)
        self.rate_units = RATE_TOLERANCE_RATIO * self.rate * system.size
        self._growth = Growth.of(system, self.rate)
        z = np.zeros
        self._pinned_growth = pin(self._growth)
        self._scratch = pin(Scratch(z(system.n), z(system.m), z(system.nq), z(system.n)))
        self.rank = system.m
        self._t, self._q = t, q
        self.status = self.project(t, q, v)

    def energy_scales(self, options: Options) -> EnergyScales:
        """As :meth:`solvers.steppers.formulation.Formulation.energy_scales`."""
        system, absolute = self.system, options.absolute
        count = 1 if system.can_compute_rate_growth else system.nq + system.n
        return EnergyScales.of(options.rtol, absolute * system.size, absolute * self.rate_units, count)

    def evaluate(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.evaluate`."""
        code = self._motion.solve(t, q, v)
        self.qdot, self.a, self.lam = self._motion.qdot, self._motion.a, self._motion.lam
        return code

    def power(self, t: float, q: Array, v: Array) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.power`."""
        if not self.system.m:
            return super().power(t, q, v)
        return float(compute_tree_power(self._eqs, t, q, v, self.a, self.lam, self._scratch))

    def project(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.project`."""
        self.system.apply(q, np.zeros(self.system.n))
        return project(self.system, t, q, v)

    def tolerance_scale(self, rtol: float, exponent: float) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.tolerance_scale`: a root mean square in meshes, which have
        many coordinates of a kind.
        """
        if self.system.can_compute_rate_growth:
            return float(tree_growth_factor(rtol, exponent, self._pinned_growth))
        return float(np.sqrt(self.system.nq + self.system.n))

    def record_energy(self, t: float, q: Array, v: Array, accounts: Any, scales: Any, is_scheduled: bool) -> None:
        """As :meth:`solvers.steppers.formulation.Formulation.record_energy`; this costs an inverse dynamics."""
        record_tree_energy(self._eqs, t, q, v, accounts, scales, is_scheduled, self._pinned_growth, self._scratch)

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def growth(self) -> NDArray[Any]:
        """As :meth:`solvers.steppers.formulation.Formulation.growth`."""
        return self._growth.inertia

    def memory(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.steppers.formulation.Formulation.memory`."""
        return [self._growth.inertia]
