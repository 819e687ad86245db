"""The formulation by matrices: a partition's workspace, its rank, its rates; and what all steppers on it share."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import COMPILED, kernel
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import EnergyScales, set_energy_scales, update_energy_bound
from solvers.inertia import tolerance_factor, update_growth
from solvers.options import Options
from solvers.outcome import CODES, OK, Code
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.projection import (
    evaluate_acceleration,
    evaluate_multipliers,
    is_near_bifurcation,
    project,
)
from solvers.projection.rank import find_normal_rank
from solvers.projection.reported import evaluate_state, has_unresolved_forces
from solvers.projection.singular import (
    BIFURCATION,
    IMPERFECT,
    NO_CRITICAL_POINT,
    branch_step_limit,
    classify_singularity,
    record_accepted,
)
from solvers.projection.workspace import Workspace, count_motions, evaluate_and_factor, factor
from solvers.resolution import coordinate_rate, require_resolution, start_rate
from solvers.stepper import Stepper
from solvers.system import Array, Equations, System, Terms

from .formulation import Formulation

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

# The characteristic rate of a coordinate is the first part of its rate at the start, which exceeds that of a small
# oscillation by the root of its amplitude; it is at least the second part of the rate of the motion, since a coordinate
# at rest may move later.
INITIAL_RATE_RATIO, MIN_RATE_RATIO = 0.1, 0.01
RANK_LOSS_RATIO = 1e-9  # singular value of J~, relative to the largest, below which a start takes no rate from it


@kernel
def classify_nearest_singularity(eqs: Equations, t: float, q: Reals, rank: int, work: Workspace) -> int:
    """Class of the singular configuration next to q; see :func:`solvers.projection.singular.classify_singularity`."""
    eqs.position(t, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return classify_singularity(eqs, t, q, rank, work)


@kernel
def estimate_rates(
    eqs: Equations,
    t: float,
    q: Reals,
    v: Reals,
    rank: int,
    known: float,
    loop_rate: float,
    duration: float,
    work: Workspace,
) -> None:
    """Note the rate of the motion (1/s, see :func:`solvers.resolution.start_rate`), and of every coordinate's own part
    in it: a stiff spring at one of them is not to make the others' tolerances coarse.

    First-order states have no part in it, however fast they are: their tolerances follow from their nominal values.
    """
    if evaluate_state(eqs, t, q, v, rank, work, work.slope, work.lam) != OK:
        for k in range(v.shape[0]):
            work.slope[k] = 0.0
    moving = count_motions(work)
    rate = start_rate(known, duration, work.size, v[:moving], work.slope)
    for k in range(moving):
        work.coordinate_rates[k] = coordinate_rate(work.size[k], v[k], work.slope[k])
        loop_rate = max(loop_rate, work.coordinate_rates[k] * work.in_loops[k])
    work.rate[0], work.rate[1] = rate, loop_rate if loop_rate != 0.0 else rate
    for k in range(moving):
        work.coordinate_rates[k] = max(INITIAL_RATE_RATIO * work.coordinate_rates[k], MIN_RATE_RATIO * rate)
    for k in range(moving, v.shape[0]):
        work.coordinate_rates[k] = 1.0  # the absolute tolerance is that of the nominal value


@kernel
def evaluate_stage(
    eqs: Equations, t: float, q: Reals, v: Reals, rank: int, work: Workspace, a: Reals, lam: Reals
) -> int:
    """Accelerations and shortest multipliers at a state that need not be closed; leaves ``terms`` there.

    Near a crossing it is closed first: v' of a state off the constraints is wrong by the inverse square of its pivot.
    """
    evaluate_and_factor(eqs, t, q, v, work)
    if is_near_bifurcation(rank, work):
        code = project(eqs, t, q, v, rank, work)
        if code != OK:
            return code
    code = evaluate_acceleration(eqs, t, q, v, rank, work, a)
    if code == OK:
        evaluate_multipliers(eqs.terms, rank, work, a, lam)
    return code


@kernel
def record_dense_energy(
    eqs: Equations, t: float, v: Reals, accounts: Any, scales: EnergyScales, is_scheduled: bool, work: Workspace
) -> None:
    """Update rate growth, and if ``is_scheduled`` the energy bound, at the state evaluated last."""
    update_growth(t, eqs.terms.M, v, work)
    if is_scheduled:
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, accounts[0], scales)


@kernel
def record_dense_step(
    eqs: Equations, t: float, q: Reals, v: Reals, taken: float, following: float, rank: int, work: Workspace
) -> float:
    """Record an accepted position, evaluated last, after a step of ``taken`` (s; 0: the first one); return the longest
    next step, s.
    """
    if taken == 0.0:
        work.branch_history[0].pivot_ratio = 0.0
    record_accepted(eqs, t, q, taken, following, rank, work)
    if taken == 0.0:
        return np.inf
    longest: float = min(branch_step_limit(t, q, v, taken, eqs.terms, work), eqs.longest_load_step(taken, eqs.data))
    return longest


@kernel
def growth_factor(rtol: float, exponent: float, work: Workspace) -> float:
    """:func:`solvers.inertia.tolerance_factor` for Python."""
    return tolerance_factor(rtol, exponent, work)


class DenseFormulation(Formulation):
    """The equations of motion by their matrices: small mechanisms, with or without constraints.

    Attributes
    ----------
    equations, terms
        Callbacks, pinned :class:`solvers.system.Equations`, and the terms they fill.
    work, workspace
        A :class:`Workspace`, pinned for kernels, and for Python.
    """

    system: System

    def __init__(self, system: System, t: float, q: Array, v: Array, options: Options) -> None:
        super().__init__(system)
        sizes = system.nq, system.n, system.m
        self.terms, self.work = (
            Terms.allocate(*sizes),
            pin(Workspace.allocate(*sizes, system.n_states, system.nonholonomic)),
        )
        self.equations = Equations.of(system, self.terms)
        workspace = self.workspace = self.work.value if COMPILED else self.work
        workspace.size[:] = system.size
        workspace.size_q[:] = system.position_sizes(system.size)
        self.rank = find_normal_rank(self.equations, t, q, v, self.work)
        code = project(self.equations, t, q, v, self.rank, self.work)
        self.starts_singular = self._loses_rank()
        self.status = Code(code)
        known = system.rate, system.loop_rate, options.duration
        estimate_rates(self.equations, t, q, v, self.rank, *known, self.work)
        self.rate = float(workspace.rate[0])
        require_resolution(t, self.rate, q, workspace.size_q, options.rtol, system.coordinate_names)
        self.position_units, self.rate_units = workspace.size_q, workspace.coordinate_rates * system.size

    def _loses_rank(self) -> bool:
        """Whether rates there are that constraints determine elsewhere, and not at the initial position."""
        if self.rank == 0 or not np.isfinite(self.terms.J).all():
            return False
        sigma = np.linalg.svd(self.terms.J * self.system.size / self.workspace.row[:, None], compute_uv=False)
        return bool(sigma[self.rank - 1] <= RANK_LOSS_RATIO * sigma[0])

    def energy_scales(self, options: Options) -> EnergyScales:
        """As :meth:`solvers.steppers.formulation.Formulation.energy_scales`."""
        n = self.system.n
        scales = EnergyScales.of(options.rtol, np.zeros(n), np.zeros(n))
        set_energy_scales(pin(scales), options.absolute, self.workspace.size, self.workspace.coordinate_rates)
        return scales

    def evaluate(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.evaluate`."""
        return self._evaluated(evaluate_state(self.equations, t, q, v, self.rank, self.work, self.a, self.lam))

    def evaluate_stage(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.evaluate_stage`."""
        return self._evaluated(evaluate_stage(self.equations, t, q, v, self.rank, self.work, self.a, self.lam))

    def _evaluated(self, code: int) -> Code:
        self.qdot[:] = self.terms.qdot
        return CODES[code]

    def project(self, t: float, q: Array, v: Array) -> Code:
        """As :meth:`solvers.steppers.formulation.Formulation.project`."""
        return CODES[project(self.equations, t, q, v, self.rank, self.work)]

    def tolerance_scale(self, rtol: float, exponent: float) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.tolerance_scale`."""
        return float(growth_factor(rtol, exponent, self.work))

    def record_energy(self, t: float, q: Array, v: Array, accounts: Any, scales: Any, is_scheduled: bool) -> None:
        """As :meth:`solvers.steppers.formulation.Formulation.record_energy`."""
        record_dense_energy(self.equations, t, v, accounts, scales, is_scheduled, self.work)

    def is_on_branch(self, t: float, q: Array) -> bool:
        """As :meth:`solvers.steppers.formulation.Formulation.is_on_branch`."""
        return bool(on_same_branch(self.equations, t, q, BRANCH_RESOLUTION, self.rank, self.work))

    def record_step(self, t: float, q: Array, v: Array, taken: float, following: float) -> float:
        """As :meth:`solvers.steppers.formulation.Formulation.record_step`."""
        return float(record_dense_step(self.equations, t, q, v, taken, following, self.rank, self.work))

    def has_unresolved_forces(self, rtol: float) -> bool:
        """As :meth:`solvers.steppers.formulation.Formulation.has_unresolved_forces`."""
        return bool(has_unresolved_forces(rtol, self.rank, self.work))

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return int(self.system.n_velocities - self.rank)

    def growth(self) -> NDArray[Any]:
        """As :meth:`solvers.steppers.formulation.Formulation.growth`."""
        return self.workspace.inertia

    def memory(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.steppers.formulation.Formulation.memory`."""
        return self.workspace.memory()

    def bifurcation_gap(self, t: float, q: Array) -> float:
        """Return the gap of the loops to the singular configuration next to q (nq,) at time t, in units of the rows.

        Zero where they pass it exactly; infinite if motions of several degrees of freedom pass next to it; not a number
        where there is none next to it. The record of other points is lost.
        """
        if self.rank == 0:
            return nan
        critical = self.workspace.critical
        critical["kind"], critical["failed_search_ratio"] = NO_CRITICAL_POINT, 0.0
        kind = classify_nearest_singularity(self.equations, t, q, self.rank, self.work)
        return {BIFURCATION: 0.0, IMPERFECT: float(abs(critical["bifurcation_gap"][0]))}.get(kind, nan)


class DenseStepper(Stepper):
    """A stepper on a :class:`DenseFormulation` whose steps are not a compiled loop: that of SUNDIALS."""

    needs_matrices = True

    def __init__(self, system: System, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        self.formulation = form = DenseFormulation(system, self._t, self._q, self._v, self.options)
        self._eqs, self._terms, self._work, self._workspace = form.equations, form.terms, form.work, form.workspace
        self._rank, self.starts_singular, self.status = form.rank, form.starts_singular, self._status(form.status)

    def _growth(self) -> tuple[float, float]:
        """Return the largest rate growth so far and its time (s), see :mod:`solvers.inertia`."""
        record = self.formulation.growth()[0]
        return float(record["largest"]), float(record["at"])

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move."""
        return self.formulation.freedom

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        form = self.formulation
        code = form.evaluate(self._t, self._q, self._v)
        return code, form.a.copy(), form.lam.copy()

    def _undetermined(self) -> bool:
        return self.formulation.has_unresolved_forces(self.options.rtol)
