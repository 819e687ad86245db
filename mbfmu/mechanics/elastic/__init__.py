"""Elastic elements between bodies, and what acts on their surface: one file a kind."""

from __future__ import annotations

from .beam import Beam
from .modal import MODES
from .plate import Plate

__all__ = ["MODES", "Beam", "Plate"]
