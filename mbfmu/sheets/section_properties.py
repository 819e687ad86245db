"""What a sheet is of, cell by cell: thickness, curl and creases may differ from place to place.

A crease is a line across which the sheet bends like a hinge with a spring: a moment M per length along the line turns
it by M / k. A cell takes a part of this angle, spread over its width a, in series with the sheet there: the compliance
of its bending across the line grows by part / (k a). The parts are those of a linear interpolation between the middles
of cells: all of a line in the middle of a cell, half of one on nodes. So the angle results from the moment at the line,
and the error is proportional to the square of the cell size. A line within half a cell of an edge acts in the middle
of the last one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from mbfmu.mechanics.checks import one_of
from mbfmu.mechanics.numbers import array_of, finite, positive
from mbfmu.sheets.elements import Plate, Shell
from mbfmu.util.errors import UserError

from .grid import Node

CREASE_AXES = ("x", "z")
MAX_CELL_ANGLE = 1.0  # rad; a cell that is bent more by its curl is no small part of the sheet
Thickness = float | Callable[[float, float], float]
Curl = Sequence[float] | Callable[[float, float], Sequence[float]]


@dataclass(frozen=True)
class Crease:
    """Straight crease across a sheet, from edge to edge, with reduced bending stiffness.

    Parameters
    ----------
    axis
        ``x`` for the line x = ``at``, or ``z`` for the line z = ``at``.
    at
        Position of the line, m.
    stiffness
        Rotational stiffness of the crease: moment per length along the line, N m/m per rad.
    """

    axis: str
    at: float
    stiffness: float


@dataclass(frozen=True, eq=False)
class SheetProperties:
    """The cells of a sheet.

    Parameters
    ----------
    what
        Whose they are, for messages.
    plate
        Properties that are equal everywhere; thickness, curl and creases are given here.
    shape
        Nodes along x and z.
    thickness
        m, or a function of x and z.
    curl
        Natural curvatures (w,xx, w,zz) or (w,xx, w,zz, w,xz), 1/m, or a function of x and z that returns them.
    creases
        The lines.
    """

    what: str
    plate: Plate
    shape: tuple[int, int]
    thickness: Thickness
    curl: Curl
    creases: Sequence[Crease]

    def check(self) -> None:
        """Raise UserError for what no sheet is."""
        if not isinstance(self.creases, Sequence):
            raise UserError(f"creases of {self.what} are {self.creases!r}; allowed: a list of them")
        for crease in self.creases:
            if not isinstance(crease, Crease):
                raise UserError(f"crease of {self.what} is {crease!r}; it must be a Crease")
            one_of(f"axis of a crease of {self.what}", crease.axis, CREASE_AXES)
            role = f"of the crease across {crease.axis} of {self.what}"
            positive(f"stiffness {role}", crease.stiffness)
            n = CREASE_AXES.index(crease.axis)
            side = (self.shape[n] - 1) * (self.plate.a, self.plate.b)[n]
            if not 0.0 < finite(f"place {role}", crease.at) < side:
                raise UserError(f"place {role} is {crease.at!r} m; allowed: within the sheet, between 0 and {side:g} m")

    @cached_property
    def middle(self) -> Plate:
        """What the sheet is of in its middle, without creases."""
        (nx, nz), p = self.shape, self.plate
        return self._plain(0.5 * (nx - 1) * p.a, 0.5 * (nz - 1) * p.b)

    def at(self, cell: Node) -> Plate:
        """Return the plate properties of cell (i, k); by default those of the sheet."""
        (i, k), p = cell, self.plate
        varies = callable(self.thickness) or callable(self.curl)
        plain = self._plain((i + 0.5) * p.a, (k + 0.5) * p.b) if varies else self.middle
        creases = self._angles(0, i), self._angles(1, k)
        return replace(plain, creases=creases) if any(creases) else plain

    def thickness_at(self, x: float, z: float) -> float:
        """Return the thickness there, m."""
        if not callable(self.thickness):
            return positive(f"thickness of {self.what}", self.thickness)
        role = f"thickness of {self.what} at x = {x:g} m, z = {z:g} m"
        return positive(role, _function_value(role, self.thickness, x, z))

    def _plain(self, x: float, z: float) -> Plate:
        """Return what the sheet is of there, without creases."""
        return replace(self.plate, thickness=self.thickness_at(x, z), curl=self._curl_at(x, z))

    def _curl_at(self, x: float, z: float) -> tuple[float, float, float]:
        """Return the natural curvatures there, 1/m."""
        role = f"curl of {self.what}" + (f" at x = {x:g} m, z = {z:g} m" if callable(self.curl) else "")
        value = _function_value(role, self.curl, x, z) if callable(self.curl) else self.curl
        k = array_of(role, value)
        if k.shape not in ((2,), (3,)) or not np.all(np.isfinite(k)):
            raise UserError(f"{role} is {value!r}; allowed: two or three finite curvatures, 1/m")
        kx, kz, kxz = float(k[0]), float(k[1]), float(k[2]) if len(k) == 3 else 0.0
        a, b = self.plate.a, self.plate.b
        bent = max(abs(kx) * a, abs(kz) * b, abs(kxz) * max(a, b))
        if bent > MAX_CELL_ANGLE:
            raise UserError(
                f"{role} is {value!r} 1/m, which bends its cells by {bent:.3g} rad; allowed: {MAX_CELL_ANGLE:g} at "
                "most; refine the grid"
            )
        return kx, kz, kxz

    def _angles(self, axis: int, n: int) -> float:
        """Return by how much the creases across an axis turn in column n of cells, rad per moment, rad/N."""
        side, count, total = (self.plate.a, self.plate.b)[axis], self.shape[axis] - 1, 0.0
        for crease in self.creases:
            if crease.axis == CREASE_AXES[axis]:
                place = min(max(crease.at / side - 0.5, 0.0), count - 1.0)  # in columns, from the middle of the first
                total += max(0.0, 1.0 - abs(place - n)) / crease.stiffness
        return total


def _function_value(role: str, function: Callable[[float, float], Any], x: float, z: float) -> Any:
    """Return the value of a user's function at a place, m."""
    try:
        return function(x, z)
    except Exception as error:
        raise UserError(
            f"{role} fails with {type(error).__name__}: {error}; allowed: a function of x and z, m"
        ) from error


def shell_of(plate: Plate) -> Shell:
    """Return a plate that is free in its plane: a shell, whose natural shape is that of its curl.

    Its corners stay as far from each other in the plane as those of the flat cell, and are lifted by the twist alone;
    its attitudes lean by the slopes of w = (kx x^2 + kz z^2) / 2 + kxz x z. The bending element then has exactly the
    curvatures less the natural ones, as it must for the patch test, and the membrane does not see them: corners drawn
    onto the arc would press the flat sheet together by (k a)^2 / 24, which is as much energy as it takes to bend it.
    """
    a, b, (kx, kz, kxz) = plate.a, plate.b, plate.curl
    corners, attitudes = np.array([(0.0, 0.0, 0.0), (a, 0.0, 0.0), (a, 0.0, b), (0.0, 0.0, b)]), None
    if any(plate.curl):
        x, z = corners[:, 0] - 0.5 * a, corners[:, 2] - 0.5 * b
        corners[:, 1] = kxz * x * z
        turns = np.column_stack((-kz * z - kxz * x, 0.0 * x, kx * x + kxz * z))  # (-w,z, 0, w,x)
        attitudes = scipy.spatial.transform.Rotation.from_rotvec(turns).as_matrix()
    return Shell(
        corners=corners,
        attitudes=attitudes,
        stretching=plate.stretching,
        bending=plate.bending,
        damping=plate.damping,
        drag=plate.drag,
    )
