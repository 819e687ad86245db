"""Mechanisms on wheels that roll without slip, against closed forms: turntable, trolley, skate, far from the origin."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import mbfmu as mb

G = 9.81


def trolley(left: Any, right: Any, grips: tuple[str, str] = ("both", "longitudinal")) -> mb.Mechanism:
    """An axle of track 1.2 m with two wheels of radius 0.3 m on it, moving in the plane z = 0."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    axle = m.body("axle", m.ground, mb.Planar(at=(0.0, 0.0, 0.3)), mass=20.0, inertia=(2.0, 1.5, 3.0))
    m.output("x", axle.position("x"))
    m.output("y", axle.position("y"))
    m.output("yaw", axle.coordinate(2))
    for name, y, drive, grip in zip(("left", "right"), (0.6, -0.6), (left, right), grips, strict=True):
        options = {"rate": drive} if isinstance(drive, float) else {"drive": drive}
        joint = mb.Revolute(axis="y", at=(0.0, y, 0.0), **options)
        wheel = m.body(name, axle, joint, mass=2.0, inertia=(0.05, 0.09, 0.05))
        m.cut(f"{name}.tire", mb.RollingWheel(radius=0.3, grip=grip), m.ground, wheel)
    return m


@pytest.mark.parametrize(("size", "solver"), [(1e-3, "adams"), (1.0, "ida"), (1e3, "radau")])
def test_a_ball_on_a_turntable_moves_in_a_circle(size: float, solver: str) -> None:
    """A torus without a hole is a ball. On a table with the rate w its center has v' = 2/7 w n x v, whatever its spin.

    The table is inclined with the gravity, and the axle of the torus, which means nothing for a ball, is turned.
    """
    w, R, v, x = 2.0, 0.1 * size, 0.3 * size, 0.5 * size
    turned = Rotation.from_rotvec((0.4, -0.7, 0.2))
    n, axle = turned.apply((0.0, 0.0, 1.0)), turned.apply((1.0, 0.2, 0.0))
    m = mb.Mechanism(gravity=-G * size * n)
    table = m.body("table", m.ground, mb.Revolute(axis=n, drive=mb.Polynomial((0.0, w))), mass=1.0, inertia=(1, 1, 1))
    start, rate = turned.apply((x, 0.0, R)), turned.apply(((0.0, v, 0.0), ((w * x - v) / R, 0.0, 0.0)))
    joint = mb.Floating(start=(*start, 1.0, 0.0, 0.0, 0.0), rate=rate.ravel())
    ball = m.body("ball", m.ground, joint, mass=3.0, inertia=(1.2 * R**2,) * 3)
    m.cut("contact", mb.RollingWheel(radius=R, crown_radius=R, normal=n, axis=axle), table, ball)
    for way in "xyz":
        m.output(way, ball.position(way))
    found = mb.simulate(m, 3.0, interval=0.1, solver=solver, tolerance=1e-9)
    assert not found.failure
    assert not found.diagnostics
    phase, radius = 2.0 / 7.0 * w * found.t, v / (2.0 / 7.0 * w)
    local = np.stack([x + radius * (np.cos(phase) - 1.0), radius * np.sin(phase), np.full(len(phase), R)], axis=1)
    place = np.stack([found[way] for way in "xyz"], axis=1)
    np.testing.assert_allclose(place / size, turned.apply(local) / size, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("driven", [False, True])
@pytest.mark.parametrize("grips", [("both", "longitudinal"), ("both", "both")])
def test_a_trolley_follows_the_circle_that_its_wheels_roll(driven: bool, grips: tuple[str, str]) -> None:
    """v = R (w_l + w_r) / 2, yaw' = R (w_r - w_l) / track; both are kept if nothing drives or brakes.

    Of two wheels on one axle the second one has a redundant lateral constraint.
    """
    speeds = (2.0, 3.0)
    m = trolley(*(mb.Polynomial((0.0, w)) if driven else w for w in speeds), grips)
    result = mb.simulate(m, 4.0, tolerance=1e-9)
    v, turning = 0.3 * sum(speeds) / 2.0, 0.3 * (speeds[1] - speeds[0]) / 1.2
    angle = turning * result.t
    np.testing.assert_allclose(result["yaw"], angle, atol=1e-8)
    np.testing.assert_allclose(result["x"], v / turning * np.sin(angle), atol=1e-7)
    np.testing.assert_allclose(result["y"], v / turning * (1.0 - np.cos(angle)), atol=1e-7)
    codes = {d.code for d in result.diagnostics}
    assert ("redundant-constraints" in codes) == (grips[1] == "both")
    assert codes <= {"redundant-constraints", "changed-start", "removed-constraints"}


def test_a_skate_slides_along_its_edge_and_turns_freely() -> None:
    """A knife edge under the center of mass on an incline moves on a cycloid (Neimark and Fufaev 1972, chapter 1)."""
    slope, spin, t = 0.2, 1.3, 5.0
    m = mb.Mechanism(gravity=(G * np.sin(slope), 0.0, -G * np.cos(slope)))
    body = m.body("skate", m.ground, mb.Planar(rate=(0.0, 0.0, spin)), mass=3.0, inertia=(0.3, 0.3, 0.4))
    m.cut("edge", mb.RollingWheel(radius=0.1, grip="lateral", at_a=(0.0, 0.0, -0.1)), m.ground, body)
    m.output("x", body.position("x"))
    m.output("y", body.position("y"))
    result = mb.simulate(m, t, tolerance=1e-9)
    angle, radius = spin * result.t, G * np.sin(slope) / (2.0 * spin**2)
    np.testing.assert_allclose(result["x"], radius * np.sin(angle) ** 2, atol=1e-7)
    np.testing.assert_allclose(result["y"], radius * (angle - 0.5 * np.sin(2.0 * angle)), atol=1e-7)


@pytest.mark.parametrize("crown", [0.0, 0.05])
@pytest.mark.parametrize("chain", [False, True])
@pytest.mark.parametrize("far", [1.0, 1e3, 1e6])
def test_a_wheel_that_starts_far_from_the_point_of_its_plane_has_all_constraints(
    far: float, chain: bool, crown: float
) -> None:
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    carrier = m.ground
    if chain:
        for axis, start in (("x", far), ("y", -2.0 * far)):
            carrier = m.body(axis, carrier, mb.Translational(axis=axis, start=start))
        joint: Any = mb.Translational(axis="z", start=0.3)
        carrier = m.body("z", carrier, joint)
        wheel = m.body("wheel", carrier, mb.Spherical(), mass=2.0, inertia=(0.05, 0.09, 0.05))
    else:
        joint = mb.Floating(start=(far, -2.0 * far, 0.3, 1, 0, 0, 0))
        wheel = m.body("wheel", m.ground, joint, mass=2.0, inertia=(0.05, 0.09, 0.05))
    m.cut("road", mb.RollingWheel(radius=0.3, crown_radius=crown), m.ground, wheel)
    simulation = mb.Simulation(m, mb.Settings(solver="radau"))
    assert simulation.compiled.system.m == 3
    assert not [found for found in simulation.diagnostics if found.severity == "warning"]
