"""Joint friction with stick, against closed forms and piecewise exact motions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.testing import check_element
from mbfmu.util.errors import EquilibriumError, UserError

G = 9.81
MU, MASS = 0.5, 2.0  # coefficient of friction and kg of the block


def block(load: Any, size: float = 1.0, rate: float = 0.0, **given: Any) -> tuple[mb.Mechanism, Any]:
    """A block that weighs on a plane; lengths and the load in units of ``size``."""
    m = mb.Mechanism()
    body = m.body("block", m.ground, mb.Translational(axis="x", nominal=size, rate=rate * size), mass=MASS)
    options = {"coulomb": MU, "normal_force": MASS * G * size} | given
    friction = m.force("friction", mb.JointFriction(**options), body)
    m.force("load", mb.JointForce(load), body)
    m.output("x", body.coordinate())
    m.output("friction", friction.effort())
    return m, friction


def unmoved(simulation: mb.Simulation, deflection: float) -> float:
    """Distance that the block has slid, in deflections of the bristle."""
    return float(simulation.stepper.q[0] / deflection - simulation.stepper.v[1])


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_block_sticks_for_an_hour(solver: str, size: float) -> None:
    """Under half of the breakaway force it moves by half of the deflection, 1e-5 of its size, and stays there."""
    m, _ = block(0.5 * MU * MASS * G * size, size)
    simulation = mb.Simulation(m, mb.Settings(solver=solver, tolerance=1e-6))
    places = []
    for t in (1.0, 3600.0):
        assert simulation.advance(t).ok
        places.append(float(simulation.stepper.q[0]))
    assert places == pytest.approx([0.5e-5 * size] * 2, rel=1e-6)
    assert abs(unmoved(simulation, 1e-5 * size)) < 1e-12
    assert not simulation.inaccurate
    assert simulation.statistics.steps < 400


def test_shaken_block_does_not_creep() -> None:
    """A load between 0.1 and 0.8 of the breakaway force, which moves a LuGre bristle by 0.5 deflections a cycle."""
    force = MU * MASS * G
    m, _ = block(mb.Harmonic(mean=0.45 * force, amplitude=0.35 * force, frequency=1.0))
    for solver, most in (("ida", 1e-11), ("radau", 1e-3)):  # radau keeps it to the remainder of Newton's iteration
        simulation = mb.Simulation(m, mb.Settings(solver=solver, tolerance=1e-6, max_steps=10**7))
        assert simulation.advance(200.0).ok
        assert abs(unmoved(simulation, 1e-5)) < most, solver


def test_loop_before_sliding_is_that_of_the_bristle() -> None:
    """A drive deflects the joint and returns it: dz/dx = (1 - alpha z) / d on the way out, 1 / d on the way back."""
    d, turn = 1e-3, 1.3e-3
    m = mb.Mechanism()
    drive = mb.Harmonic(amplitude=turn, frequency=0.25)
    slider = m.body("slider", m.ground, mb.Translational(axis="x", drive=drive), mass=1.0)
    friction = m.force("friction", mb.JointFriction(coulomb=3.0, deflection=d), slider)
    m.output("x", slider.coordinate())
    m.output("friction", friction.effort())

    def slope(x: float, z: Any) -> Any:
        s = np.clip((z - 0.9) / 0.1, 0.0, 1.0)
        return (1.0 - s * s * (3.0 - 2.0 * s) * z) / d

    result = mb.simulate(m, 1.5, interval=0.05, solver="radau", tolerance=1e-9)
    x, z = result["x"], -result["friction"] / 3.0
    out = result.t < 1.01
    exact = {"rtol": 1e-12, "atol": 1e-13, "max_step": 1e-5, "dense_output": True}
    expected = solve_ivp(slope, (0.0, turn), [0.0], "DOP853", **exact).sol
    np.testing.assert_allclose(z[out], expected(x[out])[0], atol=1e-6)
    np.testing.assert_allclose(z[~out], expected(turn)[0] - (turn - x[~out]) / d, atol=1e-6)


def test_block_breaks_away_at_the_static_force_and_stops_where_its_energy_is_spent() -> None:
    """The load grows by 1 N/s, and the block stays up to the static force. From 2 m/s it slides by v^2 / (2 mu g)."""
    m, _ = block(mb.Ramp(height=20.0, duration=20.0), static=1.2 * MU, stribeck=0.2)
    result = mb.simulate(m, 14.0, interval=0.01, tolerance=1e-6)
    slides = result.t[np.flatnonzero(result["x"] > 1e-3)[0]]
    assert slides == pytest.approx(1.2 * MU * MASS * G, rel=0.02)
    m, _ = block(0.0, rate=2.0)
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-6))
    simulation.advance(1.0)
    assert simulation.stepper.q[0] == pytest.approx(4.0 / (2.0 * MU * G), abs=6e-5)
    assert simulation.stepper.energy_account[0] == pytest.approx(-0.5 * MASS * 4.0, abs=1e-5)  # the work: heat
    assert not simulation.inaccurate


def test_viscous_part_and_negative_normal_force() -> None:
    """Without normal force the speed decays as exp(-c t / m)."""
    m, _ = block(0.0, rate=1.0, viscous=3.0, normal_force=-5.0)
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-8))
    simulation.advance(0.5)
    assert simulation.stepper.v[0] == pytest.approx(np.exp(-3.0 * 0.5 / MASS), abs=1e-7)


def belt(deflection: float) -> mb.Mechanism:
    """A mass on a spring on a belt that moves at 0.1 m/s."""
    m = mb.Mechanism()
    moving = m.body("belt", m.ground, mb.Translational(axis="x", drive="0.1 * t"), mass=1.0)
    mass = m.body("mass", moving, mb.Translational(axis="x", nominal=1.0), mass=1.0)
    options = {"coulomb": 0.25, "static": 0.4, "stribeck": 0.05, "normal_force": 10.0, "deflection": deflection}
    m.force("friction", mb.JointFriction(**options), mass)
    m.force("spring", mb.Spring(stiffness=100.0, at_b=(-10.0, 0.0, 0.0), free=10.0), mass)
    m.output("x", mass.position("x"))
    return m


def exact_period() -> float:
    """Stick until the spring pulls with the static force, then slip until the speeds are equal."""

    def slip(t: float, y: Any) -> list[float]:
        relative = y[1] - 0.1
        return [y[1], -100.0 * y[0] + 10.0 * (0.25 + 0.15 * np.exp(-((relative / 0.05) ** 2)))]

    def sticks(t: float, y: Any) -> float:
        return y[1] - 0.1 if t > 0.05 else -1.0

    sticks.terminal = True  # type: ignore[attr-defined]
    begin = (0.04, 0.1 - 1e-9)
    end = solve_ivp(slip, (0.0, 5.0), begin, "DOP853", events=sticks, rtol=1e-11, atol=1e-13)
    return float(end.t[-1] + (0.04 - end.y[0, -1]) / 0.1)


@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_stick_slip_on_a_belt_has_the_period_of_the_exact_motion(solver: str) -> None:
    result = mb.simulate(belt(1e-5), 6.0, interval=1e-3, solver=solver, tolerance=1e-6)
    assert not result.failure
    x = result["x"]
    up = np.flatnonzero((x[:-1] < 0.03) & (x[1:] >= 0.03))
    times = result.t[up] + 1e-3 * (0.03 - x[up]) / (x[up + 1] - x[up])
    np.testing.assert_allclose(np.diff(times)[1:], exact_period(), rtol=2e-3)


def pendulum(friction: float, start: float, **given: Any) -> mb.Mechanism:
    """A point mass of 1 kg at 1 m; the angle is zero where it hangs."""
    m = mb.Mechanism(gravity=(G, 0.0, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=start), mass=1.0, com=(1.0, 0.0, 0.0))
    m.force("friction", mb.JointFriction(coulomb=friction, **given), arm)
    m.output("arm.angle", arm.angle())
    return m


@pytest.mark.parametrize("solver", ["radau", "ida"])
def test_pendulum_stops_where_friction_holds_it(solver: str) -> None:
    """Each half swing ends where the potential energy that is lost is the work against friction."""
    angle = 2.0
    while G * abs(np.sin(angle)) > 1.0:
        side, before = np.sign(angle), angle

        def lost(x: float, before: float = before) -> float:
            return G * (np.cos(x) - np.cos(before)) - abs(x - before)

        angle = brentq(lost, before - 1e-6 * side, -before)
    simulation = mb.Simulation(pendulum(1.0, 2.0), mb.Settings(solver=solver, tolerance=1e-6))
    simulation.advance(60.0)
    assert simulation.stepper.q[0] == pytest.approx(angle, abs=6e-5)  # six deflections
    assert abs(simulation.stepper.v[0]) < 1e-8
    heat = G * (np.cos(angle) - np.cos(2.0))
    assert simulation.stepper.energy_account[0] == pytest.approx(-heat, abs=1e-3)
    assert not simulation.inaccurate


def test_brake_with_an_input_stops_a_wheel_and_releases_it() -> None:
    m = mb.Mechanism()
    wheel = m.body("wheel", m.ground, mb.Revolute(rate=10.0), inertia=(0.5, 0.5, 0.5))
    force = mb.Input(name="brake.force", unit="N", start=0.0)
    m.force("brake", mb.JointFriction(coulomb=0.4 * 0.1, normal_force=force), wheel)
    m.force("motor", mb.JointForce(2.0), wheel)
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-6))
    simulation.advance(0.5)
    assert simulation.stepper.v[0] == pytest.approx(12.0, abs=1e-5)
    simulation.set_input("brake.force", 300.0)  # 12 N m against 2 N m: it stops after 0.6 s and 3.6 rad
    simulation.advance(2.0)
    assert simulation.stepper.q[0] == pytest.approx(5.5 + 3.6, abs=1e-4)
    assert abs(simulation.stepper.v[0]) < 1e-9
    simulation.set_input("brake.force", 0.0)
    simulation.advance(3.0)
    assert simulation.stepper.v[0] == pytest.approx(4.0, abs=1e-4)
    assert not simulation.inaccurate


def test_steady_state_without_friction_force_and_its_bristle() -> None:
    """The bristle of d = 1e-5 rad and 1 N m is a spring of 1e5 N m/rad with damping ratio 0.7."""
    found = mb.equilibrium(pendulum(1.0, 0.3))
    assert found.positions()["arm"] == pytest.approx(0.0, abs=1e-9)
    assert found.states() == {"friction.bristle": 0.0}
    assert found.stability == "neutral"
    assert "'friction.bristle' keeps its start value" in str(found.diagnostics[0])
    zero, pair = sorted((mode.eigenvalue for mode in found.modes), key=abs)
    w = np.sqrt(1e5)
    assert abs(zero) < 1e-9
    assert pair == pytest.approx(complex(-0.7 * w, np.sqrt(1.0 - 0.49) * w), rel=1e-4)
    assert found.state_space.A[2] == pytest.approx([0.0, 1e5, 0.0])
    m, _ = block(1.01 * MU * MASS * G)
    with pytest.raises(EquilibriumError, match="friction cannot hold the start"):
        mb.equilibrium(m)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("part", [0.3, -0.99])
def test_steady_state_that_friction_holds(part: float, size: float) -> None:
    """z = load / (mu N), and the block has moved by the deflection d z; the linear model is that of the bristle."""
    m, _ = block(part * MU * MASS * G * size, size, deflection=1e-5 * size)
    found = mb.equilibrium(m)
    assert found.states()["friction.bristle"] == pytest.approx(part, rel=1e-9)
    assert found.outputs == {
        "x": pytest.approx(1e-5 * size * part),
        "friction": pytest.approx(-part * MU * MASS * G * size),
    }
    assert "friction holds the start position (state 'friction.bristle')" in str(found.diagnostics[0])
    if part == 0.3:
        pair = max((mode.eigenvalue for mode in found.modes), key=abs)
        assert abs(pair) == pytest.approx(np.sqrt(MU * G / 1e-5), rel=1e-6)


def test_steady_state_that_friction_of_a_ball_joint_holds() -> None:
    m = mb.Mechanism()
    turned = Rotation.from_rotvec([0.3, -0.2, 0.5])
    start = tuple(turned.as_quat(scalar_first=True))
    ball = m.body("ball", m.ground, mb.Spherical(start=start), inertia=(0.2, 0.2, 0.2))
    friction = m.force("friction", mb.SphericalFriction(coulomb=1.5), ball)
    m.force("torque", mb.Torque(magnitude=1.2, axis="y"), ball)
    for k in range(3):
        m.output(f"moment.{k}", friction.effort(k))
    found = mb.equilibrium(m)
    expected = turned.inv().apply([0.0, -1.2, 0.0])  # in the axes of the ball, which turns by the deflection
    assert [*found.outputs.values()] == pytest.approx(expected, abs=1.2e-5)
    assert "friction holds the start position (state 'friction.bristle.x' and 2 more)" in str(found.diagnostics[0])
    assert found.stability == "neutral"


@pytest.mark.parametrize("speed", [8.0, -8.0])
def test_friction_of_a_joint_that_a_drive_turns_through_a_gear(speed: float) -> None:
    """It slides in the steady state: torque of the drive (T + k w / 2) / 2 at the ratio 2."""
    m = mb.Mechanism(gravity=(0.0, -G, 0.0))
    drive = mb.RunUp(speed=speed, duration=0.5)
    motor = m.body("motor", m.ground, mb.Revolute(axis="y", drive=drive), inertia=(0.1, 0.1, 0.1))
    spindle = m.body("spindle", m.ground, mb.Revolute(axis="y", at=(1.0, 0.0, 0.0)), inertia=(0.1, 0.1, 0.1))
    m.couple("gear", mb.Gear(ratio=2.0), motor, spindle)
    arm = m.body("arm", spindle, mb.Revolute(axis="z", start=-1.0), mass=1.0, com=(0.25, 0.0, 0.0))
    friction = m.force("bearing", mb.JointFriction(coulomb=0.3, viscous=0.01), spindle)
    m.force("damper", mb.JointDamper(damping=0.2), arm)
    m.output("friction", friction.effort())
    m.output("torque", motor.effort())
    sign = np.sign(speed)
    found = mb.equilibrium(m)
    assert found.outputs == {"friction": pytest.approx(-0.34 * sign), "torque": pytest.approx(0.17 * sign)}
    assert found.states()["bearing.bristle"] == pytest.approx(sign)
    assert not [note for note in found.diagnostics if "keeps its start value" in note.text]
    assert found.stability == "stable"


def test_damping_refers_to_the_inertia_that_the_loop_lets_move() -> None:
    """Two cranks of 1 kg and 0.5 m and a coupler of 2 kg move together: 2/3 kg m^2 at each crank."""
    m = mb.Mechanism()
    crank = m.body("crank", m.ground, mb.Revolute(start=1.2), **mb.rod(mass=1.0, length=0.5))
    coupler = m.body("coupler", crank, mb.Revolute(at=(0.5, 0, 0), start=-1.2), **mb.rod(mass=2.0, length=1.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(1.0, 0, 0), start=1.2), **mb.rod(mass=1.0, length=0.5))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0, 0), at_b=(0.5, 0, 0)), coupler, rocker)
    m.force("friction", mb.JointFriction(coulomb=2.0), crank)
    pair = max((mode.eigenvalue for mode in mb.equilibrium(m).modes), key=abs)
    w = np.sqrt(2.0 / (1e-5 * (2.0 * 0.25 / 3.0 + 2.0 * 0.25)))
    assert abs(pair) == pytest.approx(w, rel=1e-6)
    assert -pair.real / abs(pair) == pytest.approx(0.7, rel=1e-6)


def test_solver_and_tolerance_fit_the_bristle() -> None:
    m = pendulum(1.0, 0.1, deflection=1e-7)
    simulation = mb.Simulation(m, mb.Settings(solver="adams", tolerance=1e-6))
    codes = {found.code: found for found in simulation.diagnostics}
    assert "tolerance of 1e-07 or less" in str(codes["unresolved-friction"])
    assert "'adams' is explicit" in str(codes["explicit-friction"])
    simulation = mb.Simulation(m, mb.Settings(solver="auto", tolerance=1e-7))
    assert simulation.solver_choice.solver == "radau"
    assert {found.code for found in simulation.diagnostics} == {"selected-solver"}


def test_displacement_and_angle_of_a_cylindrical_joint_have_separate_friction() -> None:
    """Each stops after v^2 / (2 a), with a = F / m and M / I."""
    m = mb.Mechanism()
    joint = mb.Cylindrical(axis="x", rate=(6.0, 2.0), nominal=1.0)
    body = m.body("body", m.ground, joint, mass=2.0, inertia=(0.5, 1.0, 1.0))
    turning = m.force("turning", mb.JointFriction(coulomb=3.0), body)
    sliding = m.force("sliding", mb.JointFriction(coulomb=8.0, coordinate=1), body)
    m.output("moment", turning.effort())
    m.output("force", sliding.effort())
    with pytest.raises(UserError, match="needs a joint with a coordinate 2"):
        m.force("none", mb.JointFriction(coulomb=1.0, coordinate=2), body)
    with pytest.raises(UserError, match="needs a Spherical joint"):
        m.force("none", mb.SphericalFriction(coulomb=1.0), body)
    with pytest.raises(UserError, match="k of effort of force 'turning' is 1; allowed: 0 to 0"):
        turning.effort(1)
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-6))
    simulation.advance(0.2)
    assert simulation.outputs()[:2] == pytest.approx([-3.0, -8.0], rel=1e-6)
    assert [v.unit for v in simulation.variables[:2]] == ["N.m", "N"]
    simulation.advance(2.0)
    assert simulation.stepper.q == pytest.approx([36.0 / 12.0, 4.0 / 8.0], abs=6e-5)


@pytest.mark.parametrize("friction", [0.9, 1.1])
def test_screw_locks_itself(friction: float) -> None:
    """Friction of the thread in parts of the torque m g h / (2 pi) of the weight: below 1 the nut turns down."""
    mass, lead, inertia = 2.0, 0.01, 1e-4
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    nut = m.body("nut", m.ground, mb.Screw(lead=lead), mass=mass, inertia=(inertia, inertia, inertia))
    torque = mass * G * lead / (2.0 * np.pi)
    m.force("thread", mb.JointFriction(coulomb=friction * torque, deflection=1e-5), nut)
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-6))
    simulation.advance(1.0)
    moved = inertia + mass * (lead / (2.0 * np.pi)) ** 2
    expected = -0.5 * (1.0 - friction) * torque / moved if friction < 1.0 else 0.0
    released = np.sqrt(friction * torque * 1e-5 / moved)  # speed, rad/s, by the energy that bends the bristle
    assert simulation.stepper.q[0] == pytest.approx(expected, abs=released if expected else 2e-5)


def test_ball_joint_stops_about_any_axis() -> None:
    """A ball that turns at 3 rad/s about an oblique axis turns by w^2 I / (2 M) about it, and then holds a torque."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    m = mb.Mechanism()
    joint = mb.Spherical(rate=tuple(3.0 * axis))
    ball = m.body("ball", m.ground, joint, mass=1.0, inertia=(0.2, 0.2, 0.2))
    friction = m.force("friction", mb.SphericalFriction(coulomb=0.5), ball)
    push = mb.Input(name="torque", unit="N.m", start=0.0)
    m.force("torque", mb.Torque(magnitude=push, axis="y"), ball)
    m.output("moment", friction.effort(2))
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-6))
    simulation.advance(0.4)
    assert simulation.outputs()[0] == pytest.approx(-0.5 * axis[2], rel=1e-6)
    simulation.advance(2.0)
    half = 0.5 * 9.0 * 0.2 / (2.0 * 0.5)
    still = np.array([np.cos(half), *(np.sin(half) * axis)])
    assert simulation.stepper.q == pytest.approx(still, abs=4e-5)
    simulation.set_input("torque", 0.4)
    simulation.advance(3600.0)
    assert simulation.stepper.q == pytest.approx(still, abs=5e-5)
    assert np.linalg.norm(simulation.stepper.v[3:]) == pytest.approx(0.8, rel=1e-5)
    assert not simulation.inaccurate


def test_normal_force_that_grows_with_the_way() -> None:
    """m v^2 / 2 = mu (N x + k x^2 / 2)."""
    stiffness = mb.Input(name="k", unit="N/m", start=40.0)
    m, _ = block(0.0, rate=2.0, normal_force="10 + k * q", uses={"k": stiffness})
    simulation = mb.Simulation(m, mb.Settings(solver="radau", tolerance=1e-6))
    simulation.advance(3.0)
    x = (-10.0 + np.sqrt(100.0 + 2.0 * 40.0 * MASS * 2.0 / MU)) / 40.0
    assert simulation.stepper.q[0] == pytest.approx(x, abs=6e-5)


def test_rope_about_a_drum_holds_by_its_loose_end() -> None:
    """Capstan: the torque is r T (exp(mu phi) - 1) with the tension T of the loose end."""
    m = mb.Mechanism()
    drum = m.body("drum", m.ground, mb.Revolute(), inertia=(0.1, 0.1, 0.1))
    coulomb = 0.2 * (np.exp(0.3 * 2.5 * np.pi) - 1.0)
    tension = mb.Ramp(height=-10.0, duration=10.0, offset=10.0)
    m.force("rope", mb.JointFriction(coulomb=coulomb, normal_force=tension), drum)
    m.force("load", mb.JointForce(4.0), drum)
    m.output("drum.angle", drum.angle())
    result = mb.simulate(m, 9.0, interval=0.01, solver="ida", tolerance=1e-6)
    slides = result.t[np.flatnonzero(result["drum.angle"] > 1e-3)[0]]
    way = (6.0 * 0.1 * 1e-3 / coulomb) ** (1.0 / 3.0)  # s until it has turned by 1e-3 rad
    assert slides == pytest.approx(10.0 - 4.0 / coulomb + way, abs=0.02)


def test_kernels_fulfil_the_identities() -> None:
    given = {"coulomb": 2.0, "static": 3.0, "stribeck": 0.5, "viscous": 0.1, "deflection": 0.3}
    law = {"normal_force": "1 + x * x + q * q", "uses": {"x": 2.0}}
    for element in (
        mb.JointFriction(**given),
        mb.JointFriction(**given, **law),
        mb.JointFriction(**given, coordinate=1),
        mb.SphericalFriction(**given),
        mb.SphericalFriction(**given, normal_force="1 + x", uses={"x": 2.0}),
    ):
        assert check_element(element, bodies=1, states=3).passed, element


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"coulomb": 0.0}, "coulomb of force 'f' is 0.0"),
        ({"static": 0.5}, "static of force 'f' is 0.5; allowed: at least coulomb, 1.0"),
        ({"static": 2.0}, "stribeck of force 'f' is not given"),
        ({"stribeck": 0.0}, "stribeck of force 'f' is 0.0"),
        ({"viscous": -1.0}, "viscous of force 'f' is -1.0"),
        ({"deflection": 0.0}, "deflection of force 'f' is 0.0"),
        ({"normal_force": "soft"}, "normal_force of force 'f'"),
    ],
)
def test_what_is_no_friction_is_refused(given: dict[str, Any], message: str) -> None:
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(), inertia=(1.0, 1.0, 1.0))

    def simulate() -> None:
        m.force("f", mb.JointFriction(**({"coulomb": 1.0} | given)), arm)
        mb.Simulation(m, mb.Settings())

    with pytest.raises(UserError, match=message):
        simulate()
