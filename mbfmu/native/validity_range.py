"""How far fits hold outside of where they were made: up to the limits of parameters, or a decade away.

A build may branch farther out, such as on a stiffness that it limits, and where one parameter is larger than another.
So the fits are compared where each parameter is at an end alone, and where every two of them are at each pair of their
ends. Each one is tried alone up to six decades away, too, and down to six decades where zero is not possible.
"""

from __future__ import annotations

from itertools import combinations, islice
from math import comb, isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mbfmu.modeling.parameters import Parameter

from .responsible import find_responsible

if TYPE_CHECKING:
    from .parameter_dependence import ParameterDependence

FAR_FACTORS = (1e3, 1e6)  # times the center
NEAR_ZERO_FACTORS = (1e-3, 1e-6)  # times the center, where zero itself is another model
FAR_FIT_TOLERANCE = 1e-6  # error of a fit so far out, where sines of large angles and sums are of few digits
MAX_CORNER_HALVINGS = 6  # of the way from the center to an end, where a corner fails

Goals = dict[tuple[str, int], float]  # by parameter and side


def extend_range(dependence: ParameterDependence) -> None:
    """Move the ends of a search outward as far as its fits hold, all parameters at once."""
    _check_corners(dependence)
    steps = {n: outward(dependence.declared[n], dependence.center[n], dependence.ends[n]) for n in dependence.settable}
    for level in range(max((len(side) for both in steps.values() for side in both), default=0)):
        goals: Goals = {
            (n, side): own[level]
            for n, both in steps.items()
            for side, own in enumerate(both)
            if dependence.may_extend[n][side] and level < len(own)
        }
        for sides in _comparisons(dependence):
            _extend_ends(dependence, sides, goals)
        for (n, side), goal in goals.items():
            dependence.ends[n][side] = goal
    _check_corners(dependence)
    for n in dependence.settable:
        for side in (0, 1):
            if dependence.may_extend[n][side]:
                dependence.may_extend[n][side] = _agrees_far(dependence, n, side)
            elif dependence.ends[n][side] == last_before_zero(steps[n][side]):
                _approach_zero(dependence, n, side)


def outward(p: Parameter, center: float, ends: list[float]) -> tuple[list[float], list[float]]:
    """Return values to be tried below and above the ends, outward, up to the limits of a parameter."""
    near, far = [0.1 * center, 0.0, -center, -10.0 * center], [10.0 * center]
    both = (near, far) if center > 0.0 else (far, near)
    below = sorted((x for x in {*both[0], p.min} if isfinite(x) and p.min <= x < ends[0]), reverse=True)
    above = sorted(x for x in {*both[1], p.max} if isfinite(x) and ends[1] < x <= p.max)
    return below, above


def last_before_zero(steps: list[float]) -> float | None:
    """Return the value after which zero was tried; None: there is none."""
    k = steps.index(0.0) if 0.0 in steps else 0
    return steps[k - 1] if k else None


def _comparisons(dependence: ParameterDependence) -> list[dict[str, int]]:
    """Return the sides at which parameters are compared, others at the center: each one alone, then all together."""
    names = dependence.settable
    alone = [{name: side} for name in names for side in (0, 1)]
    drawn = dependence.random.integers(2, size=len(names))
    together = [dict(zip(names, row.tolist(), strict=True)) for row in pairs_of_sides(len(names)) ^ drawn]
    return alone + together if len(names) > 1 else alone


def pairs_of_sides(count: int) -> NDArray[np.int64]:
    """Return rows (rows, count) of zeros and ones, in which every two columns have all four pairs.

    The ones of the columns are different sets of more than half of the rows after the first, which is zero
    (Kleitman, Spencer, Discrete Mathematics 6, 1973).
    """
    rows = 4
    while comb(rows - 1, (rows + 1) // 2) < count:
        rows += 1
    found = np.zeros((rows, count), np.int64)
    for column, ones in enumerate(islice(combinations(range(1, rows), (rows + 1) // 2), count)):
        found[[*ones], column] = 1
    return found


def _extend_ends(dependence: ParameterDependence, sides: dict[str, int], goals: Goals) -> None:
    """Compare the fits with a compiled mechanism at the goals on these sides; drop the goals of parameters to blame."""
    while True:
        there = {n: goals[n, side] for n, side in sides.items() if (n, side) in goals}
        ends = {n: there.get(n, dependence.ends[n][side]) for n, side in sides.items()}
        point = dependence.at_center() | ends
        reason, columns = dependence.compare_at(point)
        if not reason or not there:
            return
        names, _ = find_responsible(
            dependence, point, reason, dependence.influencing_parameters(columns), dependence.describe_difference
        )
        for n in [n for n in names if n in there] or list(there):
            del goals[n, sides[n]]
            dependence.may_extend[n][sides[n]] = False


def _agrees_far(dependence: ParameterDependence, name: str, side: int) -> bool:
    """Return whether the fits hold far out on one side, where one parameter is there alone."""
    p, center, end = dependence.declared[name], dependence.center[name], dependence.ends[name][side]
    points = (c * k for c in (-center, center) for k in FAR_FACTORS)
    out = [x for x in points if p.min <= x <= p.max and (x > end if side else x < end)]
    return not any(dependence.compare_at({**dependence.at_center(), name: x}, FAR_FIT_TOLERANCE)[0] for x in out)


def _approach_zero(dependence: ParameterDependence, name: str, side: int) -> None:
    """Move an end as near to zero as the fits hold where one parameter is there alone. At zero the model is another
    one, such as a controller without an integral part.
    """
    for factor in NEAR_ZERO_FACTORS:
        x = factor * dependence.center[name]
        if dependence.compare_at({**dependence.at_center(), name: x})[0]:
            return
        dependence.ends[name][side] = x


def _check_corners(dependence: ParameterDependence) -> None:
    """Compare the fits with compiled mechanisms where all parameters are at an end; move ends inward where they do not
    agree.
    """
    for sides in _comparisons(dependence):
        for _ in range(MAX_CORNER_HALVINGS):
            corner = dependence.at_center() | {n: dependence.ends[n][side] for n, side in sides.items()}
            reason, columns = dependence.compare_at(corner)
            if not reason:
                break
            names, _ = find_responsible(
                dependence, corner, reason, dependence.influencing_parameters(columns), dependence.describe_difference
            )
            for n in names:
                if n in sides:
                    dependence.move_inward(n, sides[n])
