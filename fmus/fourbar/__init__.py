"""The rigid four-bar of Kim and Kim: two cranks and a coupler that swing through singular configurations."""

from .model import FourBar

__all__ = ["FourBar"]
