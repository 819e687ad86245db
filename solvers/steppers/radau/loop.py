"""Radau IIA on constrained motion: the compiled step loop.

What is integrated is the motion that :mod:`solvers.projection.projection` makes of the equations: its accelerations are
tangent to the constraints, so that stages need not be closed, and the end of every step is. Newton's matrix is kept
while the corrections decrease fast, over steps, output times and jumps of the loads; derivatives are by differences,
and are not evaluated near a singular configuration, where v' turns within the step. The check of the branch, and the
step size near near misses, are as for Adams.

A step may pass the requested time; the reported state is then interpolated and projected. Where loads have just changed
at such a time, and may again, steps end there: what a step needs of the one before it is a guess and no more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import f8
from solvers.energy_account import (
    add_energy_error_bound,
    count_rejected_step,
    energy_check_scheduled,
    fill_account_row,
    reset_check_schedule,
    set_energy_scales,
    update_energy_bound,
)
from solvers.inertia import clear_growth, tolerance_factor, update_growth
from solvers.outcome import BRANCHES, COLLAPSED, OK
from solvers.projection.branch import BRANCH_RESOLUTION, on_same_branch
from solvers.projection.projection import evaluate_acceleration, project
from solvers.projection.reported import fill_reported_state
from solvers.projection.singular import branch_step_limit, record_accepted
from solvers.steppers.step_control import (
    FIRST_STEP_RATIO,
    MIN_CONTROLLED_ERROR,
    MIN_RECORDED_ERROR,
    MIN_STEP_CHANGE,
    end_of_step,
    retry_step,
    set_near_miss_factor,
    step_factor,
    truncated_step,
)
from solvers.steppers.step_loop import StepSettingsRecord, make_loop, make_sample, set_step_options

from .formulas import N_STAGES, A, estimate_error, estimate_work_error, factor_newton, interpolate
from .stages import MAX_EXTRAPOLATION, difference_accelerations, evaluate_power, set_state, solve_stages

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.energy_account import EnergyScales
    from solvers.projection.workspace import Workspace
    from solvers.steppers.radau.formulas import Memory
    from solvers.steppers.step_loop import Integration
    from solvers.system import Equations


class SettingsRecord(StepSettingsRecord):
    """Options of Radau; its tolerances are those of the estimated error."""

    motion_rtol: f8  # rtol requested for the motion
    newton_tolerance: f8  # what Newton may leave, in tolerances of the estimated error


SETTINGS = SettingsRecord.dtype
MIN_DERIVATIVE_PIVOT_RATIO = 1e-2  # below this ratio of the pivots no derivatives are evaluated
MAX_CONTRACTION = 0.3  # rate of the corrections that calls for new derivatives
RADAU_EXPONENT = 0.25  # of the estimate, of order 3
MAX_STEP_CHANGE = MAX_EXTRAPOLATION  # next step in units of this one, at most
# The error that is estimated is that of a formula of order 3: its step is as tolerance^(1/4), and the motion's error,
# of order 5, as that step^5. For an error in proportion to rtol the estimate is held to RTOL_FACTOR rtol^RTOL_EXPONENT.
RTOL_FACTOR, RTOL_EXPONENT = 2.0, 0.8
# Ratio of errors, estimated and expected from the last step, that only a corner of a force explains. There the motion
# is no more accurate than the estimate, which is then held to the requested tolerance.
CORNER_ERROR_RATIO = 7.0
NEWTON_RTOL_RATIO = 0.1  # of rtol: the remainder of Newton's method has one sign in many steps, and adds up


@inlined
def set_tolerances(control: Any, settings: SettingsRecord, memory: Memory, work: Workspace) -> None:
    """Tolerances at (memory.q, memory.v), larger near a near miss."""
    set_near_miss_factor(control, settings.motion_rtol, work.critical[0].kind, work.critical[0].bifurcation_gap)
    control.inertia_factor = tolerance_factor(settings.rtol, RTOL_EXPONENT, work)
    scale = control.near_miss_factor * control.inertia_factor
    for i in range(memory.q.shape[0]):
        memory.tol_q[i] = scale * (settings.rtol * abs(memory.q[i]) + settings.atol * work.size_q[i])
    for i in range(memory.v.shape[0]):
        memory.tol_v[i] = scale * (
            settings.rtol * abs(memory.v[i]) + settings.atol * work.coordinate_rates[i] * work.size[i]
        )


@kernel
def evaluate_end(
    eqs: Equations,
    t: float,
    control: Any,
    settings: SettingsRecord,
    memory: Memory,
    work: Workspace,
    scales: EnergyScales,
) -> int:
    """Evaluate q', v' and W' at (work.q, work.v), record its energy, and store it.

    The state satisfies the constraints; its ``terms`` and factors are available.
    """
    control.evaluations += 1
    code = evaluate_acceleration(eqs, t, work.q, work.v, control.rank, work, work.slope)
    if code == OK:
        for i in range(memory.q.shape[0]):
            memory.q[i], memory.qdot[i] = work.q[i], eqs.terms.qdot[i]
        for i in range(memory.v.shape[0]):
            memory.v[i], memory.a[i] = work.v[i], work.slope[i]
        update_growth(t, eqs.terms.M, work.v, work)
        if settings.energy_check == 1 and energy_check_scheduled(control):
            update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, scales)
            control.step_energy_error_bound *= max(1.0, control.near_miss_factor)
        memory.power[0] = evaluate_power(eqs, t, control, settings, work, work.slope)
    return code


@kernel
def restart_at_state(
    memory: Memory, t: float, q: Reals, v: Reals, done: float, truncated_steps: int, keeps_position: bool
) -> None:
    """Begin the next step at a reported state, with work ``done``, J; a restart needs new derivatives.

    See :class:`solvers.steppers.compiled_loop.MethodKernels`.
    """
    control = memory.control[0]
    control.is_projected = control.is_projected if keeps_position and control.t == t else 0
    control.t, control.start, control.truncated_steps, control.last_error_step = t, 1, truncated_steps, 0.0
    reset_check_schedule(memory.control)
    for i in range(memory.q.shape[0]):
        memory.q[i] = q[i]
    for i in range(memory.v.shape[0]):
        memory.v[i] = v[i]
    memory.work[0] = done
    if truncated_steps == 0:
        control.has_derivatives = 0


@kernel
def limit_steps(memory: Memory, settings: Any, t: float, q: Any, v: Any, done: float, longest: float) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`."""
    settings[0].max_step = longest


@kernel
def count(memory: Memory, counts: Any) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`."""
    control = memory.control[0]
    counts[0], counts[1], counts[2], counts[3] = control.steps, control.rejected, control.evaluations, 0
    counts[4], counts[5] = max(0, control.starts - 1), 0


@kernel
def prepare(integration: Integration) -> int:
    """After a start or a change: close (memory.q, memory.v), record its position, and evaluate its derivatives."""
    eqs, memory, work, control = integration.eqs, integration.memory, integration.work, integration.memory.control[0]
    if control.start == 0:
        return OK
    set_state(memory.q, memory.v, work)
    code = project(eqs, control.t, work.q, work.v, control.rank, work)
    if code != OK:
        return code
    if control.is_projected == 0:
        work.branch_history[0].pivot_ratio = 0.0
        record_accepted(eqs, control.t, work.q, 0.0, 0.0, control.rank, work)
    code = evaluate_end(eqs, control.t, control, integration.settings[0], memory, work, integration.scales)
    if code == OK:
        control.start, control.is_projected, control.extrapolates, control.derivatives_at_start = 0, 1, 0, 0
        control.starts += 1
        if not control.h > 0.0:
            control.h = FIRST_STEP_RATIO / work.rate[0]
    return code


@inlined
def has_corner(control: Any, h: float, error: float) -> bool:
    """Whether the error of a step of h is far above the one that follows from the last step if the motion is smooth."""
    return (
        control.last_error_step > 0.0
        and error > CORNER_ERROR_RATIO * control.last_estimate * (h / control.last_error_step) ** 4
    )


@kernel
def take_step(integration: Integration, target: float) -> int:
    """Attempt steps, shorter after each rejection, until one is accepted; or return the code of the last rejection."""
    eqs, settings, memory, work = integration.eqs, integration.settings[0], integration.memory, integration.work
    control, nq, n = memory.control[0], memory.q.shape[0], memory.v.shape[0]
    set_tolerances(control, settings, memory, work)
    is_forced = False
    while True:
        control.h = min(control.h, settings.max_step)
        h = truncated_step(control.t, control.h, target) if control.truncated_steps > 0 else control.h
        code, shorter, corner, is_accurate = COLLAPSED, 0.5, False, True
        renewable = control.derivatives_at_start == 0 and (
            control.rank == 0 or work.branch_history[0].pivot_ratio >= MIN_DERIVATIVE_PIVOT_RATIO
        )
        if renewable and (control.has_derivatives == 0 or control.contraction > MAX_CONTRACTION):
            renewable = False
            difference_accelerations(eqs, control, memory, work)
        if factor_newton(h, memory):
            code = solve_stages(eqs, h, control, settings, memory, work)
        if code == OK:
            store_step_start(memory)
            error = estimate_error(h, memory, work.size, work.states)
            corner = has_corner(control, h, error)
            largest = min(1.0, settings.motion_rtol / (control.inertia_factor * settings.rtol)) if corner else 1.0
            is_accurate = error <= largest
            if is_accurate or is_forced:
                for i in range(nq):
                    work.q[i] = memory.Q[N_STAGES - 1, i]
                for i in range(n):
                    work.v[i] = memory.v[i] + memory.Z[N_STAGES - 1, i]
                after = end_of_step(control.t, h, target) if control.truncated_steps > 0 else control.t + h
                code = project(eqs, after, work.q, work.v, control.rank, work)
                if code == OK and not on_same_branch(eqs, after, work.q, BRANCH_RESOLUTION, control.rank, work):
                    code = BRANCHES
                    control.refused += 1
                if code == OK:
                    code = evaluate_end(eqs, after, control, settings, memory, work, integration.scales)
                if code == OK:
                    accept_step(control, memory, h, after, error)
                    return OK
                corner = False  # another test refuses the step
            else:
                code, shorter = COLLAPSED, step_factor(h, error / largest, 0.0, 0.0, RADAU_EXPONENT, MAX_STEP_CHANGE)
                if corner:
                    control.corner_end = control.t + h
                if renewable:
                    control.has_derivatives = 0
        elif renewable:
            control.has_derivatives, shorter = 0, 1.0
        control.extrapolates = 0
        count_rejected_step(control, corner)
        if shorter < 1.0:
            control.h = shorter * h
        may_force = not (is_forced or is_accurate)
        h, forces = retry_step(control.h, work.rate[0], settings.max_step, control.t, may_force)
        if h == 0.0:
            return code
        control.h, is_forced = h, is_forced or forces


@inlined
def store_step_start(memory: Memory) -> None:
    """Note where this step begins."""
    for i in range(memory.q.shape[0]):
        memory.q0[i], memory.qdot0[i] = memory.q[i], memory.qdot[i]
    for i in range(memory.v.shape[0]):
        memory.v0[i], memory.a0[i] = memory.v[i], memory.a[i]
    memory.work0[0], memory.power0[0] = memory.work[0], memory.power[0]


@inlined
def accept_step(control: Any, memory: Memory, h: float, after: float, error: float) -> None:
    """Accept the step of h; the next one is as long as its error allows."""
    memory.P[N_STAGES - 1] = memory.power[0]  # what Newton left of the others is of the size of its tolerance
    done = 0.0
    for s in range(N_STAGES):
        done += h * A[N_STAGES - 1, s] * memory.P[s]
    memory.work[0] += done
    control.work_total_variation += abs(done)
    add_energy_error_bound(control, estimate_work_error(h, memory), h)
    whole = h >= control.h
    control.t, control.hold = after, h
    longer = h * step_factor(h, error, control.last_error, control.last_error_step, RADAU_EXPONENT, MAX_STEP_CHANGE)
    if after < control.corner_end:  # a corner near the middle of a step is not in the estimate: on in short steps
        longer = min(longer, max(h, MIN_STEP_CHANGE * (control.corner_end - after)))
    control.last_error, control.last_estimate, control.last_error_step = (
        max(error, MIN_RECORDED_ERROR),
        max(error, MIN_CONTROLLED_ERROR),
        h,
    )
    control.h = longer if whole else max(control.h, longer)
    control.extrapolates, control.derivatives_at_start, control.truncated_steps = (
        1,
        0,
        max(0, control.truncated_steps - 1),
    )
    control.steps += 1


@inlined
def copy_last_state(memory: Any, q: Reals, v: Reals) -> None:
    """(q, v) <- where the last step ended."""
    for i in range(q.shape[0]):
        q[i] = memory.q[i]
    for i in range(v.shape[0]):
        v[i] = memory.v[i]


@inlined
def end_step(integration: Integration) -> None:
    """Record the position of an accepted step, and limit the next one near singular configurations."""
    eqs, memory, work, control = integration.eqs, integration.memory, integration.work, integration.memory.control[0]
    record_accepted(eqs, control.t, memory.q, control.hold, control.h, control.rank, work)
    control.h = min(control.h, branch_step_limit(control.t, memory.q, memory.v, control.hold, eqs.terms, work))


@inlined
def report(integration: Integration, code: int, target: float, q: Reals, v: Reals, energy_account: Any) -> int:
    """The state at ``target``, interpolated and closed, or where the last step ended; and its energy account."""
    eqs, memory, work, control = integration.eqs, integration.memory, integration.work, integration.memory.control[0]
    copy_last_state(memory, q, v)
    done = memory.work[0]
    if code == OK:
        if target < control.t:
            done = interpolate(target, memory, work.states, q, v)
        code = project(eqs, target, q, v, control.rank, work)
        if code != OK:
            copy_last_state(memory, q, v)
            done = memory.work[0]
    fill_account_row(control, done, energy_account)
    return code


@inlined
def fill_row(integration: Integration, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, outputs: Reals) -> int:
    """Accelerations, multipliers and outputs of the system at the state reported last."""
    control, rtol = integration.memory.control[0], integration.settings[0].motion_rtol
    return fill_reported_state(integration.eqs, t, q, v, rtol, control, integration.work, a, lam, outputs)


@kernel
def set_options(options: Any, settings_array: Any) -> None:
    """Set the options of a run (``solvers.options.OPTIONS``)."""
    set_step_options(options, settings_array)
    requested, settings = options[0], settings_array[0]
    error_rtol = RTOL_FACTOR * requested.rtol**RTOL_EXPONENT
    settings.rtol, settings.atol = error_rtol, requested.absolute * error_rtol / requested.rtol
    settings.motion_rtol, settings.newton_tolerance = requested.rtol, NEWTON_RTOL_RATIO * requested.rtol / error_rtol


@kernel
def set_up(integration: Integration, rank: int, absolute: float) -> None:
    """Take rank, units and paces as they were found at the start; ``absolute`` is the tolerance in those units."""
    integration.memory.control[0].rank = rank
    set_energy_scales(integration.scales, absolute, integration.work.size, integration.work.coordinate_rates)
    clear_growth(integration.work)


advance, advance_reported = make_loop(__name__, prepare=prepare, take_step=take_step, end_step=end_step, report=report)
sample = make_sample(__name__, advance=advance, fill_row=fill_row)
