"""In a plane: a point of body b stays in the x-y plane of the cut frame in body a."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.kernel import kernel

from .base import Cut, along, between


@kernel
def evaluate(cut: Any, A: Any, B: Any, row: int, state: Any) -> None:
    """See :mod:`.base`."""
    along(cut, 2, A, between(cut, A, B), state.rows[row])


@dataclass(frozen=True, kw_only=True)
class PlaneCut(Cut):
    """Holds a point of body b in the x-y plane of the cut frame in body a."""

    rows = ("z",)
    units = ("N",)
    evaluate = evaluate
