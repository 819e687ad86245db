"""What matters: Sobol's indices, and the ends of a tornado."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import stats

from mbfmu.util.errors import UserError
from solvers.system import Array

from .study import Study


class Indices(NamedTuple):
    """Sobol's indices of one measure, by what varies, with half the width of their 95 % confidence intervals."""

    names: tuple[str, ...]
    first: Array  # the part of the variance that each causes alone
    total: Array  # ... and with others
    first_error: Array
    total_error: Array


def sobol_indices(study: Study, measure: str, count: int) -> Indices:
    """Return Sobol's indices of a study that was sampled for sensitivity, ``count`` at a time.

    After Saltelli et al. (2010), as SciPy has them; intervals by bootstrap.

    Raises
    ------
    UserError
        Runs failed: the indices need them all.
    """
    names, y = study.varied, study.column(measure)
    if not np.isfinite(y).all():
        odd = int(np.sum(~np.isfinite(y)))
        raise UserError(
            f"{odd} of {len(y)} runs have no {measure!r}, which is needed for its indices; use narrower ranges"
        )
    a, b, mixed = y[:count], y[count : 2 * count], y[2 * count :].reshape(len(names), 1, count)
    if np.ptp(y) == 0.0:
        none = np.zeros(len(names))
        return Indices(names, none, none, none, none)
    own = stats.sobol_indices(func={"f_A": a[None], "f_B": b[None], "f_AB": mixed}, n=count)
    spread = own.bootstrap(confidence_level=0.95)
    widths = [
        0.5 * np.ravel(s.confidence_interval.high - s.confidence_interval.low)
        for s in (spread.first_order, spread.total_order)
    ]
    return Indices(names, np.ravel(own.first_order), np.ravel(own.total_order), *widths)


class Bars(NamedTuple):
    """A tornado: a measure in the middle, and at both ends of each number (names, 2)."""

    names: tuple[str, ...]
    middle: float
    ends: Array


def tornado(study: Study, measure: str) -> Bars:
    """Return the tornado of a study that was sampled for one, the longest bar first."""
    y = study.column(measure)
    ends = y[1:].reshape(-1, 2)
    order = np.argsort(-np.nan_to_num(np.ptp(ends, axis=1)))
    return Bars(tuple(study.varied[k] for k in order), float(y[0]), ends[order])
