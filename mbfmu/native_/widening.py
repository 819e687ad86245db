"""How far fits hold outside of where they were made: up to the limits of parameters, or decades away."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

from mbfmu.model import Parameter

if TYPE_CHECKING:
    from .search import Search


def widen(search: Search) -> None:
    """Move the ends of a search outward as far as its fits hold, all parameters at once."""
    names = search.live
    steps = {n: outward(search.declared[n], search.center[n], search.ends[n]) for n in names}
    for level in range(max((len(side) for both in steps.values() for side in both), default=0)):
        goals = {
            (n, side): steps[n][side][level]
            for n in names
            for side in (0, 1)
            if search.open[n][side] and level < len(steps[n][side])
        }
        mixture = search.random.integers(2, size=len(names))
        for sides in (mixture, 1 - mixture) if goals else ():
            _try(search, dict(zip(names, sides.tolist(), strict=True)), goals)
        for (n, side), goal in goals.items():
            search.ends[n][side] = goal


def outward(p: Parameter, center: float, ends: list[float]) -> tuple[list[float], list[float]]:
    """Return values to be tried below and above the ends, outward, up to the limits of a parameter."""
    near, far = [0.1 * center, 0.0, -center, -10.0 * center], [10.0 * center]
    both = (near, far) if center > 0.0 else (far, near)
    below = sorted((x for x in {*both[0], p.min} if isfinite(x) and p.min <= x < ends[0]), reverse=True)
    above = sorted(x for x in {*both[1], p.max} if isfinite(x) and ends[1] < x <= p.max)
    return below, above


def _try(search: Search, sides: dict[str, int], goals: dict[tuple[str, int], float]) -> None:
    """Compare the fits with a plant at the goals on these sides; drop the goals of parameters to blame."""
    while True:
        there = {n: goals[n, side] for n, side in sides.items() if (n, side) in goals}
        point = {n: there.get(n, search.ends[n][side]) for n, side in sides.items()}
        told, columns = search.compared(point)
        if not told or not there:
            return
        alone, _ = search.culprits(there, told, [], search.differs)
        together = [n for n in search.movers(columns) if n in there]
        for n in alone or together or there:
            del goals[n, sides[n]]
            search.open[n][sides[n]] = False
