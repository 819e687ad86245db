"""Robot and machine descriptions in other formats: URDF and MJCF."""

from __future__ import annotations

from .exported import write_mjcf, write_urdf
from .imported import load, source_code

__all__ = ["load", "source_code", "write_mjcf", "write_urdf"]
