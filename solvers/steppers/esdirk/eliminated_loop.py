"""ESDIRK3(2) with eliminated constraints over its steps, its starts and its reports, as kernels.

The step itself is in :mod:`.eliminated_steps`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import kernel
from solvers.energy_account import fill_account_row, set_state_scales, set_uniform_scales
from solvers.inertia import clear_growth
from solvers.outcome import OK
from solvers.positions import count_velocities
from solvers.projection.eliminated import CLOSED_RESIDUAL, project
from solvers.projection.eliminated_crossing import record_accepted
from solvers.resolution import start_rate
from solvers.steppers.eliminated_newton import close_state, factor_with_springs, measure_inertia
from solvers.steppers.step_control import FIRST_STEP_RATIO
from solvers.steppers.step_loop import make_loop

from .eliminated_steps import SETTINGS as SETTINGS  # noqa: PLC0414  # of the method
from .eliminated_steps import copy_closed, pack, take_step
from .formulas import GAMMA, evaluate_start, interpolate, record_energy
from .loop import ESDIRK_RATE_TOLERANCE_RATIO, copy_last_state

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration


@kernel
def prepare(integration: Integration) -> int:
    """Close the state and take accelerations where the next step begins, after a start or a change; return a code."""
    settings, memory, work = integration.settings[0], integration.memory, integration.work
    control, newton = memory.control[0], work.newton
    if control.start == 0:
        return OK
    own, near = newton.work, newton.work.loops.near[0]
    near.accepted, near.time_to_singular = 0.0, np.inf
    pack(memory.q, memory.v, work.y)
    code: int = close_state(control.t, work.y, True, newton)
    if code != OK:
        return code
    copy_closed(integration)
    for i in range(own.q.shape[0]):
        memory.q[i] = own.q[i]
    for i in range(own.v.shape[0]):
        memory.v[i], memory.A[0, i] = own.v[i], own.a[i]
    for row in range(own.lam.shape[0]):
        memory.lam[row] = own.lam[row]
    evaluate_start(integration.eqs, control.t, settings.works, memory, work.stage)
    if settings.energy_check == 1:
        record_energy(integration.eqs, memory, work.stage, integration.scales)
    control.start = 0
    control.starts += 1
    if not control.h > 0.0:
        moving = count_velocities(own.positions, memory.v.shape[0])
        rate = start_rate(settings.rate, np.inf, own.loops.size, memory.v[:moving], memory.A[0])
        control.h = FIRST_STEP_RATIO / rate
        if own.inertia[0] == 0.0:
            measure_inertia(control.t, 1.0 / (GAMMA * control.h), newton)
    return OK


@kernel
def end_step(integration: Integration) -> None:
    """Record the branch of the accepted step, and limit the next one before a critical point."""
    control, own = integration.memory.control[0], integration.work.newton.work
    h = control.hold
    longest = record_accepted(integration.eqs, control.t, own.q, own.v, own.a, h, control.h, own.loops)
    control.h = min(control.h, longest)


@kernel
def report(integration: Integration, code: int, target: float, q: Reals, v: Reals, energy_account: Any) -> int:
    """The state at ``target``, interpolated and projected, or where the last step ended; and its energy account."""
    memory, work, control = integration.memory, integration.work, integration.memory.control[0]
    copy_last_state(memory, q, v)
    done = control.work
    if code == OK and target < control.t:
        done = interpolate(target, memory, work.stage, q, v)
        code = project(integration.eqs, target, q, v, CLOSED_RESIDUAL, work.newton.work.loops)
        if code != OK:
            copy_last_state(memory, q, v)
            done = control.work
    fill_account_row(control, done, energy_account)
    return code


advance, advance_reported = make_loop(__name__, prepare=prepare, take_step=take_step, end_step=end_step, report=report)


@kernel
def set_up(integration: Integration, rate: float) -> None:
    """Take the rate of the motion, 1/s, and what tolerances are measured in."""
    settings, loops, control = (
        integration.settings[0],
        integration.work.newton.work.loops,
        integration.memory.control[0],
    )
    settings.rate, settings.max_near_miss_factor = rate, 1.0
    control.rank, control.keeps_factors = loops.near[0].rank, 1
    uncontrolled = ESDIRK_RATE_TOLERANCE_RATIO * rate  # errors of rates are not controlled
    set_uniform_scales(integration.scales, settings.rtol, settings.atol, loops.size, uncontrolled, 1)
    set_state_scales(integration.scales, settings.atol, loops.size, loops.positions.states)
    clear_growth(loops)


@kernel
def renew_factors(integration: Integration) -> None:
    """Factor the tangent again at the state that was stored for it: the memory was restored."""
    own, eqs = integration.work.newton.work, integration.eqs
    if integration.memory.control[0].factored_c > 0.0:
        eqs.inverse(
            own.t[0], own.q_factored, own.v_factored, own.a_factored, own.lam_factored, eqs.data, own.loops.qdot_near,
            own.tau_factored,
        )  # fmt: skip
        factor_with_springs(integration.work.newton)
