"""Thin shell: a quadrilateral between four bodies that resists bending and stretching in its plane alike."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.checks import rotation
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import array_of, not_negative
from mbfmu.util.errors import UserError

from .base import PlaneElement
from .corners import shell_edge_angle, shell_misplacement
from .extrapolation import extrapolate_shells
from .shell_energy import SHELL_SCRATCH, ShellRecord, apply, potential
from .shell_stiffness import Matrix, assumed_strains, bending, curvature, drilling, flat_axes, membrane, stresses
from .shell_tangent import tangent
from .stress_recovery import Recovered, recover

MIN_CORNER_SINE = 1e-3  # sine of the least angle at a corner
MAX_CORNER_ANGLE = np.radians(
    45.0
)  # between the normal at a corner and that of its body: a shell element is nearly flat


@dataclass(frozen=True, kw_only=True)
class Shell(PlaneElement):
    """Element of a thin shell, flat or nearly flat; the bodies at its corners are given to the builder, with six free
    coordinates each.

    Parameters
    ----------
    corners
        Unstrained positions of the bodies (4, 3), m, in any axes; clockwise about its normal, like those of a plate.
    attitudes
        Unstrained axes of the bodies (4, 3, 3), columns, in the same axes; None: parallel to them.
    stretching, bending
        Stiffness matrices (3, 3), N/m and N m, symmetric: forces per length by strains (e_xx, e_zz, gamma), and moments
        per length by curvatures (k_xx, k_zz, 2 k_xz). x is along the mean of the first and the third edge.
    damping
        Damping time beta of the material, stress = K (e + beta e'), s; zero: none.
    drag
        Density of the air times drag coefficient, kg/m^3; zero: none.
    """

    record = ShellRecord
    apply = apply
    potential = potential
    tangent = tangent
    extrapolate = extrapolate_shells
    misplacement = shell_misplacement
    edge_angle = shell_edge_angle
    stiffness_reason = "shell elements vibrate in their plane hundreds of times faster than in bending"

    corners: Any
    stretching: Any
    bending: Any
    attitudes: Any = None
    damping: float = 0.0
    drag: float = 0.0

    def check(self, what: str = "a shell element") -> None:
        """Raise UserError for invalid data; ``what`` names the shell."""
        X = _matrix(f"corners of {what}", self.corners, (4, 3))
        if self.attitudes is not None:
            for axes in _matrix(f"attitudes of {what}", self.attitudes, (4, 3, 3)):
                rotation(f"attitudes of {what}", axes)
        normals = self._axes[:, :, 1]
        after, before = np.roll(X, -1, 0) - X, np.roll(X, 1, 0) - X
        sides = np.linalg.norm(after, axis=1) * np.linalg.norm(before, axis=1)
        spanned = np.cross(before, after)
        if not np.all(np.sum(spanned * normals, 1) > MIN_CORNER_SINE * sides):
            raise UserError(
                f"corners of {what} are {X.tolist()}; allowed: a convex quadrilateral whose normals are the y axes of "
                "its bodies: from the first corner along x, then along z"
            )
        up = np.sum(spanned * normals, 1) / np.linalg.norm(spanned, axis=1)
        if up.min() < np.cos(MAX_CORNER_ANGLE):
            raise UserError(
                f"corners of {what} are {X.tolist()}, so far off one plane that at one its normal leans by "
                f"{np.degrees(np.arccos(up.min())):.0f} degrees from the y axis of its body; allowed: at most "
                f"{np.degrees(MAX_CORNER_ANGLE):.0f}; refine the mesh"
            )
        for key in ("stretching", "bending"):
            K = _matrix(f"{key} of {what}", getattr(self, key), (3, 3))
            if not np.allclose(K, K.T, rtol=1e-9) or np.linalg.eigvalsh(K).min() <= 0.0:
                raise UserError(f"{key} of {what} is {K.tolist()}; allowed: symmetric and positive definite")
        for key in ("damping", "drag"):
            not_negative(f"{key} of {what}", getattr(self, key))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write corners, attitudes and stiffness; see :mod:`.shell_stiffness`."""
        record["node"], record["scratch"], record["X"] = site.bodies, site.scratch(SHELL_SCRATCH), self._flat[1]
        record["B"] = [(self._flat[0] @ axes).T for axes in self._axes]
        record["plane"], record["bent"] = self._stiffness
        record["damped"], record["damping"] = self.damping > 0.0, self.damping

    def recover(self, x: float, z: float) -> dict[str, Recovered]:
        """Return curvature, moment, strain and force at a point, by displacements and rotations (4, 6) of the corners,
        in element axes.

        x and z are parts of the cell, from 0 at the first corner to 1 along the first and the last edge. See
        :func:`.stress_recovery.recover`.
        """
        (E, natural), A = self._flat, np.asarray(self.stretching, float)
        X, xi, eta = natural[:, [0, 2]], 2.0 * x - 1.0, 2.0 * z - 1.0
        stretched, bent, drawn = np.zeros((3, 4, 6)), np.zeros((3, 4, 6)), np.zeros((4, 6))
        stretched[:, :, 0::2] = np.linalg.solve(A, assumed_strains(X, xi, eta) @ stresses(X, A)[0]).reshape(3, 4, 3)
        bent[:, :, 1::2] = curvature(X, xi, eta).reshape(3, 4, 3)
        drawn[:, 1] = natural[:, 1]  # how it is drawn: its corners lifted from the plane, and its normals leaning
        along, up, across = E @ self._axes[:, :, 1].T
        lean = np.arctan2(np.hypot(along, across), up) / np.maximum(np.hypot(along, across), 1e-300)
        drawn[:, 3], drawn[:, 5] = lean * across, -lean * along
        shape = np.tensordot(bent, drawn, 2)
        return recover(stretched, bent, A, np.asarray(self.bending, float), drawn=shape, natural=shape)

    @property
    def natural(self) -> tuple[Matrix, Matrix]:
        """Unstrained positions of its bodies (4, 3), m, and their axes (4, 3, 3), columns."""
        return np.asarray(self.corners, float), self._axes

    @property
    def _axes(self) -> Matrix:
        """Those of the bodies (4, 3, 3), in the axes that the corners are given in."""
        given = np.eye(3) if self.attitudes is None else np.asarray(self.attitudes, float)
        return np.broadcast_to(given, (4, 3, 3))

    @cached_property
    def _flat(self) -> tuple[Matrix, Matrix]:
        return flat_axes(self.corners)

    @cached_property
    def _stiffness(self) -> tuple[Matrix, Matrix]:
        """In the plane and out of it; cells of one sheet are one object."""
        X, A, D = self._flat[1][:, [0, 2]], np.asarray(self.stretching, float), np.asarray(self.bending, float)
        return membrane(X, A, drilling(self.corners, self._axes[:, :, 1], A, D)), bending(X, D)

    @property
    def area(self) -> float:
        """Area, m^2."""
        X = self._flat[1]
        p, q = X[2] - X[0], X[3] - X[1]
        return 0.5 * float(p[0] * q[2] - p[2] * q[0])


def _matrix(what: str, value: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return finite numbers of a shape."""
    found = array_of(what, value)
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise UserError(f"{what} is {value!r}; allowed: {' x '.join(map(str, shape))} finite numbers")
    return found
