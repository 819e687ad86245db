"""Cut joints, which close loops: one file a kind."""

from __future__ import annotations

from .base import Cut
from .distance import DistanceCut
from .planar import PlanarCut
from .plane import PlaneCut
from .revolute import RevoluteCut
from .spherical import SphericalCut
from .weld import WeldCut

__all__ = ["Cut", "DistanceCut", "PlanarCut", "PlaneCut", "RevoluteCut", "SphericalCut", "WeldCut"]
