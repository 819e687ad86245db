"""Tree joints: one file a kind."""

from __future__ import annotations

from .base import Joint
from .cylindrical import Cylindrical
from .floating import Floating
from .geodesic import Geodesic
from .out_of_plane import OutOfPlane
from .planar import Planar
from .revolute import Revolute
from .screw import Screw
from .section import Section
from .spherical import Spherical
from .stretching import Stretching
from .translational import Translational
from .universal import Universal
from .weld import Weld

__all__ = [
    "Cylindrical",
    "Floating",
    "Geodesic",
    "Joint",
    "OutOfPlane",
    "Planar",
    "Revolute",
    "Screw",
    "Section",
    "Spherical",
    "Stretching",
    "Translational",
    "Universal",
    "Weld",
]
