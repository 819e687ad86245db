"""Gears, racks and cams against closed forms and against SciPy on the one coordinate that is left."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from mbfmu import Simulation, equilibrium, linearize, simulate
from mbfmu.mechanics import (
    Beam,
    Body,
    Cam,
    CompiledMechanism,
    CouplingHandle,
    Cylindrical,
    Gear,
    Harmonic,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    RevoluteCutJoint,
    Spherical,
    SphericalCutJoint,
    Table,
    Torque,
    Translational,
    rod,
)
from mbfmu.modeling.model import as_model
from mbfmu.modeling.settings import Settings
from mbfmu.util.errors import AssemblyError, EquilibriumError, UserError

SOLVERS = ["adams", "hybrid", "ida"]
TIGHT: dict[str, Any] = {"solver": "adams", "tolerance": 1e-9}


def wheel(m: Mechanism, name: str, inertia: float, parent: Body | None = None, **joint: Any) -> Body:
    """A wheel about z that weighs nothing to speak of."""
    return m.body(name, parent or m.ground, Revolute(**joint), inertia=(inertia, inertia, inertia))


def flywheels(ratio: float, J: tuple[float, float], torque: Any, **start: Any) -> tuple[Mechanism, CouplingHandle]:
    """Two geared flywheels; the torque is on the second."""
    m = Mechanism()
    a, b = wheel(m, "a", J[0]), wheel(m, "b", J[1], **start)
    mesh = m.couple("mesh", Gear(ratio=ratio), a, b)
    m.force("motor", JointForce(torque), b)
    for name, sensor in (("a", a.angle()), ("b", b.angle()), ("on a", mesh.effort()), ("on b", mesh.effort("b"))):
        m.output(name, sensor)
    m.output("energy", m.energy)
    m.output("open", m.position_residual)
    m.output("slip", m.velocity_residual)
    return m, mesh


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("size", "ratio"), [(1e-3, -2.0), (1.0, 5.0), (1e3, -1e-3), (1.0, 1e5)])
def test_a_gear_reflects_inertia_by_the_square_of_its_ratio(solver: str, size: float, ratio: float) -> None:
    J, torque = (0.5 * size**2 / ratio**2, 0.2 * size**2), 3.0 * size**2
    m, _ = flywheels(ratio, J, torque)
    result = simulate(m, 1.0, solver=solver, tolerance=1e-8)
    assert not result.failure
    acceleration = torque / (J[1] + ratio**2 * J[0])
    np.testing.assert_allclose(result["b"], 0.5 * acceleration * result.t**2, atol=1e-7)
    np.testing.assert_allclose(result["a"], ratio * result["b"], rtol=0, atol=1e-9 * max(1.0, abs(ratio)))
    np.testing.assert_allclose(result["on a"], ratio * J[0] * acceleration, rtol=1e-6)
    np.testing.assert_allclose(result["on b"], -(ratio**2) * J[0] * acceleration, rtol=1e-6)
    assert result["open"].max() <= 1e-9 * max(1.0, abs(ratio))
    assert result["slip"].max() <= 1e-7 * max(1.0, abs(ratio))


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_rack_falls_against_its_pinion(size: float) -> None:
    m, radius = Mechanism(gravity=(0.0, -9.81, 0.0)), 0.05 * size
    rack = m.body("rack", m.ground, Translational(axis="y"), mass=2.0)
    pinion = wheel(m, "pinion", 3.0 * radius**2)
    mesh = m.couple("mesh", Gear(ratio=radius, offset=0.2 * size), rack, pinion)
    m.output("rack", rack.coordinate())
    m.output("pinion", pinion.angle())
    m.output("force", mesh.effort())
    m.output("torque", mesh.effort("b"))
    assert [v.unit for v in CompiledMechanism(m).outputs] == ["m", "rad", "N", "N.m"]
    result = simulate(m, 0.5, **TIGHT)
    fallen = 0.5 * 9.81 * 2.0 / 5.0 * result.t**2
    np.testing.assert_allclose(result["rack"], result["rack"][0] - fallen, atol=1e-7 * size)
    np.testing.assert_allclose(result["rack"], radius * result["pinion"] + 0.2 * size, atol=1e-10 * size)
    np.testing.assert_allclose(result["force"], 9.81 * 2.0 * 3.0 / 5.0, rtol=1e-6)
    np.testing.assert_allclose(result["torque"], -radius * result["force"], rtol=1e-9)


ANGLES = np.linspace(0.0, 2.0 * np.pi, 25)
LIFT = 0.02 * (1.0 - np.cos(ANGLES)) + 0.004 * np.sin(2.0 * ANGLES) ** 2
LIFT[-1] = LIFT[0]
LAWS = {
    "table": Cam(Table(ANGLES, LIFT, beyond="periodic")),
    "function": Cam(lambda q: 0.02 * (1.0 - np.cos(q)) + 0.004 * np.sin(2.0 * q) ** 2),
    "expression": Cam("0.02 * (1 - cos(q)) + 0.004 * sin(2 * q)**2"),
}


def lifted(angle: Any, order: int = 0) -> Any:
    """The law of the table, written again."""
    return CubicSpline(ANGLES, LIFT, bc_type="periodic")(np.mod(angle, 2.0 * np.pi), order)


def follower(law: Cam) -> Mechanism:
    """A follower on a spring, lifted by a cam that turns freely and twice round."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    stem = m.body("stem", m.ground, Translational(axis="y"), mass=0.5)
    cam = wheel(m, "cam", 2e-2, start=0.3, fixed=True, rate=20.0)
    mesh = m.couple("lift", law, stem, cam)
    m.force("spring", JointSpring(stiffness=800.0, free=-0.01), stem)
    m.output("stem", stem.coordinate())
    m.output("cam", cam.angle())
    m.output("force", mesh.effort())
    m.output("torque", mesh.effort("b"))
    m.output("energy", m.energy)
    return m


@cache
def one_coordinate(law: str) -> tuple[Any, Any]:
    """The cam's angle and the stem's displacement every 0.01 s of 0.8 s, by the Lagrangian of the angle alone."""
    smooth = law == "table"

    def f(q: float, order: int) -> float:
        exact = (0.02 * (1 - np.cos(q)) + 0.004 * np.sin(2 * q) ** 2, 0.02 * np.sin(q) + 0.008 * np.sin(4 * q))
        return float(lifted(q, order)) if smooth else (*exact, 0.02 * np.cos(q) + 0.032 * np.cos(4 * q))[order]

    def rates(t: float, y: Any) -> list[float]:
        q, v = y
        slope, bend = f(q, 1), f(q, 2)
        pull = -0.5 * 9.81 - 800.0 * (f(q, 0) + 0.01)
        return [v, (slope * pull - 0.5 * slope * bend * v * v) / (2e-2 + 0.5 * slope**2)]

    times = np.linspace(0.0, 0.8, 81)
    angle = solve_ivp(rates, (0.0, 0.8), [0.3, 20.0], t_eval=times, rtol=1e-10, atol=1e-12).y[0]
    return angle, [f(q, 0) for q in angle]


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("law", LAWS)
def test_a_cam_moves_as_its_one_coordinate_does(law: str, solver: str) -> None:
    result = simulate(follower(LAWS[law]), 0.8, interval=0.01, solver=solver, tolerance=1e-8)
    assert not result.failure
    assert not result.warning
    assert result["cam"].max() > 4.0 * np.pi
    angle, height = one_coordinate(law)
    np.testing.assert_allclose(result["cam"], angle, atol=2e-5)
    np.testing.assert_allclose(result["stem"], height, atol=1e-6)
    assert np.ptp(result["energy"]) < 1e-5 * np.ptp(result["stem"]) * 800.0


def test_a_cam_pushes_back_by_its_slope() -> None:
    result = simulate(follower(LAWS["table"]), 0.5, interval=0.01, **TIGHT)
    slope = lifted(result["cam"], 1)
    np.testing.assert_allclose(result["torque"], -slope * result["force"], atol=1e-6)


def planetary(torque: float) -> Mechanism:
    """Sun, planet and ring on a carrier; the ring stands still in the ground, by a gear of ratio -1."""
    m = Mechanism()
    carrier = wheel(m, "carrier", 0.3)
    sun = wheel(m, "sun", 0.05, carrier)
    planet = m.body("planet", carrier, Revolute(at=(0.15, 0.0, 0.0)), mass=0.8, inertia=(0.01, 0.01, 0.01))
    ring = wheel(m, "ring", 7.0, carrier)
    m.couple("inner", Gear(ratio=-20 / 30), planet, sun)  # 20, 30 and 80 teeth
    m.couple("outer", Gear(ratio=30 / 80), ring, planet)
    m.couple("held", Gear(ratio=-1.0), ring, carrier)
    m.force("motor", Torque(magnitude=torque, axis="z"), sun)
    for body in (carrier, sun, planet, ring):
        m.output(body.name, m.turn(body))
    return m


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_planetary_gear_turns_by_willis(solver: str) -> None:
    result = simulate(planetary(1.5), 1.0, solver=solver, tolerance=1e-8)
    assert not result.failure
    up = 1.0 + 80 / 20
    np.testing.assert_allclose(result["sun"], up * result["carrier"], atol=1e-8)
    np.testing.assert_allclose(result["planet"], (1.0 - 80 / 30) * result["carrier"], atol=1e-8)
    np.testing.assert_allclose(result["ring"], 0.0, atol=1e-8)
    inertia = 0.3 + 0.05 * up**2 + 0.8 * 0.15**2 + 0.01 * (1.0 - 80 / 30) ** 2
    np.testing.assert_allclose(result["carrier"], 0.5 * 1.5 * up / inertia * result.t**2, atol=1e-7)


def test_a_pinion_rolls_on_a_wheel_that_stands() -> None:
    """Along one chain: the arm carries the pinion, which turns three times as fast in the arm as the arm does."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, Revolute(start=0.2, fixed=True), **rod(mass=1.0, length=0.6))
    pinion = m.body("pinion", arm, Revolute(at=(0.6, 0.0, 0.0)), mass=2.0, inertia=(0.02, 0.02, 0.02))
    m.couple("mesh", Gear(ratio=3.0), pinion, arm)
    m.output("arm", arm.angle())
    inertia, weight = 0.36 / 3.0 + 2.0 * 0.36 + 0.02 * 16.0, 9.81 * (0.3 + 1.2)
    true = solve_ivp(
        lambda t, y: [y[1], -weight * np.cos(y[0]) / inertia], (0.0, 2.0), [0.2, 0.0], rtol=1e-10, atol=1e-12
    )
    assert simulate(m, 2.0, **TIGHT)["arm"][-1] == pytest.approx(true.y[0, -1], abs=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("driven", ["a", "b"])
def test_a_drive_takes_the_effort_of_what_is_coupled_to_it(driven: str, solver: str) -> None:
    m, motion = Mechanism(), Harmonic(amplitude=0.4, frequency=1.0)
    drives = {driven: motion}
    a = m.body("a", m.ground, Translational(axis="x", drive=drives.get("a")), mass=2.0)
    b = wheel(m, "b", 0.3, drive=drives.get("b"))
    mesh = m.couple("mesh", Gear(ratio=0.25), a, b)
    m.force("spring", JointSpring(stiffness=3.0), wheel(m, "loose", 1.0, start=0.5))  # something that moves by itself
    moved = {"a": a, "b": b}[driven]
    m.output("effort", moved.effort())
    m.output("acceleration", moved.acceleration())
    m.output("inner", mesh.effort("b" if driven == "a" else "a"))
    m.output("other", (b if driven == "a" else a).acceleration())
    m.output("energy", m.energy)
    result = simulate(m, 1.3, interval=0.01, solver=solver, tolerance=1e-8)
    assert not result.failure
    assert not result.warning
    inertia = 2.0 + 0.3 * 16.0 if driven == "a" else 0.3 + 2.0 / 16.0
    np.testing.assert_allclose(result["effort"], inertia * result["acceleration"], atol=1e-5)
    np.testing.assert_allclose(result["inner"], (0.3 if driven == "a" else 2.0) * result["other"], atol=1e-5)
    assert np.abs(result["energy_error"]).max() < 1e-5 * np.ptp(result["energy"])
    assert np.ptp(result["energy"]) > 0.1


def test_two_drives_agree_or_are_refused() -> None:
    def both(speed: float) -> tuple[Mechanism, CouplingHandle]:
        m = Mechanism()
        a, b = wheel(m, "a", 1.0, drive=Polynomial((0.0, speed))), wheel(m, "b", 1.0, drive=Polynomial((0.0, 2.0)))
        wheel(m, "c", 1.0)
        return m, m.couple("mesh", Gear(ratio=-3.0), a, b)

    m, mesh = both(-6.0)
    assert CompiledMechanism(m).vanishing_rows == ["mesh"]
    m, mesh = both(-6.0)
    m.output("effort", mesh.effort())
    with pytest.raises(
        UserError,
        match="'effort' reads coupling 'mesh', whose constraint is trivially satisfied in this mechanism: both its",
    ):
        CompiledMechanism(m)
    with pytest.raises(AssemblyError, match=r"the drives open .*'mesh' is violated by .* rad"):
        CompiledMechanism(both(-5.0)[0])


def slider_crank(geared: bool) -> Mechanism:
    """A crank whose inertia about its pivot a flywheel makes larger, geared to it or on it."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    crank = m.body("crank", m.ground, Revolute(start=0.5, fixed=True), **rod(mass=0.5, length=0.1))
    link = m.body("link", crank, Revolute(at=(0.1, 0, 0), start=-0.7), **rod(mass=0.8, length=0.3))
    slider = m.body("slider", m.ground, Translational(axis="x", start=0.38), mass=1.0)
    if geared:
        m.couple("mesh", Gear(ratio=-4.0, offset=1.0), wheel(m, "flywheel", 2e-3), crank)
    else:
        m.body("flywheel", crank, Revolute(drive=0.0), inertia=(0.0, 0.032, 0.032))
    m.cut("pin", SphericalCutJoint(at_a=(0.3, 0, 0)), link, slider)
    m.force("push", JointForce(Harmonic(amplitude=8.0, frequency=1.5)), slider)
    m.output("crank", crank.angle())
    return m


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_loop_with_a_gear_is_the_loop_with_more_inertia(solver: str) -> None:
    found, true = (simulate(slider_crank(geared), 1.0, solver=solver, tolerance=1e-8) for geared in (True, False))
    assert not found.failure
    np.testing.assert_allclose(found["crank"], true["crank"], atol=1e-5)
    diagnostics = Simulation(as_model(slider_crank(True)), Settings()).diagnostics
    assert [d.text for d in diagnostics if d.code == "removed-constraints"] == [
        "loop 'pin': 1 of its 3 constraints is trivially satisfied (z) and removed"
    ]


def ring(last: float) -> Mechanism:
    """Three wheels, each geared to the next."""
    m = Mechanism()
    a, b, c = (wheel(m, name, 0.1) for name in "abc")
    m.couple("ab", Gear(ratio=-2.0), a, b)
    m.couple("bc", Gear(ratio=-0.5), b, c)
    m.couple("ca", Gear(ratio=last), c, a)
    m.force("motor", JointForce(1.0), a)
    m.output("a", a.angle())
    return m


@pytest.mark.parametrize("solver", SOLVERS)
def test_three_gears_in_a_ring_are_redundant_or_stand(solver: str) -> None:
    result = simulate(ring(1.0), 1.0, solver=solver, tolerance=1e-8)
    assert not result.failure
    np.testing.assert_allclose(result["a"], 0.5 / (0.1 * (1.0 + 0.25 + 1.0)) * result.t**2, atol=1e-7)
    compiled = CompiledMechanism(ring(1.0))
    (told,) = map(str, compiled.assembly.notes(0.0, compiled.assemble()[0]))
    assert told.startswith("coupling '")
    assert ": 1 of its 1 constraints is redundant. " in told
    stuck = simulate(ring(1.1), 1.0, solver=solver, tolerance=1e-8)
    assert stuck.failure or np.abs(stuck["a"]).max() < 1e-6


def test_starts_that_do_not_fit() -> None:
    def two(fixed: bool) -> CompiledMechanism:
        m = Mechanism()
        a, b = wheel(m, "a", 1.0, start=1.0, fixed=fixed), wheel(m, "b", 1.0, start=0.2, rate=3.0, fixed=True)
        m.couple("mesh", Gear(ratio=-2.0), a, b)
        return CompiledMechanism(m)

    q, v = two(False).assemble()
    np.testing.assert_allclose(q, [-0.4, 0.2], atol=1e-12)
    np.testing.assert_allclose(v, [-6.0, 3.0], atol=1e-12)
    with pytest.raises(AssemblyError, match=r"'mesh' is violated by 1.4 .*keep fewer start values fixed"):
        two(True).assemble()


def governor(driven: bool, speed: Any = 2.0) -> Mechanism:
    """A pendulum 0.3 m long on a spindle that a motor turns by a gear, three times as fast; rods have no mass."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    if driven:
        drive = Polynomial((0.0, speed))
        motor = m.body("motor", m.ground, Revolute(axis="y", drive=drive), inertia=(0.1, 0.1, 0.1))
    else:
        motor = m.body("motor", m.ground, Revolute(axis="y", rate=speed, fixed=True), inertia=(0.1, 0.1, 0.1))
    spindle = m.body("spindle", m.ground, Revolute(axis="y"), inertia=(0.2, 0.2, 0.2))
    arm = m.body("arm", spindle, Revolute(start=-0.9), mass=1.0, com=(0.3, 0.0, 0.0))
    mesh = m.couple("mesh", Gear(ratio=3.0), spindle, motor)
    m.output("arm", arm.angle())
    m.output("spindle", spindle.rate())
    m.output("mesh", mesh.effort())
    if driven:
        m.force("bearing", JointForce(lambda t, q, v: -0.5 * v), spindle)
    return m


def test_a_geared_governor_has_a_steady_state() -> None:
    """cos of the angle from the axis: g / l w^2; of small oscillations at constant speed w sin of it."""
    state, cosine = equilibrium(governor(True)), 9.81 / (0.3 * 36.0)
    assert state.outputs["arm"] == pytest.approx(-np.pi / 2 + np.arccos(cosine), abs=1e-9)
    assert state.outputs["spindle"] == pytest.approx(6.0, rel=1e-12)
    assert state.outputs["mesh"] == pytest.approx(0.5 * 6.0, rel=1e-9)
    assert state.diagnostics == ()
    eigenvalues = np.linalg.eigvals(state.state_space.A)
    np.testing.assert_allclose(np.abs(eigenvalues), 6.0 * np.sqrt(1.0 - cosine**2), rtol=1e-9)
    free = equilibrium(governor(False))
    assert free.outputs["spindle"] == pytest.approx(6.0, rel=1e-9)
    assert free.outputs["arm"] == pytest.approx(-np.pi / 2 + np.arccos(cosine), abs=1e-9)
    assert free.outputs["mesh"] == pytest.approx(0.0, abs=1e-9)


def test_a_geared_pendulum_has_state_matrices() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, Revolute(start=-1.3), mass=2.0, com=(0.5, 0.0, 0.0))
    flywheel = wheel(m, "flywheel", 0.04)
    m.couple("mesh", Gear(ratio=-5.0), flywheel, arm)
    m.force("motor", JointForce(Input(name="torque", unit="N.m")), flywheel)
    m.output("arm", arm.angle())
    space = linearize(m)
    inertia = 2.0 * 0.25 + 25.0 * 0.04
    assert space.A.shape == (2, 2)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(space.A)), np.sqrt(2.0 * 9.81 * 0.5 / inertia), rtol=1e-9)
    gain = space.C @ np.linalg.solve(-space.A, space.B)
    assert gain[0, 0] == pytest.approx(-5.0 / (2.0 * 9.81 * 0.5), rel=1e-9)


def test_a_cam_under_a_weight_rests_where_it_does_not_rise() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    stem = m.body("stem", m.ground, Translational(axis="y"), mass=0.5)
    cam = wheel(m, "cam", 2e-3, start=0.4)
    m.couple("lift", LAWS["function"], stem, cam)
    m.output("cam", cam.angle())
    m.output("stem", stem.coordinate())
    state = equilibrium(m)
    assert np.mod(state.outputs["cam"] + np.pi, 2.0 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-7)
    A = linearize(m).A
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(A)), np.sqrt(0.5 * 9.81 * 0.052 / 2e-3), rtol=1e-6)


def train(count: int) -> Mechanism:
    """Shafts side by side, each with a wheel on it that is geared to the wheel before, and a pendulum on every one."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    before: Body | None = None
    for k in range(count):
        shaft = wheel(m, f"w{k}", 0.01, at=(0.2 * k, 0.0, 0.0)) if before else wheel(m, "w0", 0.01, rate=3.0)
        bob = m.body(f"b{k}", shaft, Revolute(at=(0.05, 0.0, 0.0), start=-1.0), **rod(mass=0.1, length=0.2))
        if before is not None:
            m.couple(f"g{k}", Gear(ratio=-1.0 if k % 2 else -0.9), shaft, before)
        before = shaft
        m.force(f"s{k}", JointSpring(stiffness=0.5), bob)
    m.couple("cam", Cam(Table([-20.0, -5.0, 5.0, 20.0], [1.0, -0.3, 0.4, 2.0])), m.bodies[4], m.bodies[2])
    m.output("energy", m.energy)
    m.output("last", m.bodies[-1].angle())
    m.output("first", m.bodies[1].angle())
    m.output("open", m.position_residual)
    return m


def test_a_large_tree_with_gears() -> None:
    """Solved by recursions with the structured tangent under ida, and by the null space of dense rows under adams."""
    found = {}
    for solver, tolerance in (("ida", 1e-7), ("adams", 1e-7)):
        m = train(65)
        assert CompiledMechanism(m).system.n == 130
        assert not CompiledMechanism(m).system.has_matrices
        found[solver] = simulate(m, 0.3, solver=solver, tolerance=tolerance)
        assert not found[solver].failure
        assert not found[solver].warning
        assert np.ptp(found[solver]["energy"]) < 1e-3
        assert found[solver]["open"].max() < 1e-8
    for name in ("first", "last"):
        np.testing.assert_allclose(found["ida"][name], found["adams"][name], atol=3e-4)
        assert np.ptp(found["adams"][name]) > 0.05


def test_the_joint_of_an_elastic_body_is_geared() -> None:
    """So stiff a beam that it is a rod: a third of m l^2 on the hub."""
    m = Mechanism()
    beam = Beam(length=2.0, mass=3.0, bending_stiffness=4e5, modes=2, ends=("clamped", "free"), damping=1e-4)
    arm = m.flexible_body("arm", m.ground, Revolute(), beam)
    motor = wheel(m, "motor", 0.02)
    m.couple("mesh", Gear(ratio=0.1), arm.body, motor)
    m.force("torque", JointForce("1.0 - cos(t)"), motor)
    m.output("motor", motor.angle())
    result = simulate(m, 2.0, solver="ida", tolerance=1e-7)
    assert not result.failure
    angle = (0.5 * result.t**2 - (1.0 - np.cos(result.t))) / (0.02 + 0.01 * 3.0 * 4.0 / 3.0)
    np.testing.assert_allclose(result["motor"], angle, atol=2e-3)


def test_a_joint_of_two_coordinates_is_a_screw_by_a_gear_in_itself() -> None:
    m = Mechanism(gravity=(0.0, 0.0, -9.81))
    nut = m.body("nut", m.ground, Cylindrical(axis="z"), mass=1.0, inertia=(0.01, 0.01, 0.01))
    m.couple("thread", Gear(ratio=0.1), nut, nut, coordinate_a=1, coordinate_b=0)
    m.output("z", nut.coordinate(1))
    fallen = simulate(m, 1.0, **TIGHT)["z"][-1]
    assert fallen == pytest.approx(-0.5 * 9.81 / (1.0 + 0.01 / 0.01), abs=1e-7)


def test_what_cannot_be_coupled_is_refused() -> None:
    m = Mechanism()
    a, ball = wheel(m, "a", 1.0), m.body("ball", m.ground, Spherical(), mass=1.0, inertia=(1, 1, 1))
    nut = m.body("nut", m.ground, Cylindrical(), mass=1.0, inertia=(1, 1, 1))
    slider = m.body("slider", m.ground, Translational(), mass=1.0)
    corner = Table([0, 1, 2], [0, 1, 0], "linear")
    refused: list[tuple[Any, Body, Body, dict[str, Any], str]] = [
        (
            Gear(ratio=1.0),
            ball,
            a,
            {},
            "coordinate_a of coupling 'g': the joint of body 'ball' has an orientation given by a quaternion",
        ),
        (Gear(ratio=1.0), a, m.ground, {}, "the joint of body 'ground' has none"),
        (Gear(ratio=1.0), a, nut, {}, r"coordinate_b of coupling 'g' is None, .*'nut'; allowed: 0: angle, 1: disp"),
        (Gear(ratio=1.0), a, nut, {"coordinate_b": 2}, "coordinate_b of coupling 'g' is 2"),
        (Gear(ratio=1.0), a, a, {}, "connects the coordinate of body 'a' to itself"),
        (Gear(ratio=0.0), a, slider, {}, "ratio of coupling 'g' is 0.0; allowed: a finite number other than zero"),
        (Gear(ratio=1.0, offset=np.nan), a, slider, {}, "offset of coupling 'g' is nan"),
        (Cam(corner), a, slider, {}, "its slope jumps, and no joint can follow"),
        (Cam(lambda q: 0.1 * q * q), a, slider, {}, "is a function of a displacement; use Cam"),
        (Cam(lambda q: np.sin(900.0 * q)), slider, a, {}, "changes faster than differences"),
        (Cam("0.1 * q", width=-1.0), slider, a, {}, "width of coupling 'g' is -1.0; allowed: finite and greater"),
        (RevoluteCutJoint(), a, slider, {}, "coupling 'g' is RevoluteCutJoint.*; allowed: a Coupling"),
    ]
    for coupling, first, second, options, message in refused:
        with pytest.raises(UserError, match=message):
            m.couple("g", coupling, first, second, **options)
    for law, message in ((3.0, "allowed: a Table, a function"), ("x + 1", "'x' is not known; allowed: q")):
        with pytest.raises(UserError, match=message):
            Cam(law)
    m.couple("g", Gear(ratio=1.0), a, slider)
    with pytest.raises(UserError, match="cut is named 'g'"):
        m.cut("g", RevoluteCutJoint(), a, slider)


def test_a_driven_cam_has_no_steady_state() -> None:
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    stem = m.body("stem", m.ground, Translational(axis="y"), mass=0.5)
    m.couple("lift", LAWS["function"], stem, wheel(m, "cam", 1.0, start=None, drive=Polynomial((0.5, 3.0))))
    with pytest.raises(EquilibriumError, match=r"no steady state: .* loop that opens by"):
        equilibrium(m)
