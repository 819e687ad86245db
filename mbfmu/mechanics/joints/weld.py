"""Weld: no coordinate; the child's frame lies on the joint frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solvers.kernel import kernel

from .base import Joint


@kernel
def move(axis: Any, q: Any, qi: int, v: Any, vi: int, rel: Any) -> None:
    """See :mod:`.base`."""
    for i in range(3):
        rel[7 + i, i] = 1.0


@dataclass(frozen=True, kw_only=True)
class Weld(Joint):
    """Fixes a body to its parent."""

    nq = 0
    nv = 0
    move = move
