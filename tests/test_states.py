"""First-order states together with positions and velocities: closed forms, and SciPy on equations written by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, FirstOrderState, Mechanism, StateHandle
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import EquilibriumError, UserError
from solvers import OneStepSolver, Options, stepper
from solvers.steppers import SOLVERS
from solvers.steppers.adams.tree import TreeAdamsStepper

G = 9.81
DENSE = tuple(SOLVERS)
KP, KI, KD, LAG = 30.0, 60.0, 6.0, 0.05  # N m/rad, N m/(rad s), N m s/rad, s


def rod_on_motor(start: float = 0.3) -> tuple[Mechanism, StateHandle, StateHandle]:
    """A rod whose angle a PI controller holds, by a sensor with a lag."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=start), **mb.rod(mass=1.0, length=1.0))
    target = mb.Input(name="target", unit="rad", start=0.5)
    measured = m.state("measured", f"(angle - z) / {LAG}", uses={"angle": arm.angle()}, start=0.2, unit="rad")
    integral = m.state("integral", "target - x", uses={"x": measured, "target": target}, unit="rad.s", nominal=0.1)
    uses = {"i": integral, "x": measured, "target": target, "kp": KP}
    m.force("motor", mb.JointForce(f"kp * (target - x) + {KI} * i - {KD} * v", uses=uses), arm)
    m.output("arm.angle", arm.angle())
    m.output("measured", measured.value())
    m.output("measured.rate", measured.rate())
    m.output("integral", integral.value())
    return m, measured, integral


def rates_of_rod(t: float, y: Any) -> list[float]:
    """y' of (angle, rate, measured, integral)."""
    angle, rate, x, i = y
    torque = KP * (0.5 - x) + KI * i - KD * rate
    return [rate, 3.0 * (torque - 0.5 * G * np.cos(angle)), (angle - x) / LAG, 0.5 - x]


def exact(rates: Any, start: Any, end: float) -> Any:
    return solve_ivp(rates, (0.0, end), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def state_of(solver: Any) -> Any:
    return np.concatenate((solver.q, solver.v))


@pytest.mark.parametrize("name", DENSE)
def test_controlled_rod_agrees_with_scipy_in_proportion_to_the_tolerance(name: str) -> None:
    compiled = CompiledMechanism(rod_on_motor()[0])
    q, v = compiled.assemble()
    expected, found = exact(rates_of_rod, (0.3, 0.0, 0.2, 0.0), 2.0), {}
    for tolerance in (1e-5, 1e-8):
        solver = stepper(name, compiled.system, 0.0, q, v, Options(rtol=tolerance))
        assert solver.advance(2.0).ok
        found[tolerance] = np.abs(state_of(solver) - expected).max()
        assert found[tolerance] < 30.0 * tolerance
    assert found[1e-8] < 0.03 * found[1e-5]
    assert solver.freedom == 1


def test_state_without_any_free_joint_is_the_lag_of_a_prescribed_motion() -> None:
    """z' = (sin w t - z) / T with z(0) = 0."""
    w, T, t = 3.0, 0.2, 1.3
    m = Mechanism()
    wheel = m.body("wheel", m.ground, mb.Revolute(drive=mb.Harmonic(amplitude=1.0, frequency=w / (2.0 * np.pi))))
    lag = m.state("lag", f"(angle - z) / {T}", uses={"angle": wheel.angle()}, unit="rad")
    m.output("lag", lag.value())
    compiled = CompiledMechanism(m)
    assert compiled.system.nq == 0
    q, v = compiled.assemble()
    exact_lag = (np.sin(w * t) - w * T * np.cos(w * t) + w * T * np.exp(-t / T)) / (1.0 + (w * T) ** 2)
    for name in DENSE:
        solver = stepper(name, compiled.system, 0.0, q, v, Options(rtol=1e-9))
        assert solver.advance(t).ok
        assert solver.v[0] == pytest.approx(exact_lag, abs=3e-8), name
        assert solver.freedom == 0


@pytest.mark.parametrize("solver", ["adams", "radau", "ida"])
@pytest.mark.parametrize("unit", [1e-50, 1e-9, 1e9, 1e50])
def test_the_unit_of_a_state_does_not_matter(solver: str, unit: float) -> None:
    """A pendulum that is held by its delayed angle; the delayed angle is measured in any unit."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=0.5))
    angle = {"angle": arm.angle()}
    late = m.state("late", f"({unit!r} * angle - z) / 0.05", uses=angle, start=0.1 * unit, nominal=unit)
    m.force("motor", mb.JointForce(f"-2 * late / {unit!r}", uses={"late": late}), arm)
    m.output("angle", arm.angle())
    m.output("late", late.value())

    def slopes(t: float, y: np.ndarray) -> list[float]:
        return [y[1], (-G * 0.25 * np.cos(y[0]) - 2.0 * y[2]) * 12.0, (y[0] - y[2]) / 0.05]

    exact = solve_ivp(slopes, (0.0, 1.0), (0.3, 0.0, 0.1), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    result = mb.simulate(m, 1.0, solver=solver, tolerance=1e-8)
    assert result["angle"][-1] == pytest.approx(exact[0], abs=1e-6)
    assert result["late"][-1] / unit == pytest.approx(exact[2], abs=1e-6)


def test_tolerance_of_a_state_follows_its_nominal_value() -> None:
    """A voltage of 1e-6 V on a resistor and a capacitor, which no absolute tolerance of order one resolves."""
    errors = {}
    for nominal in (1e-6, 1.0):
        m = Mechanism()
        m.body("wheel", m.ground, mb.Revolute(rate=1.0), mass=1.0, inertia=(1.0, 1.0, 1.0))
        m.state("voltage", "(1e-6 - z) / 0.01", unit="V", nominal=nominal)
        compiled = CompiledMechanism(m)
        solver = stepper("adams", compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))
        assert solver.advance(0.02).ok
        errors[nominal] = abs(solver.v[1] - 1e-6 * (1.0 - np.exp(-2.0)))
    assert errors[1e-6] < 1e-11
    assert errors[1.0] > 1e-10


def test_free_body_with_one_state_has_as_many_positions_as_velocities() -> None:
    """Seven positions, of which four are a quaternion, and seven velocities, of which one is a state."""
    inertia = np.array([0.1, 0.25, 0.3])
    m = Mechanism()
    start = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    top = m.body(
        "top", m.ground, mb.Floating(start=start, rate=(0.1, 0.0, 0.0, 0.3, 2.0, 0.1)), mass=1.0, inertia=inertia
    )
    m.state("filtered", "10 * (w - z)", uses={"w": top.angular_velocity("x")}, unit="rad/s")
    compiled = CompiledMechanism(m)
    assert compiled.system.nq == compiled.system.n == 7

    def rates(t: float, y: Any) -> Any:
        w, A = y[:3], y[3:12].reshape(3, 3)
        W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        return np.concatenate(((-np.cross(w, inertia * w)) / inertia, (A @ W).ravel(), [10.0 * ((A @ w)[0] - y[12])]))

    expected = exact(rates, [0.3, 2.0, 0.1, *np.eye(3).ravel(), 0.0], 2.0)
    q, v = compiled.assemble()
    for name in DENSE:
        solver = stepper(name, compiled.system, 0.0, q, v, Options(rtol=1e-8))
        assert solver.advance(2.0).ok
        w, x, y, z = solver.q[3:]
        column = (w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y))
        assert column == pytest.approx(expected[3:12].reshape(3, 3)[:, 0], abs=2e-6), name
        assert solver.v[3:] == pytest.approx([*expected[:3], expected[12]], abs=2e-6), name


def parallelogram(controlled: bool = True) -> Mechanism:
    """Two cranks of 1 kg and 0.5 m with a coupler of 2 kg; a controller turns the first one."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    crank = m.body("crank", m.ground, mb.Revolute(start=1.2), **mb.rod(mass=1.0, length=0.5))
    coupler = m.body("coupler", crank, mb.Revolute(at=(0.5, 0, 0), start=-1.2), **mb.rod(mass=2.0, length=1.0))
    rocker = m.body("rocker", m.ground, mb.Revolute(at=(1.0, 0, 0), start=1.2), **mb.rod(mass=1.0, length=0.5))
    m.cut("pin", mb.RevoluteCutJoint(at_a=(1.0, 0, 0), at_b=(0.5, 0, 0)), coupler, rocker)
    height = m.state("height", "8 * (y - z)", uses={"y": coupler.position("y", (0.5, 0, 0))}, start=0.4, unit="m")
    if controlled:
        m.force("motor", mb.JointForce("60 * (0.5 - h) - 3 * v", uses={"h": height}), crank)
    return m


@pytest.mark.parametrize("name", DENSE)
def test_loop_with_a_state_is_a_pendulum(name: str) -> None:
    inertia, weight = 2.0 * 0.25 / 3.0 + 2.0 * 0.25, (0.5 + 1.0) * G

    def rates(t: float, y: Any) -> list[float]:
        angle, rate, h = y
        torque = 60.0 * (0.5 - h) - 3.0 * rate
        return [rate, (torque - weight * np.cos(angle)) / inertia, 8.0 * (0.5 * np.sin(angle) - h)]

    compiled = CompiledMechanism(parallelogram())
    q, v = compiled.assemble()
    solver = stepper(name, compiled.system, 0.0, q, v, Options(rtol=1e-7))
    assert solver.freedom == 1
    assert solver.advance(1.0).ok
    expected = exact(rates, (1.2, 0.0, 0.4), 1.0)
    assert [solver.q[0], solver.v[0], solver.v[-1]] == pytest.approx(expected, abs=2e-5)


def test_loop_falls_through_a_singular_configuration_with_a_state() -> None:
    """The parallelogram is flat on its way, where it could fold; the state depends on it and does not act."""
    compiled = CompiledMechanism(parallelogram(controlled=False))
    inertia, weight = 2.0 * 0.25 / 3.0 + 2.0 * 0.25, (0.5 + 1.0) * G
    expected = exact(lambda t, y: [y[1], -weight * np.cos(y[0]) / inertia], (1.2, 0.0), 1.2)
    assert expected[0] < -1.0  # it has passed the horizontal
    for name in ("adams", "hybrid", "radau", "ida"):
        q, v = compiled.assemble()
        solver = stepper(name, compiled.system, 0.0, q, v, Options(rtol=1e-7))
        assert solver.advance(1.2).ok
        assert [solver.q[0], solver.v[0]] == pytest.approx(expected, abs=3e-5), name
        assert solver.q[2] == pytest.approx(solver.q[0], abs=1e-6), name


@pytest.mark.parametrize("name", DENSE)
def test_restored_run_continues_with_the_same_bits(name: str) -> None:
    simulation = Simulation(rod_on_motor()[0], Settings(solver=name))
    simulation.advance(0.3)
    saved, ends = simulation.save(), []
    for _ in range(3):
        simulation.advance(0.6)
        ends.append((simulation.outputs().tobytes(), simulation.stepper.v.tobytes()))
        simulation.restore(saved)
    assert ends[1] == ends[2]
    if name != "ida":  # whose history is in SUNDIALS, and begins again
        assert ends[0] == ends[1]


def test_energy_account_is_closed_and_outputs_have_units() -> None:
    simulation = Simulation(rod_on_motor()[0], Settings(solver="adams", tolerance=1e-7))
    times = np.linspace(0.05, 2.0, 40)
    values = np.zeros((40, len(simulation.variables)))
    assert simulation.record(times, values) == 40
    assert not simulation.inaccurate
    units = {v.name: v.unit for v in simulation.variables}
    assert (units["measured"], units["measured.rate"], units["integral"]) == ("rad", "rad/s", "rad.s")
    names = [v.name for v in simulation.variables]
    angle, x, rate = (values[:, names.index(name)] for name in ("arm.angle", "measured", "measured.rate"))
    np.testing.assert_allclose(rate, (angle - x) / LAG, atol=1e-9)


def test_auto_takes_an_implicit_solver_for_a_fast_state() -> None:
    m, *_ = rod_on_motor()
    m.state("fast", "1e5 * (x - z)", uses={"x": "sin(t)"})
    assert Simulation(m, Settings(solver="auto")).solver_choice.solver == "radau"
    assert Simulation(rod_on_motor()[0], Settings(solver="auto")).solver_choice.solver == "adams"


def test_steady_state_and_its_linear_model_are_those_of_the_equations() -> None:
    found = mb.equilibrium(rod_on_motor()[0])
    assert found.positions()["arm"] == pytest.approx(0.5, abs=1e-10)
    assert found.states() == pytest.approx({"measured": 0.5, "integral": 0.5 * G * np.cos(0.5) / KI}, abs=1e-9)
    assert found.stability == "stable"
    A = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [1.5 * G * np.sin(0.5), -3.0 * KD, -3.0 * KP, 3.0 * KI],
            [1.0 / LAG, 0.0, -1.0 / LAG, 0.0],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
    plant = found.state_space
    assert plant.states == ("arm", "der(arm)", "measured", "integral")
    assert plant.A == pytest.approx(A, abs=1e-7)
    assert plant.B.ravel() == pytest.approx([0.0, 3.0 * KP, 0.0, 1.0], abs=1e-7)
    assert plant.C[1] == pytest.approx([0.0, 0.0, 1.0, 0.0])
    expected = np.linalg.eigvals(A)
    expected = sorted(expected[expected.imag >= 0.0], key=abs)
    for modes in (plant.modes(), found.modes):
        assert [mode.eigenvalue for mode in modes] == pytest.approx(expected, rel=1e-8)
    for shape in found.shapes(4):  # motion of coordinates, and change of states: an eigenvector of A
        s, (angle, x, i) = shape.mode.eigenvalue, shape.motion
        vector = np.array([angle, s * angle, x, i])
        assert np.abs(A @ vector - s * vector).max() < 1e-6 * np.abs(s * vector).max()


def test_run_starts_in_the_steady_state_and_stays() -> None:
    simulation = Simulation(rod_on_motor()[0], Settings(solver="adams", start_at_equilibrium=True))
    simulation.advance(1.0)
    np.testing.assert_allclose(state_of(simulation.stepper), [0.5, 0.0, 0.5, 0.5 * G * np.cos(0.5) / KI], atol=1e-7)


def test_path_of_steady_states_over_an_input() -> None:
    path = mb.equilibrium_path(rod_on_motor()[0], "target", (0.5, 1.2))
    (branch,) = path.branches
    values, integrals = np.array(branch.values), np.array(branch.output("integral"))
    assert values[-1] == 1.2
    np.testing.assert_allclose(integrals, 0.5 * G * np.cos(values) / KI, atol=1e-8)


def test_loop_with_a_state_in_equilibrium() -> None:
    found = mb.equilibrium(parallelogram())
    h = found.states()["height"]
    angle = found.positions()["crank"]
    assert h == pytest.approx(0.5 * np.sin(angle), abs=1e-9)
    assert 60.0 * (0.5 - h) == pytest.approx(1.5 * G * np.cos(angle), abs=1e-8)
    inertia, weight = 2.0 * 0.25 / 3.0 + 2.0 * 0.25, 1.5 * G
    A = [
        [0.0, 1.0, 0.0],
        [weight * np.sin(angle) / inertia, -3.0 / inertia, -60.0 / inertia],
        [4.0 * np.cos(angle), 0.0, -8.0],
    ]
    expected = np.linalg.eigvals(np.array(A))
    expected = sorted(expected[expected.imag >= 0.0], key=abs)
    assert [mode.eigenvalue for mode in found.modes] == pytest.approx(expected, rel=1e-7)
    assert [mode.eigenvalue for mode in found.state_space.modes()] == pytest.approx(expected, rel=1e-7)


def test_integrator_of_what_is_not_zero_has_no_steady_state() -> None:
    m = Mechanism(gravity=(0.0, -G, 0.0))
    m.body("rod", m.ground, mb.Revolute(start=-1.5), **mb.rod(mass=1.0, length=1.0))
    m.state("clock", lambda t, z: 1.0 + 0.0 * z)
    with pytest.raises(EquilibriumError, match="clock"):
        mb.equilibrium(m)


class HalfSteps(OneStepSolver):
    """The classical formulas of Runge and Kutta."""

    order = 4

    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        k1 = f(t, y)
        k2 = f(t + 0.5 * h, y + 0.5 * h * k1)
        k3 = f(t + 0.5 * h, y + 0.5 * h * k2)
        return y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + f(t + h, y + h * k3))


def test_solver_of_a_user_integrates_states_in_its_order() -> None:
    compiled = CompiledMechanism(rod_on_motor()[0])
    q, v = compiled.assemble()
    expected, errors = exact(rates_of_rod, (0.3, 0.0, 0.2, 0.0), 0.32), []
    for h in (0.02, 0.01):
        solver = HalfSteps(compiled.system, 0.0, q, v, Options(rtol=1e-2, atol=1e6, max_step=h))
        assert solver.advance(0.32).ok
        errors.append(np.abs(state_of(solver) - expected).max())
    assert np.log2(errors[0] / errors[1]) > 3.7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m, arm: m.state("x", "1 - y"), "'y' is not known; allowed: t, z, sin"),
        (lambda m, arm: m.state("lag", "u - lag", uses={"u": 1.0}), "'lag' is not known; allowed: t, z, u, sin"),
        (lambda m, arm: m.force("f", mb.JointForce("-lag", uses={"u": 1.0}), arm), "allowed: t, q, v, u, sin"),
        (lambda m, arm: m.state("x", lambda t, y: y), "argument 'y'"),
        (lambda m, arm: m.state("x", "1 - z", uses={"u": 1.0}), "does not contain"),
        (lambda m, arm: m.state("x", "u - z", uses={"u": arm.acceleration()}), "Acceleration"),
        (lambda m, arm: m.state("x", "z", uses={"z": 1.0}), "means something else"),
        (lambda m, arm: m.state("x", "z", uses=["y"]), r"uses of state 'x' is \['y'\]; allowed: quantities by names"),
        (lambda m, arm: m.state("x", "z", nominal=0.0), "nominal of state 'x' is 0.0"),
        (lambda m, arm: m.state("x", "z", nominal=1e-60), "nominal of state 'x' is 1e-60; allowed: 1e-50 to 1e"),
        (lambda m, arm: FirstOrderState(name="x", start=np.nan), "start of state 'x' is nan"),
        (lambda m, arm: FirstOrderState(name="x", unit="foo"), "unit is 'foo'"),
        (lambda m, arm: m.state("x", "z", unit="mile"), "mile"),
        (lambda m, arm: [m.state("x", "z"), m.state("x", "z")], "is named 'x'"),
        (lambda m, arm: m.state("x", "y", uses={"y": Mechanism().state("y", "z")}), "another mechanism"),
        (lambda m, arm: m.force("f", mb.JointForce("y", uses={"y": [1]}), arm), "allowed: a number"),
        (lambda m, arm: [m.state("arm", "-z"), CompiledMechanism(m)], "joint coordinate"),
    ],
)
def test_wrong_states_are_refused(change: Any, message: str) -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    with pytest.raises(UserError, match=message):
        change(m, arm)


@pytest.mark.parametrize("links", [58, 64, 1100])
def test_states_in_chains_of_any_length_follow_their_closed_form(links: int) -> None:
    """A chain that hangs at rest: T z' = y - z, with a constant y."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    body = m.ground
    for k in range(links):
        joint = mb.Revolute(at=(0.1 if k else 0.0, 0.0, 0.0), start=0.0 if k else -0.5 * np.pi)
        body = m.body(f"link{k}", body, joint, **mb.rod(mass=0.1, length=0.1))
    tip = m.state("tip", "(y - z) / 0.02", uses={"y": body.position("y")}, unit="m")
    m.output("tip", tip.value())
    simulation = Simulation(m, Settings(solver="adams", tolerance=1e-8))
    assert isinstance(simulation.stepper, TreeAdamsStepper) is (links > 60)
    assert simulation.advance(0.01).ok
    y = -0.1 * (links - 1)
    assert simulation.outputs()[0] == pytest.approx(y * (1.0 - np.exp(-0.5)), rel=1e-6)


def test_laws_that_use_the_same_names_have_separate_quantities() -> None:
    """Rotors on springs of different stiffness, and blocks that slide under different normal forces."""
    m, t, stiffness, loads = Mechanism(), 0.5, (4.0, 9.0, 25.0), (2.0, 3.0)
    for k, K in enumerate(stiffness):
        joint = mb.Revolute(start=0.1, fixed=True)
        rotor = m.body(f"rotor{k}", m.ground, joint, mass=1.0, inertia=(1.0, 1.0, 1.0))
        given = mb.Input(name="stiffness", unit="N.m/rad", start=K) if k == 2 else K
        m.force(f"spring{k}", mb.JointForce("-K * q", uses={"K": given}), rotor)
        m.output(f"rotor{k}", rotor.angle())
    for k, N in enumerate(loads):
        block = m.body(f"block{k}", m.ground, mb.Translational(axis="x", rate=3.0), mass=1.0)
        m.force(f"friction{k}", mb.JointFriction(coulomb=0.5, normal_force="N + 0 * q", uses={"N": N}), block)
        m.output(f"block{k}", block.coordinate())
    result = mb.simulate(m, t, interval=t, solver="adams", tolerance=1e-8)
    for k, K in enumerate(stiffness):
        assert result[f"rotor{k}"][-1] == pytest.approx(0.1 * np.cos(np.sqrt(K) * t), abs=1e-6)
    for k, N in enumerate(loads):  # the bristle bends by 1e-5 m at most
        assert result[f"block{k}"][-1] == pytest.approx(3.0 * t - 0.25 * N * t**2, abs=1e-5)


def test_what_large_sheets_with_states_do_not_support() -> None:
    paper = {"thickness": 1e-4, "youngs_modulus": 3e9, "density": 800.0, "grid": (7, 5), "tree": "master"}
    still, guided = Mechanism(), Mechanism()
    for m in (still, guided):
        mb.add_sheet(m, "sheet", length=0.1, width=0.05, **paper)
    still.state("x", "-z")
    with pytest.raises(UserError, match="a mesh of elements and first-order states"):
        mb.equilibrium(still)
    slide = guided.body("slide", guided.ground, mb.Translational(axis="x"), mass=1.0)
    guided.force("friction", mb.JointFriction(coulomb=0.1, normal_force=mb.Reaction(length=1.0)), slide)
    with pytest.raises(UserError, match="a Reaction as the normal force and a mesh"):
        CompiledMechanism(guided)
