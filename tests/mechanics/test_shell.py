"""The shell element: what its stiffness holds of plates and of plane stress, forces as exact derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from random_mechanisms import random_rotation
from test_plate import A as SIDE_X
from test_plate import B as SIDE_Z
from test_plate import (
    complex_columns,
    complex_energy,
    complex_wrenches,
    curved,
    joint_axes,
    posed,
    tangent_of,
    wrenches,
)

from mbfmu.mechanics import CompiledMechanism, Floating, Mechanism
from mbfmu.sheets import Plate, Shell
from mbfmu.sheets.elements.material import PlaneStress
from mbfmu.sheets.elements.shell_stiffness import bending, flat_axes, membrane
from mbfmu.sheets.section_properties import shell_of
from mbfmu.util.errors import UserError

E, NU, T = 10.0, 0.3, 0.3
CORNERS = np.array([[0.0, 0.0, 0.0], [2.0, 0.05, 0.1], [2.2, -0.03, 1.6], [0.1, 0.04, 1.4]])  # nearly flat
STRETCHING = PlaneStress(E, NU).Q * T
BENDING = STRETCHING * T**2 / 12.0
GRAIN = np.array([[8.0, 1.0, 0.7], [1.0, 3.0, -0.4], [0.7, -0.4, 2.0]])  # of a material whose grain is askew
MATERIALS = {"isotropic": (STRETCHING, BENDING), "askew": (GRAIN, 0.01 * GRAIN)}
RIGID = np.array([1, 1, 1, 2, 2, 2]) * 0.4


def element(material: str = "isotropic", **options: Any) -> CompiledMechanism:
    """Four floating bodies with a shell element between them."""
    m = Mechanism()
    nodes = [m.body(f"n{i}", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0)) for i in range(4)]
    stretching, bent = MATERIALS[material]
    m.element(Shell(**({"corners": CORNERS, "stretching": stretching, "bending": bent} | options)), *nodes)
    return CompiledMechanism(m)


def moved(compiled: CompiledMechanism, size: float, seed: int = 0) -> Any:
    """Positions (28,) of the unstrained element with every motion of every node off by about ``size``."""
    q = compiled.assembly.start_positions()
    q.reshape(4, 7)[:, :3] = CORNERS
    compiled.system.apply(q, size * np.random.default_rng(seed).normal(size=24))
    return q


@pytest.mark.parametrize("material", MATERIALS)
def test_constant_curvature_and_strain_are_exact(material: str) -> None:
    """The patch tests: any linear displacement and any quadratic deflection, on any quadrilateral."""
    A, D = MATERIALS[material]
    X = flat_axes(CORNERS)[1][:, [0, 2]]
    area = 0.5 * ((X[2] - X[0])[0] * (X[3] - X[1])[1] - (X[2] - X[0])[1] * (X[3] - X[1])[0])
    rng = np.random.default_rng(1)
    L = rng.normal(size=(2, 2))  # displacement = L X; it turns by (L[0, 1] - L[1, 0]) / 2 about y
    d = np.column_stack((X @ L.T, np.full(4, 0.5 * (L[0, 1] - L[1, 0])))).reshape(-1)
    e = np.array([L[0, 0], L[1, 1], L[0, 1] + L[1, 0]])
    assert d @ membrane(X, A) @ d == pytest.approx(area * e @ A @ e, rel=1e-12)
    k = rng.normal(size=3)  # w = (k0 x^2 + k1 z^2 + k2 x z) / 2 and a tilt
    tilt = rng.normal(size=2)
    w = 0.5 * (k[0] * X[:, 0] ** 2 + k[1] * X[:, 1] ** 2 + k[2] * X[:, 0] * X[:, 1]) + X @ tilt
    by_x, by_z = k[0] * X[:, 0] + 0.5 * k[2] * X[:, 1] + tilt[0], k[1] * X[:, 1] + 0.5 * k[2] * X[:, 0] + tilt[1]
    d = np.column_stack((w, -by_z, by_x)).reshape(-1)
    assert d @ bending(X, D) @ d == pytest.approx(area * k @ D @ k, rel=1e-12)


@pytest.mark.parametrize("material", MATERIALS)
def test_nothing_but_rigid_motions_is_free(material: str) -> None:
    A, D = MATERIALS[material]
    X = flat_axes(CORNERS)[1][:, [0, 2]]
    for K in (membrane(X, A), bending(X, D)):
        values = np.linalg.eigvalsh(K)
        assert np.abs(values[:3]).max() < 1e-13 * values[-1]
        assert values[3] > 1e-4 * values[-1]


def test_bending_in_the_plane_of_a_rectangle_is_that_of_a_beam() -> None:
    """Displacements u = xi eta h of a rectangle: energy 4 E t b h^2 / (3 a) / 2, no locking however slim it is."""
    for a, b in ((1.0, 1.0), (10.0, 1.0)):
        X = np.array([[0.0, 0.0], [a, 0.0], [a, b], [0.0, b]])
        d = np.zeros((4, 3))
        d[:, 0] = 1.0, -1.0, 1.0, -1.0
        d[:, 2] = 2.0 / b * np.array([-1.0, 1.0, 1.0, -1.0])  # turns with the sections
        assert d.reshape(-1) @ membrane(X, STRETCHING) @ d.reshape(-1) == pytest.approx(
            4.0 * E * T * b / (3.0 * a), rel=0.01 * (a / b) ** 2
        )


@pytest.mark.parametrize("grain", [{}, {"youngs_modulus": (10.0, 4.0), "poisson": 0.4, "angle": 0.6}])
def test_a_curled_shell_has_the_moments_of_the_remaining_curvatures(grain: dict[str, Any]) -> None:
    """w = (kx x^2 + kz z^2) / 2 + kxz x z, small: energy (k - curl) D (k - curl) a b / 2; none where it rests."""
    own, k = 1e-4 * np.array([1.0, -0.4, 0.3]), 1e-4 * np.array([0.5, 0.2, -0.7])
    options: dict[str, Any] = {"a": SIDE_X, "b": SIDE_Z, "thickness": T, "youngs_modulus": E}
    plate = Plate(**(options | grain), curl=tuple(own))
    m = Mechanism()
    m.element(shell_of(plate), *(m.body(f"n{i}", m.ground, Floating(), mass=1.0, inertia=(1.0,) * 3) for i in range(4)))
    compiled, left = CompiledMechanism(m), (k - own) * (1.0, 1.0, 2.0)
    expected = 0.5 * left @ plate.bending @ left * plate.area
    assert compiled.energy(0.0, curved(k), np.zeros(24)) == pytest.approx(expected, rel=1e-5)
    assert abs(compiled.energy(0.0, curved(own), np.zeros(24))) < 1e-5 * expected


def test_rigid_motions_strain_nothing() -> None:
    compiled, rng = element(), np.random.default_rng(2)
    q = moved(compiled, 0.1)
    before = compiled.energy(0.0, q, np.zeros(24))
    R, shift = random_rotation(rng), rng.normal(size=3)
    bodies = compiled.data.state.bodies[1:]
    r, A = bodies["r"].copy(), bodies["A"].copy()
    turned = posed(r @ R.T + shift, R @ A)
    assert compiled.energy(0.0, turned, np.zeros(24)) == pytest.approx(before, rel=1e-12)
    assert compiled.energy(0.0, moved(compiled, 0.0), np.zeros(24)) < 1e-28


@pytest.mark.parametrize("size", [1e-4, 0.05, 0.3])
@pytest.mark.parametrize("material", MATERIALS)
def test_forces_are_the_gradient_of_the_energy(material: str, size: float) -> None:
    compiled = element(material)
    q = moved(compiled, size)
    gradient = complex_columns(compiled, q, complex_energy)
    F = wrenches(compiled, q)
    expected = np.concatenate([T.T @ f for T, f in zip(joint_axes(compiled), F, strict=True)])
    spread = np.abs(expected).max()
    # the velocities of a floating joint are those of its coordinates, so columns along T are motions in global axes
    assert np.abs(gradient + F.reshape(-1)).max() < 1e-12 * spread


@pytest.mark.parametrize("size", [1e-4, 0.05, 0.3, 1.0])
@pytest.mark.parametrize("material", MATERIALS)
def test_stiffness_is_the_derivative_of_the_forces(material: str, size: float) -> None:
    compiled = element(material)
    q, K = moved(compiled, size), np.zeros((24, 24))
    wrenches(compiled, q)
    tangent_of(compiled, 0.0, K)
    np.testing.assert_allclose(K, -complex_columns(compiled, q, complex_wrenches), rtol=0, atol=1e-12 * np.abs(K).max())


def test_damping_is_the_derivative_of_the_forces_by_velocities() -> None:
    compiled = element("askew", damping=0.2)
    q, K, C = moved(compiled, 0.3), np.zeros((24, 24)), np.zeros((24, 24))
    rest, Y = wrenches(compiled, q), np.random.default_rng(3).normal(size=24)
    tangent_of(compiled, 0.0, K)
    tangent_of(compiled, 1.0, C)
    C -= K
    v = np.concatenate([T @ Y[6 * i : 6 * i + 6] for i, T in enumerate(joint_axes(compiled))])
    np.testing.assert_allclose((rest - wrenches(compiled, q, v)).reshape(-1), C @ Y, atol=1e-13 * np.abs(C).max())
    np.testing.assert_allclose(C, C.T, atol=1e-13 * np.abs(C).max())
    assert np.linalg.eigvalsh(C).min() > -1e-13 * np.abs(C).max()


def test_forces_and_moments_balance() -> None:
    compiled = element("askew")
    q = moved(compiled, 0.2)
    F = wrenches(compiled, q)
    r = compiled.data.state.bodies["r"][1:]
    assert np.abs(F[:, :3].sum(0)).max() < 1e-13 * np.abs(F).max()
    assert np.abs((F[:, 3:] + np.cross(r, F[:, :3])).sum(0)).max() < 1e-13 * np.abs(F).max()


def test_damping_takes_the_power_of_its_forces_and_none_from_rigid_motions() -> None:
    rng = np.random.default_rng(3)
    plain, damped = element("askew"), element("askew", damping=0.1)
    q = moved(damped, 0.2)
    v = rng.normal(size=24)
    F = wrenches(damped, q, v) - wrenches(plain, q, v)
    Y = damped.data.state.bodies["Y"][1:]
    power = float((F * Y).sum())
    assert power < 0.0
    assert damped.data.state.cached_power[0] == pytest.approx(power, rel=1e-12)
    wrenches(damped, q, np.zeros(24))
    r, A = damped.data.state.bodies["r"][1:].copy(), damped.data.state.bodies["A"][1:].copy()
    spin, speed = rng.normal(size=3), rng.normal(size=3)
    rigid = np.concatenate([np.concatenate((speed + np.cross(spin, x), R.T @ spin)) for x, R in zip(r, A, strict=True)])
    scale = np.abs(wrenches(plain, q)).max()
    assert np.abs(wrenches(damped, q, rigid) - wrenches(plain, q, rigid)).max() < 1e-12 * scale


def test_rates_of_deformations_are_their_derivatives() -> None:
    """At the natural shape damping forces are beta times the tangent along the velocity."""
    damped, plain = element("askew", damping=0.1), element("askew")
    q, v = moved(damped, 0.0), np.random.default_rng(4).normal(size=24)
    F = wrenches(damped, q, v) - wrenches(plain, q, v)
    K = complex_columns(plain, q, complex_wrenches)
    motion = np.concatenate([T.T @ v[6 * i : 6 * i + 6] for i, T in enumerate(np.linalg.inv(joint_axes(plain)))])
    assert np.abs(F.reshape(-1) - 0.1 * K @ motion).max() < 1e-12 * np.abs(F).max()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"corners": CORNERS[::-1]}, "convex quadrilateral"),
        ({"corners": [[0, 0, 0], [2, 0, 0], [0.2, 0, 0.2], [0, 0, 2]]}, "convex quadrilateral"),
        ({"corners": [[0, 0, 0]] * 4}, "convex quadrilateral"),
        ({"corners": 3.0}, "4 x 3 finite numbers"),
        (
            {"corners": [[0, 0, 0], [1, 0, 0], [1, 1.3, 1], [0, 0, 1]]},
            "leans by 61 degrees from .* allowed: at most 45",
        ),
        ({"stretching": np.diag([1.0, 1.0, -1.0])}, "positive definite"),
        ({"bending": [[1, 0, 0], [1, 1, 0], [0, 0, 1]]}, "symmetric"),
        ({"bending": np.full((3, 3), np.nan)}, "3 x 3 finite numbers"),
        ({"damping": -1.0}, "damping of a plate is -1"),
        ({"attitudes": np.eye(3)}, "4 x 3 x 3 finite numbers"),
        ({"attitudes": [2.0 * np.eye(3)] * 4}, "attitudes of a plate"),
        ({"attitudes": [np.diag([1.0, 1.0, -1.0])] * 4}, "attitudes of a plate"),
    ],
)
def test_bad_input(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        element(**options)


def assembled(P: Any, own: Any) -> Any:
    """Stiffness over three unknowns a node of a grid of nodes P (nx, nz, 2), of cells by ``own`` of their corners."""
    nx, nz = P.shape[:2]
    K = np.zeros((3 * nx * nz, 3 * nx * nz))
    for i in range(nx - 1):
        for k in range(nz - 1):
            cell = [(i, k), (i + 1, k), (i + 1, k + 1), (i, k + 1)]
            rows = np.concatenate([3 * (a * nz + b) + np.arange(3) for a, b in cell])
            K[np.ix_(rows, rows)] += own(np.array([P[c] for c in cell]))
    return K


def cook(n: int) -> float:
    """Deflection in the middle of the free edge of Cook's membrane on n x n cells."""
    s = np.linspace(0.0, 1.0, n + 1)
    low, high = 44.0 * s, 44.0 + 16.0 * s
    P = np.stack((np.broadcast_to(48.0 * s[:, None], (n + 1, n + 1)), low[:, None] + np.outer(high - low, s)), -1)
    K, F = assembled(P, lambda X: membrane(X, PlaneStress(1.0, 1.0 / 3.0).Q)), np.zeros((n + 1, n + 1, 3))
    F[-1, :, 1] = 1.0 / n
    F[-1, [0, -1], 1] *= 0.5
    free = np.arange(3 * (n + 1), K.shape[0])
    d = np.zeros(K.shape[0])
    d[free] = np.linalg.solve(K[np.ix_(free, free)], F.reshape(-1)[free])
    return float(d.reshape(F.shape)[-1, n // 2, 1])


def test_cooks_membrane() -> None:
    """Published: 23.96 in the limit (Cook 1974; Pian and Sumihara have 23.68 on 8 x 8 and 23.88 on 16 x 16)."""
    found = [cook(n) for n in (4, 8, 16)]
    assert found[0] < found[1] < found[2]
    assert found[2] == pytest.approx(23.96, rel=5e-3)


def square(n: int, clamped: bool, skew: float) -> float:
    """Deflection in the middle of a square plate of side 1 under a uniform load, times D / q; inner nodes are moved."""
    s = np.linspace(0.0, 1.0, n + 1)
    P = np.stack(np.meshgrid(s, s, indexing="ij"), -1)
    P += skew / n * np.prod(np.sin(2.0 * np.pi * P), 2, keepdims=True) * np.array([1.0, -0.5])
    K, F = assembled(P, lambda X: bending(X, 12.0 * BENDING / (T**3 * E / (1.0 - NU**2)))), np.zeros((n + 1, n + 1, 3))
    F[:, :, 0] = 1.0 / n**2
    free = np.ones((n + 1, n + 1, 3), bool)
    for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        free[edge] = False
        if not clamped:
            free[edge][..., 2 if isinstance(edge, int) else 1] = True
    if not clamped:
        free[[0, 0, -1, -1], [0, -1, 0, -1]] = False
    at = free.reshape(-1)
    d = np.zeros(len(at))
    d[at] = np.linalg.solve(K[np.ix_(at, at)], F.reshape(-1)[at])
    return float(d.reshape(free.shape)[n // 2, n // 2, 0])


@pytest.mark.parametrize(("clamped", "exact"), [(True, 1.26532e-3), (False, 4.06235e-3)])
def test_square_plates(clamped: bool, exact: float) -> None:
    """Series solutions of Timoshenko and Woinowsky-Krieger (1959), the first to six figures by Taylor and Govindjee."""
    assert square(16, clamped, 0.0) == pytest.approx(exact, rel=1.2e-2)
    assert square(16, clamped, 0.7) == pytest.approx(exact, rel=2e-2)
    assert abs(square(16, clamped, 0.0) - exact) < 0.35 * abs(square(8, clamped, 0.0) - exact)
