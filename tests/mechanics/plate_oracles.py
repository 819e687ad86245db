"""What the plate element must agree with, written in another way; and a sheet's statics by plain dense Newton."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.recursions.dynamics import inverse_dynamics_at_solution
from mbfmu.sheets import Sheet, Support, add_sheet
from solvers.system import TreeSystem

E = 1e-30  # complex step
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
POWERS = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)]


def isotropic(D: float, nu: float) -> Any:
    """Moments (3, 3) by (w,xx, w,zz, 2 w,xz)."""
    return D * np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]])


def acm_stiffness(a: float, b: float, moduli: Any) -> Any:
    """The 12 x 12 stiffness of Adini, Clough and Melosh for (w, w_x, w_z) at the corners, by polynomials and Gauss.

    ``moduli`` (3, 3) take (w,xx, w,zz, 2 w,xz) to the moments.
    """

    def terms(x: float, z: float, dx: int, dz: int) -> Any:
        def one(p: int, n: int, s: float) -> float:
            return 0.0 if p < n else np.prod(np.arange(p, p - n, -1), initial=1.0) * s ** (p - n)

        return np.array([one(p, dx, x) * one(r, dz, z) for p, r in POWERS])

    C = np.array([terms(x * a / 2, z * b / 2, *d) for x, z in CORNERS for d in ((0, 0), (1, 0), (0, 1))])
    K, (points, weights) = np.zeros((12, 12)), np.polynomial.legendre.leggauss(3)
    for x, by_x in zip(points * a / 2, weights * a / 2, strict=True):
        for z, by_z in zip(points * b / 2, weights * b / 2, strict=True):
            B = np.array([terms(x, z, 2, 0), terms(x, z, 0, 2), 2.0 * terms(x, z, 1, 1)]) @ np.linalg.inv(C)
            K += B.T @ moduli @ B * by_x * by_z
    return K


# Sheet 0.300 x 0.210 m, 0.3 mm, one 210-mm edge clamped: CalculiX, Kratos and a Ritz plate agree on what follows.
TIP = -108.22e-3  # m, static, middle of the free edge
CLAMPED = np.array([1.7544, 5.6901, 10.8989, 19.3376, 25.0568, 31.0848, 39.8990, 40.8125])  # Hz, flat, no gravity
FREE = np.array([9.7272, 10.8575, 22.6659, 23.0186, 28.3701, 32.5645, 42.5163, 47.4405])


def cantilever(grid: tuple[int, int], *, gravity: float = 9.81, **options: Any) -> tuple[Mechanism, Sheet]:
    """That sheet, the edge x = length clamped unless ``options`` say otherwise."""
    m = Mechanism(gravity=(0.0, -gravity, 0.0))
    given: dict[str, Any] = {"length": 0.3, "width": 0.21, "thickness": 0.3e-3, "youngs_modulus": 1e10}
    given |= {"poisson": 0.3, "density": 1000.0, "grid": grid, "supports": [Support("x1")]}
    return m, add_sheet(m, "sheet", **(given | options))


def bodies_at(compiled: CompiledMechanism, q: Any) -> Any:
    """Motions of all bodies at rest in q."""
    n = compiled.system.n
    inverse_dynamics_at_solution(0.0, q, np.zeros(n), np.zeros(n), np.zeros(compiled.system.m), compiled.kernel_data)
    return compiled.data.state.bodies


def forces_and_tangent(compiled: CompiledMechanism, q: Any) -> tuple[Any, Any]:
    """Static residual (n,) by inverse dynamics and its exact derivative (n, n)."""
    system = compiled.complex_system()
    n = system.n
    K, zero = np.zeros((n, n)), np.zeros(n, complex)
    for k in range(n):
        moved, step = q.astype(complex), zero.copy()
        step[k] = 1j * E
        system.apply(moved, step)
        inverse_dynamics_at_solution(0.0, moved, zero, zero, np.zeros(system.m, complex), system.pinned_data)
        K[:, k] = system.data.state.tau.imag / E
    return system.data.state.tau.real.copy(), K


def newton(compiled: CompiledMechanism, q: Any) -> tuple[Any, int]:
    """Static equilibrium of a tree without cut joints, and the iterations it took."""
    for iteration in range(1, 16):
        f, K = forces_and_tangent(compiled, q)
        dq = np.linalg.solve(K, -f)
        q = q + dq
        if np.abs(dq).max() < 1e-9:
            return q, iteration
    raise AssertionError("Newton does not converge")


def cylindrical(grid: tuple[int, int], spine: bool) -> Any:
    """Coordinates of a sheet bent as one strip of it would be: where Newton with membrane may start."""
    m, _ = cantilever((grid[0], 2), tree="rows")
    compiled = CompiledMechanism(m)
    strip = newton(compiled, np.zeros(compiled.system.n))[0].reshape(-1, 2, 3).mean(axis=1)
    q = np.zeros((grid[0] - 1, grid[1], 3))
    q[:, : 1 if spine else None, :2] = strip[:, None, :2]
    return q.reshape(-1)


def frequencies(compiled: CompiledMechanism) -> Any:
    """Natural frequencies in Hz, lowest first, at the start; negative where the stiffness is."""
    q = compiled.assembly.start_positions()
    system = compiled.system
    free, still = np.eye(system.n), np.zeros(system.n)
    terms = system.allocate_terms()
    system.fill(0.0, q, still, terms)
    M = terms.M
    if isinstance(system, TreeSystem):
        at_rest = system.residual(0.0, q, still, still)
        M = np.array([system.residual(0.0, q, still, a) - at_rest for a in free]).T
    K = forces_and_tangent(compiled, q)[1]
    if system.m:
        _, sigma, Vt = np.linalg.svd(terms.J)
        free = Vt[int(np.sum(sigma > 1e-9 * sigma[0])) :].T
    L = np.linalg.inv(np.linalg.cholesky(free.T @ M @ free))
    values = np.linalg.eigvalsh(L @ free.T @ (0.5 * (K + K.T)) @ free @ L.T)
    return np.sign(values) * np.sqrt(np.abs(values)) / (2.0 * np.pi)


def grain(
    youngs_modulus: tuple[float, float], poisson: float, shear_modulus: float | None = None, angle: float = 0.0
) -> Any:
    """Q (3, 3), Pa, of a material whose grain lies at an angle from x towards z: its tensor of fourth order, turned.

    Without a shear modulus that of Baum, Brennan and Habeger's papers.
    """
    (E1, E2), n = youngs_modulus, np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    mean = poisson * np.sqrt(E2 / E1)
    G = 0.5 * np.sqrt(E1 * E2) / (1.0 + mean) if shear_modulus is None else shear_modulus
    Q = np.linalg.inv([[1.0 / E1, -poisson / E1, 0.0], [-poisson / E1, 1.0 / E2, 0.0], [0.0, 0.0, 1.0 / G]])
    own, pairs = np.zeros((2, 2, 2, 2)), [(0, 0), (1, 1), (0, 1)]
    for i, (p, q) in enumerate(pairs):
        for j, (r, s) in enumerate(pairs):
            own[p, q, r, s] = own[q, p, r, s] = own[p, q, s, r] = own[q, p, s, r] = Q[i, j]
    turned = np.einsum("ai,bj,ck,dl,abcd->ijkl", n, n, n, n, own)
    return np.array([[turned[p, q, r, s] for r, s in pairs] for p, q in pairs])


def ritz(sides: tuple[float, float], D: Any, mass: float, *, clamped: bool, terms: int = 12) -> Any:
    """Natural frequencies of a thin rectangular plate, Hz, lowest first, rigid motions among them.

    Products of Legendre polynomials, times (L - x)^2 where the edge x = L is clamped. ``D`` (3, 3), N m, takes (w,xx,
    w,zz, 2 w,xz) to the moments; ``mass`` is per area, kg/m^2.
    """
    s, weight = np.polynomial.legendre.leggauss(2 * terms)
    held = np.polynomial.Polynomial([1.0, -2.0, 1.0] if clamped else [1.0])
    shapes = [np.polynomial.Legendre.basis(n).convert(kind=np.polynomial.Polynomial) for n in range(terms)]

    def basis(side: float, factor: Any) -> list[Any]:
        return [np.array([(factor * p).deriv(d)(s) * (2.0 / side) ** d for p in shapes]) for d in range(3)]

    X, Z = basis(sides[0], held), basis(sides[1], np.polynomial.Polynomial([1.0]))

    def gram(a: int, b: int, c: int, d: int) -> Any:
        """Integral of the products of derivatives (a, b) by x and z with derivatives (c, d)."""
        return np.kron(X[a] * weight @ X[c].T, Z[b] * weight @ Z[d].T) * 0.25 * sides[0] * sides[1]

    orders = [(2, 0), (0, 2), (1, 1)]
    K = sum(
        D[i, j] * (1.0 + (i == 2)) * (1.0 + (j == 2)) * gram(*orders[i], *orders[j]) for i in range(3) for j in range(3)
    )
    L = np.linalg.inv(np.linalg.cholesky(mass * gram(0, 0, 0, 0)))
    values = np.linalg.eigvalsh(L @ K @ L.T)
    return np.sqrt(np.maximum(values, 0.0)) / (2.0 * np.pi)


def karman(load: float, nu: float = 0.3, count: int = 5) -> float:
    """Central deflection over thickness of a square plate on four hinged edges, which are free in the plane.

    Foeppl and von Karman's equations by Ritz: w in sines, the stress function in (1 - s^2)^2 times Legendre
    polynomials, so that no stress acts on the edges. ``load`` is q L^4 / (E t^4); ``count`` odd terms a direction.
    """
    s, weight = np.polynomial.legendre.leggauss(40)
    x, weight = 0.5 * (s + 1.0), 0.5 * weight
    k = np.pi * np.arange(1, 2 * count, 2)
    S = [np.sin(np.outer(k, x)), k[:, None] * np.cos(np.outer(k, x)), -(k[:, None] ** 2) * np.sin(np.outer(k, x))]
    rim = np.polynomial.Polynomial([1.0, 0.0, -2.0, 0.0, 1.0])
    stress = [rim * np.polynomial.Legendre.basis(2 * i).convert(kind=np.polynomial.Polynomial) for i in range(count)]
    X = [np.array([2.0**d * p.deriv(d)(s) if d else p(s) for p in stress]) for d in range(3)]

    def grid(A: Any, B: Any) -> Any:
        return np.einsum("ai,bj->abij", A, B).reshape(count * count, -1)

    def gram(d: int) -> Any:
        return X[d] * weight @ X[d].T

    area = np.outer(weight, weight).reshape(-1)
    biharmonic = np.kron(gram(2), gram(0)) + np.kron(gram(0), gram(2)) + 2.0 * np.kron(gram(1), gram(1))
    xx, yy, xy, phi = grid(S[2], S[0]), grid(S[0], S[2]), grid(S[1], S[1]), grid(X[0], X[0]) * area
    bracket = np.einsum("kp,ap,bp->kab", phi, xx, yy)
    bracket = bracket + bracket.transpose(0, 2, 1) - 2.0 * np.einsum("kp,ap,bp->kab", phi, xy, xy)
    m, n = (axis.reshape(-1) for axis in np.meshgrid(k, k, indexing="ij"))
    bending, force = (m * m + n * n) ** 2 / (48.0 * (1.0 - nu * nu)), 4.0 / (m * n)
    a = np.zeros(count * count)
    for part in np.linspace(0.05, 1.0, 20):
        for _ in range(50):
            slope = bracket @ a
            b = -0.5 * np.linalg.solve(biharmonic, slope @ a)
            tangent = np.diag(bending) + slope.T @ np.linalg.solve(biharmonic, slope) - np.tensordot(b, bracket, 1)
            step = np.linalg.solve(tangent, part * load * force + slope.T @ b - bending * a)
            a = a + step
            if np.abs(step).max() < 1e-12:
                break
    return float(np.sin(0.5 * m) * np.sin(0.5 * n) @ a)
