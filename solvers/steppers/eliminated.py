"""The formulation of mechanisms whose constraints are eliminated along their structure."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from numpy.typing import NDArray

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales, update_energy_bound
from solvers.options import Options
from solvers.outcome import CODES, OK, Code
from solvers.positions import count_velocities, position_sizes, set_coordinate_rates
from solvers.projection.eliminated import (
    CLOSED_RESIDUAL,
    REDUNDANT_LENGTH,
    EliminationScratch,
    find_normal_rank,
    find_position_correction,
    largest_distance,
    project,
    shortest_of,
)
from solvers.projection.eliminated_crossing import UNRESOLVED_LENGTH, evaluate_closed
from solvers.projection.singular import BIFURCATION, IMPERFECT
from solvers.resolution import require_resolution, start_rate
from solvers.system import AnySystem, Array, EliminationEquations, Tangent

from .formulation import Formulation
from .step_control import set_near_miss_factor
from .tree import RATE_TOLERANCE_RATIO

MIN_CROSSING_RTOL = 1e-8  # near a crossing: of many loops at once, accelerations have larger rounding errors there
NEAR_MISS_ERROR_RATIO = 3e-3  # largest error of a step near a near miss, in distances from it


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
    position_sizes(work.positions, work.size, work.size_q)
    code = project(eqs, t, q, v, CLOSED_RESIDUAL, work)
    if code == OK:
        work.near[0].rank = find_normal_rank(eqs, t, q, v, work)
        find_position_correction(eqs, t, q, REDUNDANT_LENGTH, -1.0, work)
        work.near[0].shortest = shortest_of(work.report, work.near[0].rank)
    return code


@kernel
def find_rate(
    eqs: EliminationEquations, t: float, q: Array, v: Array, is_closed: bool, known: float, duration: float,
    work: EliminationScratch,
) -> float:  # fmt: skip
    """Rate of the motion, 1/s, which tolerances of rates are made of: by gravity and drives, which is ``known``, or if
    there are none as it starts at (t, q, v) in a run of ``duration`` (s).
    """
    moving = count_velocities(work.positions, v.shape[0])
    if known > 0.0:
        rate = start_rate(known, duration, work.size, v[:0], v[:0])
    else:
        if not is_closed or evaluate_closed(eqs, t, q, v, True, work, work.qdot, work.a, work.lam) != OK:
            for i in range(work.a.shape[0]):
                work.a[i] = 0.0
        rate = start_rate(known, duration, work.size, v[:moving], work.a)
    set_coordinate_rates(work.positions, RATE_TOLERANCE_RATIO * rate, work.coordinate_rates)
    return rate


@inlined
def tolerance_scale(record: Any, settings: Any, q: Any, loops: Any) -> float:
    """Factor of the tolerances at positions q (nq,): near a near miss errors must be smaller than the distance of the
    branches, as far as rounding allows, and near a crossing they need not be smaller than it allows. What rounding
    requires is recorded in ``record`` (see :func:`.step_control.set_near_miss_factor`).
    """
    near, scale = loops.near[0], 1.0
    set_near_miss_factor(record, settings.rtol, near.kind, near.gap)
    if near.kind == BIFURCATION and settings.rtol < MIN_CROSSING_RTOL:
        record.near_miss_factor = MIN_CROSSING_RTOL / settings.rtol
        record.max_near_miss_factor = max(record.max_near_miss_factor, record.near_miss_factor)
    if near.kind == IMPERFECT:
        far = max(near.accepted, largest_distance(loops.q_c, q, loops.size_q))
        scale = min(1.0, NEAR_MISS_ERROR_RATIO * far / max(settings.rtol, settings.atol))
    return max(scale, record.near_miss_factor)


@kernel
def is_unresolved(length: float, work: EliminationScratch) -> bool:
    """Whether the shortest equation where it was evaluated last is no longer than that."""
    return work.near[0].rank > 0 and work.near[0].shortest <= length


@runtime_checkable
class ImplicitElimination(Protocol):
    """What :attr:`solvers.system.AnySystem.elimination` must be for implicit methods."""

    def __call__(self) -> EliminationEquations:
        """Return the equations with eliminated constraints, pinned."""

    def tangent(self) -> Tangent:
        """Return the structured tangent of the same mechanism."""


class EliminatedFormulation(Formulation):
    """The equations of motion with eliminated constraints."""

    def __init__(self, system: AnySystem, t: float, q: Array, v: Array, options: Options) -> None:
        super().__init__(system)
        assert system.elimination is not None  # else another formulation is used
        self.equations = system.elimination()
        self._scratch = EliminationScratch.allocate(system.nq, system.n, system.m, system.placed)
        self._scratch.size[:] = system.size
        self.position_units, self.work = self._scratch.size_q, pin(self._scratch)
        self.status = CODES[begin_motion(self.equations, t, q, v, self.work)]
        self.rank, closed = int(self._scratch.near[0]["rank"]), self.status is Code.OK
        self.starts_singular = closed and bool(is_unresolved(UNRESOLVED_LENGTH, self.work))
        known = system.rate, options.duration
        self.rate = float(find_rate(self.equations, t, q, v, closed, *known, self.work))
        require_resolution(t, self.rate, q, self.position_units, options.rtol, system.coordinate_names)
        self.rate_units = self._scratch.coordinate_rates * system.size

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

    def has_unresolved_forces(self, rtol: float) -> bool:
        """As :meth:`solvers.steppers.formulation.Formulation.has_unresolved_forces`."""
        return bool(is_unresolved(max(UNRESOLVED_LENGTH, rtol), self.work))

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
        return self.system.n_velocities - self.rank

    def growth(self) -> NDArray[Any]:
        """As :meth:`solvers.steppers.formulation.Formulation.growth`: it is not computed in loops."""
        return self._scratch.inertia

    def memory(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.steppers.formulation.Formulation.memory`."""
        return self._scratch.memory()
