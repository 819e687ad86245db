"""Adams PECE on mechanisms whose constraints are eliminated along their structure, as the formulation of :mod:`.pece`.

State y = (q, v), all of it under error control. Closing is the least change of positions and velocities. Predictions
are evaluated off the constraints except near singular configurations, see
:mod:`solvers.projection.eliminated_crossing`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import f8, i8
from solvers.energy_account import energy_check_scheduled, update_energy_bound
from solvers.inertia import clear_growth
from solvers.outcome import OK
from solvers.projection.eliminated import (
    CLOSED_RESIDUAL,
    FROZEN_RESIDUAL_RATIO,
    SINGULAR_LENGTH,
    project,
)
from solvers.projection.eliminated_crossing import (
    evaluate_closed,
    evaluate_prediction,
    record_accepted,
    stays_on_branch,
)
from solvers.projection.singular import IMPERFECT
from solvers.steppers.eliminated import tolerance_scale
from solvers.steppers.step_loop import StepSettingsRecord

from .formulas import pack_state, set_tolerance_units, unpack_state
from .pece import make_pece_loop

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration


class SettingsRecord(StepSettingsRecord):
    """Options of Adams with eliminated constraints."""

    max_order: i8
    rate: f8  # of the motion, 1/s


SETTINGS = SettingsRecord.dtype
CLEARANCE_FACTOR = 2.0  # of nearly singular configurations, and of the time to them: Runge-Kutta steps are possible


@kernel
def begin(integration: Integration) -> int:
    """Make y the state under evaluation, projected unless a step has just ended there."""
    eqs, work, history = integration.eqs, integration.work, integration.memory
    control = history.control[0]
    unpack_state(history.y, work.q, work.v)
    if control.is_projected == 0:
        code = project(eqs, control.t, work.q, work.v, CLOSED_RESIDUAL, work)
        if code != OK:
            return code
        pack_state(work.q, work.v, history.y)
        work.near[0].accepted, work.near[0].time_to_singular = 0.0, np.inf  # predictions are projected
    return OK


@inlined
def motion_rate(integration: Integration) -> float:
    """Rate of the motion, 1/s."""
    return integration.settings[0].rate


@inlined
def set_error_weights(integration: Integration) -> None:
    """Error weights 1 / (rtol |y| + atol unit) at y, near singular configurations as these require."""
    history, work, settings = integration.memory, integration.work, integration.settings[0]
    scale = tolerance_scale(history.control[0], settings, history.y[: work.q_c.shape[0]], work)
    for i in range(history.y.shape[0] - 1):
        history.weight[i] = 1.0 / (scale * (settings.rtol * abs(history.y[i]) + settings.atol * history.unit[i]))


@kernel
def evaluate_derivative(integration: Integration, t: float, closing: bool) -> int:
    """y' in ``history.yp`` at (work.q, work.v), which are closed first if ``closing``."""
    eqs, work, history, settings = integration.eqs, integration.work, integration.memory, integration.settings[0]
    loaded = settings.works == 1
    history.control[0].evaluations += 1
    if closing:
        shortest = min(1.0, work.near[0].accepted)
        closed = FROZEN_RESIDUAL_RATIO * min(settings.rtol, settings.atol) * shortest * shortest
        code = project(eqs, t, work.q, work.v, max(CLOSED_RESIDUAL, closed), work)
        if code == OK:
            code = evaluate_closed(eqs, t, work.q, work.v, loaded, work, work.qdot, work.a, work.lam)
    else:
        code = evaluate_prediction(eqs, t, work.q, work.v, loaded, work, work.qdot, work.a, work.lam)
    if code == OK:
        pack_state(work.qdot, work.a, history.yp)
    return code


@inlined
def evaluate_power(integration: Integration, t: float) -> float:
    """W' at the state evaluated last; this costs an inverse dynamics."""
    eqs, work = integration.eqs, integration.work
    if integration.settings[0].works == 0:
        return 0.0
    eqs.inverse(t, work.q, work.v, work.a, work.lam, eqs.data, work.qdot_near, work.tau)
    return eqs.power(t, work.q, work.v, work.a, work.lam, eqs.data)


@kernel
def record_energy(integration: Integration, t: float) -> None:
    """Record the energy at (work.q, work.v); this costs an inverse dynamics (`solvers.energy_account`)."""
    eqs, work, control = integration.eqs, integration.work, integration.memory.control[0]
    if integration.settings[0].energy_check == 1 and energy_check_scheduled(control):
        eqs.inverse(t, work.q, work.v, work.zero, work.zero_lam, eqs.data, work.qdot_near, work.tau)
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, integration.scales)


@inlined
def accept_branch(integration: Integration, t: float) -> bool:
    """Whether the step has stayed on its branch of the motion."""
    if stays_on_branch(integration.work):
        return True
    integration.memory.control[0].refused += 1
    return False


@inlined
def respond_to_cuts(integration: Integration, cuts: int) -> None:
    """There is no other formulation."""


@inlined
def may_end_at(integration: Integration, target: float) -> bool:
    """Whether no singular configuration is near or ahead before ``target``, so that a step may end there."""
    near, t = integration.work.near[0], integration.memory.control[0].t
    return (
        near.kind != IMPERFECT
        and near.accepted >= CLEARANCE_FACTOR * SINGULAR_LENGTH
        and near.time_to_singular >= CLEARANCE_FACTOR * (target - t)
    )


@kernel
def end_step(integration: Integration) -> None:
    """Record an accepted step, and limit the next one near singular configurations."""
    work, control = integration.work, integration.memory.control[0]
    longest = record_accepted(integration.eqs, control.t, work.q, work.v, work.a, control.hold, control.h, work)
    control.h = min(control.h, longest)


@inlined
def close(integration: Integration, t: float, q: Reals, v: Reals) -> int:
    """Project a reported state onto the constraints."""
    if t < integration.memory.control[0].t:
        return project(integration.eqs, t, q, v, CLOSED_RESIDUAL, integration.work)
    return OK


@kernel
def set_up(integration: Integration, rate: float) -> None:
    """Take the rate of the motion, 1/s, and what tolerances are measured in."""
    history, settings = integration.memory, integration.settings[0]
    settings.rate = rate
    set_tolerance_units(history, settings.atol, integration.work, integration.scales)
    clear_growth(integration.work)


advance, advance_reported = make_pece_loop(
    __name__,
    begin=begin,
    motion_rate=motion_rate,
    set_error_weights=set_error_weights,
    evaluate_derivative=evaluate_derivative,
    evaluate_power=evaluate_power,
    record_energy=record_energy,
    accept_branch=accept_branch,
    respond_to_cuts=respond_to_cuts,
    may_end_at=may_end_at,
    close=close,
    end_step=end_step,
)
