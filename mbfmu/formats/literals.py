"""Calls, numbers, vectors and rotations as Python code: short, and equal to the given values up to rounding."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from .description import Matrix, Vector

DIGITS = 15  # of numbers
INERTIA_DIGITS = 14  # relative to the largest entry: MuJoCo computes inertias from principal axes, with rounding errors
MAX_LINE_LENGTH = 120  # of statements
ROTATION_ERROR = 4e-16  # largest difference of a rotation matrix from its angles


def number_text(value: float, size: float = 0.0, digits: int = DIGITS) -> str:
    """Return a number as code, rounded to the given number of digits of ``size``."""
    if size:
        value = round(value, max(0, digits - 1 - int(np.floor(np.log10(size)))))
    rounded = float(f"{value:.{DIGITS}g}")
    whole = rounded == int(rounded) if abs(rounded) < 1e9 else False
    return str(int(rounded)) if whole else repr(rounded)


def real_text(value: float) -> str:
    """Return a number as code of a float."""
    return repr(float(f"{value:.{DIGITS}g}") + 0.0)


def vector_text(values: Iterable[float]) -> str:
    """Return a vector as a tuple."""
    entries = np.fromiter(values, float)
    size = float(np.abs(entries).max(initial=0.0))
    return f"({', '.join(number_text(entry, size) for entry in entries)})"


def axis_text(values: Vector) -> str:
    """Return a unit vector as the name of an axis if it is one."""
    for letter, unit in zip("xyz", np.eye(3), strict=True):
        if np.array_equal(values, unit):
            return f'"{letter}"'
    return vector_text(values)


def inertia_text(values: Matrix) -> str:
    """Return an inertia as its diagonal if it is diagonal, else as a matrix."""
    size = float(np.abs(values).max(initial=0.0))
    rows = [[number_text(entry, size, INERTIA_DIGITS) for entry in row] for row in values]
    if all(rows[i][j] == "0" for i in range(3) for j in range(3) if i != j):
        return "(" + ", ".join(rows[i][i] for i in range(3)) + ")"
    return "[" + ", ".join(f"[{', '.join(row)}]" for row in rows) + "]"


def rotation_text(values: Matrix) -> str:
    """Return a rotation as SciPy's ``Rotation``: by angles about fixed axes if they are short, else by a quaternion.

    Empty for the identity.
    """
    from scipy.spatial.transform import Rotation

    if np.abs(values - np.eye(3)).max() < ROTATION_ERROR:
        return ""
    turned = Rotation.from_matrix(values)
    angles = turned.as_euler("xyz", suppress_warnings=True)
    for in_degrees, digits in ((True, 8), (False, 10)):
        short = np.round(np.degrees(angles) if in_degrees else angles, digits) + 0.0
        same = Rotation.from_euler("xyz", short, degrees=in_degrees).as_matrix()
        if np.abs(same - values).max() < ROTATION_ERROR:
            used = "".join(letter for letter, angle in zip("xyz", short, strict=True) if angle)
            kept = [number_text(angle) for angle in short if angle]
            given = kept[0] if len(kept) == 1 else f"({', '.join(kept)})"
            return f'Rotation.from_euler("{used}", {given}{", degrees=True" if in_degrees else ""})'
    quaternion = turned.as_quat(canonical=True, scalar_first=True)
    return f"Rotation.from_quat({vector_text(quaternion)}, scalar_first=True)"


def call(head: str, arguments: Sequence[str], indent: int = 8) -> list[str]:
    """Return the lines of a call: one if it is short."""
    line = f"{' ' * indent}{head}({', '.join(arguments)})"
    if len(line) <= MAX_LINE_LENGTH:
        return [line]
    inner = " " * (indent + 4)
    return [f"{' ' * indent}{head}(", *(f"{inner}{argument}," for argument in arguments), f"{' ' * indent})"]
