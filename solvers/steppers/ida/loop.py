"""IDA step by step until a time is passed: the loop between IDA and the function that accepts its steps.

It is compiled where IDA is called by its C functions, and runs in Python where scikit-sundae is in between.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, f8, i8
from solvers.outcome import BRANCHES, COLLAPSED, MAX_STEPS, NOT_FINITE, OK

STANDSTILL_RATIO = 1e-10  # relative to t and one over the rate: no step, and in PROGRESS_CHECK_STEPS steps no progress
PROGRESS_CHECK_STEPS = 5000
MAX_RETURNS_WITHOUT_STEP = 10  # returns of IDA without a step, of which one is meant
IDA_ONE_STEP = np.int32(2)
MAX_ORDER = 5  # of BDF
MAX_CONVERGENCE_FAILURES = 30  # in one step
STEP_REJECTED = -1  # besides the codes of solvers.outcome: the step is rejected, IDA must restart

N_COUNTERS = 6  # of a stepper, in this order
RESIDUALS, JACOBIANS, NONFINITE_RESIDUALS, STEPS, REJECTED_STEPS, ERROR_TEST_FAILURES = range(N_COUNTERS)


class ProgressRecord(Record):
    """Where an integration by IDA stands."""

    t_reached: f8  # s, where IDA itself stands
    t_begun: f8  # s, where its history begins
    last_step: f8  # s, its last step
    max_next_step: f8  # s, how long the next one may be
    max_step: f8  # s, of any step; a shorter one is no progress
    min_step: f8
    truncated_steps: i8  # requested times at which steps are yet to end
    steps: i8  # steps in this call
    max_steps: i8  # how many there may be
    works: i8  # 1: some force does work
    energy_check: i8  # 1: record energy and work


PROGRESS = ProgressRecord.dtype


@inlined
def next_stop(progress: ProgressRecord, t: float) -> float:
    """Time at which IDA must stop before t, s; inf if it needs no stop.

    After a step it keeps the step size, doubles or shortens it; a stop it does not reach shortens it too.
    """
    reach = min(progress.max_next_step, progress.max_step)
    if reach >= 2.0 * progress.last_step > 0.0 or np.isinf(reach):
        return t if progress.truncated_steps > 0 else np.inf
    return min(
        t if progress.truncated_steps > 0 else np.inf,
        progress.t_reached + (progress.last_step if reach >= progress.last_step > 0.0 else reach),
    )


@kernel
def step_until(ida: Any, user_data: Any, t: float) -> int:
    """Step until ``t`` is passed; return a code. IDA must not be trusted to notice that it stands still.

    ``ida.accept(t, y, y', user_data)`` checks every step, records the time reached, and returns a code.
    """
    progress, counts = user_data.progress[0], user_data.counts
    returns_without_step, nonfinite_before = 0, counts[NONFINITE_RESIDUALS]
    t_checked, steps_before = progress.t_reached, progress.steps
    while progress.t_reached < t:
        if progress.steps >= progress.max_steps:
            return MAX_STEPS
        before, stop = progress.t_reached, next_stop(progress, t)
        min_step = max(progress.min_step, STANDSTILL_RATIO * abs(progress.t_reached))
        if progress.max_next_step < min_step:
            return BRANCHES
        if stop < np.inf:
            ida.stop_at(ida.memory, stop)
        flag = ida.solve(
            ida.memory, max(t, stop) if stop < np.inf else t, ida.reached_address, ida.yy, ida.yp, IDA_ONE_STEP
        )
        ida.clear_stop(ida.memory)
        reached, stopped = ida.reached[0], NOT_FINITE if counts[NONFINITE_RESIDUALS] > nonfinite_before else COLLAPSED
        if flag < 0:
            return stopped
        if reached <= before:  # it had interpolated, and first reports its time; or t does not advance
            returns_without_step += 1
            if returns_without_step > MAX_RETURNS_WITHOUT_STEP:
                return stopped
            continue
        returns_without_step, progress.last_step = 0, reached - before
        progress.steps += 1
        code = ida.accept(reached, ida.y, ida.slopes, user_data)
        if code != OK:
            return code
        if (progress.steps - steps_before) % PROGRESS_CHECK_STEPS == 0:
            if progress.t_reached - t_checked <= min_step:
                return stopped
            t_checked = progress.t_reached
    return OK
