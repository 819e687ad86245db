"""Equilibrium paths: steady states of a model over one of its inputs, through limit points and onto second paths.

A sweep (:mod:`.sweep`) goes from value to value of a parameter, and ends where the states turn back. A path is followed
along itself, see :mod:`solvers.statics.path`, so that its unstable parts are on it too.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from mbfmu.mechanics import Mechanism
from mbfmu.mechanics.numbers import finite
from mbfmu.modeling.model import Model
from mbfmu.steady.equilibrium import build_problem, find_state, search_with_rates
from mbfmu.util.errors import EquilibriumError, UserError, suggest
from mbfmu.util.files import replacing
from solvers.linalg.threads import one_thread
from solvers.statics.matrices import MAX_ASSEMBLED_COORDINATES
from solvers.statics.path import Follower, Load, State
from solvers.statics.spectrum import Stability

MAX_BRANCH_STATES = 500  # of a branch, at most


@dataclass(frozen=True, kw_only=True)
class PathState:
    """A steady state on an equilibrium path.

    Attributes
    ----------
    value
        Of the input.
    outputs, positions
        By name, as :class:`mbfmu.Equilibrium` has them.
    unstable
        How many independent motions the stiffness drives away, inertia of the drives' rotation included: negative
        eigenvalues on the constraints.
    stability
        As :class:`mbfmu.Equilibrium` has it; of more than 300 coordinates ``stable`` or ``unstable``, by that number.
    kind
        ``limit point``, ``bifurcation``, or empty.
    """

    value: float
    outputs: Mapping[str, float]
    positions: Mapping[str, float]
    unstable: int
    stability: Stability
    kind: str = ""


@dataclass(frozen=True, kw_only=True)
class PathBranch:
    """States that follow from each other. ``ended`` is the reason if it stopped before the end; else empty."""

    states: list[PathState] = field(default_factory=list)
    ended: str = ""

    @property
    def values(self) -> list[float]:
        """Of the input."""
        return [state.value for state in self.states]

    def output(self, name: str) -> list[float]:
        """Return an output along the branch."""
        return [state.outputs[name] for state in self.states]

    def of_kind(self, kind: str) -> list[PathState]:
        """Return its states of one kind."""
        return [state for state in self.states if state.kind == kind]


@dataclass(frozen=True, kw_only=True)
class EquilibriumPath:
    """Result of :func:`equilibrium_path`.

    Attributes
    ----------
    input, unit
        Name of the input over which the path was followed, and its unit.
    units
        Units of the outputs, by name.
    branches
        Branch from the start; then, on request, two from each of its bifurcations. A branch has ``values``
        of the input, ``output(name)`` along it, and ``ended``: the reason if it ended early. Its ``states`` have
        ``value``, ``outputs``, ``positions``, ``stability``, ``unstable`` motions, and ``kind``: ``limit point``,
        ``bifurcation`` or empty.
    """

    input: str
    unit: str
    units: Mapping[str, str]
    branches: list[PathBranch]

    @property
    def limit_points(self) -> list[PathState]:
        """Limit points of the first branch."""
        return self.branches[0].of_kind("limit point")

    @property
    def bifurcations(self) -> list[PathState]:
        """Bifurcations of the first branch."""
        return self.branches[0].of_kind("bifurcation")

    def as_dict(self) -> dict[str, Any]:
        """Return all results as a dictionary for JSON."""
        return asdict(self)

    def write_csv(self, path: Path | str) -> None:
        """Write the states as comma-separated values; the header contains names and units.

        Parameters
        ----------
        path
            Path of the file.

        Raises
        ------
        UserError
            The file cannot be written.
        """
        with replacing(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            outputs = [f"{name} [{unit}]" for name, unit in self.units.items()]
            writer.writerow(["branch", f"{self.input} [{self.unit}]", *outputs, "stability", "unstable", "kind"])
            for k, branch in enumerate(self.branches, 1):
                for s in branch.states:
                    texts = (repr(s.outputs[name]) for name in self.units)
                    writer.writerow([k, repr(s.value), *texts, s.stability, s.unstable, s.kind])


class PathProblem:
    """One model over one of its inputs."""

    def __init__(self, model: Model | Mechanism, over: str) -> None:
        self.problem = build_problem(model)
        self.compiled, name = self.problem.compiled, self.problem.model.name
        if self.compiled.mechanism.sampled:
            raise EquilibriumError(
                f"model {name!r} has sampled blocks, with which no path is followed; allowed: models without them. Use "
                "a sweep over a parameter (mbfmu equilibrium --sweep)"
            )
        inputs = [variable.name for variable in self.compiled.inputs.variables]
        if over not in inputs:
            if over in {p.name for p in self.problem.model.parameters()}:
                raise UserError(
                    f"{over!r} is a parameter of model {name!r}, which needs a new model for each value, but a "
                    "path is followed over an input; allowed: "
                    f"{', '.join(inputs) or 'nothing, there is no input'} "
                    "(a sweep takes parameters)"
                )
            raise UserError(f"model {name!r} has no input {over!r}{suggest(over, inputs)}")
        self._index = inputs.index(over)
        self.variable = self.compiled.inputs.variables[self._index]

    def follower(self, begin: float, end: float, start: Mapping[str, float] | None) -> Follower:
        """Return what follows the path from the steady state at the begin."""
        self.apply(begin)
        if start:
            given = self.problem.start(start)
            found = search_with_rates(self.problem, lambda: self.problem.solve(given, "the start given"))
        else:
            found = find_state(self.problem)
        at, load = self.problem.unknowns(found), Load(self.apply, begin, end)
        return Follower(self.problem.linearized(), load, at, found.lam[found.rows])

    def apply(self, value: float) -> None:
        """Let the input have a value."""
        self.problem.set_input(self._index, value)

    def passing(self, name: str, limit: float) -> Callable[[State], float]:
        """Return the function that gives the distance of an output from a limit."""
        names, limit = [variable.name for variable in self.compiled.outputs], finite(f"until of {name!r}", limit)
        if name not in names:
            model = self.problem.model.name
            raise UserError(f"until {name!r}: model {model!r} has no such output{suggest(name, names)}")

        def above(at: State) -> float:
            return self.evaluate_state(at).outputs[name] - limit

        return above

    def evaluate_state(self, at: State) -> PathState:
        """Return what is known of a state; EquilibriumError where it is no steady one."""
        self.apply(at.p)
        found = self.problem.state(at.q, at.lam, "the path")
        known = self.compiled.system.has_matrices or self.compiled.system.n <= MAX_ASSEMBLED_COORDINATES
        return PathState(
            value=at.p,
            outputs=found.outputs,
            positions=found.positions(),
            unstable=at.unstable,
            stability=found.stability if known else Stability.UNSTABLE if at.unstable else Stability.STABLE,
            kind=at.kind,
        )


def equilibrium_path(
    model: Model | Mechanism,
    over: str,
    values: tuple[float, float],
    *,
    until: tuple[str, float] | None = None,
    second: bool = False,
    start: Mapping[str, float] | None = None,
    steps: int = MAX_BRANCH_STATES,
    progress: Callable[[float], None] | None = None,
) -> EquilibriumPath:
    """Return the steady states of a model or a mechanism along a path over one of its inputs.

    The path may pass limit points and be unstable. It ends where the input leaves the range, or earlier.

    Parameters
    ----------
    model
        Model with drives at constant speed, or without drives for static equilibrium.
    over
        Name of the input: a load, gravity, the position of a support or the speed of a drive.
    values
        Values of the input at the begin and at the end of the path.
    until
        Name and value of an output at which the path also ends.
    second
        Whether to follow the paths that cross at bifurcations, in both directions.
    start
        Coordinates by name from which the search for the first state starts.
    steps
        Largest number of steps on each branch.
    progress
        Function that receives the value of the input after every state.

    Returns
    -------
    EquilibriumPath
        Branches of steady states with their outputs, stability, limit points and bifurcations.

    Raises
    ------
    UserError
        No such input, or no range.
    EquilibriumError
        There is no steady state at the beginning.
    """
    begin, end = (finite(f"{which} of {over!r}", v) for which, v in zip(("begin", "end"), values, strict=True))
    if begin == end:
        raise UserError(f"{over!r} goes from {begin:g} to {end:g}; allowed: two different values")
    if not isinstance(steps, int) or steps < 1:
        raise UserError(f"steps is {steps!r}; allowed: a whole number from 1 on")
    problem = PathProblem(model, over)
    stop = None if until is None else problem.passing(*until)
    with one_thread():  # more wait for each other, as small as the matrices are
        follower = problem.follower(begin, end, start)
        first, crossings = follow(problem, follower, follower.start, stop, steps, progress)
        branches = [first]
        for crossing in crossings if second else ():
            for side in (1.0, -1.0):
                branch, _ = follow(problem, follower, follower.branch_start(crossing, side), stop, steps, progress)
                branches.append(branch)
    return EquilibriumPath(
        input=over,
        unit=problem.variable.unit,
        units={variable.name: variable.unit for variable in problem.compiled.outputs},
        branches=branches,
    )


def follow(
    problem: PathProblem,
    follower: Follower,
    start: State,
    stop: Callable[[State], float] | None,
    steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[PathBranch, list[State]]:
    """Return a branch, and the bifurcations on it."""
    states, crossings, ended = [problem.evaluate_state(start)], [], ""
    try:
        for at in islice(follower.follow(start, stop), steps):
            states.append(problem.evaluate_state(at))
            if at.kind == "bifurcation":
                crossings.append(at)
            if progress is not None:
                progress(at.p)
        ended = follower.ended or (f"the maximum of {steps} steps was reached" if len(states) > steps else "")
    except EquilibriumError as error:
        ended = str(error)
    return PathBranch(states=states, ended=ended), crossings
