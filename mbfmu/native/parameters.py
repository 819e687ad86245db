"""Which parameters of a model stay settable without its ``build()``, and what they do to a compiled mechanism.

>>> from fmus.pendulum import SwingPendulum
>>> settable = find_settable(SwingPendulum())
>>> settable.fixed
{}
>>> settable.apply({"start_distance": 2.0})[Place("q", 8)]
2.0
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbfmu.modeling.model import Model

from .model_numbers import Place
from .parameter_dependence import ParameterDependence
from .parameter_map import LENGTH_NAME, Entry, find_entries


@dataclass(frozen=True)
class SettableParameters:
    """What parameters of one model stay settable without its ``build()``.

    Attributes
    ----------
    parameters
        Their names.
    fixed
        All others, and why.
    ranges
        Of each that is settable, from where to where; never more than the model allows.
    entries
        Every number that they move. The characteristic length comes first: others are made of it.
    start
        The values that the model has.
    """

    parameters: tuple[str, ...]
    fixed: dict[str, str]
    ranges: dict[str, tuple[float, float]]
    entries: tuple[Entry, ...]
    start: dict[str, float]

    def apply(self, values: Mapping[str, float]) -> dict[Place, float]:
        """Return all entries by their places for values of some parameters, those of the model for the others."""
        known, found = {**self.start, **values}, {}
        for entry in self.entries:
            found[entry.place] = entry.value(known)
            if entry.place.array == "length":
                known[LENGTH_NAME] = found[entry.place]
        return found


def find_settable(model: Model) -> SettableParameters:
    """Return which parameters of a model stay settable, and what they do; it is built some hundred times.

    Raises
    ------
    UserError
        The model as it is cannot be built.
    """
    dependence = ParameterDependence(model)
    names = dependence.settable
    return SettableParameters(
        tuple(names),
        {p.name: dependence.fixed[p.name] for p in model.parameters() if p.name in dependence.fixed},
        {name: _range(dependence, name, getattr(model, name)) for name in names},
        tuple(find_entries(dependence)),
        {name: getattr(model, name) for name in names},
    )


def _range(dependence: ParameterDependence, name: str, value: float) -> tuple[float, float]:
    """Return from where to where a parameter is settable.

    Of one that is a factor of whatever it moves it is all that the model allows, but for a side on which that failed.
    Lengths and rates are sums by their nature, and no reason to narrow it.
    """
    column = dependence.settable.index(name)
    parts = dependence.reader.columns("span", "drive rate")
    own = [fit.exponents[:, column] for fit in dependence.fits if not np.isin(fit.columns, parts).all()]
    single = not dependence.curved.get(name) and not any(np.ptp(powers) for powers in own if len(powers))
    if not single or name in dependence.discrete:
        low, high = dependence.ends[name]
        return min(low, value), max(high, value)
    return dependence.limits(name)
