"""Which parameters lead to what is found at values of several."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .parameter_dependence import ParameterDependence


def find_responsible(
    search: ParameterDependence,
    point: dict[str, float],
    reason: str,
    others: list[str],
    wrong: Callable[[dict[str, float]], str],
) -> tuple[list[str], str]:
    """Return the parameters that alone lead to what a point leads to, and the reason.

    Where none does, those without which it would not be so; where there are none either, the ``others``. ``wrong``
    returns what is wrong at other values, as text. It takes a mechanism each time: parameters are tried in halves,
    and one by one only where halves show nothing, since parameters may need each other.
    """
    center, moved = search.at_center(), [n for n in search.settable if n in point]

    def alone_in(names: list[str]) -> list[str]:
        if not names or not wrong(center | {n: point[n] for n in names}):
            return []
        half = len(names) // 2
        return alone_in(names[:half]) + alone_in(names[half:]) if half else names

    if alone := alone_in(moved) or [n for n in moved if wrong(center | {n: point[n]})]:
        return alone, reason
    needed = [n for n in moved if not wrong(center | point | {n: center[n]})]
    return needed or others, f"with others: {reason}"
