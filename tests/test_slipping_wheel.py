"""Wheels that slip and lift, against closed forms and Newton and Euler's equations by SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.util.errors import UserError

G, MU = 9.81, 0.3
SIZES = [1e-3, 1.0, 1e3]
MANY = 8  # wheels with 64 coordinates and states: a large model


def model(size: float, joint: Any, shape: float, crown: float = 0.0, slope: float = 0.0, **more: Any) -> mb.Mechanism:
    """A wheel of radius ``size`` and moment of inertia shape m R^2 whose weight deforms the contact by R / 1000.

    ``joint`` is the height of its center, m, if it cannot turn.
    """
    mass = 2.0 * size**3
    m = mb.Mechanism(gravity=(G * np.sin(slope), 0.0, -G * np.cos(slope)))
    inertia = shape * mass * size**2
    parent = m.ground
    if isinstance(joint, float):
        along = m.body("along", m.ground, mb.Translational(axis="x"))
        parent = m.body("across", along, mb.Translational(axis="y"))
        joint = mb.Translational(axis="z", start=joint)
    wheel = m.body("wheel", parent, joint, mass=mass, inertia=(inertia,) * 3)
    stiffness = 1e3 * mass * G * np.cos(slope) / size
    options = {"friction": MU, "damping": 3.0 / np.sqrt(G * size), "deflection": 1e-6 * size} | more
    contact = mb.SlippingWheel(radius=size, crown_radius=crown * size, stiffness=stiffness, **options)
    tire = m.force("tire", contact, wheel)
    for axis in "xyz":
        m.output(axis, wheel.position(axis))
        m.output(f"v{axis}", wheel.velocity(axis))
        m.output(f"w{axis}", wheel.angular_velocity(axis))
        m.output(f"F{axis}", tire.force(axis))
    return m


@pytest.mark.parametrize("solver", ["radau", "ida"])
@pytest.mark.parametrize("size", SIZES)
def test_a_ball_slides_until_it_rolls(size: float, solver: str) -> None:
    """The slip u keeps its direction: v = v0 - mu g t u / |u| until t = |u| / (mu g (1 + 1 / shape)), then v is kept.

    The path is a parabola, whose end is a straight line (Euler 1758).
    """
    speed, shape = np.sqrt(G * size), 0.4
    v0, w0 = np.array([1.0, 0.2]) * speed, np.array([0.9, -1.5, 0.0]) * speed / size
    slip = v0 + size * np.array([-w0[1], w0[0]])  # v + w x (-R n)
    start = (0.0, 0.0, 0.999 * size, 1.0, 0.0, 0.0, 0.0)
    m = model(size, mb.Floating(start=start, rate=(*v0, 0.0, *w0)), shape, crown=1.0)
    end = np.hypot(*slip) / (MU * G * (1.0 + 1.0 / shape))
    found = mb.simulate(m, 2.0 * end, interval=end / 10.0, solver=solver, tolerance=1e-8)
    assert not [d for d in found.diagnostics if d.severity == "warning"]
    assert not found.failure
    s, way = np.minimum(found.t, end), slip / np.hypot(*slip)
    for k, axis in enumerate("xy"):
        v = v0[k] - MU * G * s * way[k]
        x = v0[k] * s - 0.5 * MU * G * s**2 * way[k] + v * (found.t - s)
        np.testing.assert_allclose(found[axis] / size, x / size, atol=1e-5)
        np.testing.assert_allclose(found[f"v{axis}"] / speed, v / speed, atol=1e-4)
    np.testing.assert_allclose(found["z"] / size, 0.999, atol=1e-7)
    slides = (found.t > 0.05 * end) & (found.t < 0.95 * end)
    weight = 2.0 * size**3 * G
    np.testing.assert_allclose(np.hypot(found["Fx"], found["Fy"])[slides], MU * weight, rtol=1e-5)


class SlidingWheel:
    """Newton and Euler's equations of a wheel that slides on a plane of normal n, global axes, about its center.

    State: center (3), quaternion (4, scalar first), velocity (3), angular velocity (3).
    """

    def __init__(self, size: float, crown: float, n: Any, axle: Any) -> None:
        self.R, self.c, self.n, self.axle = size, crown * size, n, axle
        self.m, self.g = 2.0 * size**3, -G * n + 0.3 * G * np.cross(n, (0.3, 0.5, 0.7))
        self.k, self.damping = 300.0 * self.m * G / size, 0.5 / np.sqrt(G * size)
        self.A, self.C = 0.2 * self.m * size**2, 0.4 * self.m * size**2

    def lowest(self, e: Any) -> Any:
        """Return from the center to the lowest point."""
        down = -(self.n - (self.n @ e) * e)
        return (self.R - self.c) * down / np.linalg.norm(down) - self.c * self.n

    def slopes(self, _: float, x: Any) -> Any:
        """Return the derivative of the state."""
        v, w, turn = x[7:10], x[10:], Rotation.from_quat(x[3:7] / np.linalg.norm(x[3:7]), scalar_first=True)
        e = turn.apply(self.axle)
        r = self.lowest(e)
        depth, V = -self.n @ (x[:3] + r), v + np.cross(w, r)
        rate, slip = -self.n @ V, V - (self.n @ V) * self.n
        N = self.k * max(depth, 0.0) * max(1.0 + self.damping * rate, 0.0)
        F = N * (self.n - MU * slip / np.linalg.norm(slip))
        inertia = self.A * np.eye(3) + (self.C - self.A) * np.outer(e, e)
        dw = np.linalg.solve(inertia, np.cross(r, F) - np.cross(w, inertia @ w))
        turning = 0.5 * np.concatenate(([-w @ x[4:7]], x[3] * w + np.cross(w, x[4:7])))
        return np.concatenate((v, turning, F / self.m + self.g, dw))


@pytest.mark.parametrize(
    ("solver", "wheels"),
    [("adams", 1), ("radau", 1), ("ida", 1), ("adams", MANY), ("ida", MANY), ("esdirk", MANY)],
)
@pytest.mark.parametrize(("size", "crown"), [(1e-3, 0.2), (1.0, 0.0), (1e3, 0.4)])
def test_a_leaning_wheel_slides_as_by_newton_and_euler(size: float, crown: float, solver: str, wheels: int) -> None:
    """A disk or torus that slides all the time, of an axle and on a plane of any direction; alone, and the last of as
    many as make a large model.
    """
    rng = np.random.default_rng(17)
    n, axle = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
    first = np.cross(n, (1.0, 0.0, 0.0)) / np.hypot(n[1], n[2])
    across = (0.9 * first + 0.3 * n) / np.sqrt(0.9)
    turn, _ = Rotation.align_vectors(across[np.newaxis], axle[np.newaxis])
    ref, speed = SlidingWheel(size, crown, n, axle), np.sqrt(G * size)
    v, w = speed * (2.0 * np.cross(n, first) + 1.5 * first), speed / size * np.array([0.4, 0.3, -0.5])
    start = -ref.lowest(across) - 0.002 * size * n
    start = start - (n @ (start + ref.lowest(across)) + 0.003 * size) * n
    x = np.concatenate((start, turn.as_quat(scalar_first=True), v, w))
    times = np.linspace(0.0, 1.2 * size / speed, 7)
    exact = solve_ivp(ref.slopes, times[[0, -1]], x, "DOP853", times, rtol=1e-11, atol=1e-11 * speed * size)
    m = mb.Mechanism(gravity=ref.g)
    E = np.outer(axle, axle)
    joint = mb.Floating(start=x[:7], rate=(*v, *turn.inv().apply(w)))
    inertia = ref.A * np.eye(3) + (ref.C - ref.A) * E
    contact = mb.SlippingWheel(
        radius=size, crown_radius=ref.c, axis=axle, normal=n, stiffness=ref.k, damping=ref.damping, friction=MU,
        deflection=1e-4 * size,
    )  # fmt: skip
    for k in range(wheels):
        wheel = m.body(f"wheel{k}", m.ground, joint, mass=ref.m, inertia=inertia)
        m.force(f"tire{k}", contact, wheel)
    for axis in "xyz":
        m.output(axis, wheel.position(axis))
        m.output(f"w{axis}", wheel.angular_velocity(axis))
    tolerance = 1e-8 if solver == "adams" or wheels == 1 else 1e-6
    found = mb.simulate(m, times[-1], interval=times[1], solver=solver, tolerance=tolerance)
    assert not [d for d in found.diagnostics if d.severity == "warning"]
    for y in exact.y.T:
        r = ref.lowest(Rotation.from_quat(y[3:7], scalar_first=True).apply(axle))
        assert np.linalg.norm(y[7:10] + np.cross(y[10:], r)) > 0.1 * speed
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(found[axis] / size, exact.y[k] / size, atol=1e-4)
        np.testing.assert_allclose(found[f"w{axis}"] * size / speed, exact.y[10 + k] * size / speed, atol=1e-3)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("slope", [0.6, 0.9])
def test_a_wheel_on_an_incline_rolls_or_slides(size: float, slope: float) -> None:
    """It rolls if tan(slope) <= mu (1 + 1 / shape), with x'' = g sin / (1 + shape); else it slides."""
    shape = 0.5
    rolls = np.tan(slope) < MU * (1.0 + 1.0 / shape)
    assert rolls == (slope == 0.6)
    speed = 0.0 if rolls else np.sqrt(G * size)  # from rest the time until it slips is (d / g)^(1/2)
    start = (0.0, 0.0, 0.999 * size, 1.0, 0.0, 0.0, 0.0)
    m = model(size, mb.Floating(start=start, rate=(speed, 0.0, 0.0, 0.0, 0.0, 0.0)), shape, slope=slope)
    t = 3.0 * np.sqrt(size / G)
    found = mb.simulate(m, t, solver="radau", tolerance=1e-8)
    x = 0.5 * G * np.sin(slope) / (1.0 + shape) * t**2
    if not rolls:
        x = speed * t + 0.5 * G * (np.sin(slope) - MU * np.cos(slope)) * t**2
    np.testing.assert_allclose(found["x"][-1], x, atol=2e-5 * size)
    turned = x / size if rolls else 0.5 * MU * G * np.cos(slope) / (shape * size) * t**2
    np.testing.assert_allclose(found["wy"][-1] * t / 2.0, turned, rtol=1e-4)


@pytest.mark.parametrize("size", SIZES)
def test_a_braked_wheel_stands_on_a_slope_for_an_hour(size: float) -> None:
    """It cannot turn, and the slope is below that of 0.9 mu: it moves by a part of the deflection, and no farther."""
    m = model(size, 0.999 * size, 0.5, slope=np.arctan(0.8 * MU), deflection=1e-4 * size)
    found = mb.simulate(m, 3600.0, solver="radau", tolerance=1e-7)
    assert np.ptp(found["x"][found.t > 360.0]) < 1e-6 * 1e-4 * size
    np.testing.assert_allclose(found["x"][-1], 0.8e-4 * size, rtol=1e-3)


@pytest.mark.parametrize("size", SIZES)
def test_static_friction_holds_and_decreases_with_the_slip(size: float) -> None:
    """A braked wheel stands on a slope by static friction, and slides on a plane as by SciPy, in a direction that is no
    axis of the bristle.
    """
    speed, static = np.sqrt(G * size), 1.5
    law: dict[str, Any] = {"static": static * MU, "stribeck": 0.3 * speed}
    still = model(size, 0.999 * size, 0.5, slope=np.arctan(1.05 * MU), deflection=1e-4 * size, **law)
    found = mb.simulate(still, 100.0 * np.sqrt(size / G), solver="radau", tolerance=1e-7)
    np.testing.assert_allclose(found["x"][-1], 1.05e-4 * size, rtol=1e-3)

    def slopes(_: float, y: Any) -> Any:
        mu = MU * (1.0 + (static - 1.0) * np.exp(-((y[1] / 0.3) ** 2)))
        return y[1], -mu

    end = 2.5 * np.sqrt(size / G)
    exact = solve_ivp(slopes, (0.0, 2.5), (0.0, 1.0), rtol=1e-10, atol=1e-12).y[:, -1]  # in units of size and G
    assert exact[1] > 0.1
    moving = model(size, 0.999 * size, 0.5, deflection=1e-5 * size, **law)
    along, across = (body.joint for body in moving.bodies[1:3])
    for joint, part in ((along, 0.6), (across, 0.8)):
        object.__setattr__(joint, "rate", part * speed)
    result = mb.simulate(moving, end, solver="radau", tolerance=1e-7)
    for axis, part in (("x", 0.6), ("y", 0.8)):
        np.testing.assert_allclose(result[axis][-1] / size, part * exact[0], atol=1e-4)
        np.testing.assert_allclose(result[f"v{axis}"][-1] / speed, part * exact[1], atol=1e-4)


@pytest.mark.parametrize("size", SIZES)
def test_a_ball_that_falls_lifts_again(size: float) -> None:
    """Without damping it returns to its height: free fall, half a period of the contact, and the way back."""
    m = model(size, mb.Floating(start=(0.0, 0.0, 1.5 * size, 1.0, 0.0, 0.0, 0.0)), 0.4, crown=1.0, damping=0.0)
    omega, fall = np.sqrt(1e3 * G / size), np.sqrt(size / G)  # 1.5 R - R is g t^2 / 2
    # contact: x = x0 (1 - cos) + v0 / omega sin, until x is zero again
    touch = 2.0 * (np.pi - np.arctan(G * fall * omega / G)) / omega
    found = mb.simulate(m, 2.0 * fall + touch, solver="radau", tolerance=1e-9)
    np.testing.assert_allclose(found["z"][-1], 1.5 * size, atol=1e-6 * size)
    np.testing.assert_allclose(found["vz"][-1], 0.0, atol=1e-4 * np.sqrt(G * size))


def test_the_linear_motion_of_a_skid_is_that_of_its_bristle() -> None:
    """m s^2 + 2 xi (m mu N / d)^(1/2) s + mu N / d = 0 along both axes of the plane, with xi = 0.7."""
    size, d = 0.5, 1e-3
    m = model(size, size, 0.5, deflection=d, damping=0.0)
    found = mb.equilibrium(m)
    omega = np.sqrt(MU * G / d)
    root = omega * complex(-0.7, np.sqrt(1.0 - 0.7**2))
    up = 1j * np.sqrt(1e3 * G / size)
    expected = [root, root, root.conjugate(), root.conjugate(), up, -up]
    values = np.linalg.eigvals(found.state_space.A)
    gaps = [np.abs(values - value).min() for value in expected]
    assert max(gaps) < 1e-5 * abs(up)
    assert len(values) == 8  # two more: the places where it stands


def test_many_wheels_need_as_many_steps_as_one() -> None:
    """Equal wheels slide and then roll, each for itself: one is solved with dense matrices, eight by recursions."""
    found = []
    for count in (1, 8):
        m = mb.Mechanism(gravity=(0.0, 0.0, -G))
        for k in range(count):
            joint = mb.Floating(start=(0.0, 2.0 * k, 0.3 - 2.0 * G / 1e5, 1, 0, 0, 0), rate=(2.0, 0, 0, 0, 10.0, 0))
            wheel = m.body(f"wheel{k}", m.ground, joint, mass=2.0, inertia=(0.05, 0.09, 0.05))
            tire = mb.SlippingWheel(radius=0.3, crown_radius=0.1, friction=0.5, stiffness=1e5, damping=0.5)
            m.force(f"tire{k}", tire, wheel, m.ground)
        m.output("rate", wheel.velocity("x"))
        result = mb.simulate(m, 0.4, solver="ida", tolerance=1e-6)
        assert result["rate"][-1] == pytest.approx(2.0 + (3.0 - 2.0) / (1.0 + 2.0 * 0.3**2 / 0.09), abs=1e-5)
        found.append(result.statistics.steps)
    assert found[1] < 1.5 * found[0]


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"radius": 0.0}, "radius of"),
        ({"crown_radius": 2.0}, "crown_radius of"),
        ({"friction": 0.0}, "friction of"),
        ({"static": 0.4}, "static of .* at least friction"),
        ({"static": 0.6}, "stribeck of"),
        ({"static": 0.6, "stribeck": 0.0}, "stribeck of"),
        ({"deflection": -1.0}, "deflection of"),
        ({"stiffness": 0.0}, "stiffness of"),
        ({"axis": "w"}, "axis of"),
        ({"normal": (0.0, 0.0, 0.0)}, "normal of"),
    ],
)
def test_refusals(wrong: dict[str, Any], text: str) -> None:
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    with pytest.raises(UserError, match=text):
        m.force("w", mb.SlippingWheel(**{"radius": 1.0, "stiffness": 1.0, "friction": 0.5} | wrong), body)


def test_a_start_with_the_center_below_the_plane_is_refused() -> None:
    """As if the wheel and the plane are interchanged."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -9.81))
    joint = mb.Floating(start=(0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0))
    ball = m.body("ball", m.ground, joint, mass=1.0, inertia=(0.004, 0.004, 0.004))
    m.force("tire", mb.SlippingWheel(radius=0.1, crown_radius=0.1, stiffness=1e6, friction=0.3), m.ground, ball)
    with pytest.raises(UserError, match="is misplaced at the start"):
        mb.simulate(m, 0.1, solver="radau")
