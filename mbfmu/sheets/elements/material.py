"""A thin material in plane stress, whose stiffness may differ along and across its grain: paper, film, plywood.

In the material's own axes, 1 and 2 in the plane (Jones, *Mechanics of Composite Materials*, 1999, chapter 2), with
nu12 the contraction along 2 for a pull along 1 and nu21 = nu12 E2 / E1,

    Q = E2 / (1 - nu12 nu21) C,    C = (E1/E2  nu12  0;  nu12  1  0;  0  0  G12 (1 - nu12 nu21) / E2),

takes (e_11, e_22, gamma_12) to the stresses. It is positive definite where G12 > 0 and nu12^2 < E1 / E2. Direction 1 is
turned by ``angle`` from x towards z; strains, and curvatures (w,xx, w,zz, 2 w,xz) alike, go to the material's axes by

    T = (c^2  s^2  c s;  s^2  c^2  -c s;  -2 c s  2 c s  c^2 - s^2),    C of the plate's axes = T^T C T.

A shear modulus that is not known is taken to be what papers have (Baum, Brennan and Habeger, Tappi 64, 1981),

    G12 = sqrt(E1 E2) / (2 (1 + sqrt(nu12 nu21))),

which is E / (2 (1 + nu)) for the isotropic material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.numbers import finite, is_finite, positive
from mbfmu.util.errors import UserError

Matrix = NDArray[np.float64]
ALIGNMENT_TOLERANCE = 1e-12  # sine or cosine of an angle that is meant to be zero


@dataclass(frozen=True)
class PlaneStress:
    """A thin material in plane stress, isotropic or with a grain.

    Parameters
    ----------
    youngs_modulus
        Pa; two numbers (E1, E2) along and across the grain.
    poisson
        nu12: contraction along direction 2 for a pull along 1.
    shear_modulus
        G12, Pa; None: what follows from the others, see the module.
    angle
        Of direction 1 from x towards z, rad.
    """

    youngs_modulus: float | tuple[float, float]
    poisson: float = 0.3
    shear_modulus: float | None = None
    angle: float = 0.0

    def check(self, what: str) -> None:
        """Raise UserError for invalid material data; ``what`` names the owner."""
        value, nu = self.youngs_modulus, self.poisson
        if np.shape(value) == (2,):
            for key, modulus in zip(("E1", "E2"), value, strict=True):  # type: ignore[arg-type]
                positive(f"youngs_modulus {key} of {what}", modulus)
        else:
            positive(f"youngs_modulus of {what}", value)
        if self.shear_modulus is not None:
            positive(f"shear_modulus of {what}", self.shear_modulus)
        finite(f"angle of {what}", self.angle)
        if self.isotropic:
            if not is_finite(nu) or not -1.0 < nu <= 0.5:
                raise UserError(f"poisson of {what} is {nu!r}; allowed: above -1, at most 0.5")
        elif not is_finite(nu) or not nu**2 < self.moduli[0] / self.moduli[1]:
            raise UserError(
                f"poisson of {what} is {nu!r} with moduli {self.moduli}; allowed: its square below E1 / E2, so within "
                f"{np.sqrt(self.moduli[0] / self.moduli[1]):.4g}"
            )

    @property
    def isotropic(self) -> bool:
        """Whether it is alike in all directions."""
        return np.ndim(self.youngs_modulus) == 0 and self.shear_modulus is None

    @cached_property
    def moduli(self) -> tuple[float, float]:
        """E1 and E2, Pa."""
        value = self.youngs_modulus
        return (value[0], value[1]) if isinstance(value, tuple | list | np.ndarray) else (value, value)

    @cached_property
    def rest(self) -> float:
        """1 - nu12 nu21."""
        E1, E2 = self.moduli
        return 1.0 - self.poisson**2 * (E2 / E1)

    @cached_property
    def ratios(self) -> Matrix:
        """C (3, 3) in the plate's axes: Q = E2 / rest C."""
        (E1, E2), nu = self.moduli, self.poisson
        if self.isotropic:
            shear = 0.5 * (1.0 - nu)
        elif self.shear_modulus is None:
            shear = self.rest * np.sqrt(E1 / E2) / (2.0 * (1.0 + nu * np.sqrt(E2 / E1)))
        else:
            shear = self.rest * self.shear_modulus / E2
        C = np.array([[E1 / E2, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, shear]])
        c, s = float(np.cos(self.angle)), float(np.sin(self.angle))
        if min(abs(c), abs(s)) < ALIGNMENT_TOLERANCE:  # of pi/2: nothing couples there
            c, s = float(round(c)), float(round(s))
        if self.isotropic or s == 0.0:
            return C
        T = np.array([[c * c, s * s, c * s], [s * s, c * c, -c * s], [-2.0 * c * s, 2.0 * c * s, c * c - s * s]])
        return T.T @ C @ T

    @property
    def grain(self) -> int:
        """0: none; 1: along x or z; 2: askew, so that normal strains and shear are coupled in the plate's axes."""
        return 0 if self.isotropic else 1 + int(self.ratios[:2, 2].any())

    @property
    def Q(self) -> Matrix:
        """Stresses (3, 3) by (e_xx, e_zz, gamma) in the plate's axes, Pa."""
        return self.moduli[1] / self.rest * self.ratios

    def freed(self, kept: Sequence[bool]) -> Matrix:
        """Return Q / E2 (3, 3) where only some strains are resisted: the stresses of the others are zero."""
        S, at = np.linalg.inv(self.ratios) * self.rest, np.flatnonzero(kept)
        out = np.zeros((3, 3))
        out[np.ix_(at, at)] = np.linalg.inv(S[np.ix_(at, at)])
        return out


def add_crease_compliance(D: Matrix, compliance: tuple[float, float]) -> Matrix:
    """Return the stiffness (3, 3) of bending D, in series with hinges across x and across z.

    ``compliance`` is their angle per moment along the line, per length across it, in units of 1 / D.
    """
    if not any(compliance):
        return D
    return np.asarray(np.linalg.inv(np.linalg.inv(D) + np.diag((*compliance, 0.0))), np.float64)
