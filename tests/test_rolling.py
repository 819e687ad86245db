"""Wheels that roll without slip, against Newton and Euler's equations by SciPy, closed forms, and identities."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism
from mbfmu.studies.check_report import format_findings
from mbfmu.testing.identities import constraint_rates, random_state
from mbfmu.util.errors import AssemblyError, UserError

G = 9.81


class Wheel:
    """A wheel of radius R, crown radius c, mass m, moments of inertia A across the axle y and C about it, on z = 0.

    Reference: Newton and Euler's equations about the center with the force at the contact, global axes. State: center
    (3), quaternion (4, scalar first), angular velocity (3).
    """

    def __init__(self, size: float = 1.0, crown: float = 0.0, hoop: float = 0.5) -> None:
        self.size, self.R, self.c, self.m = size, size, crown * size, 2.0 * size**3
        self.C = hoop * self.m * size**2
        self.A = 0.5 * self.C

    def contact(self, e: Any) -> tuple[Any, Any]:
        """Return from the center to the contact point, and the direction down the wheel, for an axle e."""
        n = np.array([0.0, 0.0, 1.0])
        u = -(n - e[2] * e) / np.hypot(e[0], e[1])
        return (self.R - self.c) * u - self.c * n, u

    def accelerations(self, e: Any, w: Any, g: float) -> tuple[Any, Any]:
        """Return the angular acceleration and the force at the contact."""
        n, (r, _), s = np.array([0.0, 0.0, 1.0]), self.contact(e), np.hypot(e[0], e[1])
        de = np.cross(w, e)
        ds = -e[2] * de[2] / s
        du = (de[2] * e + e[2] * de) / s + (n - e[2] * e) * ds / s**2
        dr = (self.R - self.c) * du
        inertia = self.A * np.eye(3) + (self.C - self.A) * np.outer(e, e)
        gyroscopic = np.cross(w, inertia @ w)
        # v = -w x r, so that the acceleration of the center is -w' x r - w x r'; I w' + w x I w = r x F
        K = inertia + self.m * (r @ r * np.eye(3) - np.outer(r, r))
        drive = np.cross(r, self.m * (-np.cross(w, dr) + np.array([0.0, 0.0, g])))
        dw = np.linalg.solve(K, drive - gyroscopic)
        a = -np.cross(dw, r) - np.cross(w, dr)
        return dw, self.m * (a + np.array([0.0, 0.0, g]))

    def slopes(self, _: float, x: Any, g: float) -> Any:
        """Return the derivative of the state."""
        R, w = Rotation.from_quat(x[3:7] / np.linalg.norm(x[3:7]), scalar_first=True), x[7:]
        e = R.as_matrix()[:, 1]
        s, v = x[3], x[4:7]
        turning = 0.5 * np.concatenate(([-w @ v], s * w + np.cross(w, v)))
        return np.concatenate((-np.cross(w, self.contact(e)[0]), turning, self.accelerations(e, w, g)[0]))

    def start(self, turn: Any, w: Any) -> Any:
        """Return the state at rest in the contact with this orientation and angular velocity, global axes."""
        e = turn.as_matrix()[:, 1]
        r = self.contact(e)[0]
        return np.concatenate(([0.0, 0.0, -r[2]], turn.as_quat(scalar_first=True), w))

    def energy(self, x: Any, g: float) -> float:
        """Return the energy, J."""
        e = Rotation.from_quat(x[3:7], scalar_first=True).as_matrix()[:, 1]
        w, v = x[7:], -np.cross(x[7:], self.contact(e)[0])
        spin = w @ e
        return float(
            0.5 * self.m * v @ v + 0.5 * self.A * (w @ w - spin**2) + 0.5 * self.C * spin**2 + self.m * g * x[2]
        )

    def model(self, x: Any, g: float, joint: mb.RollingWheel | None = None) -> mb.Mechanism:
        """Return the mechanism that starts in a state; ``joint``: of the contact, without friction by default."""
        m = mb.Mechanism(gravity=(0.0, 0.0, -g))
        turn = Rotation.from_quat(x[3:7], scalar_first=True)
        v = -np.cross(x[7:], self.contact(turn.as_matrix()[:, 1])[0])
        free = mb.Floating(start=x[:7], rate=(*v, *turn.inv().apply(x[7:])))
        wheel = m.body("wheel", m.ground, free, mass=self.m, com=(0, 0, 0), inertia=(self.A, self.C, self.A))
        joint = joint or mb.RollingWheel(radius=self.R, crown_radius=self.c)
        contact = m.cut("contact", joint, m.ground, wheel)
        m.output("demand", contact.required_friction())
        for axis in "xyz":
            m.output(axis, wheel.position(axis))
            m.output(f"F{axis}", contact.joint_force(axis))
        for row in contact.rows:
            m.output(row, contact.force(row))
        return m


WOBBLE = Rotation.from_euler("zxy", (0.4, 0.7, 0.2)), np.array([0.3, 0.9, 1.1])  # attitude, angular velocity x rate


@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau", "ida"])
@pytest.mark.parametrize(("size", "crown"), [(1.0, 0.0), (1e-3, 0.3), (1e3, 0.1)])
def test_a_wobbling_wheel_follows_newton_and_euler(solver: str, size: float, crown: float) -> None:
    wheel, rate = Wheel(size, crown), np.sqrt(G / size)
    x = wheel.start(WOBBLE[0], WOBBLE[1] * rate)
    times = np.linspace(0.0, 6.0 / rate, 13)
    exact = solve_ivp(wheel.slopes, times[[0, -1]], x, "DOP853", times, args=(G,), rtol=1e-12, atol=1e-12 * rate * size)
    assert abs(wheel.energy(exact.y[:, -1], G) / wheel.energy(x, G) - 1.0) < 1e-9
    result = mb.simulate(wheel.model(x, G), times[-1], solver=solver, tolerance=1e-9, interval=times[1])
    assert not [d for d in result.diagnostics if d.severity != "note"]
    assert not result.inaccurate
    found = np.array([result[axis] for axis in "xyz"])
    assert np.abs(found - exact.y[:3]).max() < 3e-7 * size
    forces = [wheel.accelerations(Rotation.from_quat(y[3:7], scalar_first=True).as_matrix()[:, 1], y[7:], G)[1]
              for y in exact.y.T]  # fmt: skip
    found = np.array([result[f"F{axis}"] for axis in "xyz"]).T
    assert np.abs(found - forces).max() < 3e-6 * wheel.m * G
    np.testing.assert_allclose(result["normal"], np.array(forces)[:, 2], atol=3e-6 * wheel.m * G)
    np.testing.assert_allclose(np.hypot(result["longitudinal"], result["lateral"]), np.hypot(*found.T[:2]), rtol=1e-9)


def steady_spin(wheel: Wheel, lean: float, yaw_rate: float, g: float) -> float:
    """Return the angular velocity about the axle of a disk that rolls in a circle with its axle ``lean`` above the
    plane: (C + m R^2) w_u w_e = A W_e w_u + m g R sin(lean), w_u = -yaw' cos(lean), W_e = yaw' sin(lean).
    """
    w_u, along = -yaw_rate * np.cos(lean), yaw_rate * np.sin(lean)
    pull = wheel.m * g * wheel.R * np.sin(lean)
    return float((wheel.A * along * w_u + pull) / ((wheel.C + wheel.m * wheel.R**2) * w_u))


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_disk_rolls_in_a_circle_at_the_lean_angle_of_the_closed_form(size: float) -> None:
    wheel, lean, yaw_rate = Wheel(size), 0.35, 1.7 * np.sqrt(G / size)
    spin = steady_spin(wheel, lean, yaw_rate, G)
    turn = Rotation.from_euler("x", lean)
    e = turn.as_matrix()[:, 1]
    w = yaw_rate * np.array([0.0, 0.0, 1.0]) + (spin - yaw_rate * e[2]) * e
    result = mb.simulate(wheel.model(wheel.start(turn, w), G), 2.0 * np.pi / yaw_rate, tolerance=1e-10)
    assert np.abs(result["z"] - size * np.cos(lean)).max() < 1e-8 * size
    radius, angle = wheel.R * spin / yaw_rate, yaw_rate * result.t
    assert np.abs(result["x"] - radius * np.sin(angle)).max() < 1e-7 * size
    assert np.abs(result["y"] - radius * (1.0 - np.cos(angle))).max() < 1e-7 * size
    np.testing.assert_allclose(result["normal"], wheel.m * G, rtol=1e-7)


def polar(wheel: Wheel, yaw_rate: float, spin: float, lean: float, radius: float) -> mb.Mechanism:
    """A disk by the polar coordinates of its center: yaw, distance, height, lean, and rotation about the axle."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    yaw = m.body("yaw", m.ground, mb.Revolute(axis="z", rate=yaw_rate))
    arm = m.body("arm", yaw, mb.Translational(axis="y", start=radius))
    lift = m.body("lift", arm, mb.Translational(axis="z", start=wheel.R))
    held = m.body("held", lift, mb.Revolute(axis="x", start=lean))
    inertia = (wheel.A, wheel.C, wheel.A)
    disk = m.body("disk", held, mb.Revolute(axis="y", rate=spin), mass=wheel.m, inertia=inertia)
    m.cut("contact", mb.RollingWheel(radius=wheel.R), m.ground, disk)
    m.output("lean", held.coordinate())
    m.output("radius", arm.coordinate())
    return m


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_the_circle_of_a_disk_is_found_as_a_steady_state(size: float) -> None:
    wheel, lean, yaw_rate = Wheel(size), -0.35, 1.7 * np.sqrt(G / size)
    spin = steady_spin(wheel, lean, yaw_rate, G)
    radius = -wheel.R * spin / yaw_rate
    found = mb.equilibrium(polar(wheel, yaw_rate, spin - yaw_rate * np.sin(lean), 1.03 * lean, 0.98 * radius))
    assert found.outputs["lean"] == pytest.approx(lean, rel=1e-9)
    assert found.outputs["radius"] == pytest.approx(radius, rel=1e-9)


def upright(wheel: Wheel, speed: float) -> mb.Mechanism:
    """A disk that rolls upright along x, by the coordinates of its center, yaw, lean and rotation."""
    m = mb.Mechanism(gravity=(0.0, 0.0, -G))
    along = m.body("x", m.ground, mb.Translational(axis="x", rate=speed))
    across = m.body("y", along, mb.Translational(axis="y"))
    lift = m.body("z", across, mb.Translational(axis="z", start=wheel.R))
    yaw = m.body("yaw", lift, mb.Revolute(axis="z"))
    lean = m.body("lean", yaw, mb.Revolute(axis="x"))
    disk = m.body("disk", lean, mb.Revolute(axis="y"), mass=wheel.m, inertia=(wheel.A, wheel.C, wheel.A))
    m.cut("contact", mb.RollingWheel(radius=wheel.R), m.ground, disk)
    m.output("lean", lean.coordinate())
    return m


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("froude", [0.0, 0.3, 1.0])
def test_the_linear_motion_of_an_upright_disk_is_that_of_the_closed_form(size: float, froude: float) -> None:
    """(A + m R^2) s^2 = m g R - (C + m R^2) C w^2 / A, by the momentum about the vertical axis."""
    wheel, speed = Wheel(size), froude * np.sqrt(G * size)
    inertia, spin = wheel.C + wheel.m * wheel.R**2, speed / wheel.R
    square = (wheel.m * G * wheel.R - inertia * wheel.C * spin**2 / wheel.A) / (wheel.A + wheel.m * wheel.R**2)
    found = mb.equilibrium(upright(wheel, speed))
    values = found.spectrum.values
    moving = values[np.abs(values) > 0.0]
    root = np.sqrt(complex(square))
    expected = [-root, root] if square > 0.0 else [root]
    np.testing.assert_allclose(np.sort_complex(moving), np.sort_complex(expected), rtol=1e-9)
    assert found.stability == ("unstable" if square > 0.0 else "neutral")
    linear = found.state_space
    assert linear.A.shape == (8, 8)  # five independent positions, three independent rates
    assert len(linear.states) == 8
    every = np.linalg.eigvals(linear.A)
    assert np.abs(every[:, None] - np.array([root, -root])).min(axis=0).max() < 1e-6 * abs(root)
    assert np.sum(np.abs(every) > 1e-4 * abs(root)) == 2


def test_rates_with_which_a_wheel_slips_are_reported() -> None:
    """A wheel on an incline has no steady state. Its start slips, since the rotation of a floating body is at rest."""
    m = mb.Mechanism(gravity=(1.0, 0.0, -G))
    start = mb.Floating(start=(0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0), rate=(5.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    wheel = m.body("wheel", m.ground, start, mass=1.0, inertia=(0.1, 0.2, 0.1))
    m.cut("contact", mb.RollingWheel(radius=0.5), m.ground, wheel)
    with pytest.raises(mb.EquilibriumError, match=r"constraint 'contact.longitudinal' violated by 5 m/s"):
        mb.equilibrium(m)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_wheel_rolls_down_an_incline_of_any_direction(size: float) -> None:
    """a = g sin(slope) / (1 + C / (m R^2)); the plane holds it with the rest of the weight."""
    wheel, rng = Wheel(size, crown=0.2, hoop=0.8), np.random.default_rng(5)
    frame, slope = Rotation.random(random_state=rng), 0.3
    down, normal = np.array([np.sin(slope), 0.0, -np.cos(slope)]), np.array([0.0, 0.0, 1.0])  # weight in the frame
    m = mb.Mechanism(gravity=frame.apply(G * down))
    at, own = size * rng.normal(size=3), Rotation.random(random_state=rng)  # of the cut frame in the wheel
    turn = frame * own.inv()
    start = at + size * frame.apply(normal)
    free = mb.Floating(start=(*start, *turn.as_quat(scalar_first=True)))
    inertia = own.as_matrix() @ np.diag((wheel.A, wheel.C, wheel.A)) @ own.as_matrix().T
    body = m.body("wheel", m.ground, free, mass=wheel.m, inertia=inertia)
    joint = mb.RollingWheel(radius=wheel.R, crown_radius=wheel.c, at_a=at, rotation_a=frame, rotation_b=own)
    contact = m.cut("contact", joint, m.ground, body)
    for k, axis in enumerate("xyz"):
        m.output(f"r{k}", body.position(axis))
    for row in contact.rows:
        m.output(row, contact.force(row))
    t = 2.0 * np.sqrt(size / G)
    result = mb.simulate(m, t, tolerance=1e-9)
    moved = frame.inv().apply(np.array([result[f"r{k}"][-1] for k in range(3)]) - start)
    part = 1.0 / (1.0 + wheel.C / (wheel.m * wheel.R**2))
    np.testing.assert_allclose(moved, (0.5 * part * G * np.sin(slope) * t**2, 0.0, 0.0), atol=1e-8 * size)
    weight = wheel.m * G
    np.testing.assert_allclose(result["normal"], weight * np.cos(slope), rtol=1e-9)
    np.testing.assert_allclose(result["longitudinal"], -(1.0 - part) * weight * np.sin(slope), rtol=1e-9)
    np.testing.assert_allclose(result["lateral"], 0.0, atol=1e-9 * weight)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_rows_of_wheels_are_derivatives_at_random_states(size: float) -> None:
    rng = np.random.default_rng(11)
    for grip in ("both", "longitudinal", "lateral"):
        m = mb.Mechanism()
        bodies = [m.ground]
        for k in range(2):
            turn = Rotation.random(random_state=rng)
            joint = mb.Floating(start=(*(size * rng.normal(size=3)), *turn.as_quat(scalar_first=True)))
            bodies.append(m.body(f"b{k}", bodies[-1], joint, mass=1.0, inertia=np.eye(3) * size**2))
        frames = {"rotation_a": Rotation.random(random_state=rng), "rotation_b": Rotation.random(random_state=rng)}
        places = {"at_a": size * rng.normal(size=3), "at_b": size * rng.normal(size=3)}
        joint = mb.RollingWheel(
            radius=size, crown_radius=0.3 * size, grip=grip, normal="x", axis="z", **places, **frames
        )
        m.cut("wheel", joint, bodies[1], bodies[2])
        compiled = CompiledMechanism(m)
        assert compiled.system.holonomic.tolist() == [0]
        for _ in range(5):
            at = random_state(compiled, rng, 0.3 * size)
            for found in constraint_rates(compiled, at):
                assert found.size < 1e-6 + 10.0 * found.uncertainty, found


def test_refusals_and_reports() -> None:
    wheel = Wheel()
    x = wheel.start(Rotation.identity(), np.array([0.0, 1.0, 0.0]))
    m = mb.Mechanism()
    body = m.body("b", m.ground, mb.Floating())
    for wrong, text in (
        ({"radius": 0.0}, "radius of cut 'w' is"),
        ({"radius": 1.0, "crown_radius": 2.0}, "crown_radius of cut 'w' is"),
        ({"radius": 1.0, "grip": "all"}, "grip of cut 'w' is"),
        ({"radius": 1.0, "axis": "w"}, "axis of cut 'w' is"),
        ({"radius": 1.0, "normal": (0.0, 0.0, 0.0)}, "normal of cut 'w' is"),
        ({"radius": 1.0, "friction": (0.5, 0.0)}, r"friction of cut 'w' is \(0.5, 0.0\); allowed: a positive number"),
        ({"radius": 1.0, "friction": "rubber"}, "friction of cut 'w' is 'rubber'"),
    ):
        with pytest.raises(UserError, match=text):
            m.cut("w", mb.RollingWheel(**wrong), m.ground, body)
    for solver, text in (("adams-lu", "nonholonomic constraints"), ("esdirk", "large models only")):
        with pytest.raises(UserError, match=text):
            mb.simulate(wheel.model(x, G), 0.1, solver=solver)
    with pytest.raises(AssemblyError, match=r"'contact\.longitudinal' follows from constraints of the positions"):
        mb.simulate(rack_and_wheel(), 0.1)
    found = mb.check(wheel.model(x, G))
    assert (found.freedom, found.position_freedom) == (3, 5)
    assert "3 degrees of freedom (5 of positions: some constraints are nonholonomic)" in format_findings(found)
    lifted = mb.simulate(wheel.model(x, -G), 0.1)
    assert [d.subject for d in lifted.diagnostics if d.code == "lifting-wheel"] == ["contact"]


@pytest.mark.parametrize(("size", "ratio"), [(1e-3, 2.5), (1.0, 1.0), (1e3, 0.4)])
def test_a_wheel_that_needs_more_friction_than_it_has_is_reported(size: float, ratio: float) -> None:
    """The forces of the reference leave the ellipse of friction of the axes mu and ratio mu at the time reported."""
    wheel, rate = Wheel(size), np.sqrt(G / size)
    x, times = wheel.start(WOBBLE[0], WOBBLE[1] * rate), np.linspace(0.0, 2.0 / rate, 9)
    exact = solve_ivp(wheel.slopes, times[[0, -1]], x, "DOP853", times, args=(G,), rtol=1e-12, atol=1e-12 * rate * size)
    needed, plain = np.empty((2, len(times)))
    for k, y in enumerate(exact.y.T):
        e = Rotation.from_quat(y[3:7], scalar_first=True).as_matrix()[:, 1]
        force = wheel.accelerations(e, y[7:], G)[1]
        heading = np.array([e[1], -e[0], 0.0]) / np.hypot(e[0], e[1])
        along, across = force @ heading, force @ np.cross((0.0, 0.0, 1.0), heading)
        needed[k], plain[k] = np.hypot(along, across / ratio) / force[2], np.hypot(along, across) / force[2]
    largest = int(np.argmax(needed))
    for part, slips in ((1.001, False), (0.999, True)):
        mu = part * needed[largest]
        joint = mb.RollingWheel(radius=size, friction=mu if ratio == 1.0 else (mu, ratio * mu))
        result = mb.simulate(wheel.model(x, G, joint), times[-1], tolerance=1e-8, interval=times[1])
        found = [d for d in result.diagnostics if d.code == "slipping-wheel"]
        assert [d.time for d in found] == pytest.approx([times[largest]] if slips else [])
        np.testing.assert_allclose(result["demand"], plain, rtol=1e-5)


def rack_and_wheel() -> mb.Mechanism:
    """A wheel whose rotation is determined by a rack, too."""
    m = mb.Mechanism()
    slide = m.body("slide", m.ground, mb.Translational(axis="x", at=(0.0, 0.0, 0.5)))
    wheel = m.body("wheel", slide, mb.Revolute(axis="y"), mass=1.0, inertia=(1.0, 1.0, 1.0))
    m.couple("rack", mb.Gear(ratio=0.5), slide, wheel)
    m.cut("contact", mb.RollingWheel(radius=0.5), m.ground, wheel)
    return m
