"""Kernels over instances that differ between families of steppers.

Small mechanisms are integrated by their matrices, large trees by their recursions.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

from mbfmu.mechanics.recursions import dynamics as recursions
from solvers.compiled.kernel import kernel
from solvers.energy_account import WORK
from solvers.loop_closure import (
    ASSEMBLED,
    check_mobile_mass,
    is_off_branch,
)
from solvers.outcome import OK
from solvers.positions import position_sizes
from solvers.projection.eliminated import EliminationScratch
from solvers.projection.projection import project
from solvers.projection.rank import find_normal_rank
from solvers.projection.reported import has_unresolved_forces, solve_state
from solvers.projection.tree_constraints import solve_accelerations
from solvers.projection.workspace import Workspace, evaluate_and_factor
from solvers.steppers.adams import eliminated_loop, tree_loop
from solvers.steppers.adams import loop as adams
from solvers.steppers.adams.formulas import History
from solvers.steppers.adams.hybrid import HYBRID
from solvers.steppers.adams.method import ADAMS_KERNELS
from solvers.steppers.adams.pece import set_options
from solvers.steppers.compiled_loop import MethodKernels
from solvers.steppers.dense import estimate_rates
from solvers.steppers.esdirk import loop as esdirk
from solvers.steppers.esdirk.formulas import Memory as ESDIRKMemory
from solvers.steppers.esdirk.steps import Work
from solvers.steppers.esdirk.tree import ESDIRK_KERNELS
from solvers.steppers.ida import dense_loop as dense_ida
from solvers.steppers.ida import eliminated_loop as eliminated_ida
from solvers.steppers.ida import tree_loop as tree_ida
from solvers.steppers.ida import tree_memory
from solvers.steppers.ida.dense_memory import IDAMemory, continue_history
from solvers.steppers.ida.dense_memory import set_options as set_ida_options
from solvers.steppers.ida.dense_memory import set_up as set_up_ida
from solvers.steppers.ida.eliminated_memory import EliminatedIDAMemory
from solvers.steppers.radau import loop as radau
from solvers.steppers.radau.dense import RadauMethod
from solvers.steppers.radau.formulas import Memory
from solvers.steppers.tree import TreeScratch
from solvers.system import Equations, Terms, TreeEquations

from . import eliminated, locked_tangent
from .closing import close_positions, close_velocities
from .event_jumps import DENSE_JUMPS, ELIMINATED_JUMPS, TREE_JUMPS, Jumps, renew_tangent
from .exchange_dense import forget_branch
from .locked_tangent import LOCKABLE_TANGENT_KERNELS, empty_lockable_tangent, tree_tangent
from .solver_steps import ADAMS_STEPS, IDA_STEPS, ONE_STEP_STEPS, StepKernels
from .start_checks import NO_BRANCH, mark_free_rates
from .steady_start import find_start_in_steady_state, no_search

DENSE_KERNELS = {name: getattr(recursions, name) for name in Equations._fields[:-2]}


class ExplicitTreeEquations(NamedTuple):
    """Those of :class:`solvers.system.TreeEquations` that explicit solvers of trees without constraints call."""

    forward: Any
    inverse: Any
    mobility: Any
    retract: Any
    power: Any
    evaluate_energy_bound: Any
    longest_load_step: Any
    inertia_parts: Any
    data: Any


EXPLICIT_KERNELS = {name: getattr(recursions, name) for name in ExplicitTreeEquations._fields[:-1]}
EXPLICIT_KERNELS["power"] = recursions.solved_power
MORE_OF_TREES = "mesh_motion", "constraints", "position"
TREE_KERNELS = EXPLICIT_KERNELS | {name: getattr(recursions, name) for name in MORE_OF_TREES}
TREE_KERNELS |= LOCKABLE_TANGENT_KERNELS | {"inverse": locked_tangent.inverse}


@kernel
def leave(problem: Any, options: Any) -> None:
    """Change nothing: all that is remembered is in the arrays."""


@kernel
def leave_open(problem: Any) -> None:
    """Free nothing: all memory is in the block."""


def whole_of(eqs: Any, work: Any) -> tuple[Any, Any]:
    """Return the equations and the scratch of an integration: its formulation of the equations has all of them."""
    return eqs, work


class Structure(NamedTuple):
    """What the equations of a family have besides the arrays of the mechanism."""

    of: Callable[[Any], Any]  # of a compiled mechanism
    empty: Callable[[], Any]  # an example of the types that all have


STRUCTURED_TANGENT = Structure(tree_tangent, empty_lockable_tangent)


class Family(NamedTuple):
    """What differs between families. Kernels take an instance first, unless other arguments are stated."""

    loop: ModuleType  # with its kernels ``advance_reported``, and SETTINGS
    callbacks: dict[str, Callable[..., Any]]  # of its equations
    equations: Callable[..., Any]  # (callbacks, data, structure, nq, n, m)
    memory: Callable[..., Any]  # (nq, n, m): what is remembered from step to step
    work: Callable[..., Any]  # (nq, n, m, positions): scratch, with units ``size``
    assemble: Any  # (instance, t) -> code of solvers.loop_closure: lets the reported state be the start, loops closed
    begin: Any  # (instance, t) -> code and rate (1/s): options, units and paces as a stepper's constructor takes
    # them, and a flaw of the start into the status of the run
    evaluate: Any  # (instance) -> code: accelerations and multipliers at the reported state; leaves the bodies there
    evaluate_advanced: Any  # the same, directly after an advance
    leaves_placed: bool  # whether an advance leaves the bodies at the reported state
    needs_work: Any  # (settings) -> whether the work of forces without a potential is to be integrated
    method: MethodKernels
    jumps: Jumps  # how impulses change the velocities
    start: Any = None  # (instance, truncated_steps, keeps_position): instead of that of the method
    restore: Any = leave  # (problem, options): continue from arrays that were saved
    close: Any = leave_open  # (problem): free what was allocated outside of the block
    keeps_history_at_jumps: bool = True  # whether it continues where velocities jump
    balance: Any = find_start_in_steady_state  # (instance) -> code: lets the reported state be a steady state
    structure: Structure = Structure(lambda _: None, lambda: None)
    uses_tangent: bool = False  # whether it factors the structured tangent
    evaluates_placed: bool = True  # whether an evaluation leaves the bodies at the reported state
    formulation: Callable[[Any, Any], tuple[Any, Any]] = whole_of  # (eqs, work) -> those of the Instance
    steps: StepKernels = ADAMS_STEPS


@kernel
def assemble_dense(instance: Any, t: float) -> int:
    """Let the reported state be the start with its loops closed; return a code of :mod:`solvers.loop_closure`.

    If it is not ASSEMBLED, ``worst`` or ``massless`` of the scratch contains the cause, and there is no state.
    """
    problem = instance.given
    code: int = close_positions(instance, t)
    if code == ASSEMBLED:
        code = close_velocities(instance, t)
    if code == ASSEMBLED:
        problem.eqs.dynamics(t, problem.q, problem.v, problem.eqs.data, problem.eqs.terms)
        code = check_mobile_mass(problem.eqs.terms, problem.work.mass, instance.start.scratch)
    return code


@kernel
def assemble_tree(instance: Any, t: float) -> int:
    """Let the reported state be the start, which has no loops to close.

    The solver detects later whether everything that moves has inertia.
    """
    problem, start = instance.given, instance.start
    for i in range(problem.q.shape[0]):
        problem.q[i] = start.q[i]
    for i in range(problem.v.shape[0]):
        problem.v[i] = start.v[i]
    return ASSEMBLED


@kernel
def project_and_scale(instance: Any, t: float) -> tuple[int, int]:
    """Close the reported state, and find units and paces there; return how it was closed, and the rank."""
    problem = instance.given
    forget_branch(instance)
    position_sizes(instance.positions, problem.work.size, problem.work.size_q)
    rank = find_normal_rank(problem.eqs, t, problem.q, problem.v, problem.work)
    code = project(problem.eqs, t, problem.q, problem.v, rank, problem.work)
    problem.eqs.dynamics(t, problem.q, problem.v, problem.eqs.data, problem.eqs.terms)
    off = is_off_branch(problem.eqs.terms, problem.v, rank, instance.options[0].rtol, instance.start.scratch)
    instance.session.status[0].flaw = NO_BRANCH if off else ASSEMBLED
    instance.session.status[0].singular = mark_free_rates(problem.eqs.terms.J, rank, instance.start.scratch)
    estimate_rates(
        problem.eqs,
        t,
        problem.q,
        problem.v,
        rank,
        instance.known[0],
        instance.known[1],
        instance.options[0].duration,
        problem.work,
    )
    return code, rank


@kernel
def begin_adams(instance: Any, t: float) -> tuple[int, float]:
    """As ``AdamsStepper`` is made."""
    set_options(instance.options, instance.given.settings)
    code, rank = project_and_scale(instance, t)
    adams.set_up(instance.given, rank, instance.options[0].absolute)
    return code, instance.given.work.rate[0]


@kernel
def begin_radau(instance: Any, t: float) -> tuple[int, float]:
    """As ``RadauStepper`` is made."""
    radau.set_options(instance.options, instance.given.settings)
    code, rank = project_and_scale(instance, t)
    radau.set_up(instance.given, rank, instance.options[0].absolute)
    return code, instance.given.work.rate[0]


@kernel
def begin_tree(instance: Any, t: float) -> tuple[int, float]:
    """As ``TreeAdamsStepper`` is made."""
    set_options(instance.options, instance.given.settings)
    instance.session.status[0].flaw, instance.session.status[0].singular = ASSEMBLED, 0
    tree_loop.set_up(instance.given, t, instance.known[0], instance.options[0].duration)
    return OK, instance.given.settings[0].rate


@kernel
def begin_esdirk(instance: Any, t: float) -> tuple[int, float]:
    """As ``TreeESDIRKStepper`` is made."""
    problem, status = instance.given, instance.session.status[0]
    esdirk.set_options(instance.options, problem.settings)
    status.flaw, status.singular = ASSEMBLED, 0
    for row in range(problem.work.constraints.row_size.shape[0]):
        problem.work.constraints.row_size[row] = instance.start.scratch.row[row]
    code = esdirk.set_up(problem, t, instance.known[0], instance.options[0].duration)
    return code, problem.settings[0].rate


@kernel
def adapt_ida(instance: Any, t: float) -> tuple[int, float]:
    """Find rank, units and paces; return how the reported state was closed, and the rate."""
    code, rank = project_and_scale(instance, t)
    set_up_ida(instance.given, t, rank)
    return code, instance.given.work.rate[0]


@kernel
def begin_ida(instance: Any, t: float) -> tuple[int, float]:
    """As ``IDAStepper`` is made."""
    set_ida_options(instance.options, instance.given)
    code, _ = adapt_ida(instance, t)
    allocated = dense_ida.allocate(instance.given, t)
    return code if code != OK else allocated, instance.given.work.rate[0]


@kernel
def begin_tree_ida(instance: Any, t: float) -> tuple[int, float]:
    """As ``TreeIDAStepper`` is made."""
    problem, status = instance.given, instance.session.status[0]
    tree_memory.set_options(instance.options, problem)
    status.flaw, status.singular = ASSEMBLED, 0
    for row in range(problem.work.constraints.row_size.shape[0]):
        problem.work.constraints.row_size[row] = instance.start.scratch.row[row]
    code = tree_memory.set_up(problem, t, instance.known[0], instance.options[0].duration)
    return code, problem.settings[0].rate


@kernel
def evaluate_dense(instance: Any) -> int:
    """Fill ``instance.a`` and ``instance.lam``."""
    problem = instance.given
    evaluate_and_factor(problem.eqs, instance.clock[0], problem.q, problem.v, problem.work)
    return solve_dense(instance)


@kernel
def solve_dense(instance: Any) -> int:
    """As :func:`evaluate_dense`, directly after an advance: it ends with the projection of the reported state, which
    leaves bodies, terms and factors there.
    """
    problem = instance.given
    control, t = problem.memory.control[0], instance.clock[0]
    state = t, problem.q, problem.v, control.rank, problem.work
    code: int = solve_state(problem.eqs, *state, instance.a, instance.lam)
    if code == OK and has_unresolved_forces(instance.options[0].rtol, control.rank, problem.work):
        control.undetermined, control.undetermined_at = 1, t
    return code


@kernel
def evaluate_tree(instance: Any) -> int:
    """Fill ``instance.a``."""
    code: int = tree_loop.evaluate(instance.given, instance.clock[0], instance.a)
    return code


@kernel
def evaluate_constrained_tree(instance: Any) -> int:
    """Fill ``instance.a`` and ``instance.lam``."""
    problem, own = instance.given, instance.given.work.constraints
    state = instance.clock[0], problem.q, problem.v, own, own.qdot
    code: int = solve_accelerations(problem.eqs, *state, instance.a, instance.lam)
    return code


@kernel
def checks_energy(settings: Any) -> bool:
    """Whether work is needed: for the energy check."""
    return bool(settings.energy_check == 1)


@kernel
def checks_or_watches_energy(settings: Any) -> bool:
    """Whether work is needed: for the energy check, or for the hybrid, which checks for jumps of the energy."""
    return bool(settings.energy_check == 1 or settings.partition == HYBRID)


@kernel
def start_ida(instance: Any, truncated_steps: int, keeps_history: bool) -> None:
    """As ``IDAStepper.continue_after_event`` does; no truncated steps: as its ``restart``."""
    own, t = instance.given, instance.clock[0]
    own.settings[0].works = 1 if own.eqs.data.arrays.world[0].nonconservative == 1 else 0
    if truncated_steps > 0 and continue_history(own, t, keeps_history):
        own.memory.progress[0].truncated_steps = truncated_steps
    else:
        dense_ida.start(own.memory, t, own.q, own.v, own.energy_account[WORK], truncated_steps, keeps_history)


def _dense_equations(callbacks: dict[str, Any], data: Any, structure: None, nq: int, n: int, m: int) -> Equations:
    return Equations(**callbacks, data=data, terms=Terms.allocate(nq, n, m))


def _explicit_equations(
    callbacks: dict[str, Any], data: Any, structure: None, nq: int, n: int, m: int
) -> ExplicitTreeEquations:
    return ExplicitTreeEquations(**callbacks, data=data)


def _tree_equations(callbacks: dict[str, Any], data: Any, tangent: Any, nq: int, n: int, m: int) -> TreeEquations:
    return TreeEquations(**callbacks, data=data, tangent=tangent)


def _workspace(nq: int, n: int, m: int, positions: Any) -> Workspace:
    return Workspace.allocate(nq, n, m, positions.states.shape[0])


FAMILIES = {  # by the prefix of their entry points
    "adams": Family(
        adams, DENSE_KERNELS, _dense_equations, History.allocate, _workspace,
        assemble_dense, begin_adams, evaluate_dense, solve_dense, True, checks_or_watches_energy, ADAMS_KERNELS,
        DENSE_JUMPS._replace(adapt=begin_adams),
    ),
    "radau": Family(
        radau, DENSE_KERNELS, _dense_equations, lambda nq, n, m: Memory.allocate(nq, n), _workspace,
        assemble_dense, begin_radau, evaluate_dense, solve_dense, True, checks_energy, RadauMethod.kernels,
        DENSE_JUMPS._replace(adapt=begin_radau), steps=ONE_STEP_STEPS,
    ),
    "ida": Family(
        dense_ida, DENSE_KERNELS, _dense_equations, IDAMemory.allocate, _workspace,
        assemble_dense, begin_ida, evaluate_dense, solve_dense, True, checks_energy, dense_ida.IDA_KERNELS,
        DENSE_JUMPS._replace(adapt=adapt_ida), start_ida, dense_ida.restore, dense_ida.close,
        keeps_history_at_jumps=False, steps=IDA_STEPS,
    ),
    "tree": Family(
        tree_loop, EXPLICIT_KERNELS, _explicit_equations, History.allocate,
        lambda nq, n, m, p: TreeScratch.allocate(nq, n, p),
        assemble_tree, begin_tree, evaluate_tree, evaluate_tree, False, checks_energy, ADAMS_KERNELS, TREE_JUMPS,
        balance=no_search,
    ),
    "esdirk": Family(
        esdirk, TREE_KERNELS, _tree_equations, ESDIRKMemory.allocate, Work.allocate,
        assemble_tree, begin_esdirk, evaluate_constrained_tree, evaluate_constrained_tree, False, checks_energy,
        ESDIRK_KERNELS, TREE_JUMPS._replace(renew=renew_tangent),
        restore=esdirk.discard_factors, balance=no_search, structure=STRUCTURED_TANGENT, uses_tangent=True,
        steps=ONE_STEP_STEPS,
    ),
    "tree_ida": Family(
        tree_ida, TREE_KERNELS, _tree_equations, tree_memory.TreeIDAMemory.allocate, tree_memory.Work.allocate,
        assemble_tree, begin_tree_ida, evaluate_constrained_tree, evaluate_constrained_tree, False, checks_energy,
        tree_ida.IDA_KERNELS, TREE_JUMPS._replace(renew=renew_tangent),
        restore=tree_ida.restore, close=dense_ida.close, keeps_history_at_jumps=False, balance=no_search,
        structure=STRUCTURED_TANGENT, uses_tangent=True, steps=IDA_STEPS,
    ),
    "eliminated": Family(
        eliminated_loop, eliminated.ELIMINATION_KERNELS, eliminated.ClosableEquations.of,
        lambda nq, n, m: History.allocate(nq, n, 0), EliminationScratch.allocate,
        eliminated.assemble_eliminated, eliminated.begin_eliminated, eliminated.evaluate_eliminated,
        eliminated.evaluate_eliminated, False, checks_energy, ADAMS_KERNELS,
        ELIMINATED_JUMPS._replace(adapt=eliminated.adapt_eliminated), balance=no_search,
        structure=Structure(eliminated.equations_of, eliminated.empty_equations), evaluates_placed=False,
    ),
    "eliminated_ida": Family(
        eliminated_ida, eliminated.ELIMINATION_KERNELS | LOCKABLE_TANGENT_KERNELS, eliminated.implicit_equations,
        lambda nq, n, m: EliminatedIDAMemory.allocate(nq, n), eliminated.implicit_work,
        eliminated.assemble_eliminated, eliminated.begin_eliminated_ida, eliminated.evaluate_eliminated,
        eliminated.evaluate_eliminated, False, checks_energy, tree_ida.IDA_KERNELS,
        ELIMINATED_JUMPS._replace(adapt=eliminated.adapt_eliminated_ida, renew=renew_tangent),
        restore=eliminated_ida.restore, close=dense_ida.close, keeps_history_at_jumps=False, balance=no_search,
        structure=Structure(eliminated.implicit_structure_of, eliminated.empty_implicit_structure), uses_tangent=True,
        evaluates_placed=False, formulation=eliminated.formulation_of, steps=IDA_STEPS,
    ),
}  # fmt: skip
TREE_FAMILIES = ("tree", "esdirk", "tree_ida")  # families of large models without constraints
ELIMINATED_FAMILIES = ("eliminated", "eliminated_ida")  # those of models whose constraints are eliminated
NATIVE_SOLVERS = ("adams", "hybrid", "adams-lu", "radau", "ida", "esdirk")  # that they serve
