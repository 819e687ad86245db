"""IDA on trees without Python: the driver of :mod:`.loop` and the calls of SUNDIALS in one kernel.

It is for hosts that fill IDA's table of addresses (:mod:`.calls`) themselves, as native FMUs do. What does not depend
on the form of the equations is that of :mod:`.dense_loop`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import kernel
from solvers.compiled.template import specialize
from solvers.energy_account import WORK, fill_account_row_at
from solvers.outcome import COLLAPSED, NOT_FINITE, OK
from solvers.steppers.compiled_loop import MethodKernels

from . import loop
from .calls import (
    ERROR_WEIGHTS,
    JACOBIAN,
    KRYLOV_DIMENSION,
    MATVEC,
    MAX_CJ_CHANGE,
    MEMORY,
    begin_history,
    clear_stop,
    create,
    interpolate,
    solve,
    stop_at,
)
from .dense_loop import count_ida_failures, limit_step, may_take_more, restart, steps_allowed
from .loop import (
    EARLIER_FAILURES,
    ERROR_TEST_FAILURES,
    REJECTED_STEPS,
    RESIDUALS,
    STARTS,
    STEPS,
    record_start,
)
from .tree_callbacks import accept_step
from .tree_memory import (
    SETTINGS as SETTINGS,  # noqa: PLC0414  # of the method
)
from .tree_memory import end_start, fill_start, report_unknowns, set_options, set_tolerances

if TYPE_CHECKING:
    from solvers.steppers.step_loop import Integration


@kernel
def begin(problem: Integration) -> int:
    """Begin a history at the reported state; return a code."""
    memory, settings = problem.memory, problem.settings[0]
    ida, t = memory.ida, memory.control[0].t
    code = fill_start(problem, t)
    if code != OK:
        return code
    if ida.words[MEMORY] == 0:
        ida.words[JACOBIAN], ida.words[MATVEC] = 0, 0
        if settings.weighs_errors == 0:
            ida.words[ERROR_WEIGHTS] = 0
        if not create(ida, KRYLOV_DIMENSION):
            return COLLAPSED
    count_ida_failures(memory)
    memory.progress[0].works = settings.works
    limits = settings.max_order, settings.max_step, MAX_CJ_CHANGE, settings.linear_tolerance
    if not begin_history(ida, t, settings.rtol, *limits):
        return COLLAPSED
    record_start(memory.progress, memory.counts, memory.energy_record, t, problem.energy_account[WORK])
    end_start(problem, t)
    return OK


step_until: Any = specialize(
    loop.step_until,
    __name__,
    {"solve": solve, "stop_at": stop_at, "clear_stop": clear_stop, "accept": accept_step},
)


@kernel
def take_steps(problem: Integration, t: float) -> int:
    """Step until t (s) is passed; return a code."""
    memory = problem.memory
    code: int = step_until(memory.ida, memory.progress, memory.counts, problem, t)
    return code


@kernel
def resume(problem: Any) -> int:
    """IDA does not restart by itself where it could not continue."""
    return COLLAPSED


@kernel
def report(problem: Integration, t: float) -> int:
    """Make the motion at t (s) the reported state; return a code."""
    if not interpolate(problem.memory.ida, t):
        return NOT_FINITE
    code: int = report_unknowns(problem, t, problem.memory.ida.y)
    if code == OK:
        fill_account_row_at(problem.memory.energy_record, t, problem.energy_account)
    return code


HOOKS = {
    "begin": begin,
    "steps_allowed": steps_allowed,
    "may_take_more": may_take_more,
    "take_steps": take_steps,
    "resume": resume,
    "report": report,
}
advance: Any = specialize(
    loop.advance, __name__, {**HOOKS, "advance_history": specialize(loop.advance_history, __name__, HOOKS)}
)


@kernel
def advance_reported(problem: Integration, t: float) -> int:
    """Advance to t (s), and report the state there; return a code."""
    code: int = advance(problem, problem.memory.progress, t)
    return code


@kernel
def start(memory: Any, t: float, q: Any, v: Any, work: float, truncated_steps: int, keeps_position: bool) -> None:
    """Begin a history at the reported state before the next step, whatever the cause."""
    restart(memory)


@kernel
def restore(problem: Any, options: Any) -> None:
    """Continue from arrays that were saved: IDA's history is not among them, and begins again."""
    memory = problem.memory
    restart(memory)
    memory.counts[EARLIER_FAILURES] = memory.counts[ERROR_TEST_FAILURES]
    set_options(options, problem)
    set_tolerances(problem)


@kernel
def count_run(memory: Any, counts: Any) -> None:
    """Write steps, rejected steps, evaluations and restarts of the run into ``counts``."""
    count_ida_failures(memory)
    own = memory.counts
    counts[0], counts[1] = int(own[STEPS]), int(own[ERROR_TEST_FAILURES] + own[REJECTED_STEPS])
    counts[2], counts[4] = int(own[RESIDUALS]), max(0, int(own[STARTS]) - 1)


IDA_KERNELS = MethodKernels(start, limit_step, count_run)
