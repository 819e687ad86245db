"""Which parameters of a model stay settable without its ``build()``, and what they do to a compiled mechanism.

>>> from fmus.pendulum import SwingPendulum
>>> live = find_live(SwingPendulum())
>>> live.frozen
{}
>>> live.apply({"start_distance": 2.0})[Place("q", 8)]
2.0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbfmu.modeling.model import Model

from .model_numbers import Place
from .parameter_dependence import Search
from .parameter_map import LENGTH, Entry, find_entries


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
        tuple(find_entries(search)),
        {name: getattr(model, name) for name in names},
    )


def _range(search: Search, name: str, value: float) -> tuple[float, float]:
    """Return from where to where a parameter is settable.

    Of one that is a factor of whatever it moves it is all that the model allows, but for a side on which that failed.
    Lengths and rates are sums by their nature, and no reason to narrow it.
    """
    column, declared = search.live.index(name), search.declared[name]
    parts = search.reader.columns("span", "drive rate")
    own = [fit.exponents[:, column] for fit in search.fits if not np.isin(fit.columns, parts).all()]
    single = not any(np.ptp(powers) for powers in own if len(powers))
    limits = (declared.min, declared.max)
    low, high = (
        limit if single and free else end
        for limit, free, end in zip(limits, search.open[name], search.ends[name], strict=True)
    )
    return min(low, value), max(high, value)
