"""Thin plate: a rectangle between four bodies with stiffness in bending and, optionally, in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mbfmu.mechanics.checks import flag
from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.numbers import array_of, not_negative, positive
from mbfmu.util.errors import UserError

from .base import PlaneElement
from .corners import plate_edge_angle, plate_misplacement
from .extrapolation import extrapolate_plates
from .material import Matrix, PlaneStress, add_crease_compliance
from .plate_curvature import curvature
from .plate_energy import PLATE_SCRATCH, PlateRecord, apply, potential
from .plate_tangent import tangent
from .stress_recovery import Recovered, recover


@dataclass(frozen=True, kw_only=True)
class Plate(PlaneElement):
    """Rectangular element of a thin plate; the bodies at its corners are given to the builder.

    Parameters
    ----------
    a, b
        Sides along x and z of the bodies' frames in the flat plate, m.
    thickness
        Thickness, m.
    youngs_modulus, poisson, shear_modulus, angle
        Elastic moduli, Pa, Poisson's ratio and angle of the grain, rad: one modulus, or (E1, E2) along and across a
        grain at ``angle`` from x towards z.
    membrane
        Whether it has in-plane stiffness. A string selects strains: any of ``x``, ``z`` and ``s`` (shear); a single
        normal strain has the stiffness of a plate with free transverse edges, since the other stresses are zero.
    curl
        Curvatures (w,xx, w,zz, w,xz) of the unloaded plate, 1/m; positive ones lift its edges along y.
    creases
        Compliance (angle per moment) of creases across x and across z through the element, rad/N; zero: none.
    damping
        Damping time beta of the material, stress = K (e + beta e'), s; zero: none.
    drag
        Density of the air times drag coefficient, kg/m^3; zero: none.
    """

    record = PlateRecord
    apply = apply
    potential = potential
    tangent = tangent
    extrapolate = extrapolate_plates
    misplacement = plate_misplacement
    edge_angle = plate_edge_angle

    a: float
    b: float
    thickness: float
    youngs_modulus: float | tuple[float, float]
    poisson: float = 0.3
    shear_modulus: float | None = None
    angle: float = 0.0
    membrane: bool | str = False
    curl: tuple[float, float, float] = (0.0, 0.0, 0.0)
    creases: tuple[float, float] = (0.0, 0.0)
    damping: float = 0.0
    drag: float = 0.0

    def check(self, what: str = "a plate") -> None:
        """Raise UserError for an invalid number; ``what`` names the plate."""
        for key in ("a", "b", "thickness"):
            positive(f"{key} of {what}", getattr(self, key))
        self.material.check(what)
        for key in ("damping", "drag"):
            not_negative(f"{key} of {what}", getattr(self, key))
        curl, creases = array_of(f"curl of {what}", self.curl), array_of(f"creases of {what}", self.creases)
        if curl.shape != (3,) or not np.all(np.isfinite(curl)):
            raise UserError(f"curl of {what} is {self.curl!r}; allowed: three finite curvatures, 1/m")
        if creases.shape != (2,) or not np.all(np.isfinite(creases)) or creases.min() < 0.0:
            raise UserError(f"creases of {what} are {self.creases!r}; allowed: two finite numbers, not negative")
        if not isinstance(self.membrane, str):
            flag(f"membrane of {what}", self.membrane)
        if not set(self.strains) <= set("xzs"):
            raise UserError(f"membrane of {what} is {self.membrane!r}; allowed: True, False or letters of 'xzs'")

    @property
    def natural(self) -> tuple[Matrix, Matrix]:
        """Unstrained positions of its bodies (4, 3), m, and their axes (4, 3, 3), columns."""
        corners = np.array([(0.0, 0.0, 0.0), (self.a, 0.0, 0.0), (self.a, 0.0, self.b), (0.0, 0.0, self.b)])
        return corners, np.broadcast_to(np.eye(3), (4, 3, 3))

    @property
    def area(self) -> float:
        """Area, m^2."""
        return self.a * self.b

    @property
    def strains(self) -> str:
        """The membrane strains with stiffness."""
        return self.membrane if isinstance(self.membrane, str) else "xzs" * self.membrane

    @cached_property
    def material(self) -> PlaneStress:
        """What it is of."""
        return PlaneStress(self.youngs_modulus, self.poisson, self.shear_modulus, self.angle)

    @property
    def stretching(self) -> Matrix:
        """Forces per length (3, 3) by (e_xx, e_zz, gamma), N/m, independent of ``membrane``."""
        return self.material.Q * self.thickness

    @property
    def bending(self) -> Matrix:
        """Moments per length (3, 3) by curvatures (w,xx, w,zz, 2 w,xz), N m."""
        return add_crease_compliance(self.stretching * self.thickness**2 / 12.0, self._softness(1.0))

    def fill(self, record: Any, site: Attachment) -> None:
        """Write corners, sizes, stiffness and natural shape; see :mod:`.plate_energy` for the formulae."""
        a, b, material = self.a, self.b, self.material
        slim, Et = a / b, material.moduli[1] * self.thickness
        D = Et * self.thickness**2 / (12.0 * material.rest)
        C = add_crease_compliance(material.ratios, self._softness(D))
        (C11, C12, C16), (_, C22, C26), (_, _, C66) = C.tolist()
        record["node"], record["scratch"], record["a"], record["b"] = site.bodies, site.scratch(PLATE_SCRATCH), a, b
        record["bending"] = [
            4.0 * D * C11 / slim,
            4.0 * D * C22 * slim,
            12.0 * D * C11 / slim,
            D * (4.0 * C22 * slim + 16.0 * C66 / slim) / 3.0,
            12.0 * D * C22 * slim,
            D * (4.0 * C11 / slim + 16.0 * C66 * slim) / 3.0,
            D * (4.0 * C11 / slim + 3.2 * C66 * slim),
            D * (4.0 * C22 * slim + 3.2 * C66 / slim),
            64.0 * D * C66 / (a * b),
        ]
        record["coupling"] = 4.0 * C12 * D
        A16, A26 = self._fill_membrane(record, Et * a * b)
        record["grain"] = material.grain
        record["oblique"] = [
            16.0 * D * C16 / a,
            16.0 * D * C26 / b,
            8.0 * D * C16,
            8.0 * D * C26,
            8.0 / 3.0 * D * (C16 / slim + C26 * slim),
            A16,
            A26,
        ]
        kx, kz, kxz = self.curl
        record["curled"], record["curl"] = any(self.curl), 0.0
        record["curl"][0], record["curl"][1], record["curl"][8] = 0.5 * a * kx, 0.5 * b * kz, 0.25 * a * b * kxz
        record["damped"], record["damping"] = self.damping > 0.0, self.damping

    def _fill_membrane(self, record: Any, unit: float) -> tuple[float, float]:
        """Write what resists stretching, in terms of E2 t a b; return what couples normal strains with shear."""
        nu, kept = self.poisson, [strain in self.strains for strain in "xzs"]
        x, z, s = kept
        record["membrane"] = any(kept)
        if self.material.isotropic:
            normal = unit / (1.0 - nu**2 * (x and z))
            record["stretching"] = (normal * x, normal * z, nu * normal * (x and z), 0.5 * unit / (1.0 + nu) * s)
            return 0.0, 0.0
        A = unit * self.material.freed(kept)
        record["stretching"] = A[0, 0], A[1, 1], A[0, 1], A[2, 2]
        return A[0, 2], A[1, 2]

    def _softness(self, unit: float) -> tuple[float, float]:
        """Curvature of the creases per moment, spread over the element, times a bending stiffness."""
        return unit * self.creases[0] / self.a, unit * self.creases[1] / self.b

    def recover(self, x: float, z: float) -> dict[str, Recovered]:
        """Return curvature, moment, strain and force at a point, as functions of the generalized strains (12,).

        x and z are parts of a and b, from 0 to 1. See :func:`.stress_recovery.recover`; strains are means over the
        element, and local values if all strains have stiffness.
        """
        bent, natural = np.zeros((3, 12)), np.array(self.curl) * (1.0, 1.0, 2.0)
        bent[:, :9] = curvature(self.a, self.b, x * self.a, z * self.b)
        stretched = np.eye(12)[9:] if set(self.strains) == set("xzs") else None
        return recover(stretched, bent, self.stretching, self.bending, natural=natural)
