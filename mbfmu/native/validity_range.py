"""How far fits hold outside of where they were made: up to the limits of parameters, or a decade away.

A build may branch farther out, such as on a stiffness that it limits: each parameter is tried alone up to six decades
away.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

from mbfmu.modeling.parameters import Parameter

if TYPE_CHECKING:
    from .parameter_dependence import Search

FAR = (1e3, 1e6)  # times the center
CLOSE = 1e-6  # error of a fit so far out, where sines of large angles and sums are of few digits
HALVINGS = 6  # of the way from the center to an end, where a corner fails

Goals = dict[tuple[str, int], float]  # by parameter and side


def widen(search: Search) -> None:
    """Move the ends of a search outward as far as its fits hold, all parameters at once."""
    _hold_corners(search)
    steps = {n: outward(search.declared[n], search.center[n], search.ends[n]) for n in search.live}
    for level in range(max((len(side) for both in steps.values() for side in both), default=0)):
        goals: Goals = {
            (n, side): own[level]
            for n, both in steps.items()
            for side, own in enumerate(both)
            if search.open[n][side] and level < len(own)
        }
        for sides in _mixtures(search):
            _reach(search, sides, goals)
        for (n, side), goal in goals.items():
            search.ends[n][side] = goal
    _hold_corners(search)
    for n in search.live:
        for side in (0, 1):
            if search.open[n][side]:
                search.open[n][side] = _holds_far(search, n, side)


def outward(p: Parameter, center: float, ends: list[float]) -> tuple[list[float], list[float]]:
    """Return values to be tried below and above the ends, outward, up to the limits of a parameter."""
    near, far = [0.1 * center, 0.0, -center, -10.0 * center], [10.0 * center]
    both = (near, far) if center > 0.0 else (far, near)
    below = sorted((x for x in {*both[0], p.min} if isfinite(x) and p.min <= x < ends[0]), reverse=True)
    above = sorted(x for x in {*both[1], p.max} if isfinite(x) and ends[1] < x <= p.max)
    return below, above


def _mixtures(search: Search) -> list[dict[str, int]]:
    """Return a side for every parameter at random, and the other sides."""
    drawn = search.random.integers(2, size=len(search.live))
    return [dict(zip(search.live, sides.tolist(), strict=True)) for sides in (drawn, 1 - drawn)]


def _reach(search: Search, sides: dict[str, int], goals: Goals) -> None:
    """Compare the fits with a plant at the goals on these sides; drop the goals of parameters to blame."""
    while True:
        there = {n: goals[n, side] for n, side in sides.items() if (n, side) in goals}
        point = {n: there.get(n, search.ends[n][side]) for n, side in sides.items()}
        told, columns = search.compared(point)
        if not told or not there:
            return
        names, _ = search.culprits(point, told, search.movers(columns), search.differs)
        for n in [n for n in names if n in there] or list(there):
            del goals[n, sides[n]]
            search.open[n][sides[n]] = False


def _holds_far(search: Search, name: str, side: int) -> bool:
    """Return whether the fits hold far out on one side, where one parameter is there alone."""
    p, center, end = search.declared[name], search.center[name], search.ends[name][side]
    points = (c * k for c in (-center, center) for k in FAR)
    out = [x for x in points if p.min <= x <= p.max and (x > end if side else x < end)]
    return not any(search.compared({**search.at_center(), name: x}, CLOSE)[0] for x in out)


def _hold_corners(search: Search) -> None:
    """Compare the fits with plants where all parameters are at an end; move ends inward where they do not agree."""
    for sides in _mixtures(search):
        for _ in range(HALVINGS):
            corner = {n: search.ends[n][side] for n, side in sides.items()}
            told, columns = search.compared(corner)
            if not told:
                break
            names, _ = search.culprits(corner, told, search.movers(columns), search.differs)
            for n in names:
                search.ends[n][sides[n]] = 0.5 * (search.ends[n][sides[n]] + search.center[n])
                search.open[n][sides[n]] = False
