"""Resolutions: the values of a model's parameters that say how finely it is resolved, and where finer ones lead to."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.modeling.model import Model
from mbfmu.util.errors import UserError

Array = NDArray[np.float64]
Resolution = Mapping[str, Any]  # values by the names of parameters; none: the model as it is

PLAUSIBLE_ORDERS = (0.5, 8.0)  # that are believed where they are observed
MIN_REFINEMENT_COSINE = 0.5  # cosine between two steps of refinement that lead the same way
UNKNOWN_ORDER_FACTOR = 3.0  # times the last difference is the doubt where none is


def resolutions_of(model: Model, requested: Sequence[Resolution] | None) -> list[Resolution]:
    """Return what to run a model at, coarse to fine: as asked, or as its parameters declare; else as it is.

    Raises
    ------
    UserError
        The request is no parameter of resolution, or not allowed for it.
    """
    declared = {p.name: p.resolution for p in model.parameters() if p.resolution}
    if requested is None:
        resolved = declared and all(getattr(model, name) for name in declared)
        columns = zip(*declared.values(), strict=True)
        return [dict(zip(declared, values, strict=True)) for values in columns] if resolved else [{}]
    found: list[Resolution] = []
    for resolution in requested:
        for name in resolution:
            if name not in declared:
                allowed = ", ".join(declared) or "none; a model declares them with parameter(..., resolution=...)"
                raise UserError(f"{name!r} is no resolution of model {model.name!r}; allowed: {allowed}")
        changed = model.with_values(resolution)
        found.append({name: getattr(changed, name) for name in resolution})
    return sorted(found, key=size, reverse=True) or [{}]


def resolution_text(resolution: Resolution) -> str:
    """Return a resolution for people; empty for the model as it is."""
    return " ".join(f"{name}={value:g}" for name, value in resolution.items())


def size(resolution: Resolution) -> float:
    """Return the size of a cell, on some scale: one over the mean of the values."""
    return float(prod(resolution.values()) ** (-1.0 / len(resolution))) if resolution else 1.0


def moving_places(names: Sequence[Sequence[str]]) -> set[str]:
    """Return the outputs of which there are more where a model is finer: what they are of has another place then.

    ``names`` are the outputs at each resolution.
    """
    counts: dict[str, set[int]] = {}
    for own in names:
        stems = [stem(name) for name in own]
        for known in {*stems, *counts}:
            counts.setdefault(known, set()).add(stems.count(known))
    return {name for own in names for name in own if len(counts[stem(name)]) > 1}


def stem(name: str) -> str:
    """Return the name of an output without its numbers."""
    return re.sub(r"\[[^]]*\]", "[]", name)


def limit(values: Sequence[Array], sizes: Sequence[float]) -> tuple[Array, float, float | None]:
    """Return the limit of values as sizes of cells go to zero, its uncertainty, and the observed order.

    Richardson's extrapolation of the last three, error = C size^p; p is that of their differences over the whole run.
    The doubt is what it corrects the finest by. Where no sane p is seen the finest stays as it is: None, and the doubt
    is three times the last difference.
    """
    finest = values[-1]
    if len(values) == 1:
        return finest, 0.0, None
    last = finest - values[-2]
    order = observed_order(values[-3:], sizes[-3:]) if len(values) > 2 else None
    if order is None:
        return finest, UNKNOWN_ORDER_FACTOR * float(np.abs(last).max()), None
    coarse, fine = sizes[-2] ** order, sizes[-1] ** order
    correction = fine / (coarse - fine) * last
    return finest + correction, float(np.abs(correction).max()), order


def observed_order(values: Sequence[Array], sizes: Sequence[float]) -> float | None:
    """Return p of error = C size^p from three solutions, coarse to fine; None if it is not plausible."""
    steps = [b - a for a, b in pairwise(values)]
    first, last = (float(np.linalg.norm(step)) for step in steps)
    if not (np.vdot(*steps) > MIN_REFINEMENT_COSINE * first * last and sizes[0] > sizes[1] > sizes[2]):
        return None

    def off(p: float) -> float:
        a, b, c = (h**p for h in sizes)
        return float((a - b) / (b - c) - first / last)

    low, high = PLAUSIBLE_ORDERS
    return float(scipy.optimize.brentq(off, low, high)) if off(low) * off(high) < 0.0 else None
