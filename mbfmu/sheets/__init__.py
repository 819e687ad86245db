"""Flexible sheets of paper, film or metal: elements, meshes, supports, contact and transport."""

from mbfmu.util.errors import missing_attribute

from .contact.surfaces import Drum, Guide, Surface, Trough, Wall
from .contact_handles import NipHandle, SurfaceContactHandle, contact_pressure, jammed
from .elements import Plate, Shell
from .joints import Geodesic, OutOfPlane, Stretching
from .section_properties import Crease
from .sheet import add_sheet
from .sheet_handle import Sheet
from .supports import Support
from .transport import add_contact, add_nip

__all__ = [
    "Crease",
    "Drum",
    "Geodesic",
    "Guide",
    "NipHandle",
    "OutOfPlane",
    "Plate",
    "Sheet",
    "Shell",
    "Stretching",
    "Support",
    "Surface",
    "SurfaceContactHandle",
    "Trough",
    "Wall",
    "add_contact",
    "add_nip",
    "add_sheet",
    "contact_pressure",
    "jammed",
]


def __getattr__(name: str) -> object:
    raise missing_attribute("mbfmu.sheets", name)
