"""In place of the structured tangent of a mechanism that has none, such as one with flexible bodies."""

from __future__ import annotations

from solvers.system import Array

from .factored import empty_tangent, tangent_callbacks


class MissingTangent:
    """Tangent for solvers that factor none: kernels get its callbacks and do not call them.

    Attributes
    ----------
    callbacks
        Those of the types that every tangent has.
    """

    symmetric = False
    factored = 0
    negative = 0

    def __init__(self) -> None:
        self.callbacks = tangent_callbacks(empty_tangent())

    def factor(
        self, c1: float, c2: float, weight: Array | None = None, symmetric: bool = False, averaged: bool = False
    ) -> bool:
        """Raise NotImplementedError."""
        raise NotImplementedError("this mechanism has no structured tangent")

    def solve(self, r: Array) -> Array:
        """Raise NotImplementedError."""
        raise NotImplementedError("this mechanism has no structured tangent")

    def inertia(self, a: Array) -> Array:
        """Raise NotImplementedError."""
        raise NotImplementedError("this mechanism has no structured tangent")
