"""Loop-closing joints of imported files, since URDF describes trees only: pairs of bodies, or a TOML file of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbfmu.mechanics.axes import ORIGIN, along, unit_axis
from mbfmu.mechanics.checks import Matrix, vector
from mbfmu.util.errors import UserError, suggest
from mbfmu.util.toml import read_toml

Point = tuple[float, ...]
Closure = Sequence[str]  # names of two bodies of a file, and a key of CLOSURES; or the name of a TOML file
Closures = Sequence[Closure] | Path | str
CLOSURES: dict[str, Literal["SphericalCutJoint", "RevoluteCutJoint", "WeldCutJoint"]] = {
    "spherical": "SphericalCutJoint",
    "revolute": "RevoluteCutJoint",
    "weld": "WeldCutJoint",
}
TABLE_NAME = "close"  # of a TOML file
DEFAULT_AXIS = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class LoopClosure:
    """Loop-closing joint between two bodies of a file.

    Attributes
    ----------
    a, b
        Names of the bodies in the file.
    joint
        Kind, a key of CLOSURES.
    at_a, at_b
        Points (3,) in the frames of the bodies, m.
    axis_a, axis_b
        Axes (3,) of a revolute joint in the frames of the bodies.
    """

    a: str
    b: str
    joint: str = "spherical"
    at_a: Point = ORIGIN
    at_b: Point = ORIGIN
    axis_a: Point = DEFAULT_AXIS
    axis_b: Point = DEFAULT_AXIS

    def rotations(self) -> tuple[Matrix, Matrix]:
        """Return the axes (3, 3) of the frames of the joint in the bodies."""
        if self.joint != "revolute" or (self.axis_a, self.axis_b) == (DEFAULT_AXIS, DEFAULT_AXIS):
            return np.eye(3), np.eye(3)
        return along(unit_axis(self.axis_a, "axis_a")), along(unit_axis(self.axis_b, "axis_b"))


def closures_of(given: Closures) -> list[LoopClosure]:
    """Return loop-closing joints from pairs of names, or from TOML files.

    Raises
    ------
    UserError
        A file cannot be read, or a value is not allowed.
    """
    if isinstance(given, str | Path):
        return _read(Path(given))
    found = []
    for words in given:
        what = f"closing joint {' '.join(map(str, words))!r}"
        if len(words) == 1 and str(words[0]).endswith(".toml"):
            found += _read(Path(words[0]))
            continue
        if len(words) not in (2, 3):
            raise UserError(f"{what}; allowed: two bodies, and the kind: {', '.join(CLOSURES)}; or a TOML file")
        a, b, kind = (*words, "spherical")[:3]
        found.append(_checked(what, LoopClosure(a, b, kind)))
    return found


def _read(path: Path) -> list[LoopClosure]:
    """Return the loop-closing joints of a TOML file."""
    content, names = read_toml(path, "file of loops"), [field.name for field in fields(LoopClosure)]
    what = f"file of loops {str(path)!r}"
    tables = content.get(TABLE_NAME)
    if (
        set(content) != {TABLE_NAME}
        or not isinstance(tables, list)
        or not all(isinstance(table, dict) for table in tables)
    ):
        raise UserError(f"{what} contains {sorted(content)}; allowed: tables [[{TABLE_NAME}]] with {', '.join(names)}")
    found = []
    for number, table in enumerate(tables, 1):
        place = f"{what}: [[{TABLE_NAME}]] number {number}"
        for key in table:
            if key not in names:
                raise UserError(f"{place} has the key {key!r}{suggest(key, names)}")
        for key in ("a", "b"):
            if not isinstance(table.get(key), str):
                raise UserError(f"{place} has {key} = {table.get(key)!r}; allowed: the name of a body")
        found.append(_checked(place, LoopClosure(**table)))
    return found


def _checked(what: str, closure: LoopClosure) -> LoopClosure:
    """Return a loop-closing joint whose values are allowed."""
    if closure.joint not in CLOSURES:
        raise UserError(f"{what}: kind {closure.joint!r}{suggest(str(closure.joint), CLOSURES)}")
    if closure.a == closure.b:
        raise UserError(f"{what} connects a body to itself; it needs two bodies")
    numbers: dict[str, Any] = {}
    for key in ("at_a", "at_b", "axis_a", "axis_b"):
        numbers[key] = tuple(map(float, vector(f"{what}: {key}", getattr(closure, key))))
    has_axes = (numbers["axis_a"], numbers["axis_b"]) != (DEFAULT_AXIS, DEFAULT_AXIS)
    if has_axes and closure.joint != "revolute":
        raise UserError(f"{what} has axes and is {closure.joint}; allowed: axes of a revolute joint")
    for key in ("axis_a", "axis_b"):
        unit_axis(numbers[key], f"{what}: {key}")
    return LoopClosure(closure.a, closure.b, closure.joint, **numbers)
