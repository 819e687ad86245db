"""A sheet of paper through nips and guides."""

from .model import Feeder

__all__ = ["Feeder"]
