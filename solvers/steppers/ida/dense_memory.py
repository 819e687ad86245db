"""What an integration by IDA remembers in dense form, and its starts, continuations and reports, as kernels.

All kernels get a :class:`solvers.steppers.step_loop.Integration` with the memory, the settings and the callbacks of
this package. They serve the stepper in Python (:mod:`.dense`) and native FMUs (:mod:`.dense_loop`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel, records
from solvers.compiled.record import Record, f8, i8
from solvers.energy_account import ENERGY_ACCOUNT, SCALAR_RESULTS, WORK, restart_work
from solvers.inertia import update_growth
from solvers.linalg.dense import factor_lu, solve_lu
from solvers.linalg.svd import decompose
from solvers.outcome import NOT_FINITE, OK
from solvers.projection.reported import evaluate_state, project_reported_state
from solvers.projection.workspace import count_motions
from solvers.system import Array

from .calls import IDAHandle
from .dense_callbacks import RTOL_EXPONENT, check_step, record_energy
from .ggl import MULTIPLIER_REGULARIZATION, POSITION_REGULARIZATION, Unknowns, update_velocity_shift
from .loop import MAX_ORDER, PROGRESS, STANDSTILL_RATIO

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration

MIN_RTOL = 1e-9  # a tighter rtol is run as this one: below it roundoff in J grows faster than the BDF error falls
# IDA bounds the error of a step and the errors add up. At order 5 a step is as rtol^(1/6) and so the sum as the step's
# error^(5/6): for a motion's error in proportion to rtol IDA is given RTOL_FACTOR rtol^RTOL_EXPONENT, and atol in
# proportion.
RTOL_FACTOR = 3.0
MULTIPLIER_TOLERANCE = 1e20  # absolute tolerance of the multipliers, in their units
BRANCH_DISTANCE_RATIO = 10.0  # times rtol: branches that are no farther apart, in units of size, are one
# Times rtol: speed that D may take from loops in a singular configuration, in units of theirs. In a period of the
# motion that makes an error of some 60 rtol.
SPEED_LOSS_RATIO = 10.0
# Rate of the friction by redundant constraint equations, in units of rtol and the rate of the motion.
REDUNDANCY_FRICTION = 1e-3
RESIDUAL_ROUNDING = 3e-16  # relative rounding of a residual
MAX_SHIFT_RATIO = 3.0  # ramp of the velocities, in units of them and of their absolute tolerance to the relative one


class SettingsRecord(Record):
    """Options of IDA."""

    rtol: f8  # relative tolerance of IDA
    atol: f8  # absolute tolerance in units of the coordinates
    motion_rtol: f8  # rtol of the motion
    max_speed_loss: f8  # upper limit of Unknowns.speed_loss
    max_step: f8  # s
    max_order: i8
    max_steps: i8  # in one call
    energy_check: i8  # 1: record energy and work
    works: i8  # 1: some force does work


class ControlRecord(Record):
    """The reported state, and what is reported of the run; names are those of other methods."""

    t: f8  # s
    rank: i8  # of the constraints
    max_near_miss_factor: f8  # always zero: the tolerance is that of the options
    min_gap: f8
    undetermined: i8  # 1: requested forces were not resolved
    undetermined_at: f8  # s, the last time


SETTINGS, CONTROL = SettingsRecord.dtype, ControlRecord.dtype


class IDAMemory(NamedTuple):
    """What is remembered from step to step; N unknowns."""

    control: NDArray[Any]  # (1,) record of CONTROL
    progress: NDArray[Any]  # (1,) record of solvers.steppers.ida.loop.PROGRESS
    counts: Array  # (N_COUNTERS,) see solvers.steppers.ida.loop
    energy_record: NDArray[Any]  # (1,) record of ENERGY_ACCOUNT
    last_accepted: Array  # (2, N) IDA's unknowns after its last step, and their derivatives
    unknowns: Any  # solvers.steppers.ida.ggl.Unknowns
    ida: Any  # solvers.steppers.ida.calls.IDAHandle

    @staticmethod
    def allocate(nq: int, n: int, m: int) -> IDAMemory:
        """Return the memory of a motion that has yet to begin."""
        unknowns = Unknowns.allocate(nq, n, m)
        N = len(unknowns.y)
        progress = records(1, PROGRESS)
        progress["is_pending"], progress["max_next_step"], progress["max_step"] = 1, np.inf, np.inf
        own = records(1, CONTROL), progress, unknowns.counts, records(1, ENERGY_ACCOUNT)
        return IDAMemory(*own, np.zeros((2, N)), unknowns, IDAHandle.allocate(N))

    def memory(self) -> list[NDArray[Any]]:
        """Return the arrays to save: IDA's history is not among them."""
        return [self.control, self.counts, self.energy_record]


@kernel
def set_options(options: Any, problem: Integration) -> None:
    """Fill the settings from a record of solvers.options.OPTIONS, ``options`` (1,)."""
    own, settings, progress = options[0], problem.settings[0], problem.memory.progress[0]
    motion_rtol = max(MIN_RTOL, own.rtol) if problem.memory.unknowns.lam.shape[0] > 0 else own.rtol
    rtol = RTOL_FACTOR * motion_rtol**RTOL_EXPONENT
    settings.rtol, settings.motion_rtol = rtol, motion_rtol
    settings.atol = rtol if own.absolute == own.rtol else own.absolute * rtol / motion_rtol
    settings.max_speed_loss = SPEED_LOSS_RATIO * motion_rtol
    settings.max_step, settings.max_steps, settings.energy_check = own.max_step, own.max_steps, own.energy_check
    settings.max_order = own.max_order if own.max_order > 0 else MAX_ORDER
    progress.energy_check = own.energy_check


@kernel
def set_tolerances(problem: Integration) -> None:
    """Set the tolerances of IDA and of the energy account in the present units."""
    settings, memory, work, scales = problem.settings[0], problem.memory, problem.work, problem.scales
    nq, n, atol = problem.q.shape[0], problem.v.shape[0], settings.atol
    memory.unknowns.rounding[0] = RESIDUAL_ROUNDING / settings.rtol
    memory.unknowns.branch_distance[0] = BRANCH_DISTANCE_RATIO * settings.motion_rtol
    set_scaling(problem)
    absolute = memory.ida.atol
    for i in range(absolute.shape[0]):
        absolute[i] = MULTIPLIER_TOLERANCE * memory.unknowns.columns[i]
    for i in range(nq):
        absolute[i] = atol * work.size_q[i]
    for i in range(n):
        absolute[nq + i] = atol * (work.coordinate_rates[i] * work.size[i])
        scales.position_tolerance[i] = atol * work.size[i]
        scales.rate_tolerance[i] = work.coordinate_rates[i] * scales.position_tolerance[i]
    scales.rtol[0], scales.mean_count[0] = settings.rtol, float(absolute.shape[0])
    scales.extent_factors[0] = settings.rtol / settings.motion_rtol
    scales.extent_factors[1] = scales.extent_factors[0]
    memory.progress[0].min_step = STANDSTILL_RATIO / work.rate[0]


@kernel
def set_up(problem: Integration, t: float, rank: int) -> None:
    """Prepare a motion that starts at t (s) with constraints of this rank."""
    control, progress, bounds = problem.memory.control[0], problem.memory.progress[0], problem.scales.bound_results
    control.t, control.rank, progress.t_reached, progress.t_begun = t, rank, t, t
    set_tolerances(problem)
    for i in range(SCALAR_RESULTS, bounds.shape[0]):
        bounds[i] = np.nan


@kernel
def restore_tolerances(problem: Integration, t: float) -> None:
    """Set the tolerances at the reported state of time t (s), which was restored: whatever came before it."""
    problem.eqs.dynamics(t, problem.q, problem.v, problem.eqs.data, problem.eqs.terms)
    set_tolerances(problem)


@kernel
def set_scaling(problem: Integration) -> None:
    """Set the units of unknowns and residuals: pivots are not to depend on meters and kilograms."""
    unknowns, work, M = problem.memory.unknowns, problem.work, problem.eqs.terms.M
    nq, n, m, rate = problem.q.shape[0], problem.v.shape[0], unknowns.lam.shape[0], problem.work.rate[0]
    inertia = scaled_trace(M, work)
    moving = count_motions(work)
    energy = (inertia / max(1, moving) if inertia != 0.0 else 1.0) * rate**2
    for i in range(nq):
        unknowns.columns[i], unknowns.rows[i] = work.size_q[i], work.size_q[i] * rate
    for i in range(moving):
        unknowns.columns[nq + i], unknowns.rows[nq + i] = work.size[i] * rate, energy / work.size[i]
    for i in range(moving, n):
        unknowns.columns[nq + i], unknowns.rows[nq + i] = work.size[i], work.size[i] * rate
    for row in range(m):
        unknowns.columns[nq + n + row], unknowns.columns[nq + n + m + row] = energy, rate
        unknowns.rows[nq + n + row], unknowns.rows[nq + n + m + row] = rate, 1.0


@kernel
def scaled_trace(M: Reals, work: Any) -> float:
    """Trace of the mass matrix (n, n) in units of the coordinates, without first-order states."""
    total = 0.0
    for i in range(count_motions(work)):
        total += M[i, i] * work.size[i] * work.size[i]
    return total


@kernel
def set_regularization(problem: Integration) -> None:
    """Set D on rows without rank and d, and the coefficients of redundant equations in these two.

    M may be singular across the motion; there J~ stands in.
    """
    work, unknowns, terms, settings = problem.work, problem.memory.unknowns, problem.eqs.terms, problem.settings[0]
    m, n = terms.J.shape
    J, A, mobile = work.J_work, unknowns.inertia, 0.0
    for row in range(m):
        for i in range(n):
            J[row, i] = terms.J[row, i] * (work.size[i] / work.row[row])
    decompose(J, m, n, unknowns.J_scratch, work.rows, work.T, unknowns.Dlam, unknowns.D)
    square = unknowns.Dlam[0] * unknowns.Dlam[0]
    share = scaled_trace(terms.M, work) / (count_motions(work) * square)
    for i in range(n):
        for j in range(n):
            A[i, j] = 0.0
            for row in range(m):
                A[i, j] += J[row, i] * J[row, j]
            A[i, j] = terms.M[i, j] * work.size[i] * work.size[j] + share * A[i, j]
    factor_lu(A, n, work.order)
    for row in range(m):
        for i in range(n):
            work.f[i] = J[row, i]
        solve_lu(A, n, work.order, work.f, work.z)
        for i in range(n):
            mobile += J[row, i] * work.z[i]
    lam, mu = mobile / work.rate[0], square / work.rate[0]
    redundant = settings.rtol**2 / (REDUNDANCY_FRICTION * settings.motion_rtol)
    unknowns.d_default[0] = MULTIPLIER_REGULARIZATION * lam
    unknowns.d_default[1] = unknowns.rounding[0] * POSITION_REGULARIZATION * mu
    unknowns.d_redundant[0], unknowns.d_redundant[1] = redundant * lam, redundant * mu
    unknowns.d[0], unknowns.d[1] = unknowns.d_default[0], unknowns.d_default[1]


@kernel
def fill_start(problem: Integration, t: float) -> int:
    """Fill IDA's unknowns and their consistent derivatives at the reported state of time t (s); return a code."""
    eqs, work, memory, unknowns = problem.eqs, problem.work, problem.memory, problem.memory.unknowns
    nq, n, m, y, slopes = problem.q.shape[0], problem.v.shape[0], unknowns.lam.shape[0], memory.ida.y, memory.ida.slopes
    code = evaluate_state(eqs, t, problem.q, problem.v, memory.control[0].rank, work, unknowns.a, unknowns.lam)
    if code != OK:
        return code
    update_growth(t, eqs.terms.M, problem.v, work)
    for i in range(nq):
        y[i], slopes[i] = problem.q[i], eqs.terms.qdot[i]
    for i in range(n):
        y[nq + i], slopes[nq + i] = problem.v[i], unknowns.a[i]
        unknowns.velocity_shift[0, i], unknowns.velocity_shift[1, i] = 0.0, 0.0
    for row in range(m):
        y[nq + n + row], y[nq + n + m + row] = unknowns.lam[row] * work.row[row], 0.0
        slopes[nq + n + row], slopes[nq + n + m + row] = 0.0, 0.0
    for i in range(y.shape[0]):
        unknowns.evaluated_at[i] = np.nan
    unknowns.is_pending[0] = 0.0
    set_scaling(problem)
    if m > 0:
        set_regularization(problem)
    return OK


@kernel
def end_start(problem: Integration, t: float) -> None:
    """Record the start of a history at t (s) from IDA's unknowns there."""
    memory, work, progress, y = problem.memory, problem.work, problem.memory.progress[0], problem.memory.ida.y
    progress.works = problem.settings[0].works
    for i in range(y.shape[0]):
        memory.last_accepted[0, i], memory.last_accepted[1, i] = y[i], memory.ida.slopes[i]
    work.branch_history[0].pivot_ratio = 0.0  # what is known of the branch holds
    if memory.unknowns.lam.shape[0] > 0:
        bound = check_step(
            problem.eqs, t, y, 0.0, memory.control[0].rank, problem.settings[0].rtol, memory.unknowns, work
        )
        progress.max_next_step = min(progress.max_next_step, bound)
    record_energy_at(problem, t, y, memory.ida.slopes)


@kernel
def record_energy_at(problem: Any, t: float, y: Reals, slopes: Reals) -> None:
    """Record the energy at IDA's unknowns, if it is checked."""
    memory = problem.memory
    if memory.progress[0].energy_check == 1:
        works = memory.progress[0].works == 1
        record_energy(
            problem.eqs, t, y, slopes, works, memory.unknowns, problem.work, memory.energy_record, problem.scales
        )


@kernel
def report_unknowns(problem: Integration, t: float, y: Reals) -> int:
    """Make IDA's unknowns y (N,) at t (s) the reported state; return a code, not OK: it stays."""
    unknowns, nq, n = problem.memory.unknowns, problem.q.shape[0], problem.v.shape[0]
    for i in range(y.shape[0]):
        if not np.isfinite(y[i]):
            return NOT_FINITE
    for i in range(nq):
        unknowns.q[i] = y[i]
    for i in range(n):
        shift = unknowns.velocity_shift
        unknowns.v[i] = y[nq + i] + shift[0, i] + (t - unknowns.shift_start[0]) * shift[1, i]
    rank = problem.memory.control[0].rank
    code: int = project_reported_state(problem.eqs, t, unknowns.q, unknowns.v, rank, problem.work)
    if code == OK:
        problem.memory.control[0].t = t
        for i in range(nq):
            problem.q[i] = unknowns.q[i]
        for i in range(n):
            problem.v[i] = unknowns.v[i]
    return code


@kernel
def is_shift_small(problem: Integration, t: float) -> bool:
    """Whether IDA's unknowns are of the size of the velocities until t (s): relative tolerances are of them."""
    unknowns, work = problem.memory.unknowns, problem.work
    for i in range(problem.v.shape[0]):
        ramp = unknowns.velocity_shift[0, i] + (t - unknowns.shift_start[0]) * unknowns.velocity_shift[1, i]
        if not abs(ramp) <= MAX_SHIFT_RATIO * (abs(problem.v[i]) + work.coordinate_rates[i] * work.size[i]):
            return False
    return True


@kernel
def is_shift_too_large(problem: Integration, t: float) -> bool:
    """Whether a history cannot be continued until t (s), see :func:`is_shift_small`: velocities are shifted."""
    for i in range(problem.v.shape[0]):
        if problem.memory.unknowns.velocity_shift[1, i] != 0.0:
            return not is_shift_small(problem, t)
    return False


@kernel
def continue_history(problem: Integration, t: float, is_valid: bool) -> bool:
    """Continue IDA's history at the reported state of time t (s), after a change of the loads.

    ``is_valid``: the last advance was successful. Return False if the history must begin again: IDA's last step does
    not end here, the velocities are shifted too far, or there are no accelerations.
    """
    memory, progress, unknowns = problem.memory, problem.memory.progress[0], problem.memory.unknowns
    if not (is_valid and progress.is_pending == 0 and progress.t_reached == t and is_shift_small(problem, t)):
        return False
    eqs, work, rank, nq, n = problem.eqs, problem.work, memory.control[0].rank, problem.q.shape[0], problem.v.shape[0]
    if evaluate_state(eqs, t, problem.q, problem.v, rank, work, unknowns.a, unknowns.lam) != OK:
        return False
    here, slopes = memory.ida.y, memory.last_accepted[1]
    update_velocity_shift(t, unknowns.a, slopes, unknowns)
    for i in range(here.shape[0]):
        unknowns.evaluated_at[i], here[i] = np.nan, memory.last_accepted[0, i]
    for row in range(unknowns.lam.shape[0]):
        here[nq + n + row] = unknowns.lam[row] * work.row[row]
    progress.works = problem.settings[0].works
    restart_work(memory.energy_record, problem.energy_account[WORK])
    record_energy_at(problem, t, here, slopes)
    return True
