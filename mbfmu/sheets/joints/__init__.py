"""Joints between the nodes of a sheet: one file a kind."""

from __future__ import annotations

from .geodesic import Geodesic
from .out_of_plane import OutOfPlane
from .stretching import Stretching

__all__ = ["Geodesic", "OutOfPlane", "Stretching"]
