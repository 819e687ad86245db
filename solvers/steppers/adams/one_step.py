"""The formulas of Dormand and Prince of orders 5(4): steps that need no history.

An input that is set at every communication point makes y' discontinuous there. A history of y' across the jumps
contains no information on what follows: restarted at every point it gives short steps of low order, and continued it
leaves errors of one sign that add up. One-step formulas use only the smooth interval between two points. Steps end at
the points, and the first stage of a step is the last one of the step before where nothing has jumped.

The stages are kept where the history of :mod:`.formulas` would be, in columns 1 to 7 of ``phi``. Source:
Dormand and Prince, J. Comp. Appl. Math. 6 (1980), 19-26, table 2; here in units of 1/h.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined
from solvers.energy_account import add_energy_error_bound
from solvers.steppers.step_control import MIN_STEP_CHANGE, STEP_SAFETY_FACTOR, TARGET_TOLERANCE

STAGES = 7
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
MAX_STEP_CHANGE = 5.0  # next step in units of this one, at most


@inlined
def stage(c: Any, H: Any, i: int) -> None:
    """State of stage i = 1, ..., 6 (6: where the step ends) in ``H.p``; stage 0 is y."""
    for j in range(H.y.shape[0]):
        total = 0.0
        for k in range(i):
            total += A[i, k] * H.phi[j, k + 1]
        H.p[j] = H.y[j] + c.h * total


@inlined
def keep_stage(H: Any, i: int) -> None:
    """Keep y' = ``H.yp`` of stage i."""
    for j in range(H.y.shape[0]):
        H.phi[j, i + 1] = H.yp[j]


@inlined
def error_of_step(c: Any, H: Any) -> float:
    """The weighted error of the step from all seven stages."""
    square = 0.0
    for j in range(H.y.shape[0]):
        total = 0.0
        for k in range(STAGES):
            total += E[k] * H.phi[j, k + 1]
        square += (c.h * total * H.weight[j]) ** 2
    return np.sqrt(square)


@inlined
def change_step(c: Any, error: float) -> None:
    """The step that this error lets be next, or again."""
    c.h *= (
        min(MAX_STEP_CHANGE, max(MIN_STEP_CHANGE, STEP_SAFETY_FACTOR * max(error, 1e-10) ** -0.2))
        if error < np.inf
        else MIN_STEP_CHANGE
    )


@inlined
def stop_at(c: Any, target: float) -> None:
    """Let the next step end at ``target``, or half way where the one after it would be shorter still.

    The length that accuracy allows stays in ``c.single``.
    """
    c.single = c.h
    left = target - c.t
    if left * (1.0 - TARGET_TOLERANCE) <= c.h:
        c.h = left
    elif left < 2.0 * c.h:
        c.h = 0.5 * left


@inlined
def take_step(c: Any, H: Any, target: float, error: float) -> None:
    """Accept ``H.trial``, whose y' is ``H.yp``, as y; the next step is as long as accuracy allows."""
    last = H.y.shape[0] - 1
    slip = 0.0
    for k in range(STAGES):
        slip += E[k] * H.phi[last, k + 1]
    c.work_total_variation += abs(H.trial[last] - H.y[last])
    add_energy_error_bound(c, c.h * slip, c.h)
    c.t = target if abs(target - c.t - c.h) <= TARGET_TOLERANCE * c.h else c.t + c.h
    c.hold = c.h
    for j in range(H.y.shape[0]):
        H.y[j] = H.trial[j]
        H.phi[j, 1] = H.yp[j]
    whole = c.h >= c.single
    change_step(c, error)
    if not whole:  # it was cut to end at the target
        c.h = max(c.h, c.single)
    c.single = c.h
    c.singles -= 1
    c.start, c.renew, c.placed, c.kold = 1, 0, 1, 5
