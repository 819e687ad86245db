"""Elastic elements between bodies: one file a kind, and one more for an analytic tangent."""

from __future__ import annotations

from .beam import BeamElement
from .plate import Plate
from .shell import Shell

__all__ = ["BeamElement", "Plate", "Shell"]
