"""Sensors of sheets: where they are, what their elements feel, and their contacts: one file a family."""

from __future__ import annotations

from .contacts import ContactForceSum, ContactSum
from .plates import InPlate, InShell
from .positions import Covered, Jammed, SheetPosition, Skew

__all__ = [
    "ContactForceSum",
    "ContactSum",
    "Covered",
    "InPlate",
    "InShell",
    "Jammed",
    "SheetPosition",
    "Skew",
]
