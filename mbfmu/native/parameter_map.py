"""The numbers of a compiled mechanism that follow parameters.

Each is the root of the largest of some sums of products of powers of parameters. Most are one sum and no root. The
characteristic length is the largest of the lengths of bodies, and rates are the largest of those of gravity and drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from .curves import Curve, Shifted, value_of
from .model_numbers import Place
from .monomials import Fit
from .parameter_dependence import ParameterDependence

LENGTH_NAME = "characteristic length"  # of the mechanism, m, among the names of parameters; no parameter has this name

SCALE_ARRAYS = {"span", "drive size", "drive rate"}  # what lengths and rates are made of


@dataclass(frozen=True)
class Term:
    """A product: a coefficient times powers of parameters."""

    coefficient: float
    powers: tuple[tuple[str | Shifted, float], ...]

    def __mul__(self, other: Term) -> Term:
        """Return the product of both."""
        own, more = dict(self.powers), dict(other.powers)
        powers = {name: own.get(name, 0.0) + more.get(name, 0.0) for name in {**own, **more}}
        return Term(self.coefficient * other.coefficient, tuple((n, e) for n, e in powers.items() if e))

    def value(self, values: Mapping[str, float]) -> float:
        """Return it for these values of the parameters, and of the characteristic length where that is a factor."""
        return self.coefficient * float(prod(value_of(name, values) ** power for name, power in self.powers))


Sum = tuple[Term, ...]


@dataclass(frozen=True)
class Entry:
    """A number that follows parameters.

    Attributes
    ----------
    place
        Array and offset in bytes.
    sums, root
        It is the largest of the sums, to the power 1 / root; of a negative root the smallest of what they give.
    input
        Number of the input that owns it: this is what it starts from. None: no input does.
    guess
        It is near only, which is enough for a position that is corrected when loops are closed.
    """

    place: Place
    sums: tuple[Sum, ...]
    root: int = 1
    input: int | None = None
    guess: bool = False

    def value(self, values: Mapping[str, float]) -> float:
        """Return it for these values of the parameters, and of the characteristic length."""
        largest = max(sum((term.value(values) for term in own), 0.0) for own in self.sums)
        return float(largest if self.root == 1 else largest ** (1.0 / self.root))


def find_entries(dependence: ParameterDependence) -> list[Entry]:
    """Return what follows the live parameters of a search; the length first, of which others are made."""
    return _Found(dependence).entries()


class _Found:
    """What a search has found, as sums by column."""

    def __init__(self, dependence: ParameterDependence) -> None:
        self._search, self._reader = dependence, dependence.reader
        every = {int(i): _sum(dependence, fit, k) for fit in dependence.fits for k, i in enumerate(fit.columns)}
        self._moved = {i: own for i, own in every.items() if any(term.powers for term in own)}
        self._scales = {i for i, place in enumerate(self._reader.places) if place.array in SCALE_ARRAYS}

    def entries(self) -> list[Entry]:
        """Return all entries."""
        found = self._lengths()
        for i, own in sorted(self._moved.items()):
            if i not in self._scales:
                found.append(self._entry(i, (own,)))
        for curve in self._search.curves:
            for k, i in enumerate(curve.columns.tolist()):
                found.append(self._entry(i, (_curve_sum(curve, k),)))
        for bound in self._search.clipped:
            for k, i in enumerate(bound.fits[0].columns.tolist()):
                found.append(self._entry(i, tuple(_sum(self._search, fit, k) for fit in bound.fits), bound.root))
        return found + self._rates()

    def _entry(self, column: int, sums: tuple[Sum, ...], root: int = 1) -> Entry:
        place = self._reader.places[column]
        guess = column in self._search.guessed
        return Entry(place, tuple(dict.fromkeys(sums)), root, self._reader.inputs.get(place), guess)

    def _of(self, column: int) -> Sum:
        """Return a column as a sum, whether it moves or not."""
        return self._moved.get(column, (Term(float(self._reader.base[column]), ()),))

    def _moves(self, columns: NDArray[np.int64]) -> bool:
        return any(i in self._moved for i in columns.tolist())

    def _length(self, power: float) -> Term:
        """Return a power of the characteristic length."""
        if self._moves(self._reader.columns("span")):
            return Term(1.0, ((LENGTH_NAME, power),))
        return Term(float(self._reader.base[self._reader.columns("length")[0]]) ** power, ())

    def _lengths(self) -> list[Entry]:
        """Return the length, where it moves, and the numbers that are equal to it."""
        spans = self._reader.columns("span")
        if not self._moves(spans):
            return []
        first = self._entry(int(self._reader.columns("length")[0]), tuple(map(self._of, spans.tolist())), 2)
        equal = [i for i in self._search.lengths.tolist() if i not in self._scales]
        return [first, *(self._entry(i, ((self._length(1.0),),)) for i in equal)]

    def _rates(self) -> list[Entry]:
        """Return the rate of the mechanism, and that of its loops, where they move."""
        reader = self._reader
        sizes, turning = reader.columns("drive size"), reader.columns("drive rate")
        if not any(map(self._moves, (reader.gravity, reader.columns("span"), sizes, turning))):
            return []
        gravity = [[term for term in self._of(i) if term.coefficient] for i in reader.gravity.tolist()]
        rates = [tuple(self._length(-2.0) * a * b for axis in gravity for a in axis for b in axis)]
        for size, rate in zip(sizes.tolist(), turning.tolist(), strict=True):
            long = size in self._search.lengths
            unit = self._length(-4.0) if long else Term(float(reader.base[size]) ** -4.0, ())
            rates.append(tuple(unit * term for term in self._of(rate)))
        carried = tuple(rate for rate, known in zip(rates, self._search.rate_sources, strict=True) if known)
        found = [(reader.columns("rate"), tuple(rates)), (reader.columns("loop_rate"), carried)]
        return [self._entry(int(i), sums, 4) for columns, sums in found for i in columns if sums]


def _sum(dependence: ParameterDependence, fit: Fit, k: int) -> Sum:
    """Return one of the sums of a fit, as text with the parameters."""
    return tuple(
        Term(float(c), tuple((n, float(e)) for n, e in zip(dependence.settable, exponents, strict=True) if e))
        for c, exponents in zip(fit.coefficients[:, k], fit.exponents, strict=True)
    )


def _curve_sum(curve: Curve, k: int) -> Sum:
    """Return one of the numbers of a curve as a sum."""
    return tuple(
        Term(float(c), tuple((n, float(e)) for n, e in zip(curve.variables, exponents, strict=True) if e))
        for c, exponents in zip(curve.coefficients[:, k], curve.exponents, strict=True)
        if c
    )
