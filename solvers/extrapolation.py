"""Stresses that Newton's method extrapolates, see :mod:`solvers.statics.newton`."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Protocol


class StressExtrapolation(Protocol):
    """Elements of a tree that can have forces by strains linearized about an earlier position."""

    def extrapolate(self) -> None:
        """Store the strains of the position of the last inverse dynamics, plus their rates times one second.

        With a correction of the coordinates as the velocities of the inverse dynamics these are the strains that the
        correction leads to, linearized.
        """

    def imposed(self) -> AbstractContextManager[None]:
        """Return a context in which the inverse dynamics and the tangent have the forces by the stored strains."""
