"""IDA in dense form: the driver of :mod:`.loop` and the calls of SUNDIALS in one kernel.

The host fills IDA's table of addresses (:mod:`.calls`): native FMUs, and the stepper in Python if the C functions of
SUNDIALS can be called (:mod:`.sundials`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.template import specialize
from solvers.energy_account import WORK, fill_account_row_at
from solvers.outcome import COLLAPSED, NOT_FINITE, OK
from solvers.projection.reported import fill_reported_state
from solvers.steppers.compiled_loop import MethodKernels
from solvers.steppers.step_loop import make_sample

from . import loop
from .calls import (
    IS_BEGUN,
    JACOBIAN,
    KRYLOV_DIMENSION,
    LINEAR_TOLERANCE,
    MATVEC,
    MAX_CJ_CHANGE,
    PRECONDITION,
    REJECTED,
    SET_UP,
    allocate_solver,
    begin_history,
    clear_stop,
    count,
    create,
    interpolate,
    release,
    solve,
    stop_at,
)
from .dense_callbacks import accept_step
from .dense_memory import (
    SETTINGS as SETTINGS,  # noqa: PLC0414  # of the method
)
from .dense_memory import (
    end_start,
    fill_start,
    is_shift_too_large,
    report_unknowns,
    restore_tolerances,
    set_options,
)
from .loop import (
    EARLIER_FAILURES,
    ERROR_TEST_FAILURES,
    JACOBIANS,
    REJECTED_STEPS,
    RESIDUALS,
    STARTS,
    STEPS,
    count_failures,
    record_start,
)

if TYPE_CHECKING:
    from solvers.compiled.record import Reals
    from solvers.steppers.step_loop import Integration


@kernel
def count_ida_failures(memory: Any) -> None:
    """Count the steps whose error was too large."""
    count(memory.ida)
    count_failures(memory.progress, memory.counts, float(memory.ida.counters[REJECTED]))


@kernel
def begin(problem: Integration) -> int:
    """Begin a history at the reported state; return a code."""
    memory, settings = problem.memory, problem.settings[0]
    t = memory.control[0].t
    code = fill_start(problem, t)
    if code != OK:
        return code
    count_ida_failures(memory)
    memory.progress[0].works = settings.works
    if not begin_history_at(problem, t):
        return COLLAPSED
    record_start(memory.progress, memory.counts, memory.energy_record, t, problem.energy_account[WORK])
    end_start(problem, t)
    return OK


@kernel
def allocate(problem: Any, t: float) -> int:
    """Create IDA's objects, and let SUNDIALS allocate all memory before the first step; return a code.

    The linear solver is GMRES with a preconditioner if there are constraints, else the dense one. The history that
    begins at t (s) here has no contents: the one of the run begins with the first step.
    """
    words = problem.memory.ida.words
    release(problem.memory.ida)  # what an allocation that failed has left
    if problem.memory.unknowns.lam.shape[0] > 0:
        words[JACOBIAN] = 0
    else:
        words[SET_UP], words[PRECONDITION], words[MATVEC] = 0, 0, 0
    done = create(problem.memory.ida, KRYLOV_DIMENSION)
    return OK if done and begin_history_at(problem, t) and allocate_solver(problem.memory.ida) else COLLAPSED


@inlined
def begin_history_at(problem: Any, t: float) -> bool:
    """Begin a history of IDA at t (s) with its present unknowns; False: SUNDIALS refuses it."""
    settings = problem.settings[0]
    begun: bool = begin_history(
        problem.memory.ida, t, settings.rtol, settings.max_order, settings.max_step, MAX_CJ_CHANGE, LINEAR_TOLERANCE
    )
    return begun


@inlined
def steps_allowed(problem: Any) -> int:
    """Number of steps in one call."""
    allowed: int = problem.settings[0].max_steps
    return allowed


@inlined
def may_take_more(problem: Any) -> bool:
    """Whether more steps may follow: there is nothing to check on the way."""
    return False


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
    code: int = report_unknowns(problem, t, memory.last_accepted[0])
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


DENSE_HOOKS = {
    "begin": begin,
    "steps_allowed": steps_allowed,
    "may_take_more": may_take_more,
    "take_steps": take_steps,
    "resume": resume,
    "report": report,
}
advance: Any = specialize(
    loop.advance, __name__, {**DENSE_HOOKS, "advance_history": specialize(loop.advance_history, __name__, DENSE_HOOKS)}
)


@kernel
def advance_reported(problem: Integration, t: float) -> int:
    """Advance to t (s), and report the state there; return a code."""
    if is_shift_too_large(problem, t):
        restart(problem.memory)
    code: int = advance(problem, problem.memory.progress, t)
    return code


@kernel
def advance_row(problem: Integration, t: float, q: Reals, v: Reals, energy_account: Reals) -> int:
    """As :func:`advance_reported`, with a copy of the reported state and its energy account in a row of samples."""
    code: int = advance_reported(problem, t)
    for i in range(q.shape[0]):
        q[i] = problem.q[i]
    for i in range(v.shape[0]):
        v[i] = problem.v[i]
    for i in range(energy_account.shape[0]):
        energy_account[i] = problem.energy_account[i]
    return code


@inlined
def fill_row(problem: Integration, t: float, q: Reals, v: Reals, a: Reals, lam: Reals, outputs: Reals) -> int:
    """Accelerations, multipliers and outputs of the system at the state reported last."""
    control, rtol = problem.memory.control[0], problem.settings[0].motion_rtol
    return fill_reported_state(problem.eqs, t, q, v, rtol, control, problem.work, a, lam, outputs)


sample = make_sample(__name__, advance=advance_row, fill_row=fill_row)


@kernel
def restart(memory: Any) -> None:
    """Begin a history at the reported state before the next step."""
    memory.progress[0].is_pending, memory.progress[0].max_next_step = 1, float("inf")


@kernel
def start(memory: Any, t: float, q: Any, v: Any, work: float, truncated_steps: int, keeps_position: bool) -> None:
    """Begin a history at the reported state before the next step; as many steps as requested end at the targets."""
    restart(memory)
    if truncated_steps > 0:
        memory.progress[0].truncated_steps = truncated_steps


@kernel
def restore(problem: Any, options: Any) -> None:
    """Continue from arrays that were saved: IDA's history is not among them, and begins again."""
    memory = problem.memory
    if memory.ida.words[IS_BEGUN] == 0:
        allocate(problem, memory.control[0].t)
    restart(memory)
    memory.counts[EARLIER_FAILURES], memory.progress[0].truncated_steps = memory.counts[ERROR_TEST_FAILURES], 0
    set_options(options, problem)
    restore_tolerances(problem, memory.control[0].t)


@kernel
def close(problem: Any) -> None:
    """Free IDA's objects."""
    release(problem.memory.ida)


@kernel
def limit_step(memory: Any, settings: Any, t: float, q: Any, v: Any, work: float, longest: float) -> None:
    """Let no step be longer than ``longest``, s; IDA itself observes the limit of the options."""
    memory.progress[0].max_step = longest if longest < settings[0].max_step else float("inf")


@kernel
def count_run(memory: Any, counts: Any) -> None:
    """Write steps, rejected steps, evaluations and restarts of the run into ``counts``."""
    count_ida_failures(memory)
    own, columns = memory.counts, memory.unknowns.q.shape[0] + 2 * memory.unknowns.v.shape[0] + 1
    counts[0], counts[1] = int(own[STEPS]), int(own[ERROR_TEST_FAILURES] + own[REJECTED_STEPS])
    counts[2], counts[4] = int(own[RESIDUALS] + columns * own[JACOBIANS]), max(0, int(own[STARTS]) - 1)


IDA_KERNELS = MethodKernels(start, limit_step, count_run)
