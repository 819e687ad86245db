"""The swing pendulum of Choi, Park and Yoo: a sprung slider on the tip of a crank at constant speed."""

from .model import SwingPendulum

__all__ = ["SwingPendulum"]
