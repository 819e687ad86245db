"""Bodies that bend by their modes."""

from __future__ import annotations

from .beam import Beam
from .modal import MODES

__all__ = ["MODES", "Beam"]
