"""Tree joints: one file a kind."""

from __future__ import annotations

from .base import Joint
from .cylindrical import Cylindrical
from .floating import Floating
from .planar import Planar
from .revolute import Revolute
from .screw import Screw
from .section import Section
from .spherical import Spherical
from .translational import Translational
from .universal import Universal
from .weld import Weld

__all__ = [
    "Cylindrical",
    "Floating",
    "Joint",
    "Planar",
    "Revolute",
    "Screw",
    "Section",
    "Spherical",
    "Translational",
    "Universal",
    "Weld",
]
