"""One step of ESDIRK3(2) with eliminated constraints: its stages, Newton's iterations, and the error, as kernels.

With P(y) the nearest state on the constraints and f(y) the equations of motion there, the stages (:mod:`.formulas`) are
those of y' = f(P(y)), y = (q, v)::

    c (y_i - y_e) - f(P(y_i)) = 0,      y_e = y + h sum_j<i a_ij s_j,      s_j = c (y_j - y_e)

The stage equations have no multipliers, so the order is that for ordinary differential equations. The last stage is
closed, which ends the step. Newton's method is simplified: its matrix (:mod:`solvers.steppers.eliminated_newton`) is
kept until corrections decrease slowly. Singular configurations, crossings and near misses are treated as by 'adams'.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import f8
from solvers.outcome import COLLAPSED, NOT_FINITE, OK
from solvers.positions import as_slope, count_velocities
from solvers.steppers.eliminated import tolerance_scale
from solvers.steppers.eliminated_newton import (
    apply_preconditioner,
    close_state,
    factor_tangent,
    is_on_branch,
)
from solvers.system import Array

from . import steps
from .attempts import make_take_step
from .formulas import (
    GAMMA,
    MAX_STAGE_CORRECTIONS,
    N_STAGES,
    A,
    C,
    estimate_error,
    estimate_rate_error,
    has_corner,
    record_energy,
    set_state_tolerances,
)
from .steps import (
    DRIFT_FACTOR,
    ERROR_TOLERANCE_RATIO,
    FACTOR_REUSE_TOLERANCE,
    FIRST_CONTRACTION,
    MAX_REFACTORIZATIONS,
    MIN_CONTRACTION,
    MIN_SQUARED_MOTION,
    NEGLIGIBLE_CORRECTION,
    ROUNDING_OF_CORRECTIONS,
    VELOCITY_TOLERANCE_RATIO,
    larger_or_nan,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration

MAX_KEPT_CONTRACTION = 0.3  # above this rate of convergence the matrix is renewed


class SettingsRecord(steps.SettingsRecord):
    """Options of ESDIRK with eliminated constraints."""

    near_miss_factor: f8  # of the tolerance, now and the largest; see set_near_miss_factor
    max_near_miss_factor: f8
    min_gap: f8


SETTINGS = SettingsRecord.dtype


class StageWork(NamedTuple):
    """A stage and what it is solved with; N = nq + n unknowns."""

    newton: Any  # Integration with solvers.steppers.eliminated_newton.Work and ImplicitEquations, pinned
    stage: Any  # .formulas.Stage, pinned: where the step ends, and its error
    y: Array  # (N,) unknowns
    y_e: Array  # (N,) what is known of them
    r: Array  # (N,) residual
    z: Array  # (N,) correction

    @staticmethod
    def allocate(nq: int, n: int, newton: Any, stage: Any) -> StageWork:
        """Return zeroed arrays."""
        return StageWork(newton, stage, *(np.zeros(nq + n) for _ in range(4)))


@inlined
def pack(q: Reals, v: Reals, y: Reals) -> None:
    """y <- (q, v)."""
    nq = q.shape[0]
    for i in range(nq):
        y[i] = q[i]
    for i in range(v.shape[0]):
        y[nq + i] = v[i]


@inlined
def copy_closed(integration: Integration) -> None:
    """The closed state that was evaluated last becomes that of the stage, with its multipliers."""
    own, stage = integration.work.newton.work, integration.work.stage
    for i in range(own.q.shape[0]):
        stage.q[i] = own.q[i]
    for i in range(own.v.shape[0]):
        stage.v[i] = own.v[i]
    for row in range(own.lam.shape[0]):
        stage.lam[row] = own.lam[row]


@kernel
def set_tolerances(integration: Integration) -> None:
    """Tolerances of the positions in this step, near singular configurations as these require."""
    settings, memory, work = integration.settings[0], integration.memory, integration.work
    loops, stage, control = work.newton.work.loops, work.stage, memory.control[0]
    scale = ERROR_TOLERANCE_RATIO * tolerance_scale(settings, settings, memory.q, loops)
    control.max_near_miss_factor, control.min_gap = settings.max_near_miss_factor, settings.min_gap
    for k in range(stage.tol.shape[0]):
        stage.tol[k] = scale * (settings.atol * loops.size[k])
    for k in range(stage.in_q.shape[0]):
        stage.tol[stage.in_v[k]] += scale * settings.rtol * abs(memory.q[stage.in_q[k]])
    for k in range(stage.states.shape[0]):
        z = stage.states[k]
        stage.state_tol[z] = stage.tol[z] + scale * settings.rtol * abs(memory.v[z])


@kernel
def try_step(h: float, after: float, integration: Integration) -> tuple[int, float]:
    """Solve the stages of a step of h, and close its end; return a code, and the error in tolerances."""
    settings, memory, work = integration.settings[0], integration.memory, integration.work
    control, stage, newton, c = memory.control[0], work.stage, work.newton, 1.0 / (GAMMA * h)
    coarsest = 0.0
    set_state_tolerances(c, stage)
    for k in range(count_velocities(newton.work.positions, stage.tol.shape[0])):
        coarsest = max(coarsest, stage.tol[k] / newton.work.loops.size[k])
    rounding, motion = ROUNDING_OF_CORRECTIONS / coarsest, (settings.rate * h) ** 2
    tolerance = min(settings.stage_tolerance, DRIFT_FACTOR * motion) if motion > MIN_SQUARED_MOTION else rounding
    pack(memory.q, memory.v, work.y)
    if abs(control.factored_c - c) > FACTOR_REUSE_TOLERANCE * c and not factor(control.t, c, integration):
        return COLLAPSED, np.inf
    for i in range(1, N_STAGES):
        is_last = i == N_STAGES - 1
        at = after if is_last else control.t + C[i] * h
        predict_stage(i, h, integration)
        code = solve_stage(at, c, tolerance, rounding, integration)
        if code == OK and (is_last or settings.works == 1):
            code = close_state(at, work.y, True, newton)
        if code != OK:
            return code, np.inf
        store_stage(i, at, c, integration)
    if not is_on_branch(work.y, newton):
        return COLLAPSED, np.inf
    copy_closed(integration)
    estimate_error(h, memory, stage)
    filter_error(c, integration)
    moving = count_velocities(newton.work.positions, stage.tol.shape[0])
    error = largest_error(1.0, stage.tol.shape[0], integration)
    estimate_rate_error(h, memory, stage)
    as_slope(stage.q, stage.dq, stage, stage.slope)
    for k in range(stage.states.shape[0]):
        stage.dq[stage.states[k]] = 0.0
    filter_error(c, integration)
    control.rate_error = largest_error(VELOCITY_TOLERANCE_RATIO * settings.rate, moving, integration)
    return OK, larger_or_nan(error, control.rate_error) if has_corner(h, control) else error


@kernel
def predict_stage(i: int, h: float, integration: Integration) -> None:
    """y_e of stage i, and a first guess from the stage before it, in work.y: on at its velocity."""
    memory, work, nq = integration.memory, integration.work, integration.memory.q.shape[0]
    for k in range(nq):
        work.y_e[k] = memory.q[k]
        work.y[k] += (C[i] - C[i - 1]) * h * memory.Q[i - 1, k]
    for k in range(memory.v.shape[0]):
        work.y_e[nq + k] = memory.v[k]
    for j in range(i):
        a = h * A[i, j]
        for k in range(nq):
            work.y_e[k] += a * memory.Q[j, k]
        for k in range(memory.v.shape[0]):
            work.y_e[nq + k] += a * memory.A[j, k]


@kernel
def solve_stage(t: float, c: float, tolerance: float, rounding: float, integration: Integration) -> int:
    """Solve the stage from its first guess to ``tolerance`` tolerances; return a code.

    Corrections below ``rounding`` tolerances that do not decrease are rounding errors.
    """
    work, newton, control = integration.work, integration.work.newton, integration.memory.control[0]
    own, nq = newton.work, integration.memory.q.shape[0]
    contraction, before, first, n_refactored = FIRST_CONTRACTION, 0.0, 0, 0
    for k in range(MAX_STAGE_CORRECTIONS):
        control.evaluations += 1
        if k - first > 1 and contraction > MAX_KEPT_CONTRACTION and n_refactored < MAX_REFACTORIZATIONS:
            n_refactored, first = n_refactored + 1, k
            if not factor(t, c, integration):
                return COLLAPSED
        code = close_state(t, work.y, False, newton)
        if code != OK:
            return code
        for i in range(nq):
            work.r[i] = c * (work.y[i] - work.y_e[i]) - own.qdot[i]
        for i in range(own.a.shape[0]):
            work.r[nq + i] = c * (work.y[nq + i] - work.y_e[nq + i]) - own.a[i]
        apply_preconditioner(work.y, work.r, work.z, newton)
        size = 0.0
        for i in range(own.dtheta.shape[0]):
            part = abs(own.dtheta[i]) / work.stage.tol[i]
            if not part <= size:
                size = part
        if not np.isfinite(size):
            return NOT_FINITE
        for i in range(work.y.shape[0]):
            work.y[i] -= work.z[i]
        contraction = max(MIN_CONTRACTION, size / before) if k > first else contraction
        if size <= NEGLIGIBLE_CORRECTION * tolerance or contraction * size <= tolerance * (1.0 - contraction):
            return OK
        if k > first and size <= rounding and contraction > MAX_KEPT_CONTRACTION:
            return OK
        before = size
    return COLLAPSED


@kernel
def factor(t: float, c: float, integration: Integration) -> bool:
    """Factor the tangent for ``c`` at the unknowns work.y, closed; False: it is singular there."""
    control, newton = integration.memory.control[0], integration.work.newton
    control.factored_c = 0.0
    if close_state(t, integration.work.y, True, newton) != OK or not factor_tangent(t, c, newton):
        return False
    newton.work.is_damped[0], control.factored_c = 1.0, c
    return True


@kernel
def store_stage(i: int, t: float, c: float, integration: Integration) -> None:
    """Keep the slopes of stage i, and its power."""
    memory, work, nq = integration.memory, integration.work, integration.memory.q.shape[0]
    eqs, own = integration.eqs, integration.work.newton.work
    for k in range(nq):
        memory.Q[i, k] = c * (work.y[k] - work.y_e[k])
    for k in range(memory.v.shape[0]):
        memory.A[i, k] = c * (work.y[nq + k] - work.y_e[nq + k])
    memory.P[i] = 0.0
    if integration.settings[0].works == 1:
        eqs.inverse(t, own.q, own.v, own.a, own.lam, eqs.data, own.loops.qdot_near, own.load)
        memory.P[i] = eqs.power(t, own.q, own.v, own.a, own.lam, eqs.data)


@kernel
def filter_error(c: float, integration: Integration) -> None:
    """dtheta <- the error stage.slope (nq,), and stage.dq of first-order states. As a motion e (n,) its part
    that the constraints allow is filtered by (c^2 M + c D + K)^-1 (c^2 M + c D). Without D e, slow motions against
    strong dampers would count too little. The other part is left as it is: it is that of driven motions.
    """
    work, own, nq = integration.work, integration.work.newton.work, integration.memory.q.shape[0]
    for i in range(nq):
        work.r[i] = c * work.stage.slope[i]
    for i in range(own.dtheta.shape[0]):
        work.r[nq + i] = 0.0
    for k in range(work.stage.states.shape[0]):
        z = work.stage.states[k]
        work.r[nq + z] = c * c * work.stage.dq[z]
    apply_preconditioner(work.y, work.r, work.z, work.newton)


@inlined
def largest_error(scale: float, count: int, integration: Integration) -> float:
    """The largest of the first ``count`` filtered errors, in tolerances of the coordinates times ``scale``."""
    dtheta, tol, largest = integration.work.newton.work.dtheta, integration.work.stage.tol, 0.0
    for i in range(count):
        largest = larger_or_nan(largest, abs(dtheta[i]) / (scale * tol[i]))
    return largest


@inlined
def record_state(integration: Integration) -> None:
    """Record the energy where the last step ended."""
    if integration.settings[0].energy_check == 1:
        record_energy(integration.eqs, integration.memory, integration.work.stage, integration.scales)


take_step = make_take_step(__name__, set_tolerances=set_tolerances, try_step=try_step, record_state=record_state)
