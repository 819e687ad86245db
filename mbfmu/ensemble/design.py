"""Which runs a study makes: a point in the space of what varies for each.

Lists make a grid, of all combinations, or go together. Numbers with a distribution are sampled, ``count`` times at
every point of the grid and alike at all of them, so that a difference between two points is not of the samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np
from scipy import stats
from scipy.stats import qmc

from mbfmu.util.errors import UserError, suggest
from solvers.system import Array

from .variation import Drawn, Listed, Variation

Point = dict[str, Any]  # values by the names of what varies

SAMPLING_METHODS = {
    "random": "independent samples",
    "latin": "a Latin hypercube",
    "sobol": "Sobol's sequence, scrambled",
    "sensitivity": "samples for Sobol's indices: count * (number of parameters + 2) runs",
    "tornado": "one parameter at a time at its limits, all others in the middle",
}
MAX_RUNS = 10_000_000  # runs of a study
TORNADO_LOW_PROBABILITY, TORNADO_HIGH_PROBABILITY = 0.05, 0.95  # probabilities of the ends in a tornado
MIN_PROBABILITY = 1e-12  # probabilities of samples are no nearer to 0 and 1, where there may be no finite value


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How numbers with a distribution are sampled.

    Attributes
    ----------
    count
        Samples at each point of the grid of lists; of the method "sensitivity" a power of two.
    method
        One of METHODS.
    seed
        Of the random numbers: equal seeds give equal samples.
    together
        Whether lists go together, the first values of all in the first run, in place of all combinations.
    correlated
        Correlation between pairs of numbers, by their names: of their normal scores, which is that of the numbers
        themselves where both are normal.
    """

    count: int = 100
    method: str = "random"
    seed: int = 1
    together: bool = False
    correlated: tuple[tuple[str, str, float], ...] = ()

    def __post_init__(self) -> None:
        """Check; raises UserError."""
        if not isinstance(self.method, str) or self.method not in SAMPLING_METHODS:
            raise UserError(f"sampling is {self.method!r}{suggest(str(self.method), SAMPLING_METHODS)}")
        for name, value, least in (("count", self.count, 1), ("seed", self.seed, 0)):
            if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= MAX_RUNS:
                raise UserError(f"{name} is {value!r}; allowed: whole numbers from {least} to {MAX_RUNS}")
        if self.method == "sensitivity" and (self.count < 2 or self.count & (self.count - 1)):
            raise UserError(f"count is {self.count!r}; allowed for sensitivity: powers of two, such as 256")
        if not isinstance(self.together, bool):
            raise UserError(f"together is {self.together!r}; allowed: true or false")


def points(vary: Mapping[str, Variation], sampling: Sampling) -> list[Point]:
    """Return the points of a study in the order of their numbers.

    Raises
    ------
    UserError
        Lists that go together differ in length, there are too many runs, a method that needs distributions has none,
        or correlations contradict each other.
    """
    listed = {name: own.values for name, own in vary.items() if isinstance(own, Listed)}
    drawn = {name: own for name, own in vary.items() if isinstance(own, Drawn)}
    if sampling.correlated and sampling.method in ("tornado", "sensitivity"):
        raise UserError(f"sampling is {sampling.method!r}, which is of independent numbers; leave out correlated")
    for name in (name for one, other, _ in sampling.correlated for name in (one, other)):
        if name not in drawn:
            known = suggest(name, drawn) if drawn else "; no parameter has one"
            raise UserError(f"correlated names {name!r}, which has no distribution{known}")
    if sampling.method == "tornado":
        return _one_at_a_time(vary)
    if sampling.method == "sensitivity" and (listed or not drawn):
        told = f"{next(iter(listed))!r} is a list" if listed else "no parameter has one"
        raise UserError(f"sampling is 'sensitivity', which needs a distribution of every parameter; {told}")
    lengths = {name: len(values) for name, values in listed.items()}
    if sampling.together and len(set(lengths.values())) > 1:
        told = ", ".join(f"{name!r} has {count}" for name, count in lengths.items())
        raise UserError(f"lists that are combined by together must have equal lengths; {told}")
    size = max(lengths.values(), default=1) if sampling.together else prod(lengths.values())
    if size * (sampling.count if drawn else 1) > MAX_RUNS:
        raise UserError(f"the study has more than {MAX_RUNS} runs; vary less, or sample it: {{from, to}} without count")
    grid = zip(*listed.values(), strict=True) if sampling.together and listed else product(*listed.values())
    samples = _samples(drawn, sampling)
    names = (*listed, *drawn)
    return [dict(zip(names, (*one, *sample), strict=True)) for one in grid for sample in samples]


def _samples(drawn: Mapping[str, Drawn], sampling: Sampling) -> list[list[float]]:
    if not drawn:
        return [[]]
    u = np.clip(_probabilities(list(drawn), sampling), MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
    columns = [own.values(u[:, i]) for i, own in enumerate(drawn.values())]
    return [list(row) for row in zip(*columns, strict=True)]


def _probabilities(names: Sequence[str], sampling: Sampling) -> Array:
    """Return probabilities between 0 and 1 (samples, names)."""
    n, d = sampling.count, len(names)
    if sampling.method == "random":
        return _correlate(np.random.default_rng(sampling.seed).random((n, d)), names, sampling)
    if sampling.method == "latin":
        return _correlate(qmc.LatinHypercube(d, rng=sampling.seed).random(n), names, sampling)
    if sampling.method == "sobol":
        whole = qmc.Sobol(d, rng=sampling.seed).random_base2(max(n - 1, 0).bit_length())
        return _correlate(whole[:n], names, sampling)
    both = qmc.Sobol(2 * d, rng=sampling.seed).random_base2(n.bit_length() - 1)
    a, b = both[:, :d], both[:, d:]
    mixed = [np.where(np.arange(d) == i, b, a) for i in range(d)]
    return np.concatenate([a, b, *mixed])


def _correlate(u: Array, names: Sequence[str], sampling: Sampling) -> Array:
    """Return probabilities whose normal scores have the correlations, by Cholesky's factor (a Gaussian copula)."""
    if not sampling.correlated:
        return u
    matrix = np.eye(len(names))
    for one, other, value in sampling.correlated:
        i, j = names.index(one), names.index(other)
        matrix[i, j] = matrix[j, i] = value
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError as error:
        raise UserError(
            "the correlations contradict each other: their matrix is not positive definite; use smaller "
            "values, or fewer of "
            "them"
        ) from error
    found: Array = stats.norm.cdf(stats.norm.ppf(np.clip(u, MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)) @ factor.T)
    return found


def _one_at_a_time(vary: Mapping[str, Variation]) -> list[Point]:
    """Return the middle, then each number at both ends with the others in the middle; a list has the model's value."""
    middle = {name: float(own.at(np.array(0.5))) for name, own in vary.items() if isinstance(own, Drawn)}
    found: list[Point] = [middle]
    for name, own in vary.items():
        ends = (
            own.ends()
            if isinstance(own, Listed)
            else own.at(np.array([TORNADO_LOW_PROBABILITY, TORNADO_HIGH_PROBABILITY])).tolist()
        )
        found += [{**middle, name: end} for end in ends]
    return found


def correlations(given: Any, vary: Mapping[str, Variation]) -> tuple[tuple[str, str, float], ...]:
    """Return correlations as they are written: ``[["a", "b", 0.8]]``, or ``{of, covariance}`` or ``{of, correlation}``.

    Raises
    ------
    UserError
        One is written in another way, or its size is not less than one.
    """
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise UserError(f'correlated is {given!r}; allowed: a list of such as ["a", "b", 0.8]')
    found = tuple(_correlation(entry, vary) for entry in given)
    pairs = [frozenset(pair[:2]) for pair in found]
    for pair, entry in zip(pairs, given, strict=True):
        if pairs.count(pair) > 1:
            raise UserError(f"correlated has {entry!r} and another correlation of these two; allowed: one")
    return found


def _correlation(entry: Any, vary: Mapping[str, Variation]) -> tuple[str, str, float]:
    what = f"correlated has {entry!r}"
    allowed = 'such as ["a", "b", 0.8], or {of = ["a", "b"], covariance = 1e-6}'
    if isinstance(entry, Mapping):
        of, kinds = entry.get("of", ()), set(entry) - {"of"}
        two = isinstance(of, Sequence) and not isinstance(of, str) and len(of) == 2
        if not two or len(kinds) != 1 or not kinds <= {"covariance", "correlation"}:
            raise UserError(f"{what}; allowed: {allowed}")
        names, value = list(map(str, of)), entry[next(iter(kinds))]
        if "covariance" in kinds and isinstance(value, int | float):
            known = [vary.get(name) for name in names]
            if not all(isinstance(own, Drawn) for own in known):
                raise UserError(f"{what}; allowed: names of what has a distribution")
            value = value / prod(float(own.distribution.std()) for own in known if isinstance(own, Drawn))
    elif isinstance(entry, Sequence) and len(entry) == 3:
        names, value = list(entry[:2]), entry[2]
    else:
        raise UserError(f"{what}; allowed: {allowed}")
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1.0 or names[0] == names[1]:
        raise UserError(f"{what}, a correlation of {value!r}; allowed: two names, and between -1 and 1")
    return str(names[0]), str(names[1]), float(value)
