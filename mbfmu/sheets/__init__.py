"""Flexible sheets of paper, film or metal: meshes, supports, contact and transport."""

from .contacts import NipHandle, SurfaceContactHandle, contact_pressure, jammed
from .section_properties import Crease
from .sheet import Sheet, add_sheet
from .supports import Support
from .transport import add_contact, add_nip

__all__ = [
    "Crease",
    "NipHandle",
    "Sheet",
    "Support",
    "SurfaceContactHandle",
    "add_contact",
    "add_nip",
    "add_sheet",
    "contact_pressure",
    "jammed",
]
