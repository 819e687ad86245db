"""Cut joints: one file a kind, and this registry."""

from __future__ import annotations

from typing import Any

from solvers.kernel import inlined

from . import distance, planar, plane, revolute, spherical, weld
from .base import Cut
from .distance import DistanceCut
from .planar import PlanarCut
from .plane import PlaneCut
from .revolute import RevoluteCut
from .spherical import SphericalCut
from .weld import WeldCut

REGISTRY: tuple[type[Cut], ...] = (DistanceCut, RevoluteCut, SphericalCut, WeldCut, PlaneCut, PlanarCut)

_distance, _revolute, _spherical, _weld = distance.close, revolute.close, spherical.close, weld.close
_plane, _planar = plane.close, planar.close


@inlined
def close(cut: Any, A: Any, B: Any, rows: Any) -> None:
    """Fill the rows of a cut joint; see :mod:`.base`."""
    if cut.kind == 0:
        _distance(cut, A, B, rows)
    elif cut.kind == 1:
        _revolute(cut, A, B, rows)
    elif cut.kind == 2:
        _spherical(cut, A, B, rows)
    elif cut.kind == 4:
        _plane(cut, A, B, rows)
    elif cut.kind == 5:
        _planar(cut, A, B, rows)
    else:
        _weld(cut, A, B, rows)


__all__ = [
    "REGISTRY",
    "Cut",
    "DistanceCut",
    "PlanarCut",
    "PlaneCut",
    "RevoluteCut",
    "SphericalCut",
    "WeldCut",
    "close",
]
