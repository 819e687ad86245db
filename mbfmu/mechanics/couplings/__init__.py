"""Couplings of two joint coordinates, such as gears and cams: one file a kind."""

from __future__ import annotations

from .base import Coupling
from .cam import Cam
from .gear import Gear

__all__ = ["Cam", "Coupling", "Gear"]
