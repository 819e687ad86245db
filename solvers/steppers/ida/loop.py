"""IDA step by step until a time is passed, with restarts: the driver around IDA, as templates.

Hooks are the calls of IDA, the function that accepts its steps, and what a stepper does at starts and reports
(:mod:`solvers.compiled.template`). :func:`step_until` is compiled where IDA is called by its C functions, and plain
Python where scikit-sundae is in between. :func:`advance` is plain Python in steppers, and compiled in native FMUs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, f8, i8
from solvers.energy_account import restart_work
from solvers.outcome import BRANCHES, COLLAPSED, MAX_STEPS, NOT_FINITE, OK

if TYPE_CHECKING:
    from solvers.compiled.record import Reals

STANDSTILL_RATIO = 1e-10  # relative to t and one over the rate: no step, and in PROGRESS_CHECK_STEPS steps no progress
PROGRESS_CHECK_STEPS = 5000
MAX_RETURNS_WITHOUT_STEP = 10  # returns of IDA without a step, of which one is meant
IDA_ONE_STEP = np.int32(2)
MAX_ORDER = 5  # of BDF
MAX_CONVERGENCE_FAILURES = 30  # in one step
STEP_REJECTED = -1  # besides the codes of solvers.outcome: the step is rejected, IDA must restart

N_COUNTERS = 8  # of a stepper, in this order; STARTS: histories of IDA; the last: failures before the present history
(
    RESIDUALS, JACOBIANS, NONFINITE_RESIDUALS, STEPS, REJECTED_STEPS, ERROR_TEST_FAILURES, STARTS, EARLIER_FAILURES,
) = range(N_COUNTERS)  # fmt: skip


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
    is_pending: i8  # 1: a history is to begin at the reported state


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
def count_failures(progress_record: Any, counts: Reals, rejected: float) -> None:
    """Count the steps whose error was too large, of which ``rejected`` are in the present history of IDA."""
    if progress_record[0].is_pending == 0:
        counts[ERROR_TEST_FAILURES] = counts[EARLIER_FAILURES] + rejected


@kernel
def record_start(progress_record: Any, counts: Reals, energy_record: Any, t: float, work_done: float) -> None:
    """Record that a history of IDA begins at t (s), where the work done is ``work_done``, J."""
    progress = progress_record[0]
    counts[EARLIER_FAILURES] = counts[ERROR_TEST_FAILURES]
    counts[STARTS] += 1.0
    progress.is_pending, progress.t_reached, progress.t_begun, progress.last_step = 0, t, t, 0.0
    restart_work(energy_record, work_done)


def solve(ida: Any, t: float) -> int:
    """Hook: take a step towards t (s); return IDA's status."""
    raise NotImplementedError


def stop_at(ida: Any, t: float) -> None:
    """Hook: stop at t (s) if the next step reaches it."""
    raise NotImplementedError


def clear_stop(ida: Any) -> None:
    """Hook: remove the stop."""
    raise NotImplementedError


def accept(t: float, y: Any, slopes: Any, user_data: Any) -> int:
    """Hook: check a step to (t, y, y'), record the time reached, and return a code."""
    raise NotImplementedError


def step_until(ida: Any, progress_record: Any, counts: Any, user_data: Any, t: float) -> int:
    """Step until ``t`` is passed; return a code. IDA must not be trusted to notice that it stands still.

    ``ida`` has the results of a step: ``reached`` (1,), ``y`` and ``slopes``.
    """
    progress = progress_record[0]
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
            stop_at(ida, stop)
        flag = solve(ida, max(t, stop) if stop < np.inf else t)
        clear_stop(ida)
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
        code = accept(reached, ida.y, ida.slopes, user_data)
        if code != OK:
            return code
        if (progress.steps - steps_before) % PROGRESS_CHECK_STEPS == 0:
            if progress.t_reached - t_checked <= min_step:
                return stopped
            t_checked = progress.t_reached
    return OK


def begin(run: Any) -> int:
    """Hook: begin a history at the reported state; return a code."""
    raise NotImplementedError


def steps_allowed(run: Any) -> int:
    """Hook: how many steps :func:`take_steps` may take in all in this call."""
    raise NotImplementedError


def may_take_more(run: Any) -> bool:
    """Hook: whether more steps may follow after as many as :func:`steps_allowed`."""
    raise NotImplementedError


def take_steps(run: Any, t: float) -> int:
    """Hook: :func:`step_until` t, s."""
    raise NotImplementedError


def resume(run: Any) -> int:
    """Hook: restart at the end of the last good step, after IDA could not continue; return a code."""
    raise NotImplementedError


def report(run: Any, t: float) -> int:
    """Hook: make the motion at t (s) the reported state; return a code."""
    raise NotImplementedError


def advance(run: Any, progress_record: Any, t: float) -> int:
    """Advance to t (s), and report the state there; return a code."""
    progress = progress_record[0]
    code = begin(run) if progress.is_pending == 1 else OK
    if code != OK:
        return code
    code = advance_history(run, progress_record, t)
    progress.truncated_steps = max(0, progress.truncated_steps - 1)
    if code not in (OK, MAX_STEPS):
        progress.is_pending = 1
    return code


def advance_history(run: Any, progress_record: Any, t: float) -> int:
    """Step until ``t`` is passed, with restarts, and report the state there."""
    progress = progress_record[0]
    progress.steps = 0
    while True:
        progress.max_steps = steps_allowed(run)
        code = take_steps(run, t) if progress.t_reached < t else OK
        if code == MAX_STEPS and may_take_more(run):
            continue
        if not (code == STEP_REJECTED or (code == COLLAPSED and progress.t_reached > progress.t_begun)):
            return report(run, t) if code == OK else code
        code = resume(run)
        if code != OK:
            return code
