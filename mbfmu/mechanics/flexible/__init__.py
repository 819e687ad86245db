"""Bodies that deform by their modes."""

from __future__ import annotations

from .beam import Beam
from .body import FlexibleBody
from .interfaces import Interface
from .records import MODES

__all__ = ["MODES", "Beam", "FlexibleBody", "Interface"]
