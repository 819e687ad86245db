"""Dry friction on coordinates that slide together: a body on a plane, and a shaft that turns and slides."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.testing import check_element
from mbfmu.util.errors import UserError

G, MU, MASS, RADIUS = 9.81, 0.3, 2.0, 0.2
INERTIA = 0.5 * MASS * RADIUS**2  # of a disk about its axis
SIZES = [1e-3, 1.0, 1e3]


def puck(size: float, rate: Any, radius: float | None = None, **law: Any) -> mb.Mechanism:
    """A disk on a plane, with a force along the plane's first axis as an input; lengths and forces in ``size``."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G * size))
    joint = mb.Planar(rate=(rate[0] * size, rate[1] * size, rate[2]), nominal=(size, size, 1.0))
    body = m.body("puck", m.ground, joint, mass=MASS, inertia=(INERTIA * size**2,) * 3)
    own = {"radius": radius * size} if radius else {}
    given = {"coulomb": MU, "normal_force": MASS * G * size, "deflection": 1e-5 * size}
    m.force("friction", mb.PlanarFriction(**given | own | law), body)
    push = mb.Input(name="push", unit="N", start=0.0)
    m.force("push", mb.PointForce(magnitude=push, axis=(0.6, 0.8, 0.0)), body)
    m.output("energy", m.energy)
    return m


def run(m: mb.Mechanism, end: float, solver: str = "radau", tolerance: float = 1e-6) -> mb.Simulation:
    """Simulate until a time, s."""
    simulation = mb.Simulation(m, mb.Settings(solver=solver, tolerance=tolerance))
    simulation.advance(end)
    assert not simulation.inaccurate
    return simulation


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("follows_reaction", [False, True])
@pytest.mark.parametrize("solver", ["radau", "ida", "adams"])
def test_puck_slides_straight_and_sticks(solver: str, size: float, follows_reaction: bool) -> None:
    """In any direction of the plane it slides v^2 / (2 mu g), and sticks under less than mu m g."""
    law = {"normal_force": mb.Reaction()} if follows_reaction else {}
    stopped = run(puck(size, (1.2, 1.6, 0.0), **law), 1.0, solver)
    way = 2.0**2 / (2.0 * MU * G)
    assert stopped.stepper.q[:2] / size == pytest.approx([0.6 * way, 0.8 * way], abs=6e-5)
    if solver == "adams":
        return
    held = stopped.stepper.q.copy()
    stopped.set_input("push", 0.85 * MU * MASS * G * size)
    stopped.advance(3600.0)
    assert np.linalg.norm(stopped.stepper.q - held) / size < 2e-5  # the deflection
    stopped.set_input("push", 1.5 * MU * MASS * G * size)
    stopped.advance(3601.0)
    moved = (stopped.stepper.q - held)[:2] / size
    assert moved == pytest.approx(0.5 * 0.5 * MU * G * np.array([0.6, 0.8]), abs=np.sqrt(8.0 * MU * G * 1e-5))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_puck_that_spins_slides_farther(solver: str, size: float) -> None:
    """Against m v' = -F v / s and I w' = -F r^2 w / s, s = (v^2 + (r w)^2)^(1/2), while it slides."""
    radius = 2.0 * RADIUS / 3.0

    def rates(_: float, y: Any) -> Any:
        v = y[3:] * [1.0, 1.0, radius]
        force = -MU * MASS * G * v / np.linalg.norm(v) * [1.0, 1.0, radius]
        return np.concatenate((y[3:], force / [MASS, MASS, INERTIA]))

    start = [0.0, 0.0, 0.0, 0.5, -1.0, 20.0]
    expected = solve_ivp(rates, (0.0, 0.5), start, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    assert np.linalg.norm(expected[3:5]) > 0.1  # it still slides
    found = run(puck(size, (0.5, -1.0, 20.0), radius), 0.5, solver)
    scale = np.array([size, size, 1.0])
    assert found.stepper.q / scale == pytest.approx(expected[:3], abs=2e-5)
    assert found.stepper.v[:3] / scale == pytest.approx(expected[3:], abs=1e-4)


@pytest.mark.parametrize("size", SIZES)
def test_shaft_that_turns_resists_little_along_its_axis(size: float) -> None:
    """F = mu N (r w, v) / (v^2 + (r w)^2)^(1/2), against SciPy; a shaft that does not turn sticks."""
    force = 0.5 * MU * 10.0  # along the axis, less than the friction force

    def shaft(spin: float) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
        joint = mb.Cylindrical(axis="z", rate=(spin, 0.0), nominal=(1.0, size))
        body = m.body("shaft", m.ground, joint, mass=MASS, inertia=(INERTIA * size**2,) * 3)
        law: dict[str, Any] = {"coulomb": MU, "normal_force": 10.0 * size}
        m.force("friction", mb.CylindricalFriction(radius=RADIUS * size, **law), body)
        m.force("push", mb.PointForce(magnitude=force * size, axis="z"), body)
        return m

    def rates(_: float, y: Any) -> Any:
        v = y[2:] * [RADIUS, 1.0]
        friction = -MU * 10.0 * v / np.linalg.norm(v) * [RADIUS, 1.0]
        return np.concatenate((y[2:], (friction + np.array([0.0, force])) / [INERTIA, MASS]))

    expected = solve_ivp(rates, (0.0, 1.0), [0.0, 0.0, 50.0, 0.0], method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    found = run(shaft(50.0), 1.0)
    assert found.stepper.q / [1.0, size] == pytest.approx(expected[:2], abs=1e-5)
    assert found.stepper.v[:2] / [1.0, size] == pytest.approx(expected[2:], abs=1e-4)
    assert abs(run(shaft(0.0), 1.0).stepper.q[1]) < 1e-5 * RADIUS * size


@pytest.mark.parametrize("part", [0.85, 1.15])
def test_torque_and_force_break_the_shaft_away_together(part: float) -> None:
    """It slides if ((T / r)^2 + F^2)^(1/2) exceeds mu N."""
    m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
    body = m.body("shaft", m.ground, mb.Cylindrical(axis="z"), mass=MASS, inertia=(INERTIA,) * 3)
    m.force("friction", mb.CylindricalFriction(coulomb=MU, normal_force=10.0, radius=RADIUS), body)
    m.force("push", mb.PointForce(magnitude=0.6 * part * MU * 10.0, axis="z"), body)
    m.force("turn", mb.Torque(magnitude=0.8 * part * MU * 10.0 * RADIUS, axis="z"), body)
    moved = run(m, 1.0).stepper.q[1]
    assert moved < 1e-5 if part < 1.0 else moved > 1e-3


def test_heat_is_the_energy_that_is_lost() -> None:
    stopped = run(puck(1.0, (0.5, -1.0, 20.0), RADIUS), 2.0)
    lost = 0.5 * MASS * 1.25 + 0.5 * INERTIA * 400.0
    assert stopped.stepper.energy_account[0] == pytest.approx(-lost, rel=1e-4)


def test_kernels_of_coordinates_that_slide_together() -> None:
    given: dict[str, Any] = {"coulomb": 1.0, "static": 1.5, "stribeck": 0.1, "viscous": 0.2, "deflection": 1e-2}
    for element in (
        mb.CylindricalFriction(**given, radius=0.3),
        mb.CylindricalFriction(**given, radius=0.3, normal_force="1 + x", uses={"x": 2.0}),
    ):
        assert check_element(element, bodies=1, states=3).passed, element
    for radius in (None, 0.3):
        m = mb.Mechanism(gravity=(1.0, -2.0, 3.0))
        arm = m.body("arm", m.ground, mb.Revolute(axis=(1.0, 2.0, 3.0)), mass=2.0, inertia=(1.0, 2.0, 1.5))
        sled = m.body(
            "sled", arm, mb.Planar(at=(0.3, 0.2, 0.1)), mass=1.0, com=(0.1, 0.2, 0.3), inertia=(0.5, 0.4, 0.3)
        )
        m.force("friction", mb.PlanarFriction(**given, radius=radius), sled)
        assert check_element(m, states=3).passed, radius


def test_refusals() -> None:
    m = mb.Mechanism()
    shaft = m.body("shaft", m.ground, mb.Cylindrical(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    with pytest.raises(UserError, match="needs a Planar joint; the joint of 'shaft' is a Cylindrical with 2"):
        m.force("f", mb.PlanarFriction(coulomb=1.0), shaft)
    with pytest.raises(UserError, match="radius of force 'f' is 0"):
        m.force("f", mb.CylindricalFriction(coulomb=1.0, radius=0.0), shaft)
    with pytest.raises(UserError, match="has a radius; allowed for this joint: length, preload, on"):
        m.force("f", mb.CylindricalFriction(coulomb=1.0, radius=0.1, normal_force=mb.Reaction(radius=0.1)), shaft)
    with pytest.raises(UserError, match="needs a Cylindrical joint"):
        m.force("f", mb.CylindricalFriction(coulomb=1.0, radius=0.1), m.body("arm", shaft, mb.Revolute(), mass=1.0))
