"""The loop of ESDIRK3(2) on trees over its steps, its starts and its reports, as kernels.

They serve the stepper in Python (:mod:`.tree`) and native FMUs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import fill_account_row, reset_check_schedule, set_mesh_scales, set_state_scales
from solvers.inertia import clear_growth
from solvers.outcome import OK
from solvers.positions import count_velocities, position_sizes, set_coordinate_rates
from solvers.projection.tree_constraints import find_rate, project_state, solve_accelerations
from solvers.resolution import start_rate
from solvers.steppers.step_control import FIRST_STEP_RATIO
from solvers.steppers.step_loop import make_loop, set_step_options

from .formulas import Memory, evaluate_start, interpolate
from .steps import SETTINGS as SETTINGS  # noqa: PLC0414  # of the method
from .steps import STAGE_TOLERANCE, record_state, take_step

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration

ESDIRK_RATE_TOLERANCE_RATIO = 150.0  # tolerance of a rate in tolerances of its coordinate times the rate of the motion
MIN_RTOL = 1e-10  # below it steps are so short that rounding errors add up to more than the tolerance


@kernel
def prepare(integration: Integration) -> int:
    """Take accelerations where the next step begins, after a start or a change; return a code."""
    eqs, settings, memory, work = integration.eqs, integration.settings[0], integration.memory, integration.work
    control, stage = memory.control[0], work.stage
    if control.start == 0:
        return OK
    code: int = solve_accelerations(
        eqs, control.t, memory.q, memory.v, work.constraints, stage.qdot, memory.A[0], memory.lam
    )
    if code != OK:
        return code
    evaluate_start(eqs, control.t, settings.works, memory, stage)
    record_state(integration)
    control.start = 0
    control.starts += 1
    if not control.h > 0.0:
        moving = count_velocities(work.positions, memory.v.shape[0])
        rate = start_rate(settings.rate, float("inf"), work.size, memory.v[:moving], memory.A[0])
        control.h = FIRST_STEP_RATIO / rate
    return OK


@inlined
def end_step(integration: Any) -> None:
    """There is nothing more to record."""


@inlined
def copy_last_state(memory: Memory, q: Reals, v: Reals) -> None:
    """(q, v) <- where the last step ended."""
    for i in range(q.shape[0]):
        q[i] = memory.q[i]
    for i in range(v.shape[0]):
        v[i] = memory.v[i]


@kernel
def report(integration: Integration, code: int, target: float, q: Reals, v: Reals, energy_account: Any) -> int:
    """The state at ``target``, interpolated and projected, or where the last step ended; and its energy account."""
    memory, work, control = integration.memory, integration.work, integration.memory.control[0]
    copy_last_state(memory, q, v)
    done = control.work
    if code == OK and target < control.t:
        done = interpolate(target, memory, work.stage, q, v)
        code = project_state(integration.eqs, target, q, v, work.size, work.constraints)
        if code != OK:
            copy_last_state(memory, q, v)
            done = control.work
    fill_account_row(control, done, energy_account)
    return code


advance, advance_reported = make_loop(__name__, prepare=prepare, take_step=take_step, end_step=end_step, report=report)


@kernel
def set_options(options: Any, settings_array: Any) -> None:
    """Fill the settings from a record of solvers.options.OPTIONS, ``options`` (1,)."""
    own, settings = options[0], settings_array[0]
    set_step_options(options, settings_array)
    settings.rtol, settings.stage_tolerance = max(MIN_RTOL, own.rtol), STAGE_TOLERANCE
    if own.absolute == own.rtol:
        settings.atol = settings.rtol


@kernel
def set_up(integration: Integration, t: float, known: float, duration: float) -> int:
    """Find units and the rate of the motion at the reported state, of time t (s), and project the state; return a code.

    ``known`` (1/s) is what is known of the rate beforehand, ``duration`` (s) that of the run.
    """
    eqs, settings, work, scales = integration.eqs, integration.settings[0], integration.work, integration.scales
    own, control = work.constraints, integration.memory.control[0]
    control.rank, control.keeps_factors = own.root.shape[0], settings.is_smooth
    position_sizes(work.positions, work.size, work.size_q)
    moving = count_velocities(work.positions, integration.v.shape[0])
    settings.rate = find_rate(eqs, t, integration.q, integration.v, moving, work.size, known, duration, own)
    rate = ESDIRK_RATE_TOLERANCE_RATIO * settings.rate
    set_mesh_scales(
        scales, settings.rtol, settings.atol, work.size, rate, work.size.shape[0], ESDIRK_RATE_TOLERANCE_RATIO
    )
    set_state_scales(scales, settings.atol, work.size, work.positions.states)
    set_coordinate_rates(work.positions, settings.rate, work.coordinate_rates)
    clear_growth(work)
    code: int = project_state(eqs, t, integration.q, integration.v, work.size, own)
    return code


@kernel
def start(
    memory: Memory, t: float, q: Reals, v: Reals, work: float, truncated_steps: int, keeps_position: bool
) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`.

    With friction T goes with what is given: a restored run would have other factors, so they are discarded.
    """
    control = memory.control[0]
    if truncated_steps == 0:
        control.h = 0.0
    if truncated_steps == 0 or control.keeps_factors == 0:
        control.factored_c = 0.0
    control.t, control.start, control.work = t, 1, work
    control.truncated_steps, control.last_error_step, control.retry_steps = truncated_steps, 0.0, 0
    reset_check_schedule(memory.control)
    for i in range(q.shape[0]):
        memory.q[i] = q[i]
    for i in range(v.shape[0]):
        memory.v[i] = v[i]


@kernel
def limit_steps(memory: Any, settings_array: Any, t: float, q: Reals, v: Reals, work: float, longest: float) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`."""
    settings_array[0].max_step = longest


@kernel
def count(memory: Memory, counts: Any) -> None:
    """See :class:`solvers.steppers.compiled_loop.MethodKernels`."""
    control = memory.control[0]
    counts[0], counts[1], counts[2] = control.steps, control.rejected, control.evaluations
    counts[3], counts[4], counts[5] = 0, max(0, control.starts - 1), 0


@kernel
def discard_factors(integration: Integration, options: Any) -> None:
    """Let the next step factor T again at the state that was stored for it: the memory was restored."""
    integration.memory.control[0].n_factored = -1
