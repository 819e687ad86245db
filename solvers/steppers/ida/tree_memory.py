"""What an integration by IDA remembers on trees, its units and tolerances, and its starts and reports, as kernels.

All kernels get a :class:`solvers.steppers.step_loop.Integration` with the memory, the settings and the work of this
module. They serve the stepper in Python (:mod:`.tree`) and native FMUs (:mod:`.tree_loop`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel, records
from solvers.compiled.record import Record, f8, i8
from solvers.compiled.tuple_pointer import pin
from solvers.energy_account import ENERGY_ACCOUNT, set_energy_scales, set_mesh_scales, set_state_scales
from solvers.inertia import InertiaRecord, clear_growth
from solvers.outcome import NOT_FINITE, OK
from solvers.positions import Positions, count_velocities, position_sizes, set_coordinate_rates
from solvers.projection.tree_constraints import (
    ConstraintScratch,
    find_rate,
    project_state,
    set_scales,
    solve_accelerations,
)
from solvers.system import Array

from .calls import IDAHandle
from .dense_memory import CONTROL
from .ggl import QUATERNION_LENGTH_RATE
from .loop import MAX_ORDER, N_COUNTERS, PROGRESS, STANDSTILL_RATIO
from .tree_callbacks import Reduced, ResidualData, Scratch, record_energy

if TYPE_CHECKING:
    from solvers.compiled.record import Reals, Table
    from solvers.steppers.step_loop import Integration

MULTIPLIER_TOLERANCE = 1e100  # absolute tolerance of the multipliers, above any force in any unit
RATE_TOLERANCE_RATIO = 1.0  # absolute tolerance of a rate to that of its coordinate, in units of the motion's rate
MESH_RATE_TOLERANCE_RATIO = 150.0  # the same where the order is low, and fast motions are damped and not followed
MAX_MESH_ORDER = 2  # of BDF on meshes
SLIP_TOLERANCE_RATIO = 0.3  # part of the slip at which friction turns over, to which a mesh's speed is known
TIKHONOV_FACTOR = 1e-6


class SettingsRecord(Record):
    """Options of IDA on trees, and what its system is like."""

    rtol: f8  # relative tolerance of IDA
    motion_rtol: f8  # ... of the motion
    atol: f8  # absolute tolerance in units of the coordinates
    rate: f8  # of the motion, 1/s
    max_step: f8  # s
    max_order: i8
    max_steps: i8  # in one call
    energy_check: i8  # 1: record energy and work
    works: i8  # 1: some force does work
    has_mesh: i8  # 1: some joints are those between nodes of a mesh
    is_smooth: i8  # 0: forces change sharply within the tolerance
    weighs_errors: i8  # 1: errors are weighed by the tolerances of :class:`Work`
    linear_tolerance: f8  # of GMRES, see :mod:`.calls`


SETTINGS = SettingsRecord.dtype


class TreeIDAMemory(NamedTuple):
    """What is remembered from step to step."""

    control: NDArray[Any]  # (1,) record of CONTROL
    progress: NDArray[Any]  # (1,) record of solvers.steppers.ida.loop.PROGRESS
    counts: Array  # (N_COUNTERS,) see solvers.steppers.ida.loop
    energy_record: NDArray[Any]  # (1,) record of ENERGY_ACCOUNT
    ida: Any  # solvers.steppers.ida.calls.IDAHandle

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> TreeIDAMemory:
        """Return the memory of a motion that has yet to begin."""
        progress = records(1, PROGRESS)
        progress["is_pending"], progress["max_next_step"], progress["max_step"] = 1, np.inf, np.inf
        own = records(1, CONTROL), progress, np.zeros(N_COUNTERS), records(1, ENERGY_ACCOUNT)
        return TreeIDAMemory(*own, IDAHandle.allocate(nq + n + 2 * m))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save: IDA's history is not among them."""
        return [self.control, self.counts, self.energy_record]


class Work(NamedTuple):
    """Units, tolerances and scratch; N unknowns."""

    positions: Any  # solvers.positions.Positions
    size: Array  # (n,) units of the coordinates
    size_q: Array  # (nq,) units of the positions
    coordinate_rates: Array  # (n,) 1/s, as solvers.inertia.Growth has them
    parts: Array  # (1 + n,)
    inertia: Table[InertiaRecord]  # (1,)
    q: Array  # (nq,) a state, its rates, and zeros
    v: Array  # (n,)
    a: Array  # (n,)
    qdot: Array  # (nq,)
    zero: Array  # (n,)
    mesh_mask: Array  # (n,) 1: a coordinate of a mesh's joint, of which there are many like it
    friction_velocity: Array  # (n,) rates at which friction turns over; infinite: at none
    tolerances: Array  # (3, N) relative, absolute, the largest; where they are weighed
    residual: Array  # (N,) scratch
    own: Any  # solvers.steppers.ida.tree_callbacks.ResidualData
    constraints: Any  # solvers.projection.tree_constraints.ConstraintScratch
    complex_step: Any  # solvers.steppers.ida.tree_callbacks.ComplexStep; None: products are differences

    @staticmethod
    def allocate(nq: int, n: int, m: int, positions: Positions) -> Work:
        """Return zeroed arrays; the units are to be filled."""
        z, N = np.zeros, nq + n + 2 * m
        constraints = ConstraintScratch.allocate(nq, n, m)
        scratch, reduced = pin(Scratch.allocate(nq, n, m)), pin(Reduced.allocate(n, m))
        own = ResidualData(scratch, constraints.terms, reduced, pin(positions))
        return Work(
            pin(positions), z(n), z(nq), z(n), z(1 + n), InertiaRecord.zeros(1), z(nq), z(n), z(n), z(nq), z(n), z(n),
            np.full(n, np.inf), z((3, N)), z(N), pin(own), pin(constraints), None,
        )  # fmt: skip

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays that are needed to continue a motion."""
        return [self.inertia, self.coordinate_rates]


@kernel
def set_options(options: Any, problem: Integration) -> None:
    """Fill the settings from a record of solvers.options.OPTIONS, ``options`` (1,)."""
    own, settings, progress = options[0], problem.settings[0], problem.memory.progress[0]
    settings.motion_rtol, settings.atol = own.rtol, own.absolute
    settings.rtol = unknown_part(problem) * own.rtol
    settings.max_step, settings.max_steps, settings.energy_check = own.max_step, own.max_steps, own.energy_check
    settings.max_order = own.max_order
    if own.max_order == 0:
        settings.max_order = MAX_MESH_ORDER if settings.has_mesh == 1 else MAX_ORDER
    progress.energy_check = own.energy_check


@kernel
def unknown_part(problem: Any) -> float:
    """Factor of the tolerances: IDA's norm is the root of a mean square, in which one unknown may be far off."""
    return 1.0 if problem.settings[0].has_mesh == 1 else float(problem.memory.ida.y.shape[0]) ** -0.5


@kernel
def set_up(problem: Integration, t: float, known: float, duration: float) -> int:
    """Find units, tolerances and the rate of the motion at the reported state, of time t (s), and project the state;
    return a code.

    ``known`` (1/s) is what is known of the rate beforehand, ``duration`` (s) that of the run.
    """
    eqs, settings, work = problem.eqs, problem.settings[0], problem.work
    control, progress = problem.memory.control[0], problem.memory.progress[0]
    control.t, control.rank, progress.t_reached, progress.t_begun = t, work.constraints.root.shape[0], t, t
    position_sizes(work.positions, work.size, work.size_q)
    moving = count_velocities(work.positions, problem.v.shape[0])
    settings.rate = find_rate(eqs, t, problem.q, problem.v, moving, work.size, known, duration, work.constraints)
    set_coordinate_rates(work.positions, settings.rate, work.coordinate_rates)
    set_tolerances(problem)
    clear_growth(work)
    code: int = project_state(eqs, t, problem.q, problem.v, work.size, work.constraints)
    return code


@kernel
def set_tolerances(problem: Integration) -> None:
    """Set the tolerances of IDA and of the energy account, and what else follows from the units and the rate.

    The scales of the energy error are those of the requested tolerances, independent of those of IDA: the stiff modes
    of a mesh are damped on purpose, as far as IDA's own tolerances let them be.
    """
    settings, work, atol = problem.settings[0], problem.work, problem.memory.ida.atol
    nq, n, part, N = problem.q.shape[0], problem.v.shape[0], unknown_part(problem), atol.shape[0]
    for i in range(n):
        work.own.reduced.metric[i] = work.size[i] ** 2
    work.own.reduced.length_rate[0] = QUATERNION_LENGTH_RATE * settings.rate
    problem.memory.progress[0].min_step = STANDSTILL_RATIO / settings.rate
    ratio = MESH_RATE_TOLERANCE_RATIO if settings.max_order <= MAX_MESH_ORDER else RATE_TOLERANCE_RATIO
    for i in range(N):
        atol[i] = MULTIPLIER_TOLERANCE
    for i in range(nq):
        atol[i] = part * (settings.atol * work.size_q[i])
    moving = count_velocities(work.positions, n)
    for i in range(n):
        rate = ratio * settings.rate if i < moving else 1.0
        atol[nq + i] = part * (rate * (settings.atol * work.size[i]))
    if settings.has_mesh == 1:
        set_mesh_scales(
            problem.scales,
            settings.motion_rtol,
            settings.atol,
            work.size,
            ratio * settings.rate,
            N,
            MESH_RATE_TOLERANCE_RATIO,
        )
        set_state_scales(problem.scales, settings.atol, work.size, work.positions.states)
    else:
        problem.scales.rtol[0] = settings.motion_rtol
        set_energy_scales(problem.scales, settings.atol, work.size, work.coordinate_rates)
    for i in range(N):
        work.tolerances[0, i] = settings.motion_rtol if settings.is_smooth == 0 else settings.rtol
        work.tolerances[1, i], work.tolerances[2, i] = atol[i], np.inf
    if settings.is_smooth == 0:
        refine_tolerances(problem)


@kernel
def refine_tolerances(problem: Integration) -> None:
    """Refine the tolerances of coordinates outside meshes, and of all rates where friction turns over.

    IDA's norm is the root of a mean square, in which one of N unknowns may be off by sqrt(N) tolerances. A mesh has
    many similar ones, but few determine the position of a mesh as a whole. Their rates are accurate to a part of
    the slip at which friction turns over too: where it reverses within a step, that is what is left of it.
    """
    work, nq = problem.work, problem.q.shape[0]
    N, found = work.tolerances.shape[1], work.tolerances
    for i in range(work.v.shape[0]):
        work.v[i], work.a[i] = 1.0 if work.mesh_mask[i] == 1.0 else float(N) ** -0.5, 1.0
    position_sizes(work.positions, work.v, work.q)
    position_sizes(work.positions, work.a, work.qdot)
    for i in range(nq):
        for k in range(2):
            found[k, i] *= work.q[i] / work.qdot[i]
    for i in range(work.v.shape[0]):
        for k in range(2):
            found[k, nq + i] *= work.v[i]
        found[2, nq + i] = SLIP_TOLERANCE_RATIO * work.v[i] * work.friction_velocity[i]


@kernel
def fill_start(problem: Integration, t: float) -> int:
    """Fill IDA's unknowns and their consistent derivatives at the reported state of time t (s); return a code."""
    eqs, settings, work, own = problem.eqs, problem.settings[0], problem.work, problem.work.own
    y, slopes, nq, n = problem.memory.ida.y, problem.memory.ida.slopes, problem.q.shape[0], problem.v.shape[0]
    scratch, d, m = own.scratch, own.reduced.d, own.reduced.weight.shape[0]
    code: int = solve_accelerations(
        eqs, t, problem.q, problem.v, work.constraints, scratch.qdot, scratch.a, scratch.lam
    )
    if code != OK:
        return code
    part = TIKHONOV_FACTOR * settings.motion_rtol / settings.rate
    for row in range(m):
        scratch.right[row] = 0.0
        for i in range(n):
            scratch.right[row] += own.terms.J[row, i] ** 2 * own.reduced.metric[i]
    set_scales(scratch.right[:m], d[1])
    for row in range(m):
        d[0, row], d[1, row] = part / work.constraints.masses[row], part / d[1, row]
    for i in range(nq):
        y[i], slopes[i] = problem.q[i], scratch.qdot[i]
    for i in range(n):
        y[nq + i], slopes[nq + i] = problem.v[i], scratch.a[i]
    for row in range(m):
        y[nq + n + row], y[nq + n + m + row] = scratch.lam[row], 0.0
        slopes[nq + n + row], slopes[nq + n + m + row] = 0.0, 0.0
    return OK


@kernel
def end_start(problem: Integration, t: float) -> None:
    """Record the start of a history at t (s) from IDA's unknowns there."""
    problem.memory.progress[0].works = problem.settings[0].works
    if problem.memory.progress[0].energy_check == 1:
        record_energy(t, problem.memory.ida.y, problem.memory.ida.slopes, problem)


@kernel
def report_unknowns(problem: Integration, t: float, y: Reals) -> int:
    """Make IDA's unknowns y (N,) at t (s) the reported state; return a code, not OK: it stays."""
    work, nq = problem.work, problem.q.shape[0]
    for i in range(y.shape[0]):
        if not np.isfinite(y[i]):
            return NOT_FINITE
    for i in range(nq):
        work.q[i] = y[i]
    for i in range(work.v.shape[0]):
        work.v[i] = y[nq + i]
    code: int = project_state(problem.eqs, t, work.q, work.v, work.size, work.constraints)
    if code == OK:
        problem.memory.control[0].t = t
        for i in range(nq):
            problem.q[i] = work.q[i]
        for i in range(work.v.shape[0]):
            problem.v[i] = work.v[i]
    return code
