"""Rotors whose linearized motion has periodic coefficients: exponents against equations derived by hand and SciPy."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb

UNLIKE, ALIKE = (4.0, 8.0, 5.0), (4.0, 8.0, 8.0)  # kg m^2, about the spin axis and across it


def rotor(
    inertia: tuple[float, float, float],
    *,
    speed: float = 45.0,
    stiffness: float = 4000.0,
    damping: float = 0.0,
    others: int = 0,
    geared: float = 0.0,
) -> mb.Mechanism:
    """A rotor that a drive turns about x, on springs about two axes that do not turn with it."""
    m = mb.Mechanism()
    outer = m.body("outer", m.ground, mb.Revolute(axis="z"), mass=0.0)
    inner = m.body("inner", outer, mb.Revolute(axis="y"), mass=0.0)
    spin = mb.Revolute(axis="x", drive=mb.Polynomial((0.3, speed)))
    m.body("rotor", inner, spin, mass=10.0, inertia=inertia)
    for name, body in (("outer", outer), ("inner", inner)):
        m.force(f"spring {name}", mb.JointSpring(stiffness=stiffness, damping=damping), body)
    for k in range(others):
        wheel = m.body(f"wheel{k}", m.ground, mb.Revolute(axis="z"), mass=1.0, inertia=(1.0, 1.0, 1.0))
        m.force(f"spring{k}", mb.JointSpring(stiffness=1.0, damping=0.5), wheel)
    if geared:
        wheel = m.body("wheel", m.ground, mb.Revolute(axis="z"), mass=1.0, inertia=(1.0, 1.0, geared))
        m.couple("gear", mb.Gear(ratio=1.0), outer, wheel)
    m.output("angle", outer.angle())
    return m


def multipliers(inertia: Any, speed: float, stiffness: float, damping: float = 0.0, geared: float = 0.0) -> Any:
    """Of a, b, the angles of the outer and the inner axis, by the momenta p = dT/d(a', b') linearized.

    With J the inertia in axes that do not spin, p_a = J_zz a' + J_yz b' - A W b, p_b = J_yz a' + J_yy b', and
    p_a' = -k a - d a', p_b' = -k b - d b' - A W a'.
    """
    A, B, C = inertia

    def slope(t: float, flat: Any) -> Any:
        a, b, p_a, p_b = flat.reshape(4, 4)
        c, s = np.cos(0.3 + speed * t), np.sin(0.3 + speed * t)
        J = np.array([[B * s * s + C * c * c + geared, (B - C) * s * c], [(B - C) * s * c, B * c * c + C * s * s]])
        da, db = np.linalg.solve(J, np.array([p_a + A * speed * b, p_b]))
        return np.concatenate((da, db, -stiffness * a - damping * da, -stiffness * b - damping * db - A * speed * da))

    scale = np.sqrt(stiffness)
    found = solve_ivp(
        slope,
        (0.0, 2.0 * pi / abs(speed)),
        np.diag([1.0, 1.0, scale, scale]).ravel(),
        rtol=1e-12,
        atol=1e-13,
        method="DOP853",
    )
    return np.linalg.eigvals(found.y[:, -1].reshape(4, 4) @ np.diag([1.0, 1.0, 1.0 / scale, 1.0 / scale]))


def grown(state: mb.Equilibrium, period: float, count: int) -> Any:
    """Sizes of the multipliers of the modes, as many as there are of conjugate pairs too."""
    sizes = []
    for mode in state.modes:
        s = mode.eigenvalue
        alone = abs(s.imag) * period in (0.0, pytest.approx(pi))
        sizes += [np.exp(s.real * period)] * (1 if alone else 2)
    return np.sort(sizes)[-count:]


@pytest.mark.parametrize("size", [1.0, 1e-6, 1e6])
@pytest.mark.parametrize("speed", [45.0, 20.0, -45.0])
@pytest.mark.parametrize("damping", [0.0, 20.0])
def test_exponents_are_those_of_the_equations(size: float, speed: float, damping: float) -> None:
    inertia = tuple(size * x for x in UNLIKE)
    found = mb.equilibrium(rotor(inertia, speed=speed, stiffness=4000.0 * size, damping=damping * size))
    expected = multipliers(UNLIKE, speed, 4000.0, damping)
    assert found.periodic
    assert "periodic coefficients" in found.diagnostics[0].text
    assert grown(found, 2.0 * pi / abs(speed), 4) == pytest.approx(np.sort(np.abs(expected)), rel=1e-7)


def test_growth_of_the_rotor() -> None:
    found = mb.equilibrium(rotor(UNLIKE))
    expected = np.log(np.abs(multipliers(UNLIKE, 45.0, 4000.0)).max()) * 45.0 / (2.0 * pi)
    assert expected == pytest.approx(7.516, abs=1e-3)
    assert found.stability == "unstable"
    assert max(mode.eigenvalue.real for mode in found.modes) == pytest.approx(expected, rel=1e-8)
    assert mb.equilibrium(rotor(UNLIKE, damping=500.0)).stability == "stable"


@pytest.mark.parametrize("others", [57, 59])
def test_small_and_large_mechanisms_alike(others: int) -> None:
    """59 and 61 coordinates: the wheels know nothing of the rotor."""
    found = mb.equilibrium(rotor(UNLIKE, others=others))
    assert found.periodic
    assert found.stability == "unstable"
    expected = np.log(np.abs(multipliers(UNLIKE, 45.0, 4000.0)).max()) * 45.0 / (2.0 * pi)
    assert max(mode.eigenvalue.real for mode in found.modes) == pytest.approx(expected, rel=1e-8)


def test_a_rotor_on_a_gear() -> None:
    """A wheel geared to the outer axis adds its inertia; the gear is a constraint."""
    found = mb.equilibrium(rotor(UNLIKE, geared=2.0, damping=3.0))
    expected = multipliers(UNLIKE, 45.0, 4000.0, 3.0, geared=2.0)
    assert found.periodic
    assert max(mode.eigenvalue.real for mode in found.modes) == pytest.approx(
        np.log(np.abs(expected).max()) * 45.0 / (2.0 * pi), rel=1e-6
    )


@pytest.mark.parametrize("others", [0, 57, 59])
def test_a_rotor_that_is_alike_about_its_axis_is_constant(others: int) -> None:
    """B s^2 + (+-) i A W s + k = 0: the gyroscopic pair of frequencies."""
    found = mb.equilibrium(rotor(ALIKE, others=others))
    assert not found.periodic
    assert not found.diagnostics
    gyro = 4.0 * 45.0 / 8.0
    pair = [abs(x) for x in np.roots([1.0, gyro, -4000.0 / 8.0])]
    frequencies = [mode.frequency for mode in found.modes if mode.frequency > 5.0]
    assert frequencies == pytest.approx(sorted(pair), rel=1e-9)


def test_speeds_without_a_common_period() -> None:
    m = rotor(UNLIKE)
    m.body("fan", m.ground, mb.Revolute(axis="x", drive=mb.Polynomial((0.0, 45.0 * 2.0**0.5))), mass=1.0)
    found = mb.equilibrium(m)
    assert found.stability == "unknown"
    assert "no ratio of whole numbers" in found.diagnostics[0].text
    assert found.as_dict()["eigenvalues"] == []
    with pytest.raises(mb.EquilibriumError, match="no ratio of whole numbers"):
        _ = found.modes


def test_state_matrices_report_which_of_them_change() -> None:
    """An output of a point that goes round changes C alone; a rotor that is not alike about its axis changes A too."""
    for inertia, expected in ((ALIKE, ("C",)), (UNLIKE, ("A", "C"))):
        m = rotor(inertia)
        spinning = next(body for body in m.bodies if body.name == "rotor")
        m.output("tip", spinning.position("x", point=(0.0, 0.2, 0.0)))
        assert mb.linearize(m).periodic == expected
    assert mb.linearize(rotor(ALIKE)).periodic == ()


def on_two_hubs(
    speeds: tuple[float, float], stiffness: tuple[float, float], scale: float, carried: bool
) -> mb.Mechanism:
    """A mass that moves in a plane, on bushings to two hubs that turn, of which one may carry its slides."""
    m = mb.Mechanism()
    hubs = []
    for k, speed in enumerate(speeds):
        joint = mb.Revolute(drive=mb.Polynomial((0.0, speed)))
        hubs.append(m.body(f"hub{k}", m.ground, joint, mass=1.0, inertia=(1.0, 1.0, 1.0)))
    first = m.body("x", hubs[0] if carried else m.ground, mb.Translational(axis="x"))
    mass = m.body("y", first, mb.Translational(axis="y"), mass=scale)
    for k, (hub, sizes) in enumerate(zip(hubs, (stiffness, (50.0, 80.0)), strict=True)):
        m.force(f"bushing{k}", mb.Bushing(stiffness=(scale * sizes[0], scale * sizes[1], 0.0)), hub, mass)
    fixed = {"stiffness": (50.0 * scale, 50.0 * scale, 0.0), "damping": (0.2 * scale, 0.2 * scale, 0.0)}
    m.force("fixed", mb.Bushing(**fixed), m.ground, mass)
    return m


@pytest.mark.parametrize(("carried", "scale"), [(True, 1e-3), (False, 1e3)])
@pytest.mark.parametrize(
    ("parts", "base", "stiffness"),
    [
        ((3, -5), 5.0, (100.0, 100.0)),
        ((5, -3), 5.0, (100.0, 140.0)),
        ((1, -7), 8.0, (0.0, 0.0)),
        ((7, -9), 2.5, (100.0, 100.0)),
        ((1, 17), 1.0, (100.0, 140.0)),
        ((15, -17), 2.5, (100.0, 100.0)),
    ],
)
def test_harmonics_of_two_drives_are_not_mistaken_for_constants(
    parts: tuple[int, int], base: float, stiffness: tuple[float, float], carried: bool, scale: float
) -> None:
    """Samples at 16 times in the common period showed a harmonic of 16 as a constant.

    The reference integrates the mass in axes of the ground, by SciPy.
    """
    speeds = (base * parts[0], base * parts[1])
    period = np.pi / base  # bushings come back after half a turn

    def rates(t: float, y: Any) -> Any:
        K = np.diag([50.0, 50.0])
        for speed, sizes in zip(speeds, (stiffness, (50.0, 80.0)), strict=True):
            c, s = np.cos(speed * t), np.sin(speed * t)
            R = np.array([[c, -s], [s, c]])
            K = K + R @ np.diag(sizes) @ R.T
        A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -0.2 * np.eye(2)]])
        return np.asarray((A @ y.reshape(4, 4)).ravel())

    ends = solve_ivp(rates, (0.0, period), np.eye(4).ravel(), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    growth = np.log(np.abs(np.linalg.eigvals(ends.reshape(4, 4))).max()) / period
    mechanism = on_two_hubs(speeds, stiffness, scale, carried)
    found = mb.equilibrium(mechanism)
    assert found.stability == ("unstable" if growth > 0.0 else "stable")
    assert max(row.mode.eigenvalue.real for row in mb.modes(mechanism)) == pytest.approx(growth, abs=1e-5)
