"""Step-size control that several methods share; that of multistep methods is in :mod:`.adams.order_control`.

The error of a step of h is C h^(p + 1), p the order of its estimate: with the error e in tolerances the step that has
the error 1 is h e^(-1 / (p + 1)). From the last two steps follows how C changes (Gustafsson, *ACM Trans. Math. Softw.*
20, 1994, 496-517; Hairer and Wanner 1996, section IV.8, eq. 8.25): the next step is the shorter of the two.
"""

from __future__ import annotations

from typing import Any

from solvers.compiled.kernel import inlined
from solvers.projection.singular import IMPERFECT
from solvers.resolution import is_discontinuity, min_step_length

FIRST_STEP_RATIO = 0.1  # first step, in units of one over the rate of the motion
MIN_STEP_RATIO = 1e-11  # see solvers.resolution.min_step_length
STEP_SAFETY_FACTOR = 0.9  # of the step that follows from the error estimate
MIN_STEP_CHANGE = 0.2  # next step in units of this one, at least
TARGET_TOLERANCE = 1e-9  # part of a step: a step ends at the requested time if its end is so near
MIN_CONTROLLED_ERROR = 1e-8  # tolerances: a smaller error does not make the next step longer
MIN_RECORDED_ERROR = 1e-2  # tolerances: a smaller error of the last step counts as this one
MIN_RTOL_TIMES_GAP = 3e-18  # rtol that rounding allows near a near miss, times its gap; found by trial
TRUNCATED_STEPS = 12  # steps after a change of the loads that end at the requested time: another change is likely there


@inlined
def step_factor(
    h: float, error: float, last_error: float, last_step: float, exponent: float, max_change: float
) -> float:
    """Factor of the next step of a one-step method after one of h (s) with this error, in tolerances.

    ``exponent`` is 1 / (p + 1). The last accepted step was of ``last_step`` (s), with ``last_error``; 0 s: there is
    none, or this step is rejected.
    """
    controlled = MIN_CONTROLLED_ERROR if error < MIN_CONTROLLED_ERROR else error
    factor = STEP_SAFETY_FACTOR * controlled**-exponent
    if last_step > 0.0:
        factor = min(factor, STEP_SAFETY_FACTOR * h / last_step * (last_error / controlled**2) ** exponent)
    if not factor > MIN_STEP_CHANGE:  # also of an error that is not a number
        return MIN_STEP_CHANGE
    return min(max_change, factor)


@inlined
def truncated_step(t: float, h: float, target: float) -> float:
    """Length of a step from t that ends at ``target``, or half way if the one after it would be shorter still."""
    left = target - t
    if left * (1.0 - TARGET_TOLERANCE) <= h:
        return left
    return 0.5 * left if left < 2.0 * h else h


@inlined
def end_of_step(t: float, h: float, target: float) -> float:
    """Time at which a step of h from t ends: ``target`` itself if that is so near."""
    return target if abs(target - t - h) <= TARGET_TOLERANCE * h else t + h


@inlined
def retry_step(h: float, rate: float, max_step: float, t: float, may_force: bool) -> tuple[float, bool]:
    """Step to attempt at time t after a rejected one, s, and whether it is accepted with any error; 0 s: none is left.

    ``h`` is the step that follows from the rejection. If it is too short for the ``rate`` of the motion (1/s) and the
    longest step ``max_step`` (s), only a known jump of a signal allows another attempt, with the shortest step. There
    the error cannot be made smaller, so it is accepted: ``may_force`` is whether the error is the only reason of the
    rejection, and no such step has been tried.
    """
    shortest = min_step_length(MIN_STEP_RATIO, rate, max_step, t)
    if h > shortest:
        return h, False
    if may_force and is_discontinuity(max_step, t):
        return shortest, True
    return 0.0, False


@inlined
def set_near_miss_factor(control: Any, rtol: float, kind: int, bifurcation_gap: float) -> None:
    """Factor of the tolerances in ``control``: near a near miss rounding limits the accuracy, and a smaller tolerance
    only makes steps smaller. ``kind`` and ``bifurcation_gap`` are those of the known critical point.
    """
    control.near_miss_factor = 1.0
    if kind == IMPERFECT:
        gap = abs(bifurcation_gap)
        control.near_miss_factor = max(1.0, MIN_RTOL_TIMES_GAP / (gap * rtol))
        if control.near_miss_factor > control.max_near_miss_factor:
            control.max_near_miss_factor, control.min_gap = control.near_miss_factor, gap
