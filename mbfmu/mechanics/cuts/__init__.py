"""Cut joints, which close loops: one file a kind."""

from __future__ import annotations

from .base import CutJoint
from .cylindrical import CylindricalCutJoint
from .distance import DistanceCutJoint
from .planar import PlanarCutJoint
from .plane import PlaneCutJoint
from .revolute import RevoluteCutJoint
from .rolling import RollingWheel
from .spherical import SphericalCutJoint
from .translational import TranslationalCutJoint
from .universal import UniversalCutJoint
from .weld import WeldCutJoint

__all__ = [
    "CutJoint",
    "CylindricalCutJoint",
    "DistanceCutJoint",
    "PlanarCutJoint",
    "PlaneCutJoint",
    "RevoluteCutJoint",
    "RollingWheel",
    "SphericalCutJoint",
    "TranslationalCutJoint",
    "UniversalCutJoint",
    "WeldCutJoint",
]
