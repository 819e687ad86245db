"""The formulation by recursions: large trees, with constraints or without."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales, update_energy_bound
from solvers.inertia import InertiaRecord, tolerance_factor, update_tree_growth
from solvers.options import Options
from solvers.outcome import Code
from solvers.positions import Positions, set_coordinate_rates
from solvers.projection.saddle import Accelerations, count_freedom, motion_rate, project
from solvers.resolution import require_resolution
from solvers.system import Array, TreeEquations, TreeSystem

from .formulation import Formulation

if TYPE_CHECKING:
    from solvers.compiled.record import Reals, Table

# Absolute tolerance of a rate to that of its coordinate, in units of the motion's rate. A tighter one than IDA's costs
# nothing if stability limits the step, and a looser one lets the fastest modes grow.
RATE_TOLERANCE_RATIO = 1.5


class TreeScratch(NamedTuple):
    """Units, a state, its rates, and arguments of inverse dynamics.

    Only the units and :meth:`memory` are needed after a call.
    """

    positions: Any  # solvers.positions.Positions
    size: Array  # (n,)   units of the coordinates
    size_q: Array  # (nq,)  units of the positions
    coordinate_rates: Array  # (n,)   1/s, that of the motion, as the tolerances of rates take it
    q: Array  # (nq,)
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    zero: Array  # (n,)
    lam: Array  # (m,)   zero
    parts: Array  # (1 + n,) see solvers.system.TreeSystem.inertia_parts
    inertia: Table[InertiaRecord]  # (1,)

    @staticmethod
    def allocate(nq: int, n: int, positions: Positions, m: int = 0) -> TreeScratch:
        """Return zeroed arrays."""
        sizes = n, nq, n, nq, n, n, nq, n, m, 1 + n
        return TreeScratch._make((positions, *(np.zeros(size) for size in sizes), InertiaRecord.zeros(1)))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that are needed to continue a motion."""
        return [self.inertia, self.coordinate_rates]


@kernel
def compute_tree_power(
    eqs: TreeEquations, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, scratch: TreeScratch
) -> float:
    """W' at a state with accelerations a (n,) and multipliers lam (m,), W; this costs an inverse dynamics."""
    eqs.inverse(t, q, v, a, lam, eqs.data, scratch.qdot, scratch.a)
    return eqs.power(t, q, v, a, lam, eqs.data)


@kernel
def record_tree_energy(
    eqs: TreeEquations,
    t: float,
    q: Reals,
    v: Reals,
    accounts: Any,
    scales: EnergyScales,
    is_scheduled: bool,
    scratch: TreeScratch,
) -> None:
    """Update the rate growth if it is watched, and if ``is_scheduled`` the energy bound, at (t, q, v)."""
    is_watched = scratch.inertia[0].watched == 1
    if is_scheduled or is_watched:
        eqs.inverse(t, q, v, scratch.zero, scratch.lam, eqs.data, scratch.qdot, scratch.a)
    if is_scheduled:
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, accounts[0], scales)
    if is_watched:
        eqs.inertia_parts(eqs.data, scratch.parts)
        update_tree_growth(t, scratch.parts, v, scratch)


@kernel
def tree_growth_factor(rtol: float, exponent: float, scratch: Any) -> float:
    """:func:`solvers.inertia.tolerance_factor` for Python."""
    return tolerance_factor(rtol, exponent, scratch)


class TreeFormulation(Formulation):
    """The equations of motion of a large tree by its recursions."""

    system: TreeSystem

    def __init__(self, system: TreeSystem, t: float, q: Array, v: Array, options: Options) -> None:
        super().__init__(system)
        self._motion, self.equations = Accelerations(system), system.equations
        self.rate = motion_rate(self._motion, t, q, v, options.duration)
        self.position_units = system.position_sizes(system.size)
        require_resolution(t, self.rate, q, self.position_units, options.rtol, system.coordinate_names)
        self._scratch = TreeScratch.allocate(system.nq, system.n, system.positions, system.m)
        self._scratch.size[:], self._scratch.size_q[:] = system.size, self.position_units
        set_coordinate_rates(pin(system.positions), RATE_TOLERANCE_RATIO * self.rate, self._scratch.coordinate_rates)
        self.rate_units = self._scratch.coordinate_rates * system.size
        self._scratch.inertia["watched"] = system.can_compute_rate_growth
        self.work = pin(self._scratch)
        self.rank = system.m
        self._t, self._q = t, q
        self.status = project(system, t, q, v)

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
        return float(compute_tree_power(self.equations, t, q, v, self.a, self.lam, self.work))

    def project(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.project`."""
        self.system.apply(q, np.zeros(self.system.n))
        return project(self.system, t, q, v)

    def tolerance_scale(self, rtol: float, exponent: float) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.tolerance_scale`: a root mean square in meshes, which have
        many coordinates of a kind.
        """
        if self.system.can_compute_rate_growth:
            return float(tree_growth_factor(rtol, exponent, self.work))
        return float(np.sqrt(self.system.nq + self.system.n))

    def record_energy(self, t: float, q: Array, v: Array, accounts: Any, scales: Any, is_scheduled: bool) -> None:
        """As :meth:`solvers.steppers.formulation.Formulation.record_energy`; this costs an inverse dynamics."""
        record_tree_energy(self.equations, t, q, v, accounts, scales, is_scheduled, self.work)

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def growth(self) -> NDArray[Any]:
        """As :meth:`solvers.steppers.formulation.Formulation.growth`."""
        return self._scratch.inertia

    def memory(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.steppers.formulation.Formulation.memory`."""
        return self._scratch.memory()
