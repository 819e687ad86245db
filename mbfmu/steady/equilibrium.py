"""The steady state of a model: one way to build the problem and to solve it, for every use of a steady state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TypeVar

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.modeling.model import Model, as_model
from mbfmu.steady.linear import StateSpace
from mbfmu.steady.modes import ModeShapes
from mbfmu.steady.problem import EquilibriumProblem
from mbfmu.steady.sampled import use_difference_quotients
from mbfmu.steady.state import Equilibrium
from mbfmu.steady.supports import Supports, follow_supports
from mbfmu.steady.times import finish, hold_start
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import EquilibriumError, UserError
from solvers.statics.spectrum import Stability

Found = TypeVar("Found")


def build_problem(model: Model | Mechanism, compiled: CompiledMechanism | None = None) -> EquilibriumProblem:
    """Return the equilibrium problem of a model, or of a compiled mechanism of it whose inputs are set.

    Steps and run-ups of drives and loads are taken to their ends. If the compiled mechanism is given, a run starts in
    the steady state, and signals are held at their values at t = 0 in this compiled mechanism. If the model cannot be
    assembled with the supports where they are, it is laid out as it was before they moved.

    Raises
    ------
    UserError
        The model cannot be assembled, has no free coordinate, a drive is not at constant speed, or a load never
        becomes constant; or a sampled block rounds its outputs.
    """
    model = as_model(model)
    made = compiled or model.compile()
    if made.system.n == 0:
        raise EquilibriumError(f"model {model.name!r} has no free coordinate; there is no steady state to look for")
    if made.mechanism.sampled:
        use_difference_quotients(made, model.name)
    supports = Supports(made, finishes=compiled is None)
    if compiled is None:
        finish(model.name, made)
    else:
        hold_start(made)
    try:
        return EquilibriumProblem(model, made, supports)
    except UserError:
        here = supports.positions()
        for begin in supports.beginnings():
            supports.move(begin)
            with suppress(UserError):
                problem = EquilibriumProblem(model, made, supports)
                supports.move(here)
                return problem
        raise


def find_states(problem: EquilibriumProblem) -> list[Equilibrium]:
    """Return the steady state of a problem, and the unstable one that was found before it from the start, if any.

    The problem is solved from its start. If that fails, or if the state is unstable, the motion of supports that steps
    or inputs have moved is followed from where they start, then from zero. An unstable state is returned if no other
    is found. If none is found, the search is repeated with the rates 0 of cyclic coordinates.

    Raises
    ------
    UserError
        No steady state is found; the message is that of the search from the start.
    """
    return search_with_rates(problem, lambda: _find_states(problem))


def search_with_rates(problem: EquilibriumProblem, search: Callable[[], Found]) -> Found:
    """Return what a search finds with the start rates of cyclic coordinates or, if it fails, with the rates 0.

    Raises
    ------
    UserError
        Neither is found; the message is that of the search with the start rates.
    """
    try:
        return search()
    except UserError:
        if not problem.keeps_rates:
            raise
        problem.set_keeps_rates(False)
        with suppress(UserError):
            return search()
        problem.set_keeps_rates(True)
        raise


def _find_states(problem: EquilibriumProblem) -> list[Equilibrium]:
    """Return the states of :func:`find_states` with the rates that the problem has."""
    found: list[Equilibrium] = []
    failure: UserError | None = None
    try:
        found.append(problem.solve(problem.start(), stick=True))
    except UserError as error:
        failure = error
    for begin in problem.supports.beginnings():
        if found and not is_unstable(found[0]):
            break
        with suppress(UserError):
            followed = follow_supports(problem, begin)
            if not found or not is_unstable(followed):
                found.insert(0, followed)
    if not found and failure is not None:
        raise failure
    return found


def find_state(problem: EquilibriumProblem) -> Equilibrium:
    """Return the steady state of a problem, see :func:`find_states`."""
    return find_states(problem)[0]


def is_unstable(state: Equilibrium) -> bool:
    """Whether a motion grows, as far as the eigenvalues can be found."""
    with suppress(EquilibriumError):
        return state.stability is Stability.UNSTABLE
    return False


def report_unstable(state: Equilibrium) -> list[Diagnostic]:
    """Return a warning if a run that starts in this state leaves it."""
    if not is_unstable(state):
        return []
    growth = 0.0 if state.is_sampled else max(mode.eigenvalue.real for mode in state.modes)
    rate = f" by exp({growth:.3g} t), t in s" if growth > 0.0 else ""  # large models: the lowest modes only
    text = (
        f"the steady state in which {state.model.name!r} starts is unstable: deviations, at first those of rounding, "
        f"grow{rate}"
    )
    remedy = "Other start values may lead to a stable state; `mbfmu equilibrium` lists those it finds"
    return [Diagnostic.warning("unstable-start", text, remedy, subject=state.model.name)]


def equilibrium(model: Model | Mechanism, start: Mapping[str, float] | None = None) -> Equilibrium:
    """Return a steady state of a model or a mechanism.

    Steps, ramps and run-ups of drives and loads are at their ends. If no stable state is found there from the start,
    the state before the supports moved is followed through their motion, see :mod:`mbfmu.steady.supports`.

    Parameters
    ----------
    model
        Model whose drives end at a constant speed and whose loads end at a constant value.
    start
        Coordinates by name (rad or m) from which Newton's method starts; by default those of the model.

    Returns
    -------
    Equilibrium
        Coordinates, outputs, stability, natural modes and linear model of the steady state.

    Raises
    ------
    EquilibriumError
        No steady state is found; the message contains the residual. Or a drive does not end at a constant speed, or a
        load does not end at a constant value.
    """
    problem = build_problem(model)
    if start:
        return search_with_rates(problem, lambda: problem.solve(problem.start(start), "the start given", stick=True))
    return find_state(problem)


def linearize(model: Model | Mechanism, start: Mapping[str, float] | None = None) -> StateSpace:
    """Return the linear model of the motion about a steady state, from the inputs to the outputs.

    Parameters
    ----------
    model, start
        As for :func:`equilibrium`.

    Returns
    -------
    StateSpace
        Matrices A, B, C, D with the names of states, inputs and outputs, in SI units.

    Raises
    ------
    EquilibriumError
        No steady state is found, or the model is too large for state matrices.
    """
    return equilibrium(model, start).state_space


def modes(model: Model | Mechanism, count: int = 8, start: Mapping[str, float] | None = None) -> ModeShapes:
    """Return the natural modes about a steady state, the slowest first.

    Parameters
    ----------
    model, start
        As for :func:`equilibrium`.
    count
        Largest number of modes.

    Returns
    -------
    ModeShapes
        List of modes: eigenvalues (1/s), frequencies (rad/s), damping ratios and shapes in the coordinates. ``print``
        writes it as a table without the shapes, with frequencies in rad/s and Hz.

    Raises
    ------
    EquilibriumError
        No steady state is found, or its modes are not found.
    UserError
        ``count`` is not a positive whole number.
    """
    if not isinstance(count, int) or count < 1:
        raise UserError(f"count of modes is {count!r}; allowed: a whole number from 1 on")
    return equilibrium(model, start).shapes(count)
