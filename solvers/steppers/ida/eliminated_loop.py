"""IDA with eliminated constraints without Python: the driver of :mod:`.loop` and the calls of SUNDIALS in one kernel.

It is for hosts that fill IDA's table of addresses (:mod:`.calls`) themselves, as native FMUs do. What does not depend
on the form of the equations is that of :mod:`.dense_loop` and :mod:`.tree_loop`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import kernel
from solvers.compiled.template import specialize
from solvers.energy_account import WORK, fill_account_row_at
from solvers.outcome import COLLAPSED, NOT_FINITE, OK

from . import loop
from .calls import (
    ERROR_WEIGHTS,
    JACOBIAN,
    KRYLOV_DIMENSION,
    LINEAR_TOLERANCE,
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
from .dense_loop import count_ida_failures, may_take_more, restart, steps_allowed
from .eliminated_callbacks import accept_step, end_start, fill_start, report_unknowns
from .eliminated_memory import (
    SETTINGS as SETTINGS,  # noqa: PLC0414  # of the method
)
from .eliminated_memory import set_options, set_tolerances
from .loop import EARLIER_FAILURES, ERROR_TEST_FAILURES, record_start

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
        ida.words[JACOBIAN], ida.words[MATVEC], ida.words[ERROR_WEIGHTS] = 0, 0, 0
        if not create(ida, KRYLOV_DIMENSION):
            return COLLAPSED
    count_ida_failures(memory)
    memory.progress[0].works = settings.works
    if not begin_history(ida, t, settings.rtol, settings.max_order, settings.max_step, MAX_CJ_CHANGE, LINEAR_TOLERANCE):
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
def resume(problem: Integration) -> int:
    """Restart at the end of the last good step, after IDA could not continue; return a code."""
    memory, t = problem.memory, problem.memory.progress[0].t_reached
    code: int = report_unknowns(problem, t, memory.last_accepted)
    if code != OK:
        return code
    fill_account_row_at(memory.energy_record, t, problem.energy_account)
    record = memory.energy_record[0]
    passage, largest = record.open_passage_energy, record.kinetic_max_since_passage
    code = begin(problem)
    record.open_passage_energy, record.kinetic_max_since_passage = passage, largest  # the motion is the same
    return code


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
    """Advance to t (s), and report the state there; return a code, that of the equations if they have no solution."""
    code: int = advance(problem, problem.memory.progress, t)
    refusal = int(problem.work.refusal[0])
    return refusal if code in (COLLAPSED, NOT_FINITE) and refusal != OK else code


@kernel
def restore(problem: Any, options: Any) -> None:
    """Continue from arrays that were saved: IDA's history is not among them, and begins again."""
    memory = problem.memory
    restart(memory)
    memory.counts[EARLIER_FAILURES] = memory.counts[ERROR_TEST_FAILURES]
    set_options(options, problem)
    set_tolerances(problem)
