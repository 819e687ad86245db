"""The flyball governor of Haug: two arms, a collar and a spring on a spindle at constant speed."""

from .model import Governor

__all__ = ["Governor"]
