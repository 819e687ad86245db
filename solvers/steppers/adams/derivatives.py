"""Adams PECE in dense form: error weights, derivatives, power and energy at a state; see :mod:`.loop`."""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import inlined, kernel
from solvers.energy_account import energy_check_scheduled, update_energy_bound
from solvers.inertia import tolerance_factor, update_growth
from solvers.outcome import NOT_CLOSED, OK
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
from solvers.projection.singular import IMPERFECT
from solvers.projection.workspace import factor
from solvers.steppers.step_control import MIN_RTOL_TIMES_GAP

from .formulas import pack_state
from .hybrid import HYBRID, LU

FROZEN_JACOBIAN_RATIO = 1e-3  # part of the tolerance: a smaller correction of the position needs no new J


@inlined
def set_error_weights(control: Any, settings: Any, history: Any, nq: int, n: int, work: Any) -> None:
    """Error weights 1 / (rtol |y| + atol unit) at y; with 'adams-lu' dependent coordinates get none: they are not
    controlled.

    Near a near miss rounding limits the accuracy: a smaller tolerance only makes steps smaller.
    """
    control.near_miss_factor = 1.0
    if work.critical[0].kind == IMPERFECT:
        gap = abs(work.critical[0].bifurcation_gap)
        control.near_miss_factor = max(1.0, MIN_RTOL_TIMES_GAP / (gap * settings.rtol))
        if control.near_miss_factor > control.max_near_miss_factor:
            control.max_near_miss_factor, control.min_gap = control.near_miss_factor, gap
    scale = control.near_miss_factor * tolerance_factor(settings.rtol, 1.0, work)
    for i in range(nq + n):
        history.weight[i] = 1.0 / (scale * (settings.rtol * abs(history.y[i]) + settings.atol * history.unit[i]))
    if settings.partition == LU:
        for j in range(control.rank):
            history.weight[nq + history.columns[j]] = 0.0
            if nq == n:
                history.weight[history.columns[j]] = 0.0


@kernel
def evaluate_derivative(eqs: Any, t: float, closing: bool, control: Any, settings: Any, history: Any, work: Any) -> int:
    """y' in ``history.yp`` at (work.q, work.v), which are closed first where ``closing`` or in the LU regime."""
    q, v, rank = work.q, work.v, control.rank
    control.evaluations += 1
    if control.regime == LU:
        if settings.partition == LU:
            restore_dependents(rank, history.columns, history.y, q, v)
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
def evaluate_power(eqs: Any, t: float, control: Any, settings: Any, history: Any, work: Any) -> float:
    """W' at the state evaluated last, with v' in ``work.slope``."""
    if settings.works == 0:
        return 0.0
    if control.regime == LU:
        evaluate_dependent_multipliers(
            eqs.terms, control.rank, history.rows, history.columns, work, work.slope, work.lam
        )
    else:
        evaluate_multipliers(eqs.terms, control.rank, work, work.slope, work.lam)
    return eqs.power(t, work.q, work.v, work.slope, work.lam, eqs.data)


@kernel
def record_energy(eqs: Any, t: float, control: Any, settings: Any, scales: Any, work: Any) -> None:
    """Record the energy at the state evaluated last, before :func:`evaluate_power` (`solvers.energy_account`)."""
    update_growth(t, eqs.terms.M, work.v, work)
    if settings.energy_check == 1 and energy_check_scheduled(control):
        update_energy_bound(eqs.evaluate_energy_bound, eqs.data, control, scales)
        control.step_energy_error_bound *= max(1.0, control.near_miss_factor)
