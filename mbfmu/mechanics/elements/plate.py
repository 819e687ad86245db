"""Thin plate: a rectangle between four bodies that resists bending and, where asked for, stretching in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbfmu.errors import UserError
from mbfmu.mechanics.kind import Site
from mbfmu.mechanics.loads.base import Load
from mbfmu.mechanics.numbers import not_negative, positive

from .feeling import components
from .plate_curvature import Matrix, curvature
from .plate_energy import PLATE, apply, potential
from .plate_tangent import tangent
from .shell_stiffness import plane_stress


@dataclass(frozen=True, kw_only=True)
class Plate(Load):
    """A rectangular element of a thin plate; the builder is given the bodies at its corners.

    Parameters
    ----------
    a, b
        Sides along x and z of the bodies' frames in the flat plate, m.
    thickness
        m.
    youngs_modulus, poisson
        Pa and 1.
    membrane
        Resist stretching in the plane. A string picks strains: any of ``x``, ``z`` and ``s`` (shear); a single normal
        strain has the stiffness of a plate whose edges across are free.
    damping
        Time beta of the material damping, stress = K (e + beta e'), s; zero: none.
    drag
        Density of the air times drag coefficient, kg/m^3; zero: none.
    """

    record = PLATE
    apply = apply
    potential = potential
    tangent = tangent

    a: float
    b: float
    thickness: float
    youngs_modulus: float
    poisson: float = 0.3
    membrane: bool | str = False
    damping: float = 0.0
    drag: float = 0.0

    def check(self, what: str = "a plate") -> None:
        """Raise UserError for a number that no plate has; ``what`` says whose it is."""
        for key in ("a", "b", "thickness", "youngs_modulus"):
            positive(f"{key} of {what}", getattr(self, key))
        if not -1.0 < self.poisson <= 0.5:
            raise UserError(f"poisson of {what} is {self.poisson!r}; allowed: above -1, at most 0.5")
        for key in ("damping", "drag"):
            not_negative(f"{key} of {what}", getattr(self, key))
        if not set(self.strains) <= set("xzs"):
            raise UserError(f"membrane of {what} is {self.membrane!r}; allowed: True, False or letters of 'xzs'")

    @property
    def area(self) -> float:
        """Area, m^2."""
        return self.a * self.b

    @property
    def strains(self) -> str:
        """The membrane strains that the element resists."""
        return self.membrane if isinstance(self.membrane, str) else "xzs" * self.membrane

    def fill(self, record: Any, site: Site) -> None:
        """Write corners, sizes and stiffness; see :mod:`.plate_energy` for the formulae."""
        a, b, nu, Et = self.a, self.b, self.poisson, self.youngs_modulus * self.thickness
        D, slim = Et * self.thickness**2 / (12.0 * (1.0 - nu**2)), a / b
        record["node"], record["a"], record["b"] = site.bodies, a, b
        record["bending"] = [
            4.0 * D / slim,
            4.0 * D * slim,
            12.0 * D / slim,
            D * (4.0 * slim + 8.0 * (1.0 - nu) / slim) / 3.0,
            12.0 * D * slim,
            D * (4.0 / slim + 8.0 * (1.0 - nu) * slim) / 3.0,
            D * (4.0 / slim + 1.6 * (1.0 - nu) * slim),
            D * (4.0 * slim + 1.6 * (1.0 - nu) / slim),
            32.0 * D * (1.0 - nu) / (a * b),
        ]
        record["coupling"] = 4.0 * nu * D
        x, z, s = (strain in self.strains for strain in "xzs")
        normal = Et * a * b / (1.0 - nu**2 * (x and z))
        record["stretching"] = (normal * x, normal * z, nu * normal * (x and z), 0.5 * Et * a * b / (1.0 + nu) * s)
        record["membrane"], record["damped"] = bool(self.strains), self.damping > 0.0
        record["damping"] = self.damping

    @property
    def stretching(self) -> Matrix:
        """(3, 3), N/m: of strains (E_xx, E_zz, gamma) the forces per length."""
        return plane_stress(self.youngs_modulus, self.poisson) * self.thickness

    @property
    def bending(self) -> Matrix:
        """(3, 3), N m: of curvatures (w,xx, w,zz, 2 w,xz) the moments per length."""
        return self.stretching * self.thickness**2 / 12.0

    def felt(self, x: float, z: float) -> dict[str, Matrix]:
        """Return what is felt at a point, by the generalized strains.

        Parameters
        ----------
        x, z
            Parts of a and b, from 0 to 1.

        Returns
        -------
        dict
            See :func:`.feeling.components`, each (3, 12); strains are means over the element, and there where it
            resists them all.
        """
        bent = np.zeros((3, 12))
        bent[:, :9] = curvature(self.a, self.b, x * self.a, z * self.b)
        stretched = np.eye(12)[9:] if set(self.strains) == set("xzs") else None
        return components(stretched, bent, self.stretching, self.bending)

    @property
    def works(self) -> bool:
        """Whether its material is damped."""
        return self.damping > 0.0
