"""The flexible sheet."""

from .model import Sheet

__all__ = ["Sheet"]
