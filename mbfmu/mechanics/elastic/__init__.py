"""Elastic elements between bodies, and what acts on their surface: one file a kind."""

from __future__ import annotations

from .plate import Plate

__all__ = ["Plate"]
