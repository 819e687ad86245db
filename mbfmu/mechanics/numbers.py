"""Numbers as users write them, some of which are none."""

from __future__ import annotations

from math import isfinite
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError

MIN_LENGTH, MAX_LENGTH = 1e-50, 1e50  # m, of the lengths that can be reckoned with


def array_of(what: str, value: Any) -> NDArray[np.float64]:
    """Return numbers as an array; they need not be finite."""
    array = _numbers(value)
    if array is None:
        raise UserError(f"{what} is {value!r}; it needs numbers")
    return array


def ascending_times(value: Any) -> NDArray[np.float64]:
    """Check times, s: a row of finite numbers, each greater than the one before; there may be none."""
    times = array_of("times", value)
    if times.ndim != 1 or not np.isfinite(times).all() or np.any(np.diff(times) <= 0.0):
        raise UserError(f"times are {value!r}; allowed: finite numbers, each greater than the one before")
    return np.ascontiguousarray(times)


def is_finite(value: Any) -> bool:
    """Whether there are numbers, and every one is finite."""
    array = _numbers(value)
    return array is not None and bool(np.isfinite(array).all())


def finite(what: str, value: Any) -> float:
    """Check a finite number."""
    if isinstance(value, float) and isfinite(value):  # what comes at every communication point, from NumPy too
        return float(value)
    if np.ndim(value) or not is_finite(value):
        raise UserError(f"{what} is {value!r}; it must be a finite number")
    return float(value)


def is_whole(value: Any) -> TypeGuard[int]:
    """Whether it is a whole number; to Python a truth value is one."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def positive(what: str, value: Any) -> float:
    """Check a finite number that is greater than zero."""
    if np.ndim(value) or not is_finite(value) or value <= 0.0:
        raise UserError(f"{what} is {value!r}; allowed: finite and greater than zero")
    return float(value)


def not_negative(what: str, value: Any) -> float:
    """Check a finite number that is not negative."""
    if np.ndim(value) or not is_finite(value) or value < 0.0:
        raise UserError(f"{what} is {value!r}; allowed: finite and not negative")
    return float(value)


def _numbers(value: Any) -> NDArray[np.float64] | None:
    """Return numbers as an array, None where there is anything else; NumPy alone would read text and truth values."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return None
    return array.astype(float) if array.dtype.kind in "iuf" else None
