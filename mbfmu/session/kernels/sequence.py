"""What happens at a communication point, in its order: the one description for Python and for native FMUs.

    set input   set the value; if it changes the equations of motion, count a jump of the potential energy as work, and
                the solver continues at its state
    step        extrapolated loads change; support motions start, with the impulse of all velocity jumps;
                the solver advances; check of the energy balance; limits of elements
    read        accelerations and multipliers; outputs; check of the energy balance
    retune      count the change of the energy by parameters as work; the solver restarts

A host that changes parameters and inputs at one point calls ``note_energy`` and ``retune`` before ``set_input``: the
work of the change of parameters is that with the inputs that were valid until then, which keep their values in it.
:func:`sampling_of` returns a function that does ``step`` and ``read`` at several points at which nothing is set, in one
call of the solver.

The functions run over a *run*, which has the fields of :class:`Run`. In a native FMU a run is a pinned tuple, the
actions of its solver are kernels, and the functions are compiled together with them. In Python a run contains a
:class:`solvers.Stepper` of any kind, the actions are its methods, and the functions are interpreted: they only call
actions and kernels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.input_kernels import (
    LOADS_CHANGED,
    MOTION_STARTS,
    RATE_JUMPS,
    all_finished,
    perturb_motions,
    restore_motions,
    skip_points,
)
from solvers.outcome import NOT_FINITE, OK
from solvers.stepper import Samples
from solvers.system import Array

from .points import (
    account_discontinuity,
    account_parameters,
    apply_input,
    check_point,
    check_samples,
    energy_at,
    note_energy,
    note_impulse,
    plan_step,
    read_outputs,
    start_support_motions,
    store_velocity_jump,
)

F = TypeVar("F", bound=Callable[..., Any])


class Run(Protocol):
    """What the functions read of a run; arrays are those of the reported state."""

    session: Any  # .points.Session, pinned
    inputs: Any  # mbfmu.mechanics.arrays.input_kernels.InputRecords, pinned: those of the session
    clock: Array | tuple[float]  # (1,) s, the time reached
    q: Array  # (nq,)
    v: Array  # (n,)
    energy_account: Array  # (ACCOUNT_SIZE,)
    a: Array  # (n,) accelerations, filled by the action ``evaluate``
    lam: Array  # (m,) multipliers, filled by it too
    dv: Array  # (n,) jump of the velocities, see the action ``jump``
    out: NDArray[np.float64]  # outputs


class SampledRun(Run, Protocol):
    """A run that passes several points in one call."""

    samples: Samples  # motion at these points
    ratios: Array  # (k,) how far elements are from their limits there


class SolverActions(NamedTuple):
    """What a solver does for a run. Codes are those of :mod:`solvers.outcome`."""

    advance: Callable[..., int]  # (run, end) -> code: advance to the time ``end``, s
    evaluate: Callable[..., int]  # (run) -> code: fill ``run.a`` and ``run.lam``
    continue_at_state: Callable[..., Any]  # (run): continue after a small change of the equations
    restart: Callable[..., Any]  # (run): discard the history
    jump: Callable[..., Any]  # (run): add ``run.dv`` to the velocities, and continue
    leaves_placed: bool  # whether ``advance`` leaves the bodies placed and moving as at the state reached
    evaluates_placed: bool  # whether ``evaluate`` leaves them so, and loaded as there


class Sequence(NamedTuple):
    """What a run does. All functions take a run first and return a code."""

    set_input: Callable[..., int]  # (run, index, value, rate): at the time reached; rate: not a number if not given
    begin_step: Callable[..., int]  # (run, end): the part of ``step`` before the solver advances
    step: Callable[..., int]  # (run, end): advance to the communication point at ``end``, s
    read: Callable[..., int]  # (run): fill ``run.out``
    note_energy: Callable[..., int]  # (run): before parameters change
    retune: Callable[..., int]  # (run): after parameters have changed


def _unchanged(function: F) -> F:
    return function


def sequence_of(solver: SolverActions, compiled: Callable[[F], F] = _unchanged) -> Sequence:
    """Return what runs of a solver do; ``compiled`` compiles a function that others call."""
    advance, evaluate, continue_at_state, restart, jump, leaves_placed, evaluates_placed = solver

    def evaluate_impulse(run: Any) -> int:
        """Put the jump of the velocities into ``run.dv``, see :mod:`mbfmu.mechanics.arrays.input_kernels`."""
        code: int = OK
        for k in range(2):
            if code == OK:
                perturb_motions(run.inputs, run.clock[0], float(k))
                code = evaluate(run)
                store_velocity_jump(run.a, k, run.dv)
        restore_motions(run.inputs)
        return code

    impulse: Any = compiled(evaluate_impulse)  # type: ignore[arg-type]

    def begin_step(run: Any, end: float) -> int:
        t = run.clock[0]
        found = plan_step(run.session, t, end)
        if found & LOADS_CHANGED:
            continue_at_state(run)
        if found & MOTION_STARTS:
            before, jumps = energy_at(run.session, t, run.q, run.v), found & RATE_JUMPS != 0
            code: int = impulse(run) if jumps else OK
            note_impulse(run.session, code)
            if code != OK:
                return code
            start_support_motions(run.session)
            if jumps:
                jump(run)
            else:
                continue_at_state(run)
            account_discontinuity(run.session, before, t, run.q, run.v)
        return OK

    begin: Any = compiled(begin_step)  # type: ignore[arg-type]

    def step(run: Any, end: float) -> int:
        code: int = begin(run, end)
        if code != OK:
            return code
        t = run.clock[0]
        code = advance(run, end)
        placed = leaves_placed and code == OK and run.clock[0] > t
        check_point(run.session, run.clock[0], run.q, run.v, run.energy_account, placed)
        return code

    def set_input(run: Any, index: int, value: float, rate: float) -> int:
        if not abs(value) < np.inf or abs(rate) == np.inf:
            return NOT_FINITE
        if apply_input(run.session, index, value, rate, run.clock[0], run.q, run.v):
            continue_at_state(run)
        return OK

    def read(run: Any) -> int:
        code: int = evaluate(run)
        if code == OK:
            solution = run.q, run.v, run.a, run.lam
            read_outputs(run.session, run.clock[0], *solution, run.energy_account, evaluates_placed, run.out)
        return code

    def note(run: Any) -> int:
        note_energy(run.session, run.clock[0], run.q, run.v)
        return OK

    def retune(run: Any) -> int:
        account_parameters(run.session, run.clock[0], run.q, run.v)
        restart(run)
        return OK

    return Sequence(set_input, begin, step, read, note, retune)


def sampling_of(sequence: Sequence, take_samples: Callable[..., Samples]) -> Callable[..., int]:
    """Return what steps to several points at which nothing is set, and reads there, in one call of the solver.

    Parameters
    ----------
    sequence
        Sequence of the same runs, which are interpreted.
    take_samples
        (run, times, out) -> samples: advance to each of ``times`` (k,), s, as far as possible, and fill a row of
        ``out`` (k, outputs) with the outputs there.

    Returns
    -------
    callable
        (run, times, out) -> count: fill rows of ``out`` until a solver stops, an element is invalid, or a prescribed
        motion may begin or end, and fill ``run.samples`` and ``run.ratios``. The rows that are valid are counted.
    """

    def sample(run: Any, times: Array, out: Array) -> int:
        if sequence.begin_step(run, times[0]) != OK:
            return 0
        ahead = len(times) if all_finished(run.inputs) else 1
        run.samples = found = take_samples(run, times[:ahead], out[:ahead])
        reached = len(found.q)
        run.ratios = np.zeros(reached)
        state = times[:reached], found.q, found.v, found.energy_account
        count = int(check_samples(run.session, *state, run.ratios, out[:reached]))
        if count > 1:
            skip_points(run.inputs, times[count - 2])
        return count

    return sample
