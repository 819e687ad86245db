"""The plate element: closed forms of its energy, forces and tangents as exact derivatives, what it must not feel."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plate_oracles import CORNERS, E, acm_stiffness, grain, isotropic
from random_mechanisms import random_rotation

from mbfmu.mechanics import CompiledMechanism, Floating, Mechanism, Polynomial
from mbfmu.mechanics.dispatch import load_tangent
from mbfmu.mechanics.loads import Drag
from mbfmu.mechanics.records import to_complex_state
from mbfmu.mechanics.recursions.dynamics import energy, update_kinematics
from mbfmu.sheets import Plate, Shell
from mbfmu.sheets.elements.plate_energy import PLATE_SCRATCH, bending_strain, slope_factor, stress
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.util.errors import UserError
from solvers.compiled.tuple_pointer import pin, unpin

A, B, NU = 2.0, 1.5, 0.3
BENDING = {"a": A, "b": B, "thickness": 0.3, "youngs_modulus": 10.0, "poisson": NU}
D = 10.0 * 0.3**3 / (12.0 * (1.0 - NU**2))
FLAT = np.array([[0.0, 0.0, 0.0], [A, 0.0, 0.0], [A, 0.0, B], [0.0, 0.0, B]])
GRAIN: dict[str, Any] = {"youngs_modulus": (10.0, 4.0), "poisson": 0.4, "shear_modulus": 2.0}
ASKEW = GRAIN | {"angle": 0.6}
KINDS: list[dict[str, Any]] = [
    {},
    {"membrane": True},
    {"membrane": "xs"},
    ASKEW | {"membrane": True},
    ASKEW | {"membrane": "xs", "creases": (0.5, 0.1)},
]
CURLED = ASKEW | {"membrane": True, "curl": (0.3, -0.2, 0.1)}
SIZES = [1e-3, 0.1, 0.3, 1.0]


def element(**options: Any) -> CompiledMechanism:
    """Four floating bodies with a plate between them."""
    m = Mechanism()
    nodes = [m.body(f"n{i}", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0)) for i in range(4)]
    m.element(Plate(**(BENDING | options)), *nodes)
    return CompiledMechanism(m)


def pressed(p: Any) -> CompiledMechanism:
    """Four floating bodies with a pressure between them."""
    m = Mechanism()
    nodes = [m.body(f"n{i}", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0)) for i in range(4)]
    m.pressure("wind", p, [nodes])
    return CompiledMechanism(m)


def bent(compiled: CompiledMechanism, size: float, seed: int = 0) -> Any:
    """Positions (28,) with every motion of every node off by about ``size``."""
    rng, q = np.random.default_rng(seed), compiled.assembly.start_positions()
    q.reshape(4, 7)[:, :3] = FLAT
    compiled.system.apply(q, size * rng.normal(size=24))
    return q


def quaternion(R: Any) -> Any:
    """Unit quaternion of a rotation matrix, scalar first."""
    K = np.array([[R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]])
    S = R + R.T - np.trace(R) * np.eye(3)
    N = np.block([[np.trace(R) * np.ones((1, 1)), K], [K.T, S]])
    return np.linalg.eigh(N)[1][:, -1]


def posed(r: Any, A_: Any) -> Any:
    """Positions (28,) of four bodies from their origins and orientations."""
    return np.concatenate([np.concatenate((x, quaternion(R))) for x, R in zip(r, A_, strict=True)])


def curved(curvatures: Any) -> Any:
    """Positions (28,) on w = (kx x^2 + kz z^2) / 2 + kxz x z, small."""
    kx, kz, kxz = curvatures
    x, z = FLAT[:, 0], FLAT[:, 2]
    r = FLAT + np.outer(0.5 * (kx * x * x + kz * z * z) + kxz * x * z, (0, 1, 0))
    frames = []
    for wx, wz in zip(kx * x + kxz * z, kz * z + kxz * x, strict=True):
        n = np.array([-wx, 1.0, -wz]) / np.sqrt(1.0 + wx * wx + wz * wz)
        ex = np.cross(n, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(n, (0.0, 0.0, 1.0)))
        frames.append(np.column_stack((ex, n, np.cross(ex, n))))
    return posed(r, frames)


def wrenches(compiled: CompiledMechanism, q: Any, v: Any = None) -> Any:
    """Applied wrenches (4, 6) about the origins, global axes."""
    update_kinematics(0.0, q, np.zeros(24) if v is None else v, *compiled.kernel_data)
    return compiled.data.state.bodies["F"][1:].copy()


def joint_axes(compiled: CompiledMechanism) -> list[Any]:
    """For each body, the 6x6 matrix from motions (dr, phi) in global axes to the floating joint's velocities."""
    out = []
    for body in compiled.data.state.bodies[1:]:
        T = np.eye(6)
        T[3:, 3:] = body["A"].T.real
        out.append(T)
    return out


def complex_columns(compiled: CompiledMechanism, q: Any, function: Any) -> Any:
    """Derivative of ``function(q, system)`` along the 24 motions of the nodes, by complex step."""
    system = compiled.complex_system()
    wrenches(compiled, q)
    columns = []
    for i, T in enumerate(joint_axes(compiled)):
        for k in range(6):
            moved, step = q.astype(complex), np.zeros(24, complex)
            step[6 * i : 6 * i + 6] = 1j * E * T[:, k]
            system.apply(moved, step)
            columns.append(np.imag(function(moved, system)) / E)
    return np.array(columns).T


def complex_wrenches(q: Any, system: Any) -> Any:
    update_kinematics(0.0, q, np.zeros(24, complex), *unpin(system.pinned_data))
    return system.data.state.bodies["F"][1:].reshape(-1)


def complex_energy(q: Any, system: Any) -> Any:
    return energy(0.0, q, np.zeros(24, complex), system.pinned_data)


def tangent_of(compiled: CompiledMechanism, c1: float, K: Any) -> None:
    """Add to K the tangent of the only load where it is."""
    _, state = compiled.kernel_data
    arrays = pin(compiled._elements.tangent_arrays())
    twin = pin(to_complex_state(compiled.data.state))
    load_tangent(compiled.data.arrays.loads[0], c1, arrays, state, twin, K)


@pytest.mark.parametrize("b", [0.4, 1.5, 2.0])
@pytest.mark.parametrize("material", [{}, GRAIN, ASKEW])
def test_bending_is_the_rectangle_of_adini_clough_and_melosh(b: float, material: dict[str, Any]) -> None:
    """Half u.K u for any u: the element uses u minus the tilt of the mean plane, which has no energy."""
    u = np.random.default_rng(0).normal(size=(4, 3))
    compiled = element(b=b, **material)
    moduli = grain(**material) * 0.3**3 / 12.0 if material else isotropic(D, NU)
    K = acm_stiffness(A, b, moduli)
    w = u[:, 0]
    tilt = (w[1] - w[0] + w[2] - w[3]) / (2 * A), (w[3] - w[0] + w[2] - w[1]) / (2 * b)
    plate = compiled.records(Plate)[0]
    e, s = np.zeros(12), np.zeros(12)
    bending_strain(plate, u[:, 1:] - tilt, 0.25 * (w[0] - w[1] + w[2] - w[3]), e)
    stress(plate, e, 1.0, s)
    assert 0.5 * s @ e == pytest.approx(0.5 * u.reshape(-1) @ K @ u.reshape(-1), rel=1e-13)


@pytest.mark.parametrize("phi", [1e-3, 0.2, 1.0])
def test_cylinder_bending_is_exact_at_any_angle(phi: float) -> None:
    """Nodes on a circular arc of length a: energy D kappa^2 a b / 2 with kappa = phi / a."""
    radius = A / phi
    angles = np.array([-0.5, 0.5, 0.5, -0.5]) * phi
    r = np.column_stack((radius * np.sin(angles), radius * (1.0 - np.cos(angles)), FLAT[:, 2]))
    turned = [np.array([[np.cos(x), -np.sin(x), 0], [np.sin(x), np.cos(x), 0], [0, 0, 1]]) for x in angles]
    expected = 0.5 * D * (phi / A) ** 2 * A * B
    assert element().energy(0.0, posed(r, turned), np.zeros(24)) == pytest.approx(expected, rel=1e-9)


def test_arc_of_unchanged_length_has_no_membrane_strain_to_fourth_order() -> None:
    """The chord is shorter by what the von Karman terms add."""

    def strain(phi: float) -> float:
        radius, compiled = A / phi, element(membrane=True)
        angles = np.array([-0.5, 0.5, 0.5, -0.5]) * phi
        r = np.column_stack((radius * np.sin(angles), radius * (1.0 - np.cos(angles)), FLAT[:, 2]))
        turned = [np.array([[np.cos(x), -np.sin(x), 0], [np.sin(x), np.cos(x), 0], [0, 0, 1]]) for x in angles]
        wrenches(compiled, posed(r, turned))
        scratch = compiled.data.state.scratch[: PLATE_SCRATCH.itemsize].view(PLATE_SCRATCH)
        return float(scratch["strain"][0, 9])

    assert abs(strain(0.2)) < 0.2**4
    assert strain(0.4) / strain(0.2) == pytest.approx(16.0, rel=0.05)


@pytest.mark.parametrize(
    ("curvature", "energy_density"),
    [
        ((1.0, 0.0, 0.0), 0.5),
        ((0.0, 1.0, 0.0), 0.5),
        ((1.0, 1.0, 0.0), 1.0 + NU),
        ((1.0, -1.0, 0.0), 1.0 - NU),
        ((0.0, 0.0, 1.0), 1.0 - NU),
    ],
)
def test_constant_curvature_patch(curvature: Any, energy_density: float) -> None:
    """w = (kx x^2 + kz z^2) / 2 + kxz x z, small: energy D a b times the closed form."""
    expected = energy_density * D * 1e-8 * A * B
    assert element().energy(0.0, curved(1e-4 * np.array(curvature)), np.zeros(24)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("b", [0.4, 1.5])
@pytest.mark.parametrize("angle", [0.0, 0.3, 0.5 * np.pi, 2.0])
def test_membrane_is_plane_stress_of_the_strains_that_are_resisted(angle: float, b: float) -> None:
    """The others go with no stress: the inverse of their part of the compliance."""
    S = np.linalg.inv(grain(**GRAIN, angle=angle))
    for strains in ("x", "z", "s", "xz", "xs", "zs", "xzs"):
        plate = element(b=b, membrane=strains, angle=angle, **GRAIN).records(Plate)[0]
        at = ["xzs".index(strain) for strain in strains]
        expected = np.zeros((3, 3))
        expected[np.ix_(at, at)] = np.linalg.inv(S[np.ix_(at, at)]) * 0.3 * A * b
        found = []
        for unit in np.eye(12)[9:]:
            s = np.zeros(12)
            stress(plate, unit, 1.0, s)
            assert not s[:9].any()
            found.append(s[9:])
        np.testing.assert_allclose(found, expected, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize("angle", [0.0, 0.5 * np.pi, -np.pi])
def test_a_grain_along_the_sides_couples_nothing(angle: float) -> None:
    plate = element(membrane=True, angle=angle, **GRAIN).records(Plate)[0]
    assert plate["grain"] == 1
    assert not plate["oblique"].any()


def test_a_grain_that_does_not_matter_is_that_of_an_isotropic_plate() -> None:
    """Equal moduli along and across, the shear modulus by default: the angle changes nothing."""
    plain = element(membrane=True).records(Plate)[0]
    turned = element(membrane=True, youngs_modulus=(10.0, 10.0), angle=0.7).records(Plate)[0]
    for key in ("bending", "coupling", "stretching"):
        np.testing.assert_allclose(turned[key], plain[key], rtol=1e-14)
    assert np.abs(turned["oblique"]).max() < 1e-14 * plain["stretching"].max()


@pytest.mark.parametrize("phi", [1e-3, 0.2, 1.0])
@pytest.mark.parametrize("kind", [{}, GRAIN, ASKEW])
def test_a_plate_curled_to_a_cylinder_rests_there_at_any_angle(kind: dict[str, Any], phi: float) -> None:
    """Neither energy nor forces on the arc of its natural curvature, towards y where that is positive."""
    radius = A / phi
    angles = np.array([-0.5, 0.5, 0.5, -0.5]) * phi
    r = np.column_stack((radius * np.sin(angles), radius * (1.0 - np.cos(angles)), FLAT[:, 2]))
    turned = [np.array([[np.cos(x), -np.sin(x), 0], [np.sin(x), np.cos(x), 0], [0, 0, 1]]) for x in angles]
    compiled, flat = element(curl=(phi / A, 0.0, 0.0), **kind), element(**kind)
    bent = flat.energy(0.0, posed(r, turned), np.zeros(24))
    assert abs(compiled.energy(0.0, posed(r, turned), np.zeros(24))) < 1e-13 * bent
    rest = np.abs(wrenches(compiled, posed(r, turned))).max()
    assert rest < 1e-12 * np.abs(wrenches(flat, posed(r, turned))).max()


@pytest.mark.parametrize("kind", [{}, ASKEW])
@pytest.mark.parametrize("curl", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, -0.4, 0.3)])
def test_energy_of_a_curled_plate_is_that_of_the_curvatures_that_are_left(kind: dict[str, Any], curl: Any) -> None:
    """w = (kx x^2 + kz z^2) / 2 + kxz x z, small: energy (k - curl) D (k - curl) a b / 2."""
    own, k = 1e-4 * np.array(curl), 1e-4 * np.array([0.5, 0.2, -0.7])
    moduli = grain(**kind) * 0.3**3 / 12.0 if kind else isotropic(D, NU)
    compiled = element(curl=tuple(own), **kind)
    left = (k - own) * (1.0, 1.0, 2.0)
    assert compiled.energy(0.0, curved(k), np.zeros(24)) == pytest.approx(0.5 * left @ moduli @ left * A * B, rel=1e-6)
    assert abs(compiled.energy(0.0, curved(own), np.zeros(24))) < 1e-7 * 0.5 * left @ moduli @ left * A * B


def test_a_crease_is_a_hinge_in_series_with_the_plate() -> None:
    """Of the moment on a strip that is free at its sides: a / EI + 1 / k; and the twist does not feel it."""
    k = 3.0
    for kind, moduli in (({}, isotropic(D, NU)), (ASKEW, grain(**ASKEW) * 0.3**3 / 12.0)):
        softer = np.linalg.inv(np.linalg.inv(moduli) + np.diag((1.0 / (k * A), 0.0, 0.0)))
        EI = 1.0 / np.linalg.inv(moduli)[0, 0]
        assert A * np.linalg.inv(softer)[0, 0] == pytest.approx(A / EI + 1.0 / k, rel=1e-12)
        compiled = element(creases=(1.0 / k, 0.0), **kind)
        for c in np.eye(3) * 1e-4:
            own = c * (1.0, 1.0, 2.0)
            expected = 0.5 * own @ softer @ own * A * B
            assert compiled.energy(0.0, curved(c), np.zeros(24)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_rigid_motion_stores_nothing_and_turning_about_the_normal_costs_nothing(kind: dict[str, Any]) -> None:
    rng, compiled = np.random.default_rng(1), element(damping=0.1, **kind)
    for _ in range(5):
        R, r0, w, u = random_rotation(rng), rng.normal(size=3), rng.normal(size=3), rng.normal(size=3)
        r = FLAT @ R.T + r0
        frames = []
        for angle in rng.uniform(-3, 3, 4):
            c, s = np.cos(angle), np.sin(angle)
            frames.append(R @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
        v = np.concatenate([np.concatenate((u + np.cross(w, x), F.T @ w)) for x, F in zip(r, frames, strict=True)])
        assert compiled.energy(0.0, posed(r, frames), np.zeros(24)) < 1e-28
        np.testing.assert_allclose(wrenches(compiled, posed(r, frames), v), 0.0, atol=1e-13)


@pytest.mark.parametrize("kind", [*KINDS, CURLED])
@pytest.mark.parametrize("size", SIZES)
def test_forces_are_minus_the_gradient_of_the_energy(kind: dict[str, Any], size: float) -> None:
    compiled = element(**kind)
    q = bent(compiled, size)
    F = wrenches(compiled, q).reshape(-1)
    slope = complex_columns(compiled, q, complex_energy)
    np.testing.assert_allclose(F, -slope, rtol=0, atol=1e-12 * np.abs(F).max())


@pytest.mark.parametrize("kind", [*KINDS, CURLED])
@pytest.mark.parametrize("size", SIZES)
def test_stiffness_is_the_derivative_of_the_forces(kind: dict[str, Any], size: float) -> None:
    compiled = element(**kind)
    q, K = bent(compiled, size), np.zeros((24, 24))
    wrenches(compiled, q)
    tangent_of(compiled, 0.0, K)
    np.testing.assert_allclose(K, -complex_columns(compiled, q, complex_wrenches), rtol=0, atol=1e-13 * np.abs(K).max())


@pytest.mark.parametrize("kind", [*KINDS, CURLED])
def test_damping_is_the_derivative_of_the_forces_by_velocities(kind: dict[str, Any]) -> None:
    compiled = element(damping=0.2, **kind)
    q, C = bent(compiled, 0.3), np.zeros((24, 24))
    rest, Y = wrenches(compiled, q), np.random.default_rng(3).normal(size=24)
    K = np.zeros((24, 24))
    tangent_of(compiled, 0.0, K)
    tangent_of(compiled, 1.0, C)
    C -= K
    v = np.concatenate([T @ Y[6 * i : 6 * i + 6] for i, T in enumerate(joint_axes(compiled))])
    np.testing.assert_allclose((rest - wrenches(compiled, q, v)).reshape(-1), C @ Y, atol=1e-13 * np.abs(C).max())
    assert np.linalg.eigvalsh(0.5 * (C + C.T)).min() > -1e-13 * np.abs(C).max()
    np.testing.assert_allclose(C, C.T, atol=1e-13 * np.abs(C).max())


@pytest.mark.parametrize("kind", [*KINDS, CURLED, {"membrane": True, "damping": 0.1}])
def test_a_turned_element_has_turned_forces(kind: dict[str, Any]) -> None:
    rng, compiled = np.random.default_rng(4), element(**kind)
    q, v = bent(compiled, 0.3), rng.normal(size=24)
    F = wrenches(compiled, q, v)
    bodies = compiled.data.state.bodies[1:]
    r, frames, Y = bodies["r"].copy(), bodies["A"].copy(), bodies["Y"].copy()
    R, r0 = random_rotation(rng), rng.normal(size=3)
    turned = posed(r @ R.T + r0, R @ frames)
    moved = np.concatenate([np.concatenate((R @ y[:3], A_.T @ y[3:])) for y, A_ in zip(Y, frames, strict=True)])
    G = wrenches(compiled, turned, moved)
    np.testing.assert_allclose(G[:, :3], F[:, :3] @ R.T, atol=1e-12)
    np.testing.assert_allclose(G[:, 3:], F[:, 3:] @ R.T, atol=1e-12)


@pytest.mark.parametrize("kind", [*KINDS, CURLED, {"membrane": True, "damping": 0.1}])
@pytest.mark.parametrize("size", SIZES)
def test_forces_and_moments_of_an_element_balance(kind: dict[str, Any], size: float) -> None:
    compiled = element(**kind)
    F = wrenches(compiled, bent(compiled, size), np.random.default_rng(5).normal(size=24))
    r = compiled.data.state.bodies["r"][1:]
    np.testing.assert_allclose(F[:, :3].sum(axis=0), 0.0, atol=1e-13)
    np.testing.assert_allclose((F[:, 3:] + np.cross(r, F[:, :3])).sum(axis=0), 0.0, atol=1e-13)


@pytest.mark.parametrize("kind", [{"damping": 0.3}, {"damping": 0.3, "membrane": True}, {"drag": 2.0}])
def test_damping_and_drag_take_power_at_every_motion(kind: dict[str, Any]) -> None:
    compiled = element(**kind)
    for seed in range(20):
        q, v = bent(compiled, 0.3, seed), np.random.default_rng(seed).normal(size=24)
        rest = wrenches(compiled, q)
        F = wrenches(compiled, q, v) - rest
        assert np.sum(F * compiled.data.state.bodies["Y"][1:]) < 0.0


def test_drag_of_a_plate_across_the_wind() -> None:
    """Pressure rho c v^2 / 2 on the area, against the motion; none along the plane."""
    compiled = element(drag=1.2)
    q, v = bent(compiled, 0.0), np.tile((7.0, 3.0, -2.0, 0, 0, 0), 4)
    F = wrenches(compiled, q, v) - wrenches(compiled, q)
    np.testing.assert_allclose(F.sum(axis=0)[:3], (0.0, -0.5 * 1.2 * 9.0 * A * B, 0.0), rtol=1e-13)


def surface(r: Any) -> Any:
    """Points (49, 3), vector areas (49, 3), shape functions (49, 4) of the bilinear surface over corners (4, 3)."""
    x, weights = np.polynomial.legendre.leggauss(7)
    X, Z = (grid.reshape(-1) for grid in np.meshgrid(x, x))
    N = np.array([0.25 * (1 + cx * X) * (1 + cz * Z) for cx, cz in CORNERS]).T
    by_x = np.array([0.25 * cx * (1 + cz * Z) for cx, cz in CORNERS]).T @ r
    by_z = np.array([0.25 * cz * (1 + cx * X) for cx, cz in CORNERS]).T @ r
    return N @ r, np.cross(by_z, by_x) * np.outer(weights, weights).reshape(-1, 1), N


@pytest.mark.parametrize("size", [0.0, *SIZES])
def test_pressure_loads_corners_by_the_volume_they_sweep(size: float) -> None:
    compiled = pressed(3.0)
    F = wrenches(compiled, bent(compiled, size))
    r = compiled.data.state.bodies["r"][1:]
    points, areas, N = surface(r)
    np.testing.assert_allclose(F[:, :3], 3.0 * N.T @ areas, atol=1e-13)
    np.testing.assert_allclose(np.cross(r, F[:, :3]).sum(axis=0), 3.0 * np.cross(points, areas).sum(axis=0), atol=1e-12)
    assert not F[:, 3:].any()
    if size == 0.0:
        np.testing.assert_allclose(F[:, :3], np.tile((0.0, 0.25 * 3.0 * A * B, 0.0), (4, 1)), atol=1e-15)


@pytest.mark.parametrize("size", SIZES)
def test_stiffness_of_a_pressure_is_the_derivative_of_its_forces(size: float) -> None:
    compiled = pressed(3.0)
    q, K = bent(compiled, size), np.zeros((24, 24))
    wrenches(compiled, q)
    tangent_of(compiled, 0.0, K)
    np.testing.assert_allclose(K, -complex_columns(compiled, q, complex_wrenches), rtol=0, atol=1e-14 * np.abs(K).max())


def test_pressure_is_a_signal() -> None:
    compiled = pressed(Polynomial((1.0, 2.0)))
    update_kinematics(3.0, bent(compiled, 0.0), np.zeros(24), *compiled.kernel_data)
    np.testing.assert_allclose(compiled.data.state.bodies["F"][1:, 1], 0.25 * 7.0 * A * B)
    with pytest.raises(UserError, match="magnitude of pressure 'wind' is nan"):
        pressed(float("nan"))


@pytest.mark.parametrize("theta", [1e-8, 1e-3, 0.0894, 0.0896, 0.3, 0.4509, 0.4511, 1.0, 2.0, 3.0])
def test_lean_of_a_normal_on_both_sides_of_its_series(theta: float) -> None:
    c = np.cos(theta)
    F, slope, bend = slope_factor(c)
    assert F == pytest.approx(theta / np.sin(theta), rel=1e-7 if theta < 1e-3 else 1e-13)
    shifted = slope_factor(complex(c, E))
    assert shifted[0].imag / E == pytest.approx(slope, rel=1e-12)
    assert shifted[1].imag / E == pytest.approx(bend, rel=1e-11)


def test_effects_that_are_off_are_absent() -> None:
    def plates(**options: Any) -> tuple[int, int, int]:
        compiled = element(**options)
        (plate,) = compiled.records(Plate)
        return int(plate["membrane"]), int(plate["damped"]), len(compiled.records(Drag))

    assert plates() == (0, 0, 0)
    assert plates(membrane="s", damping=0.1, drag=1.0) == (1, 1, 1)
    m = Mechanism()
    m.body("b", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    assert len(CompiledMechanism(m).data.arrays.loads) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"thickness": 0.0}, "thickness of a plate is 0.0"),
        ({"a": float("nan")}, "a of a plate is nan"),
        ({"poisson": 0.6}, "poisson of a plate is 0.6"),
        ({"damping": -1.0}, "damping of a plate is -1.0"),
        ({"drag": float("inf")}, "drag of a plate is inf"),
        ({"membrane": "xy"}, "membrane of a plate is 'xy'"),
        ({"membrane": 1.0}, "membrane of a plate is 1.0; allowed: True, False"),
        ({"youngs_modulus": (1.0, -1.0)}, "youngs_modulus E2 of a plate is -1.0"),
        ({"youngs_modulus": (1.0, 2.0, 3.0)}, "youngs_modulus of a plate is"),
        ({"youngs_modulus": (1.0, 4.0), "poisson": 0.5}, "poisson of a plate is 0.5 .* within 0.5"),
        ({"shear_modulus": 0.0}, "shear_modulus of a plate is 0.0"),
        ({"angle": float("nan")}, "angle of a plate is nan"),
        ({"curl": (1.0, 2.0)}, "curl of a plate is .* three finite curvatures"),
        ({"creases": (1.0, -2.0)}, "creases of a plate are .* not negative"),
    ],
)
def test_mistakes_in_a_plate_are_reported(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        element(**options)


@pytest.mark.parametrize("element", [Plate(**BENDING), "shell"])
@pytest.mark.parametrize(
    ("order", "lift", "message"),
    [
        ("adcb", 0.0, "from 'a' to 'd' the direction of its edge differs by 90"),  # clockwise
        (
            "acbd",
            0.0,
            "from 'c' to 'b' the direction of its edge differs by 180|from 'd' to 'a' the direction of its edge "
            "differs by 180",
        ),  # crossing
        ("bcda", 0.0, "the direction of its edge differs by 90"),  # begun at the wrong corner
        ("abcd", 2.0, "to 'c' the direction of its edge differs by 69"),  # a corner far out of the plane
        ("abcd", 0.2, ""),
    ],
)
def test_bodies_that_do_not_span_a_plate_are_named(element: Any, order: str, lift: float, message: str) -> None:
    a, b = BENDING["a"], BENDING["b"]
    corners = np.array([(0.0, 0.0, 0.0), (a, 0.0, 0.0), (a, 0.0, b), (0.0, 0.0, b)])
    if element == "shell":
        element = Shell(corners=corners, stretching=1e6 * np.eye(3), bending=np.eye(3))
    places = corners + np.outer([0, 0, 1, 0], [0, lift * max(a, b), 0])
    m = Mechanism()
    inertia: dict[str, Any] = {"mass": 1.0, "inertia": (1.0, 1.0, 1.0)}
    nodes = {
        name: m.body(name, m.ground, Floating(at=place, start=(0, 0, 0, 1, 0, 0, 0)), **inertia)
        for name, place in zip("abcd", places, strict=True)
    }
    m.element(element, *(nodes[name] for name in order))
    if not message:
        CompiledMechanism(m).assemble()
        return
    with pytest.raises(UserError, match=f"corners of a plate are .*({message}).*; allowed: at most 45"):
        CompiledMechanism(m).assemble()
    with pytest.raises(UserError, match="corners of a plate are"):
        equilibrium(m)


def test_bodies_at_one_place_span_no_plate() -> None:
    m = Mechanism()
    nodes = [m.body(f"n{i}", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0)) for i in range(4)]
    m.element(Plate(**BENDING), *nodes)
    with pytest.raises(UserError, match="from 'n0' to 'n1' the direction of its edge differs by 90"):
        CompiledMechanism(m).assemble()


def test_corners_are_four_bodies_of_the_mechanism() -> None:
    m = Mechanism()
    a = m.body("a", m.ground, Floating(), mass=1.0)
    with pytest.raises(UserError, match="it needs 4 different bodies"):
        m.element(Plate(**BENDING), a, a, m.ground, a)
    with pytest.raises(UserError, match=r"corners of a face of pressure 'wind' are .* it needs 4 different bodies"):
        m.pressure("wind", 1.0, [(a, a, m.ground, a)])
