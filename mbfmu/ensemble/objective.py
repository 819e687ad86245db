"""What a study aims at, and the optimizers of SciPy that look for it, many runs at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

import numpy as np
from scipy import optimize

from mbfmu.util.errors import UserError, suggest
from solvers.system import Array

from .design import Point
from .variation import Drawn, Variation

OPTIMIZATION_METHODS = ("differential_evolution", "L-BFGS-B", "least_squares")
OBJECTIVE_KEYS = ("minimize", "maximize", "target", "method", "most")
OBJECTIVE_DIFFERENCE_STEP = 1e-3  # of the range: steps of finite differences, well above the noise of a tolerance
RANGE_END_TOLERANCE = 1e-4  # of a range, within which a point is at its end
MAX_TARGET_MISS = 1e-3  # of targets, relative to their size
FAILED_RUN_COST = 1e30  # a failed run, for optimizers that cannot take infinity
# probabilities between which a number with an endless distribution is looked for
UNBOUNDED_RANGE_PROBABILITIES = (1e-3, 1.0 - 1e-3)

Evaluate = Callable[[list[Point]], list[dict[str, float]]]  # measures of runs at points, in order; NaN where one failed
Measured = Callable[[Array], list[dict[str, float]]]  # the same, for rows of parts of the ranges


@dataclass(frozen=True, kw_only=True)
class Objective:
    """What is to become least, greatest or equal to something.

    Attributes
    ----------
    measure
        To be minimized, ``sign`` times; empty: targets.
    targets
        Values of measures that are to be reached, relative to their size.
    method
        Of ``scipy.optimize``: derivative-free, or by finite differences.
    most
        Runs at most, about.
    """

    measure: str = ""
    sign: float = 1.0
    targets: tuple[tuple[str, float], ...] = ()
    method: str = OPTIMIZATION_METHODS[0]
    most: int = 1000

    def errors(self, measured: Mapping[str, float]) -> Array:
        """Return by how much the targets are missed, of their size."""
        return np.array([(measured[name] - value) / (abs(value) or 1.0) for name, value in self.targets])

    def cost(self, measured: Mapping[str, float]) -> float:
        """Return what is to become least; ``inf`` of a run that failed."""
        value = self.sign * measured[self.measure] if self.measure else float(np.sum(self.errors(measured) ** 2))
        return value if isfinite(value) else inf


@dataclass(frozen=True)
class Optimum:
    """What an optimizer found."""

    point: Point
    cost: float
    ended: str  # why it ended, in SciPy's words
    at_ends: tuple[str, ...]  # what is at an end of its range: beyond it may be better

    def doubts(self, objective: Objective) -> list[str]:
        """Return in sentences why this may not be what was wanted."""
        missed = self.cost**0.5 if objective.targets else 0.0
        found = [f"the targets are missed by {100.0 * missed:.3g} % of their size"] if missed > MAX_TARGET_MISS else []
        ends = " and ".join(map(repr, self.at_ends))
        return found + (
            [f"it is at the limit of the range of {ends}; a wider range may give a better value"] if ends else []
        )


def read_objective(given: Any, vary: Mapping[str, Variation], measures: Mapping[str, Any]) -> Objective | None:
    """Return the aim that is written as a table; None: there is none.

    Raises
    ------
    UserError
        It aims at no measure or at several, or something that varies has no range.
    """
    if given is None:
        return None
    if not isinstance(given, Mapping):
        raise UserError(f"aim is {given!r}; allowed: a table with minimize, maximize or target")
    for key in given:
        if key not in OBJECTIVE_KEYS:
            raise UserError(f"aim has no key {key!r}{suggest(str(key), OBJECTIVE_KEYS)}")
    kinds = [key for key in OBJECTIVE_KEYS[:3] if key in given]
    if len(kinds) != 1:
        raise UserError(
            f"aim has {', '.join(kinds) or 'nothing to aim at'}; allowed: one of {', '.join(OBJECTIVE_KEYS[:3])}"
        )
    targets = given.get("target", {})
    if not isinstance(targets, Mapping) or ("target" in given and not targets):
        raise UserError(f"target is {targets!r}; allowed: a table of measures and values, such as {{reach = 1.2}}")
    for name in (*targets, *(given[k] for k in kinds if k != "target")):
        if not isinstance(name, str) or name not in measures:
            raise UserError(f"aim: there is no measure {name!r}{suggest(str(name), measures)}")
    for name, value in targets.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            raise UserError(f"aim: the target of {name!r} is {value!r}; allowed: a finite number")
    method, most = (
        given.get("method", OPTIMIZATION_METHODS[2] if targets else OPTIMIZATION_METHODS[0]),
        given.get("most", 1000),
    )
    if method not in OPTIMIZATION_METHODS or (method == "least_squares" and not targets):
        allowed = OPTIMIZATION_METHODS if targets else OPTIMIZATION_METHODS[:2]
        raise UserError(f"aim: method is {method!r}; allowed: {', '.join(allowed)}")
    if isinstance(most, bool) or not isinstance(most, int) or most < 1:
        raise UserError(f"aim: most is {most!r}; allowed: a number of runs, at least 1")
    for name, own in vary.items():
        if not isinstance(own, Drawn):
            raise UserError(f"aim: {name!r} is a list; give it a range, {{from = ..., to = ...}}")
        if own.whole:
            raise UserError(
                f"aim: {name!r} is a whole number; allowed: a range of real numbers, {{from = ..., to = ...}}"
            )
    sign = -1.0 if "maximize" in given else 1.0
    measure = given.get("minimize", given.get("maximize", ""))
    return Objective(measure=measure, sign=sign, targets=tuple(targets.items()), method=method, most=most)


def bounds(vary: Mapping[str, Variation]) -> Array:
    """Return between what everything is looked for (names, 2): the ends of distributions, or far out where none are."""
    found = []
    for own in vary.values():
        assert isinstance(own, Drawn)
        ends = np.array(own.distribution.support(), float)
        found.append(np.where(np.isfinite(ends), ends, own.at(np.array(UNBOUNDED_RANGE_PROBABILITIES))))
    return np.array(found)


def optimize_objective(objective: Objective, vary: Mapping[str, Variation], evaluate: Evaluate, seed: int) -> Optimum:
    """Look for the best point, in parts of the ranges of all that varies.

    Raises
    ------
    UserError
        The run that a search by differences begins with failed.
    """
    names, ends = list(vary), bounds(vary)
    low, size = ends[:, 0], np.ptp(ends, axis=1)
    middle = np.array([float(own.at(np.array(0.5))) for own in vary.values() if isinstance(own, Drawn)])

    def point(u: Array) -> Point:
        return dict(zip(names, map(float, low + u * size), strict=True))

    def measured(rows: Array) -> list[dict[str, float]]:
        return evaluate([point(u) for u in rows])

    search = _evolve if objective.method == OPTIMIZATION_METHODS[0] else _descend
    u, cost, ended = search(objective, (middle - low) / size, measured, seed)
    at_ends = [
        name for name, x in zip(names, u, strict=True) if not RANGE_END_TOLERANCE < x < 1.0 - RANGE_END_TOLERANCE
    ]
    return Optimum(point(u), cost, ended, tuple(at_ends))


def _evolve(objective: Objective, start: Array, measured: Measured, seed: int) -> tuple[Array, float, str]:
    def costs(u: Array) -> Array:
        return np.array([min(objective.cost(m), FAILED_RUN_COST) for m in measured(u.T)])

    count = len(start)
    each = max(5, 15 * count)  # runs of a generation, as SciPy has it
    result = optimize.differential_evolution(
        costs, [(0.0, 1.0)] * count, x0=start, vectorized=True, updating="deferred", rng=seed, polish=False,
        maxiter=max(1, objective.most // each - 1),
    )  # fmt: skip
    return result.x, float(result.fun), str(result.message)


def _descend(objective: Objective, start: Array, measured: Measured, _: int) -> tuple[Array, float, str]:
    """Descend by finite differences, all runs of one gradient at once."""
    count = len(start)
    if not isfinite(objective.cost(measured(start[None])[0])):
        raise UserError(
            "aim: the optimization starts in the middle of all ranges, and the run there failed; change the "
            "ranges, or run "
            "this point by itself to see why"
        )

    def around(at: Array) -> tuple[list[dict[str, float]], Array]:
        """Return the measures at a point and at its neighbors, and the steps to them; inward at the upper ends."""
        steps = np.where(at + OBJECTIVE_DIFFERENCE_STEP <= 1.0, OBJECTIVE_DIFFERENCE_STEP, -OBJECTIVE_DIFFERENCE_STEP)
        return measured(np.vstack([at, at + np.diag(steps)])), steps

    def jacobian(u: Array) -> Array:
        measures_around, steps = around(u)
        errors = np.array([objective.errors(m) for m in measures_around])
        found: Array = (errors[1:] - errors[0]).T / steps
        return found

    def slope(u: Array) -> tuple[float, Array]:
        measures_around, steps = around(u)
        costs = np.array([min(objective.cost(m), FAILED_RUN_COST) for m in measures_around])
        return float(costs[0]), (costs[1:] - costs[0]) / steps

    rounds = max(1, objective.most // (count + 2))
    if objective.method == "least_squares":
        result = optimize.least_squares(
            lambda u: objective.errors(measured(u[None])[0]), start, jacobian, bounds=(0.0, 1.0), max_nfev=rounds
        )
        return result.x, 2.0 * float(result.cost), str(result.message)
    result = optimize.minimize(
        slope, start, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * count, options={"maxfun": rounds}
    )
    return result.x, float(result.fun), str(result.message)
