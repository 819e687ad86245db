"""Pictures of a motion in space: an interactive page, still pictures and films."""

from .motion import Motion, Recorder

__all__ = ["Motion", "Recorder"]
