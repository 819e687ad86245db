"""What varies from run to run: values in a list, or numbers drawn from a distribution.

A variation is written in a study file, or given from Python, as one of

- ``[0.9, 1.0, 1.1]``, a list of values;
- ``{from = 1.0, to = 2.0, count = 11}``, a list of values at equal distances, or with ``log = true`` at equal ratios;
- ``{from = 1.0, to = 2.0}``, a number anywhere between, with ``log = true`` its logarithm;
- ``{distribution = "norm", loc = 1.0, scale = 0.1}``, of ``scipy.stats`` by its name and with its arguments;
- ``"1 m +- 0.01 mm"``, a size with its tolerance: normal, the tolerance three standard deviations, no part beyond it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from scipy import stats

from mbfmu.util.errors import MAX_VALUE_LENGTH, UserError, short, suggest
from mbfmu.util.units import read_unit
from solvers.system import Array

NUMBER_PATTERN = r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?|[-+]?\.\d+(?:[eE][-+]?\d+)?"
TOLERANCE_PATTERN = re.compile(rf"\s*({NUMBER_PATTERN})\s*(\S*?)\s*(?:\+-|\+/-|±)\s*({NUMBER_PATTERN})\s*(\S*)\s*")
SIGMAS_PER_TOLERANCE = 3.0  # standard deviations in a tolerance
MAX_FLOAT = sys.float_info.max
MAX_LISTED_VALUES = 10_000_000  # values of one list
ALLOWED_VARIATIONS = 'a list, {from, to, count}, {from, to}, {distribution, ...} or a text such as "1 m +- 0.01 mm"'


@dataclass(frozen=True)
class Listed:
    """Values that are taken one after the other."""

    values: tuple[Any, ...]

    def ends(self) -> tuple[Any, Any]:
        """Return the least and the largest value; of words the first and the last."""
        if any(isinstance(value, str) for value in self.values):
            return self.values[0], self.values[-1]
        return min(self.values), max(self.values)


@dataclass(frozen=True)
class Drawn:
    """A number with a distribution, frozen, of ``scipy.stats``."""

    distribution: Any

    def at(self, u: Array) -> Array:
        """Return values for probabilities u between 0 and 1."""
        return np.asarray(self.distribution.ppf(u), float)

    @property
    def whole(self) -> bool:
        """Whether the distribution is of whole numbers."""
        return isinstance(getattr(self.distribution, "dist", None), stats.rv_discrete)

    def values(self, u: Array) -> list[float] | list[int]:
        """Return the same in a list, whole numbers of a discrete distribution."""
        return [int(x) for x in self.at(u)] if self.whole else [float(x) for x in self.at(u)]


Variation = Listed | Drawn


def read_variation(name: str, given: Any, unit: str) -> Variation:
    """Return what a variation of ``name``, whose numbers are in ``unit``, is written as.

    Raises
    ------
    UserError
        It is written in another way, it is empty, or a distribution does not take its arguments.
    """
    what = f"variation of {name!r}"
    if isinstance(given, str):
        return toleranced(what, given, unit)
    if isinstance(given, Mapping):
        return _of_table(what, dict(given))
    if isinstance(given, Sequence | np.ndarray):
        return _listed(what, list(given))
    if hasattr(given, "ppf"):  # frozen already, from Python
        return Drawn(given)
    raise UserError(f"{what} is {given!r}; allowed: {ALLOWED_VARIATIONS}")


def toleranced(what: str, text: str, unit: str) -> Drawn:
    """Return the distribution of a size that is written with its tolerance."""
    # it takes the square of the length
    found = TOLERANCE_PATTERN.fullmatch(text) if len(text) <= MAX_VALUE_LENGTH else None
    if not found:
        raise UserError(
            f'{what} is {short(text)}; allowed for a text: a size and its tolerance, such as "1 m +- 0.01 mm"'
        )
    size, size_unit, width, width_unit = found.groups()
    center = float(size) * _factor(what, size_unit or width_unit.replace("%", ""), unit)
    if width_unit == "%":
        far = abs(center) * float(width) / 100.0
    else:
        far = float(width) * _factor(what, width_unit or size_unit, unit)
    if not (isfinite(center) and 0.0 < far < np.inf):
        raise UserError(f"{what} is {text!r}; allowed: a tolerance greater than zero")
    return Drawn(
        stats.truncnorm(-SIGMAS_PER_TOLERANCE, SIGMAS_PER_TOLERANCE, loc=center, scale=far / SIGMAS_PER_TOLERANCE)
    )


def _factor(what: str, given: str, unit: str) -> float:
    """Return by what numbers in one unit are multiplied to be in another; nothing given is the same unit."""
    if not given or given == unit:
        return 1.0
    try:
        one, other = read_unit(given), read_unit(unit)
    except UserError as error:
        raise UserError(f"{what}: {error}") from error
    if one.exponents != other.exponents:
        raise UserError(f"{what} is in {given!r}; allowed: units that can be converted to {unit!r}")
    return one.factor / other.factor


def _of_table(what: str, given: dict[str, Any]) -> Variation:
    if "distribution" in given:
        return _distributed(what, given)
    if "values" in given and len(given) == 1:
        return _listed(what, given["values"])
    known = {"from", "to", "count", "log"}
    odd = sorted(set(given) - known)
    if odd or not {"from", "to"} <= set(given):
        told = f" has {odd[0]!r}{suggest(odd[0], known)}" if odd else f" is {given!r}; allowed: {ALLOWED_VARIATIONS}"
        raise UserError(f"{what}{told}")
    low, high, by_ratio = (given["from"], given["to"], given.get("log", False))
    if not isinstance(by_ratio, bool):
        raise UserError(f"{what}: log is {by_ratio!r}; allowed: true or false")
    for end in (low, high):
        if isinstance(end, bool) or not isinstance(end, int | float) or not abs(end) <= MAX_FLOAT:
            raise UserError(f"{what}: {end!r} is not allowed as a limit; allowed: finite numbers")
    if not low < high or (by_ratio and low <= 0.0) or not high - low <= MAX_FLOAT:
        positive = " greater than zero" if by_ratio else ""
        raise UserError(f"{what} is from {low!r} to {high!r}; allowed: from a number{positive} to a larger number")
    if "count" not in given:
        return Drawn(stats.loguniform(low, high) if by_ratio else stats.uniform(low, high - low))
    count = given["count"]
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_LISTED_VALUES:
        raise UserError(f"{what}: count is {count!r}; allowed: whole numbers from 2 to {MAX_LISTED_VALUES}")
    spaced = np.geomspace(low, high, count) if by_ratio else np.linspace(low, high, count)
    return Listed(tuple(spaced.tolist()))


def _listed(what: str, values: Any) -> Listed:
    kinds = bool, int, float, str, np.number, np.bool_
    values = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, Sequence) or isinstance(values, str) or not values:
        raise UserError(f"{what}: values are {values!r}; allowed: a list with at least one value")
    for value in values:
        plain: Any = value.item() if isinstance(value, np.generic) else value
        endless = isinstance(plain, int | float) and not abs(plain) <= MAX_FLOAT
        if not isinstance(value, kinds) or endless:
            raise UserError(f"{what} has the value {value!r}; allowed: finite numbers, words, true and false")
    return Listed(tuple(v.item() if isinstance(v, np.generic) else v for v in values))


def _distributed(what: str, given: dict[str, Any]) -> Drawn:
    name = given.pop("distribution")
    known = [n for n in dir(stats) if isinstance(getattr(stats, n), stats.rv_continuous | stats.rv_discrete)]
    if name not in known:
        raise UserError(f"{what}: there is no distribution {name!r} in scipy.stats{suggest(str(name), known)}")
    try:
        frozen = getattr(stats, name)(**given)
        middle, low, high = (float(frozen.ppf(u)) for u in (0.5, 0.01, 0.99))
    except (TypeError, ValueError) as error:
        raise UserError(f"{what}: distribution {name!r} does not take {given!r}: {error}") from error
    if not (isfinite(middle) and isfinite(low) and isfinite(high)):
        raise UserError(f"{what}: distribution {name!r} is not defined with {given!r}; see scipy.stats.{name}")
    return Drawn(frozen)
