"""Error weights, derivatives, power and energy by matrices: hooks of :mod:`.pece`, used by :mod:`.loop`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, update_energy_bound
from solvers.inertia import tolerance_factor, update_growth
from solvers.outcome import NOT_CLOSED, OK
from solvers.positions import has_quaternions
from solvers.projection.lu_partition import (
    evaluate_dependent_acceleration,
    evaluate_dependent_multipliers,
    factor_dependent,
    project_dependents,
    restore_dependents,
)  # fmt: skip
from solvers.projection.projection import (
    evaluate_acceleration,
    evaluate_multipliers,
    is_near_bifurcation,
    project,
    project_with_frozen_jacobian,
)
from solvers.projection.workspace import factor
from solvers.steppers.step_control import set_near_miss_factor

from .formulas import pack_state
from .hybrid import HYBRID, LU

if TYPE_CHECKING:
    from solvers.steppers.step_loop import Integration

FROZEN_JACOBIAN_RATIO = 1e-3  # part of the tolerance: a smaller correction of the position needs no new J


@inlined
def set_error_weights(integration: Integration) -> None:
    """Error weights 1 / (rtol |y| + atol unit) at y; with 'adams-lu' dependent coordinates get none: they are not
    controlled.
    """
    history, work, settings = integration.memory, integration.work, integration.settings[0]
    control, nq, n = history.control[0], work.q.shape[0], work.v.shape[0]
    set_near_miss_factor(control, settings.rtol, work.critical[0].kind, work.critical[0].bifurcation_gap)
    scale = control.near_miss_factor * tolerance_factor(settings.rtol, 1.0, work)
    for i in range(nq + n):
        history.weight[i] = 1.0 / (scale * (settings.rtol * abs(history.y[i]) + settings.atol * history.unit[i]))
    if settings.partition == LU:
        for j in range(control.rank):
            history.weight[nq + history.columns[j]] = 0.0
            if not has_quaternions(nq, n, work.states):
                history.weight[history.columns[j]] = 0.0


@kernel
def evaluate_derivative(integration: Integration, t: float, closing: bool) -> int:
    """y' in ``history.yp`` at (work.q, work.v), which are closed first where ``closing`` or in the LU regime."""
    eqs, work, history, settings = integration.eqs, integration.work, integration.memory, integration.settings[0]
    control = history.control[0]
    q, v, rank = work.q, work.v, control.rank
    control.evaluations += 1
    if control.regime == LU:
        if settings.partition == LU:
            restore_dependents(rank, history.columns, history.y, q, v, work.states)
        if closing or settings.partition == LU:
            hybrid = settings.partition == HYBRID
            code = project_dependents(eqs, t, q, v, rank, history.rows, history.columns, hybrid, work)
        else:
            eqs.dynamics(t, q, v, eqs.data, eqs.terms)
            code = OK if factor_dependent(eqs.terms, rank, history.rows, history.columns, work) else NOT_CLOSED
        if code == OK:
            code = evaluate_dependent_acceleration(eqs.terms, rank, history.rows, history.columns, work, work.slope)
    else:
        code = OK
        if closing:
            code = project_with_frozen_jacobian(
                eqs, t, q, v, history.p, rank, FROZEN_JACOBIAN_RATIO * min(settings.rtol, settings.atol), work
            )
        else:
            eqs.dynamics(t, q, v, eqs.data, eqs.terms)
            factor(eqs.terms, work)
            if is_near_bifurcation(rank, work):  # v' of what is not closed is wrong by the inverse square of its pivot
                code = project(eqs, t, q, v, rank, work)
        if code == OK:
            code = evaluate_acceleration(eqs, t, q, v, rank, work, work.slope)
    if code == OK:
        pack_state(eqs.terms.qdot, work.slope, history.yp)
    return code


@kernel
def evaluate_power(integration: Integration, t: float) -> float:
    """W' at the state evaluated last, with v' in ``work.slope``."""
    eqs, work, history = integration.eqs, integration.work, integration.memory
    control = history.control[0]
    if integration.settings[0].works == 0:
        return 0.0
    if control.regime == LU:
        evaluate_dependent_multipliers(
            eqs.terms, control.rank, history.rows, history.columns, work, work.slope, work.lam
        )
    else:
        evaluate_multipliers(eqs.terms, control.rank, work, work.slope, work.lam)
    return eqs.power(t, work.q, work.v, work.slope, work.lam, eqs.data)


@kernel
def record_energy(integration: Integration, t: float) -> None:
    """Record the energy at the state evaluated last (`solvers.energy_account`)."""
    eqs, work, control = integration.eqs, integration.work, integration.memory.control[0]
    update_growth(t, eqs.terms.M, work.v, work)
    if integration.settings[0].energy_check == 1 and energy_check_scheduled(control):
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, integration.scales)
        control.step_energy_error_bound *= max(1.0, control.near_miss_factor)
