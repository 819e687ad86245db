"""Bodies that bend by their modes."""

from __future__ import annotations

from .beam import Beam
from .modal import MAX_MODES

__all__ = ["MAX_MODES", "Beam"]
