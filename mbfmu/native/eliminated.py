"""Large mechanisms with loops, whose constraints are eliminated along their structure: kernels over instances.

They do what :class:`solvers.steppers.adams.eliminated.EliminatedAdamsStepper` and
:class:`solvers.steppers.ida.eliminated.EliminatedIDAStepper` do in Python.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.arrays.compiled_mechanism import CompiledMechanism
from mbfmu.mechanics.elimination import eliminated, empty_elimination
from mbfmu.mechanics.elimination.loops import find_closed_velocities, iterate_to_closed
from mbfmu.mechanics.recursions import dynamics as recursions
from solvers.compiled.kernel import kernel
from solvers.compiled.tuple_pointer import unpin
from solvers.loop_closure import ASSEMBLED, MAX_STAGES, set_weights
from solvers.outcome import OK
from solvers.positions import Positions
from solvers.projection.eliminated import EliminationScratch
from solvers.projection.eliminated_crossing import UNRESOLVED_LENGTH, evaluate_closed
from solvers.steppers.adams import eliminated_loop
from solvers.steppers.adams.pece import set_options
from solvers.steppers.eliminated import begin_motion, find_rate, is_unresolved
from solvers.steppers.eliminated_newton import ImplicitEquations, Work
from solvers.steppers.ida import eliminated_memory
from solvers.system import Array, EliminationEquations, Terms

from .closing import close_positions, close_velocities
from .exchange_eliminated import copy_branch
from .locked_tangent import LOCKABLE_TANGENT_KERNELS, empty_lockable_tangent, lockable_tangent
from .start_checks import find_turned, mark_free_rates

ELIMINATIONS = "accelerate", "correct_position", "correct_velocity"
ELIMINATION_KERNELS = {name: getattr(eliminated, name) for name in ELIMINATIONS}
ELIMINATION_KERNELS |= {name: getattr(recursions, name) for name in ("inverse", "retract", "position")}
ELIMINATION_KERNELS |= {"power": recursions.solved_power, "evaluate_energy_bound": recursions.evaluate_energy_bound}
ELIMINATION_KERNELS |= {"longest_load_step": recursions.longest_load_step}


class ClosableEquations(NamedTuple):
    """:class:`solvers.system.EliminationEquations`, with what closes the loops at the start."""

    accelerate: Any
    correct_position: Any
    correct_velocity: Any
    inverse: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    longest_load_step: Any
    position: Any
    data: Any
    elimination: Any
    in_loops: Array
    terms: Any

    @staticmethod
    def of(
        callbacks: dict[str, Any], data: Any, known: EliminationEquations, nq: int, n: int, m: int
    ) -> ClosableEquations:
        """Return the equations of a mechanism by those of its system."""
        terms = Terms.allocate_constraints(n, m)
        return ClosableEquations(
            **callbacks, data=data, elimination=known.elimination, in_loops=known.in_loops, terms=terms
        )


def equations_of(compiled: CompiledMechanism) -> Any:
    """Return the equations of a mechanism with its constraints eliminated."""
    assert compiled.system.elimination is not None  # else it is of another family
    return unpin(compiled.system.elimination())


def empty_equations() -> EliminationEquations:
    """Return equations whose data have the types that all mechanisms have."""
    return EliminationEquations._make((*[None] * 9, empty_elimination(), np.zeros(1)))


class ImplicitStructure(NamedTuple):
    """What the equations of IDA have besides the arrays of the mechanism."""

    loops: EliminationEquations
    tangent: Any  # data of the structured tangent, pinned: .locked_tangent.LockableTangent


def implicit_structure_of(compiled: CompiledMechanism) -> ImplicitStructure:
    """Return that of a mechanism."""
    elimination: Any = compiled.system.elimination
    tangent = lockable_tangent(compiled, elimination.tangent().callbacks.tangent)
    return ImplicitStructure(equations_of(compiled), tangent)


def empty_implicit_structure() -> ImplicitStructure:
    """Return one whose data have the types that all mechanisms have."""
    return ImplicitStructure(empty_equations(), empty_lockable_tangent())


def implicit_equations(
    callbacks: dict[str, Any], data: Any, known: ImplicitStructure, nq: int, n: int, m: int
) -> ImplicitEquations:
    """Return the equations of IDA."""
    loops, tangent = (
        {name: callbacks[name] for name in own} for own in (ELIMINATION_KERNELS, LOCKABLE_TANGENT_KERNELS)
    )
    closable = ClosableEquations.of(loops, data, known.loops, nq, n, m)
    return ImplicitEquations(loops=closable, **tangent, tangent=known.tangent)


def implicit_work(nq: int, n: int, m: int, positions: Positions) -> Work:
    """Return the scratch of IDA, zeroed."""
    return Work.allocate(nq, n, m, EliminationScratch.allocate(nq, n, m, positions), positions)


def formulation_of(eqs: ImplicitEquations, work: Work) -> tuple[ClosableEquations, EliminationScratch]:
    """Return the equations and the scratch of IDA without what it alone needs."""
    return unpin(eqs.loops), unpin(work.loops)


def units_of(eqs: ClosableEquations) -> list[NDArray[Any]]:
    """Return the arrays of the elimination that a run sets at its start."""
    own = unpin(unpin(eqs.elimination).own)
    return [own.size, own.row_size, own.length]


@kernel
def set_units(instance: Any) -> None:
    """Set the units of the elimination: parameters may have changed them since the export."""
    own, work, known = instance.eqs.elimination.own, instance.work, instance.known
    for i in range(own.size.shape[0]):
        own.size[i] = work.size[i]
    for i in range(own.row_size.shape[0]):
        own.row_size[i] = instance.start.scratch.row[i]
    own.length[0] *= known[2] / known[3]
    known[3] = known[2]


@kernel
def assemble_eliminated(instance: Any, t: float) -> int:
    """As :func:`.closing.close_loops`; those of a system without matrices are first tried by the elimination, as
    :class:`mbfmu.mechanics.elimination.EliminatedLoops` does.
    """
    problem, start, scratch = instance.given, instance.start, instance.start.scratch
    set_units(instance)
    eqs, own = instance.eqs, (scratch.size, scratch.weight, instance.work.change, instance.work.report)
    is_closed, has_velocities = False, False
    if start.eliminates == 1:
        for stage in range(MAX_STAGES):
            if not is_closed and set_weights(stage, scratch.given[0], scratch):
                for i in range(start.q.shape[0]):
                    problem.q[i] = start.q[i]
                is_closed = iterate_to_closed(eqs, t, problem.q, *own)
    code = find_turned(instance, scratch.worst[0]) if is_closed else close_positions(instance, t)
    if code == ASSEMBLED and start.eliminates == 1:
        state = t, problem.q, start.v, instance.known[0], problem.v
        for stage in range(MAX_STAGES):
            if not has_velocities and set_weights(stage, scratch.given[1], scratch):
                has_velocities = find_closed_velocities(eqs, *state, *own)
    if code == ASSEMBLED and not has_velocities:
        code = close_velocities(instance, t)
    return code


@kernel
def begin_eliminated(instance: Any, t: float) -> tuple[int, float]:
    """As ``EliminatedAdamsStepper`` is made."""
    set_options(instance.options, instance.given.settings)
    code, rate = begin_formulation(instance, t)
    eliminated_loop.set_up(instance.given, rate)
    return code, rate


@kernel
def begin_eliminated_ida(instance: Any, t: float) -> tuple[int, float]:
    """As ``EliminatedIDAStepper`` is made."""
    problem = instance.given
    eliminated_memory.set_options(instance.options, problem)
    code, rate = begin_formulation(instance, t)
    for row in range(problem.work.row_size.shape[0]):
        problem.work.row_size[row] = instance.start.scratch.row[row]
    eliminated_memory.set_up(problem, t, rate)
    return code, rate


@kernel
def begin_formulation(instance: Any, t: float) -> tuple[int, float]:
    """As ``EliminatedFormulation`` is made; return a code and the rate of the motion, 1/s."""
    problem, status, eqs, work = instance.given, instance.session.status[0], instance.eqs, instance.work
    set_units(instance)
    code = begin_motion(eqs, t, problem.q, problem.v, work)
    control = problem.memory.control[0]
    control.rank, status.flaw, status.singular = work.near[0].rank, ASSEMBLED, 0
    if code == OK and is_unresolved(UNRESOLVED_LENGTH, work):
        eqs.position(t, problem.q, eqs.data, eqs.terms)
        status.singular = mark_free_rates(eqs.terms.J, control.rank, instance.start.scratch)
    known, duration = instance.known[0], instance.options[0].duration
    return code, find_rate(eqs, t, problem.q, problem.v, code == OK, known, duration, work)


@kernel
def replace_branches(instance: Any) -> None:
    """Let what model exchange has stored of the branch be that of the present constraints and their rank."""
    exchange = instance.exchange
    copy_branch(instance.work, exchange.before)
    copy_branch(instance.work, exchange.completed)
    copy_branch(instance.work, exchange.previous)


@kernel
def adapt_eliminated(instance: Any, t: float) -> tuple[int, float]:
    """Continue at the reported state with joints that were locked or released."""
    code, rate = begin_eliminated(instance, t)
    replace_branches(instance)
    return code, rate


@kernel
def adapt_eliminated_ida(instance: Any, t: float) -> tuple[int, float]:
    """As :func:`adapt_eliminated`."""
    code, rate = begin_eliminated_ida(instance, t)
    replace_branches(instance)
    return code, rate


@kernel
def evaluate_eliminated(instance: Any) -> int:
    """Fill ``instance.a`` and ``instance.lam``."""
    problem, work, t = instance.given, instance.work, instance.clock[0]
    state = t, problem.q, problem.v, True, work, work.qdot
    code: int = evaluate_closed(instance.eqs, *state, instance.a, instance.lam)
    if code == OK and is_unresolved(max(UNRESOLVED_LENGTH, instance.options[0].rtol), work):
        control = problem.memory.control[0]
        control.undetermined, control.undetermined_at = 1, t
    return code
