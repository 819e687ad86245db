"""The formulation of mechanisms whose constraints are eliminated along their structure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales, update_energy_bound
from solvers.options import Options
from solvers.outcome import CODES, OK, Code
from solvers.projection.eliminated import (
    CLOSED_RESIDUAL,
    REDUNDANT_LENGTH,
    EliminationScratch,
    find_normal_rank,
    project,
    shortest_of,
)
from solvers.projection.eliminated_crossing import UNRESOLVED_LENGTH, evaluate_closed
from solvers.stepper import require_resolution, start_rate
from solvers.system import AnySystem, Array, EliminationEquations

from .formulation import Formulation
from .tree import RATE_TOLERANCE_RATIO


@kernel
def compute_eliminated_power(
    eqs: EliminationEquations, t: float, q: Array, v: Array, a: Array, lam: Array, work: EliminationScratch
) -> float:
    """W' at a state with accelerations a (n,) and multipliers lam (m,), W; this costs an inverse dynamics."""
    eqs.inverse(t, q, v, a, lam, eqs.data, work.qdot_near, work.tau)
    return float(eqs.power(t, q, v, a, lam, eqs.data))


@kernel
def record_eliminated_energy(
    eqs: EliminationEquations, t: float, q: Array, v: Array, accounts: Any, scales: EnergyScales,
    work: EliminationScratch,
) -> None:  # fmt: skip
    """Update the energy bound at a state; this costs an inverse dynamics."""
    eqs.inverse(t, q, v, work.zero, work.zero_lam, eqs.data, work.qdot_near, work.tau)
    update_energy_bound(eqs.evaluate_energy_bound, eqs.data, accounts[0], scales)


@kernel
def begin_motion(eqs: EliminationEquations, t: float, q: Array, v: Array, work: EliminationScratch) -> int:
    """Project the initial state, and find the number of independent equations; return a code."""
    code = project(eqs, t, q, v, CLOSED_RESIDUAL, work)
    if code == OK:
        work.near[0].rank = find_normal_rank(eqs, t, q, v, work)
        eqs.correct_position(t, q, eqs.elimination, REDUNDANT_LENGTH, -1.0, work.change, work.report)
        work.near[0].shortest = shortest_of(work.report, work.near[0].rank)
    return code


class EliminatedFormulation(Formulation):
    """The equations of motion with eliminated constraints."""

    def __init__(self, system: AnySystem, t: float, q: Array, v: Array, options: Options) -> None:
        super().__init__(system)
        assert system.elimination is not None  # else another formulation is used
        self.equations = system.elimination()
        self._scratch = EliminationScratch.allocate(system.nq, system.n, system.m, system.placed)
        self._scratch.size[:] = system.size
        self.position_units = self._scratch.size_q
        self.position_units[:] = system.position_sizes(system.size)
        self.work = pin(self._scratch)
        self.status = CODES[begin_motion(self.equations, t, q, v, self.work)]
        self.rank = int(self._scratch.near[0]["rank"])
        self.starts_singular = self.status is Code.OK and self._is_unresolved(UNRESOLVED_LENGTH)
        self.rate = self._find_rate(t, q, v, options.duration)
        require_resolution(t, self.rate, q, self.position_units, options.rtol, system.coordinate_names)
        self._scratch.coordinate_rates[:] = RATE_TOLERANCE_RATIO * self.rate
        self.rate_units = self._scratch.coordinate_rates * system.size

    def _find_rate(self, t: float, q: Array, v: Array, duration: float) -> float:
        """Return the rate of the motion, 1/s: by gravity and drives, or if there are none as it starts."""
        known = self.system.rate
        if known > 0.0:
            return float(start_rate(known, duration, self.system.size, v[:0], v[:0]))
        a = self.a if self.status is Code.OK and self.evaluate(t, q, v) is Code.OK else np.zeros(self.system.n)
        return float(start_rate(known, duration, self.system.size, v, a))

    def energy_scales(self, options: Options) -> EnergyScales:
        """As :meth:`solvers.steppers.formulation.Formulation.energy_scales`."""
        system, absolute = self.system, options.absolute
        return EnergyScales.of(options.rtol, absolute * system.size, absolute * self.rate_units)

    def evaluate(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.evaluate`."""
        return CODES[evaluate_closed(self.equations, t, q, v, True, self.work, self.qdot, self.a, self.lam)]

    def power(self, t: float, q: Array, v: Array) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.power`."""
        return float(compute_eliminated_power(self.equations, t, q, v, self.a, self.lam, self.work))

    def _is_unresolved(self, length: float) -> bool:
        """Whether the shortest equation where it was evaluated last is no longer than that."""
        return self.rank > 0 and bool(self._scratch.near[0]["shortest"] <= length)

    def has_unresolved_forces(self, rtol: float) -> bool:
        """As :meth:`solvers.steppers.formulation.Formulation.has_unresolved_forces`."""
        return self._is_unresolved(max(UNRESOLVED_LENGTH, rtol))

    def project(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.project`."""
        return CODES[project(self.equations, t, q, v, CLOSED_RESIDUAL, self.work)]

    def tolerance_scale(self, rtol: float, exponent: float) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.tolerance_scale`: a sum of squares."""
        return 1.0

    def record_energy(self, t: float, q: Array, v: Array, accounts: Any, scales: Any, is_scheduled: bool) -> None:
        """As :meth:`solvers.steppers.formulation.Formulation.record_energy`; this costs an inverse dynamics."""
        if is_scheduled:
            record_eliminated_energy(self.equations, t, q, v, accounts, scales, self.work)

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return self.system.n - self.rank

    def growth(self) -> NDArray[Any]:
        """As :meth:`solvers.steppers.formulation.Formulation.growth`: it is not computed in loops."""
        return self._scratch.inertia

    def memory(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.steppers.formulation.Formulation.memory`."""
        return self._scratch.memory()
