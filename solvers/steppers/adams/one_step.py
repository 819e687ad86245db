"""The formulas of Dormand and Prince of orders 5(4): steps that need no history.

An input that is set at every communication point makes y' discontinuous there. A history of y' across the jumps
contains no information on what follows: restarted at every point it gives short steps of low order, and continued it
leaves errors of one sign that add up. One-step formulas use only the smooth interval between two points. Steps end at
the points, and the first stage of a step is the last one of the step before where nothing has jumped.

The stages are kept where the history of :mod:`.formulas` would be, in columns 1 to 7 of ``phi``. Source:
Dormand and Prince, J. Comp. Appl. Math. 6 (1980), 19-26, table 2; here in units of 1/h.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined
from solvers.energy_account import add_energy_error_bound
from solvers.steppers.step_control import MIN_STEP_CHANGE, end_of_step, step_factor, truncated_step

if TYPE_CHECKING:
    from solvers.steppers.adams.formulas import History

N_STAGES = 7
NODES = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
A = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0],
        [44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)  # the last row is the step itself
E = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])  # order 5 less order 4
DORMAND_PRINCE_EXPONENT = 0.2  # of the estimate, of order 4
MAX_START_STEP_CHANGE = 5.0  # next step in units of this one, at most


@inlined
def compute_stage(control: Any, history: History, i: int) -> None:
    """State of stage i = 1, ..., 6 (6: where the step ends) in ``history.p``; stage 0 is y."""
    for j in range(history.y.shape[0]):
        total = 0.0
        for k in range(i):
            total += A[i, k] * history.phi[j, k + 1]
        history.p[j] = history.y[j] + control.h * total


@inlined
def store_stage(history: History, i: int) -> None:
    """Keep y' = ``history.yp`` of stage i."""
    for j in range(history.y.shape[0]):
        history.phi[j, i + 1] = history.yp[j]


@inlined
def estimate_error(control: Any, history: History) -> float:
    """The weighted error of the step from all seven stages."""
    square = 0.0
    for j in range(history.y.shape[0]):
        total = 0.0
        for k in range(N_STAGES):
            total += E[k] * history.phi[j, k + 1]
        square += (control.h * total * history.weight[j]) ** 2
    return np.sqrt(square)


@inlined
def adapt_step(control: Any, error: float) -> None:
    """Set the next step, or the repeated one, from this error."""
    finite = error < np.inf
    control.h *= (
        step_factor(0.0, error, 0.0, 0.0, DORMAND_PRINCE_EXPONENT, MAX_START_STEP_CHANGE) if finite else MIN_STEP_CHANGE
    )


@inlined
def truncate_step(control: Any, target: float) -> None:
    """End the next step at ``target``; the length that accuracy allows stays in ``control.rk_step_size``."""
    control.rk_step_size = control.h
    control.h = truncated_step(control.t, control.h, target)


@inlined
def accept_runge_kutta_step(control: Any, history: History, target: float, error: float) -> None:
    """Accept ``history.trial``, whose y' is ``history.yp``, as y; the next step is as long as accuracy allows."""
    last = history.y.shape[0] - 1
    slip = 0.0
    for k in range(N_STAGES):
        slip += E[k] * history.phi[last, k + 1]
    control.work_total_variation += abs(history.trial[last] - history.y[last])
    add_energy_error_bound(control, control.h * slip, control.h)
    control.t = end_of_step(control.t, control.h, target)
    control.hold = control.h
    for j in range(history.y.shape[0]):
        history.y[j] = history.trial[j]
        history.phi[j, 1] = history.yp[j]
    whole = control.h >= control.rk_step_size
    adapt_step(control, error)
    if not whole:  # it was cut to end at the target
        control.h = max(control.h, control.rk_step_size)
    control.rk_step_size = control.h
    control.rk_steps -= 1
    control.start, control.needs_derivative, control.is_projected, control.kold = 1, 0, 1, 5
