"""Geometric stiffness of a reduced body, by the stresses of unit loads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError

from .fe_model import WRITTEN_DIGITS
from .reduction import Reduced

Array = NDArray[np.float64]


class Stiffening:
    """Geometric stiffness in modes by the stresses of unit loads."""

    def __init__(self, function: Callable[[Array], Any], reduced: Reduced) -> None:
        self._function, self._U, self._statics = function, reduced.shapes, reduced.statics
        if not callable(function):
            raise UserError(
                f"geometric_stiffness is a {type(function).__name__}; allowed: a function of static displacements"
            )
        assert self._statics is not None
        u = self._statics.by_loads(np.ones(len(self._U)))
        once, twice = self._reduced(u), self._reduced(2.0 * u)
        if np.abs(twice - 2.0 * once).max() > WRITTEN_DIGITS * np.abs(twice).max():
            raise UserError(
                "geometric_stiffness is not linear in the displacements; allowed: a linear function of them"
            )

    def by_loads(self, load: Array) -> Array:
        """Return K[F] (modes, modes) of loads (dof n,) on the nodes."""
        assert self._statics is not None
        return self._reduced(self._statics.by_loads(load))

    def by_wrench(self, interface: int, component: int) -> Array:
        """Return K[F] (modes, modes) of a unit force or moment on an interface."""
        assert self._statics is not None
        return self._reduced(self._statics.by_wrench(interface, component))

    def _reduced(self, u: Array) -> Array:
        matrix = self._function(u)
        if getattr(matrix, "shape", None) != (len(u), len(u)):
            raise UserError(
                f"geometric_stiffness returns {getattr(matrix, 'shape', matrix)!r}; allowed: a matrix of {len(u)} rows "
                "and columns, dense or sparse"
            )
        found: Array = self._U.T @ (matrix @ self._U)
        if not np.all(np.isfinite(found)):
            raise UserError("geometric_stiffness returns numbers that are not finite")
        if np.abs(found - found.T).max() > WRITTEN_DIGITS * np.abs(found).max():
            raise UserError("geometric_stiffness returns a matrix that is not symmetric; allowed: a symmetric one")
        return 0.5 * (found + found.T)
