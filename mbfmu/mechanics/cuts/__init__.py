"""Cut joints, which close loops: one file a kind."""

from __future__ import annotations

from .base import Cut
from .cylindrical import CylindricalCut
from .distance import DistanceCut
from .planar import PlanarCut
from .plane import PlaneCut
from .revolute import RevoluteCut
from .spherical import SphericalCut
from .translational import TranslationalCut
from .weld import WeldCut

__all__ = [
    "Cut",
    "CylindricalCut",
    "DistanceCut",
    "PlanarCut",
    "PlaneCut",
    "RevoluteCut",
    "SphericalCut",
    "TranslationalCut",
    "WeldCut",
]
