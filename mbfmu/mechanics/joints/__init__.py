"""Tree joints: one file a kind."""

from __future__ import annotations

from .base import Joint
from .floating import Floating
from .geodesic import Geodesic
from .out_of_plane import OutOfPlane
from .revolute import Revolute
from .section import Section
from .spherical import Spherical
from .translational import Translational
from .weld import Weld

__all__ = [
    "Floating",
    "Geodesic",
    "Joint",
    "OutOfPlane",
    "Revolute",
    "Section",
    "Spherical",
    "Translational",
    "Weld",
]
