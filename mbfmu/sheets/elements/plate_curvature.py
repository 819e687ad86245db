"""Curvatures within the rectangle of Adini, Clough and Melosh, from its generalized strains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
POWERS = np.array([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)])
X, Z = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])  # signs of the corners


def monomials(x: float, z: float, by_x: int = 0, by_z: int = 0) -> Matrix:
    """Return the derivatives (12,) of x^i z^k, the terms of the deflection."""
    found = np.ones(12)
    for n, (value, times) in enumerate(((x, by_x), (z, by_z))):
        power = POWERS[:, n].copy()
        for _ in range(times):
            found *= power
            power = np.maximum(power - 1, 0)
        found *= value**power
    return found


def curvature(a: float, b: float, x: float, z: float) -> Matrix:
    """Return (w,xx, w,zz, 2 w,xz), (3, 9), at (x, z) from the first corner, m, by the strains 0 ... 8 of a plate."""
    e, twist = np.eye(9), X * Z
    w = np.outer(twist, e[8])
    by_x = e[2] + np.outer(X, e[0]) + np.outer(twist, e[5]) + np.outer(Z, e[6] + 2.0 / a * e[8])
    by_z = e[4] + np.outer(Z, e[1]) + np.outer(twist, e[3]) + np.outer(X, e[7] + 2.0 / b * e[8])
    corners = 0.5 * np.column_stack((a * X, b * Z))  # from the middle
    terms = [monomials(u, v, i, k) for i, k in ((0, 0), (1, 0), (0, 1)) for u, v in corners]
    amounts = np.linalg.solve(terms, np.vstack((w, by_x, by_z)))
    at = x - 0.5 * a, z - 0.5 * b
    return np.array([monomials(*at, 2, 0), monomials(*at, 0, 2), 2.0 * monomials(*at, 1, 1)]) @ amounts
