"""The solver that ``auto`` stands for: found before the run by trying, from the model as it starts.

Eigenvalues do not show which motion a solver must resolve: rotation at a constant speed requires no steps. So both
families run for a short time with the settings of the run, and the results are discarded. The explicit solver is first.
Where accuracy sets its steps it is the cheapest there is, and nothing else is tried. Where stability sets them the
implicit one runs, some times as far, and the cheaper one is taken: by evaluations of the equations for a second of
motion, which are the same on every machine and every day.

A trial of an implicit solver is dear while what is fast still dies out. So what it will have to follow when that is
done is estimated too, from eigenvalues and amplitudes (:mod:`mbfmu.session.stiffness`), and the lower number counts.
Either may be too high: eigenvalues take a speed for a rate, a short trial the start for the whole.

A model at rest needs no evaluations by an implicit solver. It will not remain at rest, so that no fewer are
counted than gravity and drives will require. Stiffness after the trial, such as a stop that is reached later, is not
detected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from mbfmu.mechanics import CompiledMechanism
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_count
from solvers import stepper
from solvers.compiled.kernel import COMPILED
from solvers.options import Options
from solvers.resolution import MIN_RATE_PER_DURATION
from solvers.steppers import (
    MAX_RADAU_COORDINATES,
    describe_order_refusal,
    eliminates_constraints,
    eliminates_implicitly,
    uses_recursions,
)
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, Array

from .stiffness import spectrum

EXPLICIT_TRIAL_STEPS, IMPLICIT_TRIAL_STEPS = 300, 60  # of a trial, of the explicit solver and of the implicit one
MAX_TRIAL_TIME_FACTOR = 1e3  # of a trial, in units of one over the rate of the motion
# times as far as the explicit one the implicit one may go: decays at the start count less
IMPLICIT_TRIAL_TIME_FACTOR = 10.0
EVALUATION_WEIGHTS = {"radau": 1.5, "esdirk": 2.5, "ida": 1.8}  # of an evaluation, in those of an explicit solver
TRIAL_TIME_DOUBLINGS = 10  # of twice the length each, by which it goes there
MIN_EVALUATIONS_PER_RATE = 50.0  # evaluations of an implicit solver for every 1/s of gravity and drives
EVALUATIONS_PER_MOTION_RATE = 250.0  # of an implicit solver, per 1/s of the rate of the motion
EVALUATIONS_PER_OSCILLATION_RATE = 15.0  # per 1/s of a fast oscillation that is resolved
DENSE_TOLERANCE_EXPONENT = 1.0 / 6.0  # evaluations of radau grow as 1 / tolerance to this power
TREE_TOLERANCE_EXPONENT = 0.45  # the same, of esdirk and ida on trees
MIN_HYBRID_CONSTRAINTS = 10  # constraint equations from which LU on the dependent coordinates pays
MIN_ESDIRK_TOLERANCE = 1e-6  # tightest tolerance of esdirk on trees without meshes, where its order is too low
# part of the fastest undamped motion's rate that must be followed for orders of BDF above MAX_STABLE_BDF_ORDER
MIN_RESOLVED_RATE_RATIO = 0.3
MAX_STABLE_BDF_ORDER = 2  # of BDF, up to which undamped motions of any speed are stable

State = tuple[float, Array, Array]  # t (s), q (nq,), v (n,)


class SolverChoice(NamedTuple):
    """A solver, and the reason why ``auto`` selected it; no reason if it was requested."""

    solver: str
    reason: str = ""  # a clause with the numbers that decided
    stiff: bool = False  # whether it is an implicit one, because stability would limit the steps of an explicit one

    @property
    def diagnostics(self) -> list[Diagnostic]:
        """A note on both, if ``auto`` selected the solver."""
        text = f"auto selected {self.solver!r}: {self.reason}"
        return [Diagnostic.note("selected-solver", text, subject=self.solver)] if self.reason else []


class _Trial(NamedTuple):
    """What a solver did in a trial."""

    end: State
    took: float  # s
    cost: float  # evaluations for a second of motion, 1/s; infinite where it did not get anywhere
    limited: bool  # whether stability set the length of steps


def select_solver(compiled: CompiledMechanism, states: Sequence[State], options: Options) -> SolverChoice:
    """Return the solver of the cheaper family for motions from these states, which must keep the constraints."""
    if not compiled.system.n:
        return SolverChoice("adams", "the drives determine the motion, and nothing is integrated")
    if reason := compiled.system.stiffness_reason or compiled.system.stick_reason:
        solver, size = select_implicit(compiled, options.absolute)
        return SolverChoice(solver, f"stiff: {reason}; {size}", True)
    first, size = select_explicit(compiled)
    if first == "ida":
        return SolverChoice(first, size)
    tried = [_try_explicit(compiled, first, state, options) for state in states]
    if not any(trial.limited for trial in tried):
        return SolverChoice(first, f"not stiff, the step size is limited by accuracy; {size}")
    other, other_size = select_implicit(compiled, options.absolute)
    costs = [_costs(compiled, first, other, *both, options) for both in zip(states, tried, strict=True)]
    cost, least = (sum(family) / len(states) for family in zip(*costs, strict=True))
    numbers = f"per second of motion {cost:.3g} evaluations with {first!r}, and the cost of {least:.3g} with {other!r}"
    if least < cost:
        return SolverChoice(
            other, f"cheaper where stability limits the steps of {first!r}: {numbers}; {other_size}", True
        )
    return SolverChoice(first, f"cheaper although stability limits its steps: {numbers}; {size}")


def limit_order(
    compiled: CompiledMechanism, solver: str, state: State, options: Options
) -> tuple[Options, list[Diagnostic]]:
    """Return the options of a run, and a warning if they limit the order of `ida`, or if a lower or higher one was set.

    Orders from 3 on are unstable on undamped motions that the steps do not resolve. A large tree without a mesh has
    such motions if its fastest undamped one is much faster than what the solver has to follow.
    """
    system = compiled.system
    requested = options.max_order
    if solver != "ida":
        return options, []
    meshed = has_mesh(compiled)
    if requested and requested <= MAX_STABLE_BDF_ORDER:
        return options, [] if meshed and requested == MAX_STABLE_BDF_ORDER else [describe_low_order(requested)]
    if system.has_matrices or system.mesh_mask is None:
        return options, []
    if meshed:  # of itself, it uses low orders there
        what = "the membrane motions of sheets are"
        return options, [describe_unstable_order(requested, what, "or use 'esdirk'")] if requested else []
    if not COMPILED:  # the eigenvalues would take longer than most runs; without a limit the error is as small
        return options, []
    try:
        found = spectrum(compiled, *state)
    except UserError:
        return options, []
    followed = found.followed(options.absolute)
    if followed >= MIN_RESOLVED_RATE_RATIO * found.undamped or followed <= MIN_RATE_PER_DURATION / options.duration:
        return options, []  # in the second case it is at rest, and the motion to be resolved is unknown
    if requested:
        what = f"the fastest motion of this model ({found.undamped:.3g} rad/s, coordinate {found.leading!r}) is"
        return options, [describe_unstable_order(requested, what, "or use 'adams' if the run is short")]
    limited = Diagnostic.warning(
        "limited-order",
        f"'ida' uses orders 1 and 2 only: the fastest motion of this model ({found.undamped:.3g} rad/s, coordinate "
        f"{found.leading!r}) is hardly damped and faster than the resolved motion ({followed:.3g} rad/s), and "
        "higher orders are unstable there",
        "The error may be several hundred times the tolerance: choose a tolerance 100 times smaller than the required "
        "accuracy, or set max_order, or use 'adams' if the run is short",
        subject="ida",
    )
    return replace(options, max_order=MAX_STABLE_BDF_ORDER), [limited]


def describe_low_order(order: int) -> Diagnostic:
    """Return the warning about an order that was set, where `ida` would use higher ones."""
    lowest = order == 1
    used, error, factor = ("order 1", "thousand", 10_000) if lowest else ("orders 1 and 2", "hundred", 1000)
    return Diagnostic.warning(
        "limited-order",
        f"max_order is {order}, so that 'ida' uses {used} only: the error may be several {error} times the tolerance",
        "Leave max_order at 0, which allows the orders that the model permits, or choose a tolerance "
        f"{factor} times smaller than the required accuracy",
        subject="max_order",
    )


def describe_unstable_order(order: int, what: str, other: str) -> Diagnostic:
    """Return the warning about an order that was set, where `ida` would use lower ones."""
    return Diagnostic.warning(
        "unstable-order",
        f"max_order is {order}, but {what} faster than the resolved motion, and orders from 3 on are unstable there if "
        "it is hardly damped: the run may take very many steps",
        f"Leave max_order at 0 (orders 1 and 2), {other}",
        subject="max_order",
    )


def _try_explicit(compiled: CompiledMechanism, solver: str, state: State, options: Options) -> _Trial:
    rate = max(_rate(compiled, state), MIN_RATE_PER_DURATION / options.duration)
    return try_solver(compiled, solver, state, options, [MAX_TRIAL_TIME_FACTOR / rate], EXPLICIT_TRIAL_STEPS)


def _costs(
    compiled: CompiledMechanism, first: str, other: str, state: State, before: _Trial, options: Options
) -> tuple[float, float]:
    """Return what a second from this state on costs the explicit solver and the implicit one, 1/s.

    ``before`` is the trial of the explicit one. The implicit one is tried last, since that takes longest, and gets on:
    where it ends is the second state, about which the explicit one and the estimate are asked again.
    """
    weight, whole = EVALUATION_WEIGHTS[other], IMPLICIT_TRIAL_TIME_FACTOR * before.took
    least = weight * MIN_EVALUATIONS_PER_RATE * compiled.system.rate
    if not before.took:
        return 0.0, 0.0
    if not least < before.cost:
        return before.cost, least
    later = max(least, weight * _evaluations_after(compiled, state, options.absolute, whole))
    if later < before.cost:
        return before.cost, later
    trial = try_solver(
        compiled,
        other,
        state,
        options,
        [whole / 2.0**rung for rung in range(TRIAL_TIME_DOUBLINGS, -1, -1)],
        IMPLICIT_TRIAL_STEPS,
    )
    again = _try_explicit(compiled, first, trial.end, options)
    later = weight * _evaluations_after(compiled, trial.end, options.absolute, IMPLICIT_TRIAL_TIME_FACTOR * again.took)
    return again.cost if again.took else before.cost, max(least, min(weight * trial.cost, later))


def _evaluations_after(compiled: CompiledMechanism, state: State, tolerance: float, after: float) -> float:
    """Return the evaluations of an implicit solver for a second of what is left ``after`` so long (s), 1/s.

    They are infinite where they are not known.
    """
    try:
        swinging = spectrum(compiled, *state).swinging(tolerance, after)
    except UserError:
        return inf
    gain = DENSE_TOLERANCE_EXPONENT if compiled.system.has_matrices else TREE_TOLERANCE_EXPONENT
    return float(
        max(EVALUATIONS_PER_MOTION_RATE * _rate(compiled, state), EVALUATIONS_PER_OSCILLATION_RATE * swinging)
        * (1e-6 / tolerance) ** gain
    )


def _rate(compiled: CompiledMechanism, state: State) -> float:
    """Return the rate of the motion by gravity, drives and velocities, 1/s; zero: at rest."""
    system = compiled.system
    speeds = np.abs(state[2] / system.size)[: system.n_velocities]
    return max(float(system.rate), float(speeds.max(initial=0.0)))


def try_solver(
    compiled: CompiledMechanism, solver: str, state: State, options: Options, times: Sequence[float], steps: int
) -> _Trial:
    """Try a solver for these times (s) one after the other, until it has taken ``steps`` steps.

    A start that it refuses gets nowhere here; the run will say why.
    """
    begin = state[0]
    order = None if describe_order_refusal(solver, options.max_order) else options.max_order
    options = replace(options, max_steps=steps, max_order=order, energy_check=False)
    try:
        trial = stepper(solver, compiled.system, *state, options)
    except ValueError:
        return _Trial(state, 0.0, inf, False)
    with compiled.histories_kept():
        for t in times:
            if not trial.advance(begin + t).ok or trial.statistics.steps > steps:
                break
    done, took = trial.statistics, trial.t - begin
    cost = done.rhs_evals / took if took > 0.0 else inf
    return _Trial((trial.t, trial.q, trial.v), took, cost, done.stability_limited > 0)


def select_explicit(compiled: CompiledMechanism) -> tuple[str, str]:
    """Return the solver to take where nothing is stiff, and what its size has to do with it."""
    system, size = compiled.system, describe_size(compiled)
    if not system.has_matrices and not system.m:
        return "adams", f"a large open-chain model with {size}"
    if eliminates_constraints("adams", system):
        return "adams", f"{size} and {system.m} constraints, which are eliminated along the tree"
    if system.n > MAX_SOLVER_DENSE_COORDINATES:
        return "ida", f"{size} with loops, too many for the dense matrices of 'adams' and 'hybrid'"
    if system.m >= MIN_HYBRID_CONSTRAINTS:
        return "hybrid", f"{size} and {system.m} constraints"
    return "adams", f"{size} and {format_count(system.m, 'constraint')}" if system.m else f"{size} without loops"


def select_implicit(compiled: CompiledMechanism, tolerance: float) -> tuple[str, str]:
    """Return the solver to take where something is stiff, and what its size has to do with it."""
    system, size = compiled.system, describe_size(compiled)
    if uses_recursions("ida", system):
        return "ida", f"a large open-chain model with {size}"
    if system.has_matrices and system.n_states and eliminates_implicitly("ida", system):
        return "ida", f"{size} and {system.m} constraints, which are eliminated along the tree"
    if system.has_matrices:
        few = system.n <= MAX_RADAU_COORDINATES
        return ("radau", size) if few else ("ida", f"{size}, too many for 'radau'")
    if system.nonsmooth_reason:
        return "esdirk", f"a large model with {size} and contact"
    if system.m:
        return "ida", f"a large model with {size} and {format_count(system.m, 'constraint')}"
    if not suits_esdirk(compiled, tolerance):
        limit = f"{MIN_ESDIRK_TOLERANCE:g}"
        return "ida", f"a large model with {size} and a tolerance below {limit}, which is too small for esdirk"
    return "esdirk", f"a large open-chain model with {size}"


def has_mesh(compiled: CompiledMechanism) -> bool:
    """Whether a large model contains a sheet."""
    system = compiled.system
    return not system.has_matrices and system.mesh_mask is not None and bool(system.mesh_mask.any())


def suits_esdirk(compiled: CompiledMechanism, tolerance: float) -> bool:
    """Whether `esdirk` needs less than `ida` for an error: on sheets, where the order of `ida` is lower, always."""
    return tolerance >= MIN_ESDIRK_TOLERANCE or has_mesh(compiled)


def describe_size(compiled: CompiledMechanism) -> str:
    """Return the numbers of joint coordinates and of first-order states as text."""
    system = compiled.system
    coordinates = format_count(system.n_velocities, "joint coordinate")
    return f"{coordinates} and {format_count(system.n_states, 'first-order state')}" if system.n_states else coordinates
