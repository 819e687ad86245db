"""IDA step by step until a time is passed: the loop between IDA and what looks after its steps.

It is compiled where IDA is called by its C functions, and runs in Python where scikit-sundae is in between.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.outcome import BRANCHES, COLLAPSED, MAX_STEPS, NOT_FINITE, OK

STANDSTILL_RATIO = 1e-10  # relative to t and one over the rate: no step, and in PROGRESS_CHECK_STEPS steps no progress
PROGRESS_CHECK_STEPS = 5000
MAX_RETURNS_WITHOUT_STEP = 10  # returns of IDA without a step, of which one is meant
IDA_ONE_STEP = np.int32(2)
MAX_CONVERGENCE_FAILURES = 30  # in one step
STEP_REJECTED = -1  # besides the codes of solvers.outcome: the step is rejected, IDA must restart

N_COUNTERS = 6  # of a stepper, in this order
RESIDUALS, JACOBIANS, NONFINITE_RESIDUALS, STEPS, REJECTED_STEPS, ERROR_TEST_FAILURES = range(N_COUNTERS)
COURSE = np.dtype(
    [
        ("passed", "f8"), ("begun", "f8"),  # s, where IDA itself stands, and where its history begins
        ("taken", "f8"), ("reach", "f8"),  # s, its last step, and how long the next one may be
        ("longest", "f8"), ("instant", "f8"),  # s, of any step; of no account
        ("stops", "i8"),  # requested times at which steps are yet to end
        ("count", "i8"), ("most", "i8"),  # steps in this call, and how many there may be
        ("works", "i8"), ("energy_check", "i8"),  # 1: power is to be booked; steps are
    ],
    align=True,
)  # fmt: skip


@inlined
def stop_on_the_way(c: Any, t: float) -> float:
    """Where IDA must stop on the way to t, s; inf where it will not reach that.

    After a step it keeps the step size, doubles or shortens it; a stop it does not reach shortens it too.
    """
    reach = min(c.reach, c.longest)
    if reach >= 2.0 * c.taken > 0.0 or np.isinf(reach):
        return t if c.stops > 0 else np.inf
    return min(t if c.stops > 0 else np.inf, c.passed + (c.taken if reach >= c.taken > 0.0 else reach))


@kernel
def go(ida: Any, given: Any, t: float) -> int:
    """Step until ``t`` is passed; return a code. IDA must not be trusted to notice that it stands still.

    ``ida.accept(t, y, y', given)`` looks over every step: it notes that it is passed, and returns a code.
    """
    c, counts = given.course[0], given.counts
    stood, bad, since, first = 0, counts[NONFINITE_RESIDUALS], c.passed, c.count
    while c.passed < t:
        if c.count >= c.most:
            return MAX_STEPS
        before, stop, instant = c.passed, stop_on_the_way(c, t), max(c.instant, STANDSTILL_RATIO * abs(c.passed))
        if c.reach < instant:
            return BRANCHES
        if stop < np.inf:
            ida.stop_at(ida.memory, stop)
        flag = ida.solve(ida.memory, max(t, stop) if stop < np.inf else t, ida.told, ida.yy, ida.yp, IDA_ONE_STEP)
        ida.stop_nowhere(ida.memory)
        reached, stopped = ida.reached[0], NOT_FINITE if counts[NONFINITE_RESIDUALS] > bad else COLLAPSED
        if flag < 0:
            return stopped
        if reached <= before:  # it had interpolated, and first reports its time; or t does not advance
            stood += 1
            if stood > MAX_RETURNS_WITHOUT_STEP:
                return stopped
            continue
        stood, c.taken = 0, reached - before
        c.count += 1
        code = ida.accept(reached, ida.y, ida.slopes, given)
        if code != OK:
            return code
        if (c.count - first) % PROGRESS_CHECK_STEPS == 0:
            if c.passed - since <= instant:
                return stopped
            since = c.passed
    return OK
