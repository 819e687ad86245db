"""Robot and machine descriptions in other formats: URDF and MJCF."""

from __future__ import annotations

from .imported import load, source_code

__all__ = ["load", "source_code"]
