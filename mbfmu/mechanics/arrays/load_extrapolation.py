"""Loads that a host sets, between the communication points at which it does.

What is held lags by half a step. A load may go on instead as from the last point to this one, which is right but for
the square of the step; where it jumps, it does so once more within the step that follows. If a host gives a rate with
the value, the load continues with this rate until it is set again.

Kernels take a load and the polynomial that is evaluated.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Record, f8, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.signals.polynomial import PolynomialRecord


class LoadRecord(Record):
    """A force that an input gives, extrapolated between communication points."""

    polynomial: i8  # number of the polynomial
    value: f8  # what the host has set
    point: f8  # s, of the last point; not a number: there was none
    before: f8  # s, of the one before
    was: f8  # value there
    rate: f8  # that the host has given with the value; not a number: none


@inlined
def load_finished(polynomial: PolynomialRecord) -> bool:
    """Whether a load stays as it is until it is set."""
    return polynomial.c[1] == 0.0


@kernel
def start_load(load: LoadRecord, polynomial: PolynomialRecord) -> None:
    """Begin at the value that the polynomial has; nothing is known of the time before."""
    load.value, load.point, load.before, load.was = polynomial.c[0], np.nan, np.nan, np.nan
    load.rate = np.nan


@kernel
def set_load_input(t: float, value: float, rate: float, load: LoadRecord, polynomial: PolynomialRecord) -> None:
    """Take the value and the rate at the point t, s; a rate that is not a number is not given."""
    if t != load.point:
        load.before, load.was, load.point = load.point, load.value, t
    load.value, load.rate = value, rate
    polynomial.t0, polynomial.c[0], polynomial.c[1] = t, value, 0.0 if np.isnan(rate) else rate


@kernel
def load_starts(t: float, end: float, load: LoadRecord, polynomial: PolynomialRecord) -> bool:
    """Begin a step from t to ``end``, s; return whether the load changes its rate.

    It changes by no more than it last did, however long the step. With a given rate it changes when it is set.
    """
    if not np.isnan(load.rate):
        return False
    went_on = not load_finished(polynomial)
    if t != load.point:
        set_load_input(t, load.value, np.nan, load, polynomial)  # the host has said nothing: it is what it was
    change = load.value - load.was
    slope = change / max(t - load.before, end - t) if change != 0.0 and t > load.before else 0.0
    polynomial.t0, polynomial.c[0], polynomial.c[1] = load.point, load.value, slope
    return went_on or slope != 0.0


@kernel
def skip_load_point(t: float, load: LoadRecord, polynomial: PolynomialRecord) -> None:
    """Note a point, t (s), at which the load stayed as it is."""
    if load_finished(polynomial) and not t <= load.point:
        set_load_input(t, load.value, load.rate, load, polynomial)
