"""Rigid surfaces that a sheet touches: one file a kind."""

from __future__ import annotations

from .base import Surface
from .drum import Drum
from .guide import Guide
from .trough import Trough
from .wall import Wall

__all__ = ["Drum", "Guide", "Surface", "Trough", "Wall"]
