"""Stops, torsion springs, bushings and follower forces against closed forms, and against SciPy on their laws again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from random_mechanisms import random_rotation
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from mbfmu import modes, simulate
from mbfmu.mechanics import (
    Bushing,
    CompiledMechanism,
    DistanceStop,
    Floating,
    Input,
    JointSpring,
    JointStop,
    Mechanism,
    PointForce,
    Revolute,
    Spherical,
    Spring,
    Torque,
    TorsionSpring,
    Translational,
    box,
    cylinder,
    rod,
    sphere,
    tube,
)
from mbfmu.util.errors import UserError

TIGHT: dict[str, Any] = {"solver": "adams", "tolerance": 1e-10}


def pushed(stop: JointStop, q: float, v: float) -> tuple[float, float]:
    """Force and stored energy of a stop on a slider of 1 kg that moves by v at q."""
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    m.output("effort", m.force("stop", stop, slider).effort())
    compiled, out = CompiledMechanism(m), np.zeros(1)
    compiled.observe(0.0, np.array([q]), np.array([v]), np.zeros(1), np.zeros(0), out)
    return float(out[0]), compiled.energy(0.0, np.array([q]), np.zeros(1))


@pytest.mark.parametrize(
    ("q", "v", "force"),
    [
        (0.0, 3.0, 0.0),
        (1.0, -3.0, 0.0),  # on the limit
        (1.5, 0.0, -5.0),
        (1.5, 2.0, -5.0 * 1.5),
        (1.5, -2.0, -5.0 * 0.5),
        (1.5, -4.0, 0.0),
        (1.5, -9.0, 0.0),  # would pull
        (-2.2, 0.0, 2.0),
        (-2.2, -2.0, 3.0),
        (-2.2, 5.0, 0.0),
    ],
)
def test_a_stop_pushes_beyond_its_limits_and_never_pulls(q: float, v: float, force: float) -> None:
    stop = JointStop(lower=-2.0, upper=1.0, stiffness=10.0, damping=0.25)
    found, stored = pushed(stop, q, v)
    assert found == pytest.approx(force, abs=1e-12)
    assert stored == pytest.approx(5.0 * max(-2.0 - q, q - 1.0, 0.0) ** 2, abs=1e-12)


def test_a_stop_on_one_side_leaves_the_other_free() -> None:
    assert pushed(JointStop(upper=1.0, stiffness=10.0), -1e6, 0.0) == (0.0, 0.0)
    assert pushed(JointStop(lower=1.0, stiffness=10.0), 1e6, 0.0) == (0.0, 0.0)
    assert pushed(JointStop(upper=1.0, stiffness=10.0), 2.0, 0.0)[0] == pytest.approx(-10.0)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_ball_bounces_as_computed_by_scipy(size: float) -> None:
    """Dropped from its size onto a stop that is pressed in by some hundredths of that."""
    mass, g = 2.0, 9.81 * size
    k, c = 400.0 * mass * g / size, 0.3 / np.sqrt(g * size)
    m = Mechanism(gravity=(0.0, -g, 0.0))
    ball = m.body("ball", m.ground, Translational(axis="y", start=size), mass=mass)
    m.force("floor", JointStop(lower=0.0, stiffness=k, damping=c), ball)
    m.output("height", ball.coordinate())
    m.output("energy", m.energy)
    result = simulate(m, 2.0, interval=0.05, **TIGHT)
    assert not result.failure

    def law(_: float, x: Any) -> Any:
        depth = max(-x[0], 0.0)
        return [x[1], -g + k * depth * max(1.0 - c * x[1], 0.0) / mass]

    tight = {"rtol": 1e-11, "atol": 1e-12 * size, "max_step": 2e-3}
    exact = solve_ivp(law, (0.0, 2.0), [size, 0.0], t_eval=result.t, method="DOP853", **tight)
    assert exact.y[0].min() < -1e-3 * size  # some output is in the stop
    np.testing.assert_allclose(result["height"], exact.y[0], atol=1e-5 * size)
    assert result["energy"][-1] < 0.8 * result["energy"][0]


@pytest.mark.parametrize("damping", [0.0, 0.05, 2.0])
def test_a_slider_comes_back_according_to_the_closed_form(damping: float) -> None:
    """m v dv = -k x (1 + c v) dx, so that v / c - ln(1 + c v) / c^2 is the same going in and coming out."""
    m, v = Mechanism(), 3.0
    slider = m.body("slider", m.ground, Translational(axis="x", start=-0.5, rate=v), mass=0.7)
    m.force("stop", JointStop(upper=0.0, stiffness=900.0, damping=damping), slider)
    m.output("rate", slider.rate())
    result = simulate(m, 1.0, interval=0.01, **TIGHT)

    def reduced(speed: float) -> float:
        return speed / damping - np.log1p(damping * speed) / damping**2 if damping else 0.5 * speed**2

    back = brentq(lambda x: reduced(-x) - reduced(v), 0.0, min(v, 0.999999 / damping if damping else v))
    assert result["rate"][-1] == pytest.approx(-back, rel=1e-6)
    if damping == 0.05:
        assert back == pytest.approx(v * (1.0 - 2.0 * damping * v / 3.0), rel=0.02)


def test_a_pendulum_between_two_stops_swings_as_computed_by_scipy() -> None:
    g, k, c, length = 9.81, 60.0, 0.4, 0.8
    m = Mechanism(gravity=(0.0, -g, 0.0))
    hinge = Revolute(start=-np.pi / 2 + 0.7, rate=1.0, fixed=True)
    bob = m.body("bob", m.ground, hinge, mass=1.0, com=(length, 0.0, 0.0))
    low, high = -np.pi / 2 - 0.3, -np.pi / 2 + 0.4
    m.force("stops", JointStop(lower=low, upper=high, stiffness=k, damping=c), bob)
    m.output("angle", bob.angle())
    result = simulate(m, 3.0, interval=0.05, **TIGHT)

    def law(_: float, x: Any) -> Any:
        q, v = x
        torque = max(low - q, 0.0) * k * max(1.0 - c * v, 0.0) - max(q - high, 0.0) * k * max(1.0 + c * v, 0.0)
        return [v, (torque - g * length * np.cos(q)) / length**2]

    start = [-np.pi / 2 + 0.7, 1.0]
    exact = solve_ivp(law, (0.0, 3.0), start, t_eval=result.t, method="DOP853", rtol=1e-11, atol=1e-12, max_step=2e-3)
    assert exact.y[0].min() < low
    assert exact.y[0].max() > high
    np.testing.assert_allclose(result["angle"], exact.y[0], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "force 's' has neither lower nor upper"),
        ({"lower": 1.0, "upper": 1.0}, r"lower of force 's' is 1.0, upper 1.0; allowed: lower less than upper"),
        ({"lower": np.nan}, "lower of force 's' is nan"),
        ({"upper": 1.0, "stiffness": -2.0}, "stiffness of force 's' is -2.0; allowed: finite and not negative"),
        ({"upper": 1.0, "damping": -2.0}, "damping of force 's' is -2.0"),
    ],
)
def test_what_is_no_stop_is_refused(options: dict[str, Any], message: str) -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, Revolute(), mass=1.0)
    with pytest.raises(UserError, match=message):
        m.force("s", JointStop(**{"stiffness": 1.0} | options), arm)


def test_a_stop_needs_a_joint_of_one_coordinate() -> None:
    m = Mechanism()
    with pytest.raises(UserError, match="needs a joint of one coordinate"):
        m.force("s", JointStop(upper=0.0, stiffness=1.0), m.body("b", m.ground, Floating(), mass=1.0))


@pytest.mark.parametrize(
    ("x", "v", "force"),
    [
        (2.0, 9.0, 0.0),
        (3.5, 0.0, -5.0),
        (3.5, 2.0, -7.5),
        (3.5, -5.0, 0.0),
        (-3.5, -2.0, 7.5),  # taut on the other side
        (0.8, 0.0, 2.0),
        (0.8, -2.0, 3.0),
        (-0.8, 0.0, -2.0),
        (0.8, 5.0, 0.0),
        (0.0, 5.0, 0.0),  # no line of action
    ],
)
def test_a_distance_is_stopped_along_its_line(x: float, v: float, force: float) -> None:
    """Between a point next to the ground's origin and one next to the slider's, level with each other."""
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    stop = DistanceStop(lower=1.0, upper=3.0, stiffness=10.0, damping=0.25, at_a=(0.5, 2, 0), at_b=(0.5, 2, 0))
    handle = m.force("stop", stop, m.ground, slider)
    m.output("pull", handle.force("x", on="b"))
    m.output("lever", handle.moment("z", on="b"))
    m.output("back", handle.force("x"))
    compiled, out = CompiledMechanism(m), np.zeros(3)
    compiled.observe(0.0, np.array([x]), np.array([v]), np.zeros(1), np.zeros(0), out)
    np.testing.assert_allclose(out, [force, -2.0 * force, -force], atol=1e-12)
    stored = compiled.energy(0.0, np.array([x]), np.zeros(1))
    assert stored == pytest.approx(5.0 * max(1.0 - abs(x), abs(x) - 3.0, 0.0) ** 2)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_ball_falls_into_a_rope_as_computed_by_scipy(size: float) -> None:
    """Thrown sideways, slack at first; then it swings, the rope now and then slack."""
    mass, g = 2.0, 9.81 * size
    k, c = 300.0 * mass * g / size, 0.5 / np.sqrt(g * size)
    m = Mechanism(gravity=(0.0, -g, 0.0))
    start = Floating(start=(0.5 * size, 0, 0, 1, 0, 0, 0), rate=(size, 0.5 * size, 0, 0, 0, 0))
    ball = m.body("ball", m.ground, start, mass=mass, inertia=np.ones(3) * 0.1 * size**2)
    rope = m.force("rope", DistanceStop(upper=size, stiffness=k, damping=c), m.ground, ball)
    for axis in "xy":
        m.output(axis, ball.position(axis))
        m.output(f"f{axis}", rope.force(axis))
    result = simulate(m, 1.5, interval=0.05, **TIGHT)

    def tension(x: Any) -> float:
        length = np.hypot(x[0], x[1])
        return k * max(length - size, 0.0) * max(1.0 + c * (x[0] * x[2] + x[1] * x[3]) / length, 0.0) / length

    def law(_: float, x: Any) -> Any:
        pull = tension(x) / mass
        return [x[2], x[3], -pull * x[0], -g - pull * x[1]]

    tight = {"rtol": 1e-11, "atol": 1e-12 * size, "max_step": 1e-3}
    exact = solve_ivp(law, (0, 1.5), [0.5 * size, 0, size, 0.5 * size], t_eval=result.t, method="DOP853", **tight)
    pulls = np.array([tension(x) for x in exact.y.T])
    assert pulls[0] == 0.0
    assert pulls.max() > 0.0
    for axis, place in zip("xy", exact.y, strict=False):
        np.testing.assert_allclose(result[axis], place, atol=1e-5 * size)
        np.testing.assert_allclose(result[f"f{axis}"], pulls * place, atol=1e-2 * mass * g)


def test_a_distance_below_zero_is_refused() -> None:
    m = Mechanism()
    slider = m.body("slider", m.ground, Translational(axis="x"), mass=1.0)
    for options in ({"lower": -1.0}, {"upper": -1.0}):
        with pytest.raises(UserError, match=r"er of force 's' is -1\.0; allowed: finite and not negative"):
            m.force("s", DistanceStop(stiffness=1.0, **options), m.ground, slider)
    with pytest.raises(UserError, match="neither lower nor upper"):
        m.force("s", DistanceStop(stiffness=1.0), m.ground, slider)


def hinged(angle: float, rate: float, spring: bool) -> tuple[Any, float]:
    """Bias forces and energy of two hinged bodies with a torsion spring, or with one in the joint."""
    rng = np.random.default_rng(4)
    axis, R = rng.normal(size=3), random_rotation(rng)
    m = Mechanism(gravity=(1.0, 2.0, 3.0))
    first = m.body("first", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.2, 1.4))
    joint = Revolute(axis=axis, rotation=R, at=(0.3, 0.1, -0.4))
    second = m.body("second", first, joint, mass=0.6, com=(0.2, 0.5, 0.1), inertia=(0.2, 0.3, 0.4))
    numbers: dict[str, Any] = {"stiffness": 3.0, "damping": 0.7, "free": 0.4}
    if spring:
        m.force("spring", TorsionSpring(axis=R @ axis, rotation=R, **numbers), first, second)
    else:
        m.force("spring", JointSpring(**numbers), second)
    compiled = CompiledMechanism(m)
    q, v = compiled.assembly.start_positions(), rng.normal(size=7)
    compiled.system.apply(q, np.r_[rng.normal(size=6), 0.0])
    q[7], v[6] = angle, rate
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, q, v, terms)
    return terms.h.copy(), compiled.energy(0.0, q, v)


@pytest.mark.parametrize("angle", [-3.1, -1.7, 0.0, 0.4, 1e-9, 2.0, 3.1])
def test_a_torsion_spring_on_a_hinge_is_the_spring_in_the_joint(angle: float) -> None:
    for rate in (0.0, -2.0):
        (h, energy), (expected, stored) = hinged(angle, rate, True), hinged(angle, rate, False)
        np.testing.assert_allclose(h, expected, rtol=1e-12, atol=1e-12)
        assert energy == pytest.approx(stored, rel=1e-13)


def test_the_angle_of_a_torsion_spring_jumps_at_half_a_turn() -> None:
    (beyond, _), (within, _) = hinged(np.pi + 0.2, 0.0, True), hinged(-np.pi + 0.2, 0.0, True)
    np.testing.assert_allclose(beyond, within, rtol=1e-12, atol=1e-12)


def tilted(R: Any, spring: Any) -> tuple[Any, float]:
    """Moment in ground axes, and stored energy, of a spring between the ground and a ball with this attitude."""
    m = Mechanism()
    x, y, z, w = Rotation.from_matrix(R).as_quat()
    ball = m.body("ball", m.ground, Spherical(start=(w, x, y, z)), mass=1.0, inertia=(1.0, 1.0, 1.0))
    handle = m.force("spring", spring, m.ground, ball)
    for axis in "xyz":
        m.output(axis, handle.moment(axis, on="b"))
    compiled, out = CompiledMechanism(m), np.zeros(3)
    q = compiled.assembly.start_positions()
    compiled.observe(0.0, q, np.zeros(3), np.zeros(3), np.zeros(0), out)
    return out, compiled.energy(0.0, q, np.zeros(3))


def test_a_torsion_spring_turns_back_the_twist_that_a_tilt_leaves() -> None:
    """Twist of a quaternion: twice the arcus tangent of its part along the axis by its scalar."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        R, axis = random_rotation(rng), rng.normal(size=3)
        n = axis / np.linalg.norm(axis)
        q = Rotation.from_matrix(R).as_quat()
        phi = 2.0 * np.arctan2(q[:3] @ n, q[3])
        phi -= 2.0 * np.pi * np.round(phi / (2.0 * np.pi))
        moment, stored = tilted(R, TorsionSpring(axis=axis, stiffness=3.0, free=0.3))
        assert stored == pytest.approx(1.5 * (phi - 0.3) ** 2, rel=1e-9)
        g = (n + R @ n) / (1.0 + n @ R @ n)
        np.testing.assert_allclose(moment, -3.0 * (phi - 0.3) * g, rtol=1e-9, atol=1e-12)


def test_a_torsion_spring_exerts_nothing_where_its_axis_is_upside_down() -> None:
    moment, _ = tilted(np.diag((1.0, -1.0, -1.0)), TorsionSpring(axis="z", stiffness=3.0, free=0.3))
    np.testing.assert_array_equal(moment, 0.0)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_two_free_discs_turn_against_each_other_according_to_the_closed_form(size: float) -> None:
    m, J = Mechanism(), 2.0 * size**2
    a = m.body("a", m.ground, Floating(rate=(0, 0, 0, 0, 0, 1.0)), mass=1.0, inertia=(J, J, J))
    b = m.body("b", m.ground, Floating(start=(size, 0, 0, 1, 0, 0, 0)), mass=1.0, inertia=(3 * J, 3 * J, 3 * J))
    m.force("spring", TorsionSpring(stiffness=5.0 * J), a, b)
    m.output("a", a.angular_velocity("z"))
    m.output("b", b.angular_velocity("z"))
    result = simulate(m, 3.0, interval=0.1, **TIGHT)
    omega = np.sqrt(5.0 * (1.0 + 1.0 / 3.0))
    np.testing.assert_allclose(result["a"] - result["b"], np.cos(omega * result.t), atol=1e-7)
    np.testing.assert_allclose(result["a"] + 3.0 * result["b"], 1.0, atol=1e-7)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_body_on_a_bushing_has_the_frequencies_of_its_axes(size: float) -> None:
    rng = np.random.default_rng(3)
    at, R, inertia = size * rng.normal(size=3), random_rotation(rng), np.array((1.0, 1.4, 2.1)) * size**2
    k, kappa = np.array((30.0, 50.0, 80.0)), np.array((7.0, 11.0, 13.0)) * size**2
    m = Mechanism()
    start = np.r_[at, Rotation.from_matrix(R).as_quat(scalar_first=True)]
    body = m.body("block", m.ground, Floating(start=start), mass=2.0, inertia=inertia)
    bushing = Bushing(stiffness=k, rotational_stiffness=kappa, at_a=at, rotation_a=R)
    m.force("bushing", bushing, m.ground, body)
    expected = np.sqrt(np.r_[k / 2.0, kappa / inertia])
    found = [shape.mode.frequency for shape in modes(m)]
    np.testing.assert_allclose(np.sort(found), np.sort(expected), rtol=1e-8)


def test_a_bushing_damps_along_each_axis_according_to_the_closed_form() -> None:
    m, c, gamma = Mechanism(), np.array((2.0, 3.0, 5.0)), np.array((1.0, 2.0, 4.0))
    body = m.body("block", m.ground, Floating(), mass=2.0, inertia=(1.0, 1.5, 2.0))
    m.force(
        "bushing",
        Bushing(stiffness=10.0, damping=c, rotational_stiffness=8.0, rotational_damping=gamma),
        m.ground,
        body,
    )
    found = np.sort([-2.0 * shape.mode.eigenvalue.real for shape in modes(m)])
    np.testing.assert_allclose(found, np.sort(np.r_[c / 2.0, gamma / (1.0, 1.5, 2.0)]), rtol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 2.0, 3.0, np.pi, 3.5, 6.0])
def test_a_bushing_resists_a_turn_by_its_sine(angle: float) -> None:
    """About an axis of its frame: U = kappa (2 sin(phi / 2))^2 / 2."""
    R0 = random_rotation(np.random.default_rng(6))
    turned = Rotation.from_rotvec(angle * R0[:, 1]).as_matrix() @ R0
    moment, stored = tilted(turned, Bushing(rotational_stiffness=(2.0, 5.0, 9.0), rotation_a=R0))
    np.testing.assert_allclose(moment, -5.0 * np.sin(angle) * R0[:, 1], atol=1e-13)
    assert stored == pytest.approx(10.0 * np.sin(0.5 * angle) ** 2, abs=1e-13)


def test_the_moment_of_a_bushing_is_the_gradient_of_its_potential_through_half_a_turn() -> None:
    bushing = Bushing(rotational_stiffness=(2.0, 5.0, 9.0))
    n, h = np.array((2.0, -1.0, 2.0)) / 3.0, 1e-4
    for angle in (np.pi - 1e-6, np.pi, np.pi + 1e-6):
        R = Rotation.from_rotvec(angle * n)
        moment, _ = tilted(R.as_matrix(), bushing)
        for k, e in enumerate(np.eye(3)):
            ahead, back = (tilted((Rotation.from_rotvec(s * e) * R).as_matrix(), bushing)[1] for s in (h, -h))
            assert moment[k] == pytest.approx(-(ahead - back) / (2.0 * h), abs=1e-7)


def test_a_bushing_exerts_its_force_at_its_point_on_both_bodies() -> None:
    m = Mechanism()
    a = m.body("a", m.ground, Floating(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    b = m.body("b", m.ground, Floating(start=(3.0, 1.0, 0.5, 1, 0, 0, 0)), mass=1.0, inertia=(1.0, 1.0, 1.0))
    handle = m.force("bushing", Bushing(stiffness=(2.0, 3.0, 4.0), at_a=(1, 0, 0), at_b=(0, 2, 0)), a, b)
    for on in "ab":
        for axis in "xyz":
            m.output(f"f{on}{axis}", handle.force(axis, on=on))
        for axis in "xyz":
            m.output(f"m{on}{axis}", handle.moment(axis, on=on))
    compiled, out = CompiledMechanism(m), np.zeros(12)
    compiled.observe(0.0, compiled.assembly.start_positions(), np.zeros(12), np.zeros(12), np.zeros(0), out)
    force = np.array((2.0, 3.0, 4.0)) * (2.0, 3.0, 0.5)  # from (1, 0, 0) to (3, 3, 0.5)
    expected = [*force, *np.cross((3.0, 3.0, 0.5), force), *-force, *np.cross((0.0, 2.0, 0.0), -force)]
    np.testing.assert_allclose(out, expected, atol=1e-13)


@pytest.mark.parametrize("key", ["stiffness", "damping", "rotational_stiffness", "rotational_damping"])
def test_what_is_no_bushing_is_refused(key: str) -> None:
    for wrong in (-1.0, (1.0, 2.0), (1.0, np.nan, 1.0), "stiff", True):
        m = Mechanism()
        body = m.body("b", m.ground, Floating(), mass=1.0)
        with pytest.raises(UserError, match=rf"{key} of force 'bush' is"):
            m.force("bush", Bushing(**{key: wrong}), m.ground, body)


@pytest.mark.parametrize("kind", [Spring, TorsionSpring, JointSpring])
@pytest.mark.parametrize("key", ["stiffness", "damping"])
def test_what_is_no_spring_is_refused(kind: Any, key: str) -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Revolute(), mass=1.0, inertia=(1.0, 1.0, 1.0))
    for wrong in (-1.0, np.nan, np.inf, True, (1.0, 2.0)):
        with pytest.raises(UserError, match=rf"{key} of force 'coil' is .*; allowed: finite and not negative"):
            m.force("coil", kind(**{key: wrong}), body)
    with pytest.raises(UserError, match="free of force 'coil' is inf; it must be a finite number"):
        m.force("coil", kind(stiffness=1.0, free=np.inf), body)
    m.force("coil", kind(stiffness=lambda x: -x), body)  # what drives away is a function


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_follower_force_sends_a_spinning_body_round_a_circle(size: float) -> None:
    """Spin omega and a force across the path: radius f / m omega^2, once round in 2 pi / omega."""
    mass, omega = 2.0, 3.0
    force = mass * omega**2 * size
    m = Mechanism()
    joint = Floating(start=(size, 0, 0, 1, 0, 0, 0), rate=(0, omega * size, 0, 0, 0, omega))
    body = m.body("body", m.ground, joint, mass=mass, inertia=np.array((1.0, 1.0, 1.0)) * size**2)
    m.force("thrust", PointForce(magnitude=force, axis=(-1.0, 0.0, 0.0), fixed_in="body"), body)
    for axis in "xyz":
        m.output(axis, body.position(axis))
    result = simulate(m, 2.0, interval=0.05, **TIGHT)
    np.testing.assert_allclose(result["x"], size * np.cos(omega * result.t), atol=1e-6 * size)
    np.testing.assert_allclose(result["y"], size * np.sin(omega * result.t), atol=1e-6 * size)
    np.testing.assert_allclose(result["z"], 0.0, atol=1e-9 * size)


def accelerations(joint: Any, q: Any, load: Any) -> Any:
    """Accelerations at rest of a ball whose inertias are one, with this load."""
    m = Mechanism()
    body = m.body("ball", m.ground, joint, mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.force("load", load, body)
    compiled = CompiledMechanism(m)
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, np.asarray(q, float), np.zeros(6), terms)
    return np.linalg.solve(terms.M, -terms.h)


def test_what_is_fixed_in_a_body_turns_with_it_and_else_stays() -> None:
    """Linear accelerations of a floating body are in ground axes, angular ones in axes of the body."""
    rng = np.random.default_rng(5)
    R, n, p = random_rotation(rng), np.array((2.0, -1.0, 2.0)) / 3.0, np.array((0.3, 0.2, -0.5))
    q = np.r_[np.zeros(3), Rotation.from_matrix(R).as_quat(scalar_first=True)]
    for where, direction in (("ground", n), ("body", R @ n)):
        a = accelerations(Floating(), q, PointForce(magnitude=4.0, axis=n, at_a=p, fixed_in=where))
        np.testing.assert_allclose(a[:3], 4.0 * direction, atol=1e-12)
        np.testing.assert_allclose(a[3:], 4.0 * np.cross(p, R.T @ direction), atol=1e-12)
        a = accelerations(Floating(), q, Torque(magnitude=4.0, axis=n, fixed_in=where))
        np.testing.assert_allclose(a, [0, 0, 0, *(4.0 * R.T @ direction)], atol=1e-12)
    with pytest.raises(UserError, match="fixed_in of force 'load' is 'sky'; allowed: 'ground', 'body'"):
        accelerations(Floating(), q, Torque(magnitude=4.0, fixed_in="sky"))
    with pytest.raises(UserError, match="fixed_in of force 'load' is None"):
        accelerations(Floating(), q, PointForce(magnitude=4.0, fixed_in=None))  # type: ignore[arg-type]


def test_a_follower_force_is_no_gradient_and_its_work_is_counted() -> None:
    """A torque of the body on a spinning ball: power is torque times spin, along an axis that both share."""
    m = Mechanism()
    ball = m.body("ball", m.ground, Spherical(rate=(0.0, 0.0, 2.0)), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.force("motor", Torque(magnitude=Input(name="t", unit="N.m", start=0.5), axis="z", fixed_in="body"), ball)
    m.output("energy", m.energy)
    result = simulate(m, 2.0, interval=0.1, **TIGHT)
    np.testing.assert_allclose(result["energy"], 0.5 * (2.0 + 0.5 * result.t) ** 2, rtol=1e-8)


def integrals(points: Any, mass: float) -> tuple[Any, Any]:
    """Center, and inertia about it, of equal masses at these points."""
    center = points.mean(axis=0)
    x = points - center
    return center, mass / len(x) * (np.sum(x * x) * np.eye(3) - x.T @ x)


def filled(inside: Any, reach: float) -> Any:
    """Points of a fine grid that are inside."""
    x = np.linspace(-reach, reach, 120)
    points = np.stack(np.meshgrid(x, x, x), axis=-1).reshape(-1, 3)
    return points[inside(points)]


AXIS = np.array((2.0, -1.0, 2.0)) / 3.0
TURN = random_rotation(np.random.default_rng(9))


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(
    ("make", "options", "inside"),
    [
        (box, {"size": (0.9, 0.5, 0.7)}, lambda p: np.all(np.abs(p) < (0.45, 0.25, 0.35), axis=1)),
        (
            box,
            {"size": (0.9, 0.5, 0.7), "rotation": TURN},
            lambda p: np.all(np.abs(p @ TURN) < (0.45, 0.25, 0.35), axis=1),
        ),
        (sphere, {"radius": 0.6}, lambda p: np.linalg.norm(p, axis=1) < 0.6),
        (
            cylinder,
            {"radius": 0.3, "length": 1.0, "axis": AXIS},
            lambda p: (np.abs(p @ AXIS) < 0.5) & (np.linalg.norm(np.cross(p, AXIS), axis=1) < 0.3),
        ),
        (
            tube,
            {"outer": 0.5, "inner": 0.3, "length": 0.8, "axis": "y"},
            lambda p: (np.abs(p[:, 1]) < 0.4) & (np.abs(np.hypot(p[:, 0], p[:, 2]) - 0.4) < 0.1),
        ),
    ],
)
def test_mass_properties_are_those_of_the_points_within(size: float, make: Any, options: Any, inside: Any) -> None:
    lengths = {k: np.multiply(v, size) for k, v in options.items() if k not in ("axis", "rotation")}
    found = make(mass=3.0, com=(0.1, 0.2, 0.3), **options | lengths)
    _, inertia = integrals(filled(inside, 0.75), 3.0)
    given = np.asarray(found["inertia"])
    given = np.diag(given) if given.shape == (3,) else given
    np.testing.assert_allclose(given / size**2, inertia, atol=0.02 * np.trace(inertia))
    assert found["mass"] == 3.0
    np.testing.assert_array_equal(found["com"], (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(make(mass=3.0, **options | lengths)["com"], np.zeros(3))
    m = Mechanism()
    assert m.body("b", m.ground, Floating(), **found).mass == 3.0


def test_mass_properties_are_those_of_the_books() -> None:
    np.testing.assert_allclose(box(mass=12.0, size=(1, 2, 3))["inertia"], np.diag((13.0, 10.0, 5.0)))
    np.testing.assert_allclose(cylinder(mass=12.0, radius=2, length=3)["inertia"], np.diag((21.0, 21.0, 24.0)))
    np.testing.assert_allclose(tube(mass=2.0, outer=2.0, inner=1.0, length=3)["inertia"][2, 2], 5.0)
    np.testing.assert_allclose(sphere(mass=5.0, radius=3.0)["inertia"], 18.0)
    thin = cylinder(mass=2.0, radius=1e-9, length=3.0, axis="x", com=(1.5, 0, 0))
    same = rod(mass=2.0, length=3.0)
    np.testing.assert_allclose(thin["inertia"], np.diag(same["inertia"]), atol=1e-15)
    np.testing.assert_allclose(thin["com"], same["com"])


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (box, {"size": (1, 0, 1)}, r"size of a box is \(1, 0, 1\) m; it needs three lengths, finite and greater"),
        (box, {"size": 1.0}, "size of a box is 1.0 m"),
        (box, {"size": (1, 1, 1), "rotation": np.ones((3, 3))}, "rotation of a box is"),
        (box, {"size": (1, 1, 1), "mass": -1.0}, "mass of a box is -1.0"),
        (box, {"size": (1, 1, 1), "com": 1.0}, "com of a box is 1.0"),
        (sphere, {"radius": -1.0}, "radius of a sphere is -1.0; allowed: finite and greater"),
        (sphere, {"radius": "big"}, "radius of a sphere is 'big'; allowed: finite"),
        (cylinder, {"radius": 1.0, "length": np.inf}, "length of a cylinder is inf"),
        (cylinder, {"radius": 1.0, "length": 1.0, "axis": "w"}, "axis of a cylinder is 'w'"),
        (tube, {"outer": 1.0, "inner": 2.0, "length": 1.0}, "inner radius of a tube is 2.0 m; allowed: no more than"),
        (tube, {"outer": 1.0, "inner": 0.0, "length": 1.0}, "inner radius of a tube is 0.0; allowed: finite and"),
        (tube, {"outer": 2.0, "inner": 1.0, "length": 0.0}, "length of a tube is 0.0"),
    ],
)
def test_what_is_no_solid_is_refused(make: Any, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        make(**{"mass": 1.0} | options)
