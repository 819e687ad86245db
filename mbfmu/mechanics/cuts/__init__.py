"""Cut joints: one file a kind, and this registry."""

from __future__ import annotations

from typing import Any

from solvers.kernel import inlined

from . import distance, revolute, spherical, weld
from .base import Cut
from .distance import DistanceCut
from .revolute import RevoluteCut
from .spherical import SphericalCut
from .weld import WeldCut

REGISTRY: tuple[type[Cut], ...] = (DistanceCut, RevoluteCut, SphericalCut, WeldCut)

_distance, _revolute, _spherical, _weld = distance.close, revolute.close, spherical.close, weld.close


@inlined
def close(cut: Any, A: Any, B: Any, rows: Any) -> None:
    """Fill the rows of a cut joint; see :mod:`.base`."""
    if cut.kind == 0:
        _distance(cut, A, B, rows)
    elif cut.kind == 1:
        _revolute(cut, A, B, rows)
    elif cut.kind == 2:
        _spherical(cut, A, B, rows)
    else:
        _weld(cut, A, B, rows)


__all__ = ["REGISTRY", "Cut", "DistanceCut", "RevoluteCut", "SphericalCut", "WeldCut", "close"]
