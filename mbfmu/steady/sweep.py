"""Branches of steady states while one parameter changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from mbfmu.modeling.model import Model
from mbfmu.steady.equilibrium import build_problem, find_states
from mbfmu.steady.problem import EquilibriumProblem
from mbfmu.steady.state import Equilibrium
from mbfmu.util.errors import EquilibriumError
from solvers.system import Array


@dataclass
class Branch:
    """Steady states that follow from each other; ``values`` of the parameter ascend as the sweep does."""

    values: list[float] = field(default_factory=list)
    states: list[Equilibrium] = field(default_factory=list)


def sweep(
    model: Model,
    parameter: str,
    values: Sequence[float],
    *,
    scattered: int = 12,
    progress: Callable[[float], None] | None = None,
) -> list[Branch]:
    """Find the steady states at each value and join them to branches.

    Each branch is followed from value to value, and from where it was first found backwards too. New ones are looked
    for at every value from the model's start and from ``scattered`` other starts.

    Raises
    ------
    EquilibriumError
        No steady state at any value; the message is that of the last one.
    """
    problems = [build_problem(model.with_values({parameter: value})) for value in values]
    branches: list[Branch] = []
    failure: EquilibriumError | None = None
    for i, problem in enumerate(problems):
        found: list[Equilibrium] = []
        try:
            found = find_states(problem)  # first, since it selects the rates of cyclic coordinates
            found += problem.others(found[0], scattered)
        except EquilibriumError as error:
            failure = error
        for branch in branches:
            extend(branch, problem, values[i], branches)
        for state in found:
            if not is_known_state(problem, state.q, values[i], branches):
                branches.append(traced_back(state, i, values, problems, branches))
        if progress is not None:
            progress(values[i])
    if not branches and failure is not None:
        raise failure
    return branches


def extend(branch: Branch, problem: EquilibriumProblem, value: float, branches: list[Branch]) -> bool:
    """Follow a branch to the next value; False where it ends or meets another."""
    q = branch.states[-1].q
    if len(branch.states) > 1:  # secant
        q = q + problem.difference(q, branch.states[-2].q)
    try:
        state = problem.solve(q, "the branch's last state", branch.states[-1].lam)
    except EquilibriumError:
        return False
    if state.continued or is_known_state(problem, state.q, value, branches):
        return False
    branch.values.append(value)
    branch.states.append(state)
    return True


def is_known_state(problem: EquilibriumProblem, q: Array, value: float, branches: list[Branch]) -> bool:
    """Whether a branch has this state at this value already."""
    return any(
        problem.same(state.q, q)
        for branch in branches
        for v, state in zip(branch.values, branch.states, strict=True)
        if v == value
    )


def traced_back(
    state: Equilibrium, i: int, values: Sequence[float], problems: Sequence[EquilibriumProblem], branches: list[Branch]
) -> Branch:
    """Return the branch of a state found at ``values[i]``, followed backwards as far as it goes."""
    branch = Branch([values[i]], [state])
    for j in range(i - 1, -1, -1):
        if not extend(branch, problems[j], values[j], branches):
            break
    branch.values.reverse()
    branch.states.reverse()
    return branch
