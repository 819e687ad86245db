"""Which numbers of a compiled mechanism follow which parameters, and how, so that they follow without ``build()``.

A run starts from the numbers of :class:`.numbers.Place`. Those that a live parameter moves are entries here: each the
root of the largest of some sums of products of powers of parameters. All others stay as they are in the model.

>>> from fmus.pendulum import SwingPendulum
>>> live = find_live(SwingPendulum())
>>> live.frozen
{}
>>> live.apply({"crank_length": 2.0})["bodies", 312]  # where its center of mass is
1.0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

import numpy as np

from mbfmu.model import Model

from .monomials import Fit
from .numbers import Place
from .search import Search

LENGTH = "characteristic length"  # beside the names of parameters: of the mechanism, m; no parameter has such a name


@dataclass(frozen=True)
class Term:
    """A product: a coefficient times powers of parameters."""

    coefficient: float
    powers: tuple[tuple[str, float], ...]

    def value(self, values: Mapping[str, float]) -> float:
        """Return it for these values of the parameters, and of the characteristic length where that is a factor."""
        return self.coefficient * float(prod(values[name] ** power for name, power in self.powers))


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
        largest = max(sum(term.value(values) for term in own) for own in self.sums)
        return float(largest if self.root == 1 else largest ** (1.0 / self.root))


@dataclass(frozen=True)
class Live:
    """What parameters of one model stay settable without its ``build()``.

    Attributes
    ----------
    parameters
        Their names.
    frozen
        All others, and why.
    ranges
        Of each that is settable, from where to where; never more than the model allows.
    entries
        Every number that they move. The characteristic length comes first: others are made of it.
    start
        The values that the model has.
    """

    parameters: tuple[str, ...]
    frozen: dict[str, str]
    ranges: dict[str, tuple[float, float]]
    entries: tuple[Entry, ...]
    start: dict[str, float]

    def apply(self, values: Mapping[str, float]) -> dict[Place, float]:
        """Return all entries by their places for values of some parameters, those of the model for the others."""
        known, found = {**self.start, **values}, {}
        for entry in self.entries:
            found[entry.place] = entry.value(known)
            if entry.place.array == "length":
                known[LENGTH] = found[entry.place]
        return found


def find_live(model: Model) -> Live:
    """Return which parameters of a model stay settable, and what they do; it is built some hundred times.

    Raises
    ------
    UserError
        The model as it is cannot be built.
    """
    search = Search(model)
    names = search.live
    return Live(
        tuple(names),
        {p.name: search.frozen[p.name] for p in model.parameters() if p.name in search.frozen},
        {name: _range(search, name, getattr(model, name)) for name in names},
        tuple(_entries(search)),
        {name: getattr(model, name) for name in names},
    )


def _range(search: Search, name: str, value: float) -> tuple[float, float]:
    """Return from where to where a parameter is settable.

    Of one in products only it is all that the model allows, but for a side on which they failed. Lengths and rates
    are sums by their nature, and no reason to narrow it.
    """
    column, declared = search.live.index(name), search.declared[name]
    parts = search.reader.columns("span", "weight", "drive rate")
    own = [fit for fit in search.fits if np.any(fit.exponents[:, column])]
    single = all(len(fit.exponents) == 1 or np.isin(fit.columns, parts).all() for fit in own)
    limits = (declared.min, declared.max)
    low, high = (
        limit if single and free else end
        for limit, free, end in zip(limits, search.open[name], search.ends[name], strict=True)
    )
    return min(low, value), max(high, value)


def _entries(search: Search) -> list[Entry]:
    """Return the entries: the length, what is found as it is, and what is made of these."""
    reader = search.reader
    sums = {int(i): _sum(search, fit, k) for fit in search.fits for k, i in enumerate(fit.columns)}
    sums = {i: own for i, own in sums.items() if any(term.powers for term in own)}
    made = {"span", "weight", "drive size", "drive rate"}

    def own(name: str) -> list[Sum]:
        columns = reader.columns(name).tolist()
        return [sums.get(i, (Term(float(reader.base[i]), ()),)) for i in columns]

    def moves(*names: str) -> bool:
        return any(i in sums for i in reader.columns(*names))

    long = set(search.lengths.tolist())
    entries = []
    if moves("span"):
        entries.append(Entry(Place("length", 0), tuple(dict.fromkeys(own("span"))), root=2))
        entries += [
            Entry(reader.places[i], ((Term(1.0, ((LENGTH, 1.0),)),),))
            for i in search.lengths.tolist()
            if reader.places[i].array not in made
        ]
    for i in sorted(sums):
        place = reader.places[i]
        if place.array not in made:
            entries.append(Entry(place, (sums[i],), 1, reader.inputs.get(place), i in search.guessed))
    for bound in search.clipped:
        for k, i in enumerate(bound.fits[0].columns.tolist()):
            parts = tuple(_sum(search, fit, k) for fit in bound.fits)
            entries.append(Entry(reader.places[i], tuple(dict.fromkeys(parts)), bound.root))
    if moves("span", "weight", "drive size", "drive rate"):
        by_weight = tuple(Term(t.coefficient, (*t.powers, (LENGTH, -2.0))) for t in own("weight")[0])
        rates = [by_weight]
        for i, turning in zip(reader.columns("drive size").tolist(), own("drive rate"), strict=True):
            if i in long:
                rates.append(tuple(Term(t.coefficient, (*t.powers, (LENGTH, -4.0))) for t in turning))
            else:
                rates.append(tuple(Term(t.coefficient / float(reader.base[i]) ** 4, t.powers) for t in turning))
        entries.append(Entry(Place("rate", 0), tuple(dict.fromkeys(rates)), root=4))
        carried = [rate for rate, known in zip(rates, search.carried, strict=True) if known]
        if len(reader.columns("loop_rate")):
            entries.append(Entry(Place("loop_rate", 0), tuple(dict.fromkeys(carried)), root=4))
    return entries


def _sum(search: Search, fit: Fit, k: int) -> Sum:
    """Return one of the sums of a fit, in words of the parameters."""
    return tuple(
        Term(float(c), tuple((n, float(e)) for n, e in zip(search.live, exponents, strict=True) if e))
        for c, exponents in zip(fit.coefficients[:, k], fit.exponents, strict=True)
    )
