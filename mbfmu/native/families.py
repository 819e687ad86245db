"""What machine code does otherwise for one family of steppers than for another: kernels over instances.

Small mechanisms are integrated by their matrices, large trees by their recursions.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

from mbfmu.mechanics.recursions import dynamics as recursions
from solvers.assembly import ASSEMBLED, check_mobile_mass, find_closed_positions, find_consistent_velocities
from solvers.compiled.kernel import kernel
from solvers.energy_account import WORK
from solvers.outcome import OK
from solvers.positions import position_sizes
from solvers.projection.projection import project
from solvers.projection.rank import find_normal_rank
from solvers.projection.reported import evaluate_state
from solvers.projection.workspace import Workspace
from solvers.steppers.adams import loop as adams
from solvers.steppers.adams import tree_loop
from solvers.steppers.adams.formulas import History, restart_history
from solvers.steppers.adams.hybrid import HYBRID
from solvers.steppers.adams.jumps import limit_steps
from solvers.steppers.dense import estimate_rates
from solvers.steppers.radau import loop as radau
from solvers.steppers.radau.formulas import Memory
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.system import Equations, Terms

from .start_checks import find_turned

SMALL = {name: getattr(recursions, name) for name in Equations._fields[:-2]}
LARGE = {name: getattr(recursions, name) for name in tree_loop.TreeEquations._fields[:-1]}
LARGE["power"] = recursions.solved_power


class Family(NamedTuple):
    """What is a family's own. All kernels but the last two take an instance first."""

    loop: ModuleType  # with its kernels ``advance_reported``, and SETTINGS
    callbacks: dict[str, Callable[..., Any]]  # of its equations
    equations: Callable[..., Any]  # (callbacks, data, nq, n, m)
    memory: Callable[..., Any]  # (nq, n, m): what is remembered from step to step
    work: Callable[..., Any]  # (nq, n, m, positions): scratch, with units ``size``
    assemble: Any  # (s, t) -> code of solvers.assembly: the reported state is the start with its loops closed
    begin: Any  # (s, t) -> code and rate (1/s): options, units and paces as a stepper's constructor takes them
    evaluate: Any  # (s) -> code: accelerations and multipliers at the reported state
    renew: Any  # (s, fresh): go on at the reported state; fresh: nothing is kept of what was known
    limit: Any  # (g, t, longest): no step from the reported state at t on is longer, s
    count: Any  # (g, counts): what the run has cost, in the order of COUNTERS


@kernel
def assemble_small(s: Any, t: float) -> int:
    """If it is not ASSEMBLED, ``worst`` or ``massless`` of the scratch contains the cause, and there is no state."""
    g, start, work = s.given, s.start, s.start.scratch
    code: int = find_closed_positions(g.eqs, t, start.q, g.q, work)
    if code == ASSEMBLED:
        code = find_turned(s.frames, g.eqs.data, work.worst[0])
    if code == ASSEMBLED:
        code = find_consistent_velocities(g.eqs, t, g.q, start.v, s.known[0], g.v, work)
    if code == ASSEMBLED:
        g.eqs.dynamics(t, g.q, g.v, g.eqs.data, g.eqs.terms)
        code = check_mobile_mass(g.eqs.terms, g.work.mass, work)
    return code


@kernel
def assemble_tree(s: Any, t: float) -> int:
    """Nothing is to be closed; whether all that moves has inertia the solver finds out."""
    g, start = s.given, s.start
    for i in range(g.q.shape[0]):
        g.q[i] = start.q[i]
    for i in range(g.v.shape[0]):
        g.v[i] = start.v[i]
    return ASSEMBLED


@kernel
def find_out(s: Any, t: float) -> tuple[int, int]:
    """Close the reported state, and find units and paces there; return how it was closed, and the rank."""
    g = s.given
    position_sizes(s.positions, g.work.size, g.work.size_q)
    rank = find_normal_rank(g.eqs, t, g.q, g.v, g.work)
    code = project(g.eqs, t, g.q, g.v, rank, g.work)
    estimate_rates(g.eqs, t, g.q, g.v, rank, s.known[0], s.known[1], s.options[0].duration, g.work)
    return code, rank


@kernel
def begin_adams(s: Any, t: float) -> tuple[int, float]:
    """As ``AdamsStepper`` is made."""
    adams.set_options(s.options, s.given.settings)
    code, rank = find_out(s, t)
    adams.set_up(s.given, rank, s.options[0].absolute)
    return code, s.given.work.rate[0]


@kernel
def begin_radau(s: Any, t: float) -> tuple[int, float]:
    """As ``RadauStepper`` is made."""
    radau.set_options(s.options, s.given.settings)
    code, rank = find_out(s, t)
    radau.set_up(s.given, rank, s.options[0].absolute)
    return code, s.given.work.rate[0]


@kernel
def begin_tree(s: Any, t: float) -> tuple[int, float]:
    """As ``TreeAdamsStepper`` is made."""
    adams.set_options(s.options, s.given.settings)
    tree_loop.set_up(s.given, t, s.known[0], s.options[0].duration)
    return OK, s.given.settings[0].rate


@kernel
def evaluate_small(s: Any) -> int:
    """Fill ``s.a`` and ``s.lam``."""
    g = s.given
    code: int = evaluate_state(g.eqs, s.clock[0], g.q, g.v, g.memory.control[0].rank, g.work, s.a, s.lam)
    return code


@kernel
def evaluate_tree(s: Any) -> int:
    """Fill ``s.a``."""
    code: int = tree_loop.evaluate(s.given, s.clock[0], s.a)
    return code


@kernel
def renew_history(s: Any, fresh: bool, watched: bool) -> None:
    """As ``ExplicitStepper.continue_after_event`` does; ``fresh``: as its ``restart``; ``watched``: work is to be
    booked.
    """
    g, keeps_position, rk_steps = s.given, not fresh and s.told[0].code == OK, 0 if fresh else TRUNCATED_STEPS
    g.settings[0].works = 1 if watched and g.eqs.data.arrays.world[0].nonconservative == 1 else 0
    restart_history(g.memory, s.clock[0], g.q, g.v, g.energy_account[WORK], rk_steps, 0 if fresh else 1, keeps_position)


@kernel
def renew_adams(s: Any, fresh: bool) -> None:
    """See :func:`renew_history`."""
    o = s.given.settings[0]
    renew_history(s, fresh, o.energy_check == 1 or o.partition == HYBRID)


@kernel
def renew_tree(s: Any, fresh: bool) -> None:
    """See :func:`renew_history`."""
    renew_history(s, fresh, s.given.settings[0].energy_check == 1)


@kernel
def renew_radau(s: Any, fresh: bool) -> None:
    """As ``RadauStepper.continue_after_event`` does; ``fresh``: as its ``restart``."""
    g, keeps_position = s.given, not fresh and s.told[0].code == OK
    o = g.settings[0]
    o.works = 1 if o.energy_check == 1 and g.eqs.data.arrays.world[0].nonconservative == 1 else 0
    radau.restart_at_state(
        g.memory, s.clock[0], g.q, g.v, g.energy_account[WORK], 0 if fresh else TRUNCATED_STEPS, keeps_position
    )
    if fresh:
        g.memory.control[0].has_derivatives = 0


@kernel
def limit_history(g: Any, t: float, longest: float) -> None:
    """As ``ExplicitStepper._limit`` does."""
    limit_steps(g.memory, g.settings, t, g.q, g.v, g.energy_account[WORK], longest)


@kernel
def limit_radau(g: Any, t: float, longest: float) -> None:
    """As ``RadauStepper._limit`` does."""
    g.settings[0].max_step = longest


@kernel
def count_adams(g: Any, counts: Any) -> None:
    """As ``statistics`` of steppers on Adams formulas."""
    c = g.memory.control[0]
    left = c.by_turn + c.by_flicker + c.by_energy + c.by_collapse
    counts[0], counts[1], counts[2], counts[3] = c.steps, c.rejected, c.evaluations, left + c.returns
    counts[4], counts[5] = max(0, c.starts - 1), c.stability_limited


@kernel
def count_radau(g: Any, counts: Any) -> None:
    """As ``RadauStepper.statistics``."""
    c = g.memory.control[0]
    counts[0], counts[1], counts[2] = c.steps, c.rejected, c.evaluations
    counts[4] = max(0, c.starts - 1)


def _by_matrices(callbacks: dict[str, Any], data: Any, nq: int, n: int, m: int) -> Equations:
    return Equations(**callbacks, data=data, terms=Terms.allocate(nq, n, m))


def _by_recursions(callbacks: dict[str, Any], data: Any, nq: int, n: int, m: int) -> tree_loop.TreeEquations:
    return tree_loop.TreeEquations(**callbacks, data=data)


def _workspace(nq: int, n: int, m: int, positions: Any) -> Workspace:
    return Workspace.allocate(nq, n, m)


FAMILIES = {  # by the prefix of their entry points
    "adams": Family(
        adams, SMALL, _by_matrices, History.allocate, _workspace,
        assemble_small, begin_adams, evaluate_small, renew_adams, limit_history, count_adams,
    ),
    "radau": Family(
        radau, SMALL, _by_matrices, lambda nq, n, m: Memory.allocate(nq, n), _workspace,
        assemble_small, begin_radau, evaluate_small, renew_radau, limit_radau, count_radau,
    ),
    "tree": Family(
        tree_loop, LARGE, _by_recursions, History.allocate, lambda nq, n, m, p: tree_loop.Scratch.allocate(nq, n, p),
        assemble_tree, begin_tree, evaluate_tree, renew_tree, limit_history, count_adams,
    ),
}  # fmt: skip
SOLVERS = ("adams", "hybrid", "adams-lu", "radau")  # that they serve
