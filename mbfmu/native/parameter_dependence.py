"""Identify how every number of a compiled mechanism depends on the parameters of its model.

``build()`` is arbitrary Python code, but its numbers are nearly always sums of products of powers of parameters.
``build()`` is sampled: with one parameter changed at a time to find the exponents, then with all of them to fit the
coefficients. The result is validated on independent samples, inside the fitted ranges and as far outside as it
holds. A parameter that does not pass is fixed at export, with the reason.

Numbers that record how they were computed are no substitute: what passes through an array, ``float()`` or a function of
the library loses its record without notice. In a trial on eight models they gave 146 of the 324 numbers found here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from mbfmu.modeling.model import Model
from mbfmu.modeling.parameters import Parameter
from mbfmu.util.errors import UserError
from solvers.diagnostics import without_code
from solvers.system import Array

from .clipped import Clipped, fit_clipped
from .guesses import fit_guesses
from .model_numbers import STRUCTURE_REASON, Reader
from .monomials import CONSTANT_POWERS, FIT_TOLERANCE, MAX_TERMS, Fit, Powers, fit_sums, joint_exponents, single, sums
from .validity_range import extend_range

PROBE_FACTORS = (0.6, 1.7)  # of its value: where a parameter is probed first
INTERIOR_FRACTIONS = (0.2, 0.5, 0.8)  # of its range: more points for sums
EXTRA_FIT_POINTS, VALIDATION_POINTS = 3, 3  # points more than terms in a fit; points that have no part in it
MAX_RANGE_TRIES = 5  # to find an end where the build does not refuse, nearer to the center each time
PROBE_VALUE_FOR_ZERO = 0.7  # a value for what is zero
ARRAY_DESCRIPTIONS = {
    "world": "gravity",
    "bodies": "a body",
    "memory": "a joint, a force, a signal or a sensor",
    "numbers": "a table",
    "flexibles": "an elastic body",
    "nodes": "the shape of an elastic body",
    "q": "a start position",
    "v": "a start velocity",
    "size": "the unit of a coordinate",
    "row_size": "the unit of a constraint",
    "residual_scale": "the unit of a constraint",
    "span": "the length of the mechanism",
    "drive size": "the rate of the mechanism",
    "drive rate": "the rate of the mechanism",
}


class ParameterDependence:
    """The search of one model.

    Attributes
    ----------
    reader
        The numbers of its compiled mechanisms.
    settable
        Parameters that are not frozen, in their order.
    fixed
        Reason for every other parameter, as text.
    fits
        Sums of products of powers of the live ones; those of ``guessed`` columns are near only.
    clipped
        What follows them up to a bound.
    lengths
        Which columns are the characteristic length, whatever that is.
    rate_sources
        Which of gravity and the drives give the rate of the loops.
    ends
        Up to where the fits were verified, lower and upper end.
    may_extend
        Whether nothing spoke against values beyond these ends.
    declared, center
        Of every live parameter its declaration, and a value near its own, about which it is probed.
    """

    def __init__(self, model: Model) -> None:
        self.reader = Reader(model)
        self.fixed: dict[str, str] = {}
        self.settable: list[str] = []
        self.fits: list[Fit] = []
        self.guessed: set[int] = set()
        self.clipped: list[Clipped] = []
        self._bounded: set[int] = set()
        self.ends: dict[str, list[float]] = {}
        self.may_extend: dict[str, list[bool]] = {}
        self.center: dict[str, float] = {}
        self.declared: dict[str, Parameter] = {}
        self.random = np.random.default_rng(1)
        self._model = model
        self._powers: dict[str, dict[int, Powers]] = {}
        for p in model.parameters():
            self._add_parameter(p, getattr(model, p.name))
        scales = self.reader.columns("size", "row_size", "residual_scale", "drive size")
        self.lengths = scales[self._equal_to_length(self.reader.base)[scales]]
        self.rate_sources = np.ones(1 + len(self.reader.columns("drive rate")), bool)
        self._fix_refused()
        for name in list(self.settable):
            self._probe(name)
        while not (self._fit() and self._fit_guesses()):
            pass
        extend_range(self)

    def _add_parameter(self, p: Parameter, value: float) -> None:
        """Let a parameter be live for now, with a value about which it is probed, or freeze it."""
        if p.structural or not isinstance(p.default, float):
            self.fixed[p.name] = (
                "it changes the structure of the model"
                if p.structural
                else "integer, Boolean and text parameters cannot be changed after a native export"
            )
            return
        apart = self.random.uniform(0.9, 1.1)  # from values that happen to be equal
        tries = (
            apart * value,
            0.93 * value,
            1.07 * value,
            PROBE_VALUE_FOR_ZERO,
            -PROBE_VALUE_FOR_ZERO,
            0.5 * (p.min + p.max),
        )
        center = next((x for x in tries if x != 0.0 and p.min < x < p.max), 0.0)
        if center == 0.0:
            self.fixed[p.name] = "its allowed range is too small for the identification"
            return
        low, high = sorted((PROBE_FACTORS[0] * center, PROBE_FACTORS[1] * center))
        self.settable.append(p.name)
        self.declared[p.name], self.center[p.name] = p, center
        self.ends[p.name] = [max(low, p.min), min(high, p.max)]
        self.may_extend[p.name] = [True, True]

    def _fix(self, names: Iterable[str], reason: str) -> None:
        """Leave parameters as they are in the model."""
        for name in list(names):
            hint = ""
            if reason == STRUCTURE_REASON and getattr(self._model, name) == 0.0:
                hint = " where it is not zero; export with another value than zero"
            self.fixed[name] = reason + hint
            self.settable.remove(name)

    def describe_refusal(self, values: dict[str, float]) -> str:
        """Return why there is no compiled mechanism with these values of live parameters; empty: there is."""
        try:
            self.reader.read(values)
        except UserError as error:
            return without_code(str(error))
        return ""

    def _fix_refused(self) -> None:
        """Freeze what cannot be moved to its center, alone or with all others."""
        if not self.describe_refusal(self.at_center()):
            return
        special_values = {n: (0.0, self.declared[n].min, self.declared[n].max) for n in self.settable}
        usual = [n for n in self.settable if getattr(self._model, n) not in special_values[n]]
        all_do = not self.describe_refusal({n: self.center[n] for n in usual})
        for name in list(self.settable):
            reason = "" if all_do and name in usual else self.describe_refusal({name: self.center[name]})
            if reason:
                self._fix([name], reason)
        reason = self.describe_refusal(self.at_center())
        if reason:
            self._fix(self.settable, f"with others: {reason}")

    def at_center(self) -> dict[str, float]:
        """Return the values of all live parameters about which they are probed."""
        return {name: self.center[name] for name in self.settable}

    def _equal_to_length(self, row: Array) -> NDArray[np.bool_]:
        """Return which numbers of a row are equal to the length."""
        return np.asarray(row == row[self.reader.columns("length")[0]])

    def _probe(self, name: str) -> None:
        """Find the powers of a parameter in every number that it moves, or freeze it."""
        try:
            points, rows = self._sample_range(name)
            u, y = np.array(points) / self.center[name], np.array(rows)
            moved = self._without_derived(np.flatnonzero(np.any(y != y[0], axis=0)))
            found = dict(zip(moved.tolist(), single(u, y[:, moved]), strict=True))
            unknown = {i for i in moved.tolist() if found[i] is None}
            self._bounded |= unknown & set(self.reader.columns("size").tolist())
            unexplained = np.array(sorted(unknown - self._bounded), np.int64)
            if len(unexplained):
                found |= dict(zip(unexplained.tolist(), self._sums(name, u, y, unexplained), strict=True))
        except UserError as error:
            self._fix([name], without_code(str(error)))
            return
        unknown = {i for i in unexplained.tolist() if found[i] is None}
        self._powers[name] = {i: powers or CONSTANT_POWERS for i, powers in found.items()}
        self.guessed |= {i for i in unknown if self.reader.guesses[i]}
        if unknown - self.guessed:
            self._fix([name], self._describe_no_sum(unknown - self.guessed))

    def _sample_range(self, name: str) -> tuple[list[float], list[Array]]:
        """Return values of a parameter, its center and both ends, and the numbers there.

        Ends at which the build refuses are moved inward. Raises UserError where the parameter cannot be moved at all.
        """
        points, rows = [self.center[name]], [self.reader.read(self.at_center())]
        for side in (0, 1):
            for left in reversed(range(MAX_RANGE_TRIES)):
                x = self.ends[name][side]
                try:
                    rows.append(self.reader.read(self.at_center() | {name: x}))
                    points.append(x)
                    break
                except UserError:
                    if not left:
                        raise
                    self.ends[name][side] = self.center[name] + 0.4 * (x - self.center[name])
                    self.may_extend[name][side] = False
        for row in rows:
            self.lengths = self.lengths[self._equal_to_length(row)[self.lengths]]
        return points, rows

    def _sums(self, name: str, u: Array, y: Array, columns: NDArray[np.int64]) -> list[Powers | None]:
        """Return the powers of a parameter whose sums these columns are, from more points between its ends."""
        low, high = self.ends[name]
        more = low + (high - low) * np.array(INTERIOR_FRACTIONS)
        between = [self.reader.read(self.at_center() | {name: float(x)}) for x in more]
        return sums(np.append(u, more / self.center[name]), np.array([*y, *between])[:, columns])

    def _without_derived(self, columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those columns that are not made of others."""
        made = self.reader.columns("rate", "loop_rate", "length")
        return np.setdiff1d(columns, np.concatenate([made, self.lengths]))

    def _describe_no_sum(self, columns: Iterable[int]) -> str:
        words = dict.fromkeys(
            ARRAY_DESCRIPTIONS.get(self.reader.places[i].array, "the rate of the mechanism") for i in columns
        )
        follow = "follows" if len(words) == 1 else "follow"
        return (
            f"{' and '.join(words)} {follow} it in a way that a native FMU cannot represent (only sums of "
            "products of powers)"
        )

    def _fit(self) -> bool:
        """Fit all sums and compare them with fresh compiled mechanisms; false where that froze a parameter."""
        keys: dict[tuple[Powers, ...], list[int]] = {}
        for i in sorted(set().union(*(self._powers[n] for n in self.settable)) - self.guessed - self._bounded):
            keys.setdefault(tuple(self._powers[n].get(i, CONSTANT_POWERS) for n in self.settable), []).append(i)
        for key, columns in keys.items():
            if np.prod([len(powers) for powers in key]) > MAX_TERMS:
                several = [n for n, powers in zip(self.settable, key, strict=True) if len(powers) > 1]
                self._fix(several, self._describe_no_sum(columns))
                return False
        exponents = {key: joint_exponents(key) for key in keys}
        count = max(map(len, exponents.values()), default=0) + EXTRA_FIT_POINTS
        points = self._random_points(count + VALIDATION_POINTS)
        rows = []
        for point in points[:count]:
            try:
                rows.append(self.reader.read(point))
            except UserError as error:
                self._fix(
                    *self.responsible_parameters(point, without_code(str(error)), self.settable, self.describe_refusal)
                )
                return False
        x, center, y = self._vectors(points[:count]), np.array([self.center[n] for n in self.settable]), np.array(rows)
        self.fits = []
        for key, members in keys.items():
            own = np.array(members, np.int64)
            self.fits += fit_sums(own, exponents[key], x, center, y[:, own])
        self._find_rate_sources(y)
        if not self._fit_bounded(points):
            return False
        return all(map(self._agrees_at, [{}, *points]))

    def _fit_bounded(self, points: list[dict[str, float]]) -> bool:
        """Fit what follows parameters up to a bound; false where that froze them."""
        columns = np.array(sorted(self._bounded), np.int64)
        started = set(self.reader.columns("q", "v", "world").tolist())
        names = [n for n in self.settable if self._powers[n].keys() - started]  # a start has no say in a unit
        self.clipped = []
        if not any(self._powers[n].keys() & self._bounded for n in names):
            return True
        try:
            found = fit_clipped(self.reader.read, self.at_center(), points, names, columns)
        except UserError:
            found = None
        if found is None:
            self._fix([n for n in names if self._powers[n].keys() & self._bounded], self._describe_no_sum(columns))
            return False
        self.clipped = found
        return True

    def _random_points(self, count: int) -> list[dict[str, float]]:
        """Return points at random within the ends."""
        drawn = self.random.uniform
        return [{n: float(drawn(self.ends[n][0], self.ends[n][1])) for n in self.settable} for _ in range(count)]

    def _vectors(self, points: list[dict[str, float]]) -> Array:
        """Return the values of all live parameters (points, live)."""
        values = [[p.get(n, getattr(self._model, n)) for n in self.settable] for p in points]
        return np.array(values, float).reshape(len(points), len(self.settable))

    def _find_rate_sources(self, rows: Array) -> None:
        """Find what the rate of the loops is the largest of."""
        loop_rate = self.reader.columns("loop_rate")
        if len(loop_rate):
            rates = np.array([self._rates(row) for row in rows])
            self.rate_sources = np.all(rates <= rows[:, loop_rate] * (1.0 + FIT_TOLERANCE), axis=0)

    def _rates(self, row: Array) -> Array:
        """Return the rates by gravity and by each drive."""
        gravity, length = row[self.reader.gravity], row[self.reader.columns("length")[0]]
        size, rate = row[self.reader.columns("drive size")], row[self.reader.columns("drive rate")]
        return np.asarray(np.append(gravity @ gravity / length**2, rate / size**4) ** 0.25)

    def _agrees_at(self, point: dict[str, float]) -> bool:
        """Return whether the fits agree with a compiled mechanism; false where they do not, which freezes what is to
        blame.
        """
        reason, columns = self.compare_at(point)
        if reason:
            self._fix(
                *self.responsible_parameters(
                    point, reason, self.influencing_parameters(columns), self.describe_difference
                )
            )
        return not reason

    def compare_at(self, point: dict[str, float], good: float = FIT_TOLERANCE) -> tuple[str, list[int]]:
        """Return why the fits do not agree with a compiled mechanism to within an error, and in which columns; empty:
        they agree.
        """
        try:
            row = self.reader.read(point)
        except UserError as error:
            return without_code(str(error)), []
        wanted, size = self._predicted(point)
        with np.errstate(invalid="ignore"):
            off = ~(np.abs(wanted - row) <= good * size)
        off[list(self.guessed)] = False
        wrong = np.flatnonzero(off).tolist()
        return (self._describe_no_sum(wrong), wrong) if wrong else ("", [])

    def _predicted(self, point: dict[str, float]) -> tuple[Array, Array]:
        """Return the numbers by the fits, and the sums of their terms without signs."""
        row, x, column = self.reader.base.copy(), self._vectors([point]), self.reader.columns
        size = np.abs(row)
        for fit in self.fits:
            row[fit.columns], size[fit.columns] = (own[0] for own in fit.values(x))
        for bound in self.clipped:
            row[bound.fits[0].columns] = bound.values(x)[0]
        size[column("size")] = np.abs(row[column("size")])
        with np.errstate(all="ignore"):
            row[column("length")] = np.sqrt(row[column("span")].max())
            row[self.lengths] = row[column("length")[0]]
            rates = self._rates(row)
        row[column("rate")], row[column("loop_rate")] = rates.max(), rates[self.rate_sources].max(initial=0.0)
        made = np.concatenate([column("length", "rate", "loop_rate"), self.lengths])
        size[made] = np.abs(row[made])
        return row, size

    def influencing_parameters(self, columns: list[int]) -> list[str]:
        """Return the parameters that move some columns; where there are such, those that do so by sums."""
        moving = [[self._powers[n][i] for i in columns if i in self._powers[n]] for n in self.settable]
        found = [n for n, powers in zip(self.settable, moving, strict=True) if powers]
        by_sums = [n for n, powers in zip(self.settable, moving, strict=True) if any(len(p) > 1 for p in powers)]
        return by_sums or found or self.settable

    def describe_difference(self, point: dict[str, float]) -> str:
        """Return why the fits do not agree with a compiled mechanism; empty: they agree."""
        return self.compare_at(point)[0]

    def responsible_parameters(
        self, point: dict[str, float], reason: str, others: list[str], wrong: Callable[[dict[str, float]], str]
    ) -> tuple[list[str], str]:
        """Return the parameters that alone lead to what a point leads to, and the reason.

        Where none does, those without which it would not be so; where there are none either, the ``others``.
        """
        center = self.at_center()
        alone = [n for n in self.settable if n in point and wrong(center | {n: point[n]})]
        if alone:
            return alone, reason
        needed = [n for n in self.settable if n in point and not wrong(center | point | {n: center[n]})]
        return needed or others, f"with others: {reason}"

    def _fit_guesses(self) -> bool:
        """Fit first guesses that are no sums, in a range that is narrow enough; false where that froze parameters."""
        columns = np.array(sorted(self.guessed), np.int64)
        names = [n for n in self.settable if any(i in self._powers[n] for i in columns)]
        if not names:
            return True
        known = {n: (float(getattr(self._model, n)), self.declared[n].min, self.declared[n].max) for n in names}
        found = fit_guesses(self.reader.read, known, columns, self.random)
        if found is None:
            self._fix(names, "a start position of the loops depends on it in a way that a native FMU cannot represent")
            return False
        guess, box = found
        exponents = np.zeros((len(guess.exponents), len(self.settable)))
        exponents[:, [self.settable.index(n) for n in names]] = guess.exponents
        self.fits.append(guess._replace(exponents=exponents))
        for name, ends in box.items():
            self.ends[name], self.may_extend[name] = list(ends), [False, False]
            self.center[name] = float(np.clip(self.center[name], *ends))
        return True
