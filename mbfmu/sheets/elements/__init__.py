"""Plate and shell elements: one file a kind, one more for its energy, its tangent and what it is made of."""

from __future__ import annotations

from .plate import Plate
from .shell import Shell

__all__ = ["Plate", "Shell"]
