"""Single steps of the solvers of native FMUs, as the search for events takes them."""

from __future__ import annotations

from typing import Any, NamedTuple

from mbfmu.mechanics.recursions.dynamics import input_step_limit
from mbfmu.session.kernels.event_search import StepActions
from mbfmu.session.kernels.sequence import SolverActions
from solvers.compiled.kernel import inlined, jit_uncached, kernel
from solvers.energy_account import WORK
from solvers.outcome import MAX_STEPS, OK


class StepKernels(NamedTuple):
    """What a family has for steps that are examined; kernels over an instance."""

    is_dense: Any  # (instance) -> bool: whether any time of the last step, or of the next one, can be reported again
    own_time: Any  # (instance) -> float: time that the solver has reached itself, s


@kernel
def is_always_dense(instance: Any) -> bool:
    """Of solvers all of whose steps have a dense output."""
    return True


@kernel
def is_adams_dense(instance: Any) -> bool:
    """As :attr:`solvers.steppers.adams.method.AdamsMethod.has_dense_output`."""
    control = instance.given.memory.control[0]
    return bool(control.is_projected == 0 and not (control.start == 1 and control.rk_steps > 0))


@kernel
def control_time(instance: Any) -> float:
    """Of solvers with the step loop of :mod:`solvers.steppers.step_loop`."""
    return float(instance.given.memory.control[0].t)


@kernel
def ida_time(instance: Any) -> float:
    """As :attr:`solvers.steppers.ida.driver.IDADriver.own_time`."""
    progress = instance.given.memory.progress[0]
    return float(instance.clock[0] if progress.is_pending == 1 else progress.t_reached)


ADAMS_STEPS = StepKernels(is_adams_dense, control_time)
ONE_STEP_STEPS = StepKernels(is_always_dense, control_time)
IDA_STEPS = StepKernels(is_always_dense, ida_time)


@inlined
def copy_words(source: Any, target: Any) -> None:
    """Copy all words of a state."""
    for i in range(source.shape[0]):
        target[i] = source[i]


class OwnSteps(NamedTuple):
    """Advances of a solver of a family; kernels over an instance that return codes of :mod:`solvers.outcome`."""

    advance_to: Any  # (instance, t): to t, s, or report the state of this time in the last step
    advance_one_step: (
        Any  # (instance, end, longest): by at most one step of at most ``longest`` (s) towards ``end`` (s)
    )


def own_steps(family: Any) -> OwnSteps:
    """Return how a solver of a family advances."""
    own_time = family.steps.own_time
    advance_reported, limit_method = family.loop.advance_reported, family.method.limit_step

    @jit_uncached
    def advance_to(instance: Any, t: float) -> int:
        """Advance to t, s, or report the state of this time in the last step."""
        status = instance.session.status[0]
        code: int = advance_reported(instance.given, t)
        status.code = code
        instance.clock[0] = t if code == OK else own_time(instance)
        return code

    @jit_uncached
    def advance_to_accepted(instance: Any, t: float) -> int:
        """Advance towards t (s) until the solver has taken a step."""
        settings, begin, taken = instance.given.settings[0], instance.clock[0], 0
        allowed = settings.max_steps
        settings.max_steps = 1
        code: int = advance_to(instance, t)
        while code == MAX_STEPS and not own_time(instance) > begin and taken < allowed:  # the step was rejected
            taken += 1
            code = advance_to(instance, t)
        settings.max_steps = allowed
        if code == MAX_STEPS and own_time(instance) > begin:
            code = advance_to(instance, own_time(instance))
        return code

    @jit_uncached
    def advance_one_step(instance: Any, end: float, longest: float) -> int:
        own, t = instance.given, instance.clock[0]
        limit, until = input_step_limit(t, instance.eqs.data)
        limit = min(limit, instance.options[0].max_step, longest)
        limit_method(own.memory, own.settings, t, own.q, own.v, own.energy_account[WORK], limit)
        target, reached = min(end, until), own_time(instance)
        if reached > t:
            return int(advance_to(instance, min(reached, target)))
        return int(advance_to_accepted(instance, target))

    return OwnSteps(advance_to, advance_one_step)


def step_actions(family: Any, solver: SolverActions) -> StepActions:
    """Return what a solver of a family does in the search for events, as kernels.

    A step without dense output is repeated from a copy of the state of the solver.
    """
    is_dense, restored = family.steps.is_dense, family.restore
    advance_to, advance_one_step = own_steps(family)

    @jit_uncached
    def take_step(instance: Any, end: float, longest: float) -> int:
        kept = instance.step_begin
        kept.is_kept[0] = 0 if is_dense(instance) else 1
        if kept.is_kept[0] == 1:
            copy_words(kept.state, kept.copy)
            kept.target[0] = end
        code: int = advance_one_step(instance, end, longest)
        if is_dense(instance):
            kept.is_kept[0] = 0
        return code

    @jit_uncached
    def report(instance: Any, t: float) -> int:
        kept = instance.step_begin
        if kept.is_kept[0] == 0:
            return int(advance_to(instance, t))
        copy_words(kept.copy, kept.state)
        restored(instance.given, instance.options)
        code: int = solver.advance(instance, t)
        return code

    @jit_uncached
    def return_to_end(instance: Any, t: float) -> int:
        kept = instance.step_begin
        if kept.is_kept[0] == 0:
            return int(advance_to(instance, t))
        copy_words(kept.copy, kept.state)
        restored(instance.given, instance.options)
        return int(advance_one_step(instance, kept.target[0], float("inf")))

    @jit_uncached
    def tolerance(instance: Any) -> float:
        return float(instance.options[0].rtol)

    @jit_uncached
    def max_steps(instance: Any) -> int:
        return int(instance.options[0].max_steps)

    return StepActions(take_step, report, return_to_end, is_dense, tolerance, max_steps)
