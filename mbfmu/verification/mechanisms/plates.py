"""Plates under compression, whose buckling loads are known by the method of Ritz."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Legendre, Polynomial
from scipy.linalg import eigh

from mbfmu.mechanics import Floating, Input, Mechanism, PointForce, Product
from mbfmu.sheets import Support, add_sheet
from mbfmu.steady.equilibrium import equilibrium

from .shells import shares

ROOTS = ("at the support", "at the load", "in the middle")  # of the tree of joints
PLATES = {"hinged": (0.3, 0.3), "clamped": (0.3, 0.21)}  # m, compressed along the first
MATERIAL: dict[str, Any] = {"thickness": 1e-3, "youngs_modulus": 1e10, "poisson": 0.3}


def compressed_plate(edges: str, cells: int, load: float | Input, root: str) -> Mechanism:
    """Return a plate between two hinged or clamped edges, under ``load`` times Euler's load of its strips.

    ``load`` is a number or an input. The loaded edge x = 0 slides in the plane. If the node in the middle is
    the root, it is a free body.
    """
    (length, width), t = PLATES[edges], MATERIAL["thickness"]
    grid = cells + 1, round(cells * width / length) + 1
    strip = {"hinged": 1.0, "clamped": 4.0}[edges] * np.pi**2 * MATERIAL["youngs_modulus"] * t**3 / (12.0 * length**2)
    m, master, at = Mechanism(), None, (0.0, 0.0, 0.0)
    if root == "in the middle":
        at = (-(cells // 2) * length / cells, 0.0, -(grid[1] // 2) * width / (grid[1] - 1))
        master = m.body("middle", m.ground, Floating())
    held, sliding = {"hinged": ("pinned", "supported"), "clamped": ("clamped", "guided")}[edges]
    supports = [Support("x1", held, at=at), Support("x0", sliding, at=at)]
    sheet = add_sheet(
        m, "plate", length=length, width=width, density=1000.0, grid=grid, master=master, at=at, stretch=True,
        supports=supports[::-1] if root == "at the load" else supports, **MATERIAL,
    )  # fmt: skip
    for k, share in enumerate(shares(grid[1] - 1)):
        part = share * strip * width
        push = PointForce(magnitude=Product(load, part) if isinstance(load, Input) else load * part, axis="x")
        m.force(f"push{k}", push, sheet.node(0, k))
    return m


def buckling_load(edges: str, cells: int, root: str) -> float:
    """Return the load of :func:`compressed_plate` at which its lowest frequency is zero.

    The square of the frequency decreases linearly with the load, except for the change of the mode.
    """
    loads, squares = (0.8, 1.0), []
    for load in loads:
        found = equilibrium(compressed_plate(edges, cells, load, root))
        squares.append(found.shapes(1)[0].mode.eigenvalue.imag ** 2)
    return loads[1] + squares[1] * (loads[1] - loads[0]) / (squares[0] - squares[1])


def ritz_buckling_load(edges: str, terms: int = 12) -> float:
    """Return the buckling load by Ritz: w = sum of f(x) g(z), f polynomials that satisfy the supports, g even ones.

    Kirchhoff's energy over D: (w,xx + w,zz)^2 - 2 (1 - nu) (w,xx w,zz - w,xz^2), against w,x^2 of the force; length 1.
    """
    nu, b = MATERIAL["poisson"], PLATES[edges][1] / PLATES[edges][0]
    s, weight = np.polynomial.legendre.leggauss(40)
    kept = Polynomial([0.0, 1.0, -1.0]) ** {"hinged": 1, "clamped": 2}[edges]
    along = [kept * Legendre.basis(k)(Polynomial([-1.0, 2.0])) for k in range(terms)]
    across = [Legendre.basis(2 * k)(Polynomial([0.0, 2.0 / b])) for k in range(terms)]

    def products(shapes: Any, points: Any, weights: Any, c: int, d: int) -> Any:
        """Return integrals of products of the derivatives of orders c and d of all pairs."""
        left, right = (np.array([p.deriv(n)(points) for p in shapes]) for n in (c, d))
        return (left * weights) @ right.T

    X = {(c, d): products(along, 0.5 * (s + 1.0), 0.5 * weight, c, d) for c in range(3) for d in range(3)}
    Z = {(c, d): products(across, 0.5 * b * s, 0.5 * b * weight, c, d) for c in range(3) for d in range(3)}
    bent = np.kron(X[2, 2], Z[0, 0]) + np.kron(X[0, 0], Z[2, 2]) + 2.0 * (1.0 - nu) * np.kron(X[1, 1], Z[1, 1])
    bent += nu * (np.kron(X[2, 0], Z[0, 2]) + np.kron(X[0, 2], Z[2, 0]))
    strip = {"hinged": 1.0, "clamped": 4.0}[edges] * np.pi**2 * (1.0 - nu**2)
    return float(eigh(bent, np.kron(X[1, 1], Z[0, 0]), eigvals_only=True)[0] / strip)
