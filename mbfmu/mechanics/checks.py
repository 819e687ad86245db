"""Checks of what a user writes: what comes back is fit for the arrays, what is not is named in a UserError."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.util.errors import UserError

from .numbers import array_of, is_finite, is_whole
from .signals import Function, Polynomial, Signal

Matrix = NDArray[np.float64]
Vector = Sequence[float] | Matrix


def is_time_law(value: Any) -> bool:
    """Whether a value is a signal, or a function or an expression of time."""
    return isinstance(value, Signal | str) or callable(value)


def signal_of(value: Any, what: str, *, drive: bool = False) -> Signal:
    """Return a signal from a number, a signal, an input, or a function or expression of time; one that is to drive
    needs its derivatives.
    """
    if isinstance(value, Function) and drive:
        return replace(value, differentiate=True)
    if isinstance(value, Signal):
        return value
    if is_time_law(value):
        return Function(value, differentiate=drive, what=what)
    if np.ndim(value) or not is_finite(value):
        raise UserError(f"{what} is {value!r}; it must be a finite number, a signal, an input or a function of time")
    return Polynomial((float(value),))


def vector(what: str, value: Vector) -> Matrix:
    """Check three finite numbers."""
    array = array_of(what, value)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise UserError(f"{what} is {value!r}; it needs three finite numbers")
    return array


def rotation(what: str, value: Any) -> Matrix:
    """Check a 3x3 rotation matrix or a ``scipy.spatial.transform.Rotation``; None is the identity."""
    if value is None:
        return np.eye(3)
    R = array_of(what, value.as_matrix() if hasattr(value, "as_matrix") else value)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0.0:
        raise UserError(f"{what} is {value!r}; allowed: a 3x3 rotation matrix or one scipy.spatial.transform.Rotation")
    return R


def lengths(what: str, value: Vector) -> Matrix:
    """Check three lengths (m) that are greater than zero."""
    array = array_of(what, value)
    if array.shape != (3,) or not np.all(np.isfinite(array)) or np.any(array <= 0.0):
        raise UserError(f"{what} is {value!r} m; it needs three lengths, finite and greater than zero")
    return array


def whole(what: str, value: Any) -> int:
    """Check a whole number."""
    if not is_whole(value):
        raise UserError(f"{what} are {value!r}; allowed: whole numbers")
    return int(value)


def inertia_matrix(body: str, value: Any) -> Matrix:
    """Check an inertia: symmetric, no negative principal value, triangle inequality."""
    array = array_of(f"inertia of body {body!r}", value)
    J = np.diag(array) if array.shape == (3,) else array
    what = f"inertia of body {body!r} is {value!r}"
    rounding = 1e-9 * float(np.abs(J).max(initial=0.0))
    if J.shape != (3, 3) or not np.all(np.isfinite(J)) or np.abs(J - J.T).max() > rounding:
        raise UserError(f"{what}; it needs three principal values or a symmetric 3x3 matrix, kg m^2")
    p = np.linalg.eigvalsh(J)
    if p[0] < -rounding or p[2] > p[0] + p[1] + rounding:
        raise UserError(f"{what}; principal values must not be negative, and none may exceed the sum of the others")
    return J


def with_unit_quaternion(body: str, start: Matrix) -> Matrix:
    """Check positions that end with a quaternion; return them without the rounding of its length."""
    e = start[-4:]
    length = float(np.linalg.norm(e))
    if abs(length - 1.0) > 1e-6:
        raise UserError(
            f"start of body {body!r} has the quaternion {e.tolist()} of length {length:.6g}; its length must be 1"
        )
    return np.concatenate((start[:-4], e / length))


def one_of(what: str, value: Any, allowed: Collection[str]) -> None:
    """Refuse a word that is not among those allowed."""
    if not isinstance(value, str) or value not in allowed:
        raise UserError(f"{what} is {value!r}; allowed: {', '.join(map(repr, allowed))}")


def flag(what: str, value: Any) -> bool:
    """Check a truth value: a text or a number that Python takes for true may have been meant as anything."""
    if not isinstance(value, bool | np.bool_):
        raise UserError(f"{what} is {value!r}; allowed: True, False")
    return bool(value)
