"""Weld: no coordinate; the child's frame lies on the joint frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from solvers.compiled.kernel import kernel

from .base import Joint

if TYPE_CHECKING:
    from mbfmu.mechanics.records import State
    from solvers.compiled.record import Record


@kernel
def place(joint: Record, qi: int, state: State) -> None:
    """See :mod:`.base`."""
    rel = state.rel[0]
    for i in range(3):
        for j in range(3):
            rel.R[i, j] = 1.0 if i == j else 0.0
        rel.p[i] = 0.0


@dataclass(frozen=True, kw_only=True)
class Weld(Joint):
    """Rigid connection of a body to its parent."""

    nq = 0
    nv = 0
    place = place
