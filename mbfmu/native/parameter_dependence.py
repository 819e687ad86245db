"""Identify how every number of a compiled mechanism depends on the parameters of its model.

``build()`` is arbitrary Python code, but its numbers are nearly always sums of products of powers of parameters.
``build()`` is sampled: with one parameter changed at a time to find the exponents, then with all of them to fit the
coefficients. Other smooth numbers are represented by polynomials in a range (:mod:`.curves`). The result is validated
on independent samples, inside the fitted ranges and as far outside as it holds. A parameter that does not pass is fixed
at export, with the reason.

Numbers that record how they were computed are no substitute: what passes through an array, ``float()`` or a function of
the library loses its record without notice. In a trial on eight models they gave 146 of the 324 numbers found here.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mbfmu.modeling.model import Model
from mbfmu.modeling.parameters import Parameter
from mbfmu.util.errors import UserError
from solvers.diagnostics import without_code
from solvers.system import Array

from .clipped import Clipped, blame_for_units, fit_all_clipped
from .curves import Curve, fit_all_curves
from .guesses import fit_all_guesses
from .model_numbers import STRUCTURE_REASON, Reader
from .monomials import CONSTANT_POWERS, FIT_TOLERANCE, MAX_TERMS, Fit, Powers, fit_sums, joint_exponents, single, sums
from .responsible import find_responsible
from .sampling import sample_choices, sample_range
from .validity_range import extend_range

PROBE_FACTORS = (0.6, 1.7)  # of its value: where a parameter is probed first
INTERIOR_FRACTIONS = (0.2, 0.5, 0.8)  # of its range: more points for sums
EXTRA_FIT_POINTS, VALIDATION_POINTS = 3, 3  # points more than terms in a fit; points that have no part in it
MIN_POWER_POINTS = 4  # points that decide whether a number is proportional to a power
MAX_SCALE_RATIO = 2.0  # by which units may differ from those of another export, where they cannot follow a parameter
UNIT_ERROR_RATIO = 1e4  # errors of units relative to those of other numbers: of a tolerance a few digits matter
PROBE_VALUE_FOR_ZERO = 0.7  # a value for what is zero


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
    powers, curved
        By parameters, the powers of numbers that they move, and the numbers that curves represent.
    curves
        Those curves.
    bounded
        Numbers that follow products up to a bound.
    discrete
        Values of parameters that are whole numbers or Booleans.
    constant_scales
        Numbers that lengths and rates are made of, and that stay as they are because they cannot be represented. Units
        then differ from those of a model built with other values, by a factor up to ``MAX_SCALE_RATIO``.
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
        self.curves: list[Curve] = []
        self.curved: dict[str, set[int]] = {}
        self.discrete: dict[str, tuple[int, ...]] = {}
        self.constant_scales: set[int] = set()
        self.bounded: set[int] = set()
        self.ends: dict[str, list[float]] = {}
        self.may_extend: dict[str, list[bool]] = {}
        self.center: dict[str, float] = {}
        self.declared: dict[str, Parameter] = {}
        self.random = np.random.default_rng(1)
        self.model = model
        self.powers: dict[str, dict[int, Powers]] = {}
        self._parts_of_scales = set(self.reader.columns("span", "drive size", "drive rate").tolist())
        for p in model.parameters():
            self._add_parameter(p, getattr(model, p.name))
        scales = self.reader.columns("size", "row_size", "residual_scale", "drive size")
        self.lengths = scales[self.equal_to_length(self.reader.base)[scales]]
        self.rate_sources = np.ones(1 + len(self.reader.columns("drive rate")), bool)
        self._fix_refused()
        for name in list(self.settable):
            self._probe(name)
        while not (self._fit() and fit_all_guesses(self) and fit_all_curves(self)):
            pass
        extend_range(self)

    def _add_parameter(self, p: Parameter, value: float) -> None:
        """Let a parameter be live for now, with a value about which it is probed, or freeze it."""
        if p.structural:
            self.fixed[p.name] = "it changes the structure of the model"
            return
        if not isinstance(p.default, float):
            self.settable.append(p.name)
            self.declared[p.name], self.center[p.name] = p, float(value)
            self.discrete[p.name], self.may_extend[p.name] = (int(value),), [False, False]
            self.ends[p.name] = [float(value), float(value)]
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

    def fix(self, names: Iterable[str], reason: str) -> None:
        """Leave parameters as they are in the model."""
        for name in list(names):
            hint = ""
            if reason == STRUCTURE_REASON and name not in self.discrete and getattr(self.model, name) == 0.0:
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
        usual = [n for n in self.settable if getattr(self.model, n) not in special_values[n]]
        all_do = not self.describe_refusal({n: self.center[n] for n in usual})
        for name in list(self.settable):
            reason = "" if all_do and name in usual else self.describe_refusal({name: self.center[name]})
            if reason:
                self.fix([name], reason)
        reason = self.describe_refusal(self.at_center())
        if reason:
            self.fix(self.settable, f"with others: {reason}")

    def at_center(self) -> dict[str, float]:
        """Return the values of all live parameters about which they are probed."""
        return {name: self.center[name] for name in self.settable}

    def equal_to_length(self, row: Array) -> NDArray[np.bool_]:
        """Return which numbers of a row are equal to the length."""
        return np.asarray(row == row[self.reader.columns("length")[0]])

    def _probe(self, name: str) -> None:
        """Find the powers of a parameter in every number that it moves, or freeze it."""
        try:
            points, rows = sample_choices(self, name) if name in self.discrete else sample_range(self, name)
            y = np.array(rows)
            moved = self._without_derived(np.flatnonzero(np.any(y != y[0], axis=0)))
            found: dict[int, Powers | None] = dict.fromkeys(moved.tolist())
            if name not in self.discrete or (all(points) and len(points) >= MIN_POWER_POINTS):
                u = np.array(points) / self.center[name]
                found = dict(zip(moved.tolist(), single(u, y[:, moved]), strict=True))
            unknown = {i for i in moved.tolist() if found[i] is None}
            self.bounded |= unknown & set(self.reader.columns("size").tolist())
            unexplained = np.array(sorted(unknown - self.bounded), np.int64)
            if len(unexplained) and name not in self.discrete:
                found |= dict(zip(unexplained.tolist(), self._sums(name, u, y, unexplained), strict=True))
        except UserError as error:
            self.fix([name], without_code(str(error)))
            return
        unknown = {i for i in unexplained.tolist() if found[i] is None}
        self.powers[name] = {i: powers or CONSTANT_POWERS for i, powers in found.items()}
        self.constant_scales |= unknown & self._parts_of_scales
        self.guessed |= {i for i in unknown if self.reader.guesses[i]}
        self.curved[name] = unknown - self.constant_scales - self.guessed

    def _sums(self, name: str, u: Array, y: Array, columns: NDArray[np.int64]) -> list[Powers | None]:
        """Return the powers of a parameter whose sums these columns are, from more points between its ends."""
        low, high = self.ends[name]
        more = low + (high - low) * np.array(INTERIOR_FRACTIONS)
        between = [self.reader.read(self.at_center() | {name: float(x)}) for x in more]
        return sums(np.append(u, more / self.center[name]), np.array([*y, *between])[:, columns])

    def _without_derived(self, columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return those columns that are not made of others."""
        return np.setdiff1d(columns, self._made_of_others())

    def _made_of_others(self) -> NDArray[np.int64]:
        """Return the columns that are made of others: units of lengths and rates."""
        return np.concatenate([self.reader.columns("rate", "loop_rate", "length"), self.lengths])

    def describe_no_sum(self, columns: Iterable[int]) -> str:
        """Return why a parameter is fixed that these columns follow in a way that is not represented."""
        words = dict.fromkeys(self.reader.describe(i) for i in columns)
        follow = "follows" if len(words) == 1 else "follow"
        return (
            f"{' and '.join(words)} {follow} it in a way that a native FMU cannot represent (only sums of "
            "products of powers, and smooth functions of few parameters)"
        )

    def _fit(self) -> bool:
        """Fit all sums and compare them with fresh compiled mechanisms; false where that froze a parameter."""
        keys: dict[tuple[Powers, ...], list[int]] = {}
        self.curves = []
        left_out = self.guessed | self.bounded | self.constant_scales | self._curved_columns()
        for i in sorted(set().union(*(self.powers[n] for n in self.settable)) - left_out):
            keys.setdefault(tuple(self.powers[n].get(i, CONSTANT_POWERS) for n in self.settable), []).append(i)
        for key, columns in keys.items():
            if np.prod([len(powers) for powers in key]) > MAX_TERMS:
                several = [n for n, powers in zip(self.settable, key, strict=True) if len(powers) > 1]
                self.fix(several, self.describe_no_sum(columns))
                return False
        exponents = {key: joint_exponents(key) for key in keys}
        count = max(map(len, exponents.values()), default=0) + EXTRA_FIT_POINTS
        points = [self.random_point() for _ in range(count + VALIDATION_POINTS)]
        rows = []
        for point in points[:count]:
            try:
                rows.append(self.reader.read(point))
            except UserError as error:
                self.fix(*find_responsible(self, point, without_code(str(error)), self.settable, self.describe_refusal))
                return False
        x, center, y = (
            self._vectors(points[:count]),
            np.array([self.center[n] or 1.0 for n in self.settable]),
            np.array(rows),
        )
        self.fits = []
        for key, members in keys.items():
            own = np.array(members, np.int64)
            self.fits += fit_sums(own, exponents[key], x, center, y[:, own])
        self._find_rate_sources(y)
        if not fit_all_clipped(self, points):
            return False
        return all(map(self._agrees_at, [{}, *points]))

    def _curved_columns(self) -> set[int]:
        """Return the numbers that need curves."""
        return set().union(*(self.curved.get(n, set()) for n in self.settable))

    def random_point(self) -> dict[str, float]:
        """Return values at random within the ends."""
        drawn, point = self.random.uniform, dict.fromkeys(self.settable, 0.0)
        for n in self.settable:
            low, high = self.ends[n]
            whole = n in self.discrete
            point[n] = float(self.random.integers(int(low), int(high) + 1) if whole else drawn(low, high))
        return point

    def limits(self, name: str) -> tuple[float, float]:
        """Return the allowed range of a parameter, without what was found not to be represented."""
        declared, ends, own = self.declared[name], self.ends[name], float(getattr(self.model, name))
        low, high = (
            limit if free else end
            for limit, free, end in zip((declared.min, declared.max), self.may_extend[name], ends, strict=True)
        )
        return min(low, own), max(high, own)

    def narrow(self, name: str, ends: tuple[float, float]) -> None:
        """Let the range of a parameter be this one, and its center be within."""
        self.ends[name], self.may_extend[name] = list(ends), [False, False]
        self.center[name] = float(np.clip(self.center[name], *ends))

    def move_inward(self, name: str, side: int) -> None:
        """Move one end of the range of a parameter nearer to the center."""
        end = 0.5 * (self.ends[name][side] + self.center[name])
        if name in self.discrete:
            end = float(np.ceil(end) if end < self.center[name] else np.floor(end))
        self.ends[name][side], self.may_extend[name][side] = end, False

    def _vectors(self, points: list[dict[str, float]]) -> Array:
        """Return the values of all live parameters (points, live)."""
        values = [[float(p.get(n, getattr(self.model, n))) for n in self.settable] for p in points]
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
        if columns and set(columns) <= self.bounded and (names := blame_for_units(self)):
            self.fix(names, reason)
        elif reason:
            self.fix(
                *find_responsible(self, point, reason, self.influencing_parameters(columns), self.describe_difference)
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
        known = {int(i) for curve in self.curves for i in curve.columns}
        with np.errstate(invalid="ignore", divide="ignore"):
            off = ~(np.abs(wanted - row) <= good * size)
            units = self._scales() if self.constant_scales else np.zeros(0, np.int64)
            off[units] &= ~(np.abs(np.log(np.abs(wanted[units] / row[units]))) <= np.log(MAX_SCALE_RATIO))
        unknown = self._curved_columns() - known
        off[[*self.guessed, *self.constant_scales, *unknown]] = False
        if unknown & {*self._scales().tolist(), *self.reader.gravity.tolist()}:
            off[self._made_of_others()] = False
        wrong = np.flatnonzero(off).tolist()
        return (self.describe_no_sum(wrong), wrong) if wrong else ("", [])

    def _predicted(self, point: dict[str, float]) -> tuple[Array, Array]:
        """Return the numbers by the fits, and the sums of their terms without signs."""
        row, x, column = self.reader.base.copy(), self._vectors([point]), self.reader.columns
        size = np.abs(row)
        for fit in self.fits:
            row[fit.columns], size[fit.columns] = (own[0] for own in fit.values(x))
        for bound in self.clipped:
            row[bound.fits[0].columns] = bound.values(x)[0]
        known = {n: float(point.get(n, getattr(self.model, n))) for n in self.settable}
        for curve in self.curves:
            row[curve.columns], size[curve.columns] = curve.values(known)
        size[column("size")] = np.abs(row[column("size")])
        with np.errstate(all="ignore"):
            row[column("length")] = np.sqrt(row[column("span")].max())
            row[self.lengths] = row[column("length")[0]]
            rates = self._rates(row)
        row[column("rate")], row[column("loop_rate")] = rates.max(), rates[self.rate_sources].max(initial=0.0)
        made = self._made_of_others()
        size[made] = UNIT_ERROR_RATIO * np.abs(row[made])
        return row, size

    def _scales(self) -> NDArray[np.int64]:
        """Return the columns that are made of lengths and rates of the mechanism."""
        return np.concatenate([self.reader.columns("length", "rate", "loop_rate", "span", "drive rate"), self.lengths])

    def influencing_parameters(self, columns: list[int]) -> list[str]:
        """Return the parameters that move some columns; where there are such, those that do so by sums."""
        moving = [[self.powers[n][i] for i in columns if i in self.powers[n]] for n in self.settable]
        found = [n for n, powers in zip(self.settable, moving, strict=True) if powers]
        by_sums = [n for n, powers in zip(self.settable, moving, strict=True) if any(len(p) > 1 for p in powers)]
        return by_sums or found or self.settable

    def describe_difference(self, point: dict[str, float]) -> str:
        """Return why the fits do not agree with a compiled mechanism; empty: they agree."""
        return self.compare_at(point)[0]
