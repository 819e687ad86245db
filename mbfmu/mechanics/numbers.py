"""Numbers as users write them, some of which are none."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import UserError


def array_of(what: str, value: Any) -> NDArray[np.float64]:
    """Return numbers as an array; they need not be finite."""
    try:
        return np.asarray(value, float)
    except (TypeError, ValueError) as error:
        raise UserError(f"{what} is {value!r}; it needs numbers") from error


def is_finite(value: Any) -> bool:
    """Whether there are numbers, and every one is finite."""
    try:
        return bool(np.isfinite(np.asarray(value, float)).all())
    except (TypeError, ValueError):
        return False


def finite(what: str, value: Any) -> float:
    """Check a finite number."""
    if np.ndim(value) or not is_finite(value):
        raise UserError(f"{what} is {value!r}; it must be a finite number")
    return float(value)
