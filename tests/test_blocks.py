"""Blocks of control against closed forms: lags, transfer functions, limited controllers, motors."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.transfer import realize, steady_states
from mbfmu.util.errors import UserError
from solvers import Options, stepper
from solvers.steppers import SOLVERS

RAMP = 2.0  # rad/s


def turning_wheel() -> tuple[Mechanism, Any]:
    """A wheel that a drive turns at 2 rad/s, so that its angle is a ramp."""
    m = Mechanism()
    return m, m.body("wheel", m.ground, mb.Revolute(drive=mb.Polynomial((0.0, RAMP))))


def ramp_response(numerator: Any, denominator: Any, times: Any, *, power: int) -> Any:
    """Response to t^(power - 1), power 1 or 2, by partial fractions; the poles of the transfer function are simple."""
    poles = np.roots(denominator)
    slope = np.polyder(np.poly1d(denominator))
    found = sum(np.polyval(numerator, p) / slope(p) / p**power * (np.exp(p * times) - 1.0) for p in poles)
    if power == 2:
        found = found - sum(np.polyval(numerator, p) / slope(p) / p * times for p in poles)
    direct = numerator[0] / denominator[0] if len(numerator) == len(denominator) else 0.0
    return np.real(found) + direct * times ** (power - 1)


def test_outputs_accept_blocks_and_states() -> None:
    m, wheel = turning_wheel()
    for name, handle in (("lag", m.lag("lag", wheel.rate(), time_constant=0.1)), ("state", m.state("state", "-z"))):
        m.output(name, handle)
        assert m.outputs[-1][1] == handle.value()
    with pytest.raises(UserError, match=r"output 'x' is 3; allowed: a sensor, .* a block or a state"):
        m.output("x", 3)  # type: ignore[arg-type]


@pytest.mark.parametrize("solver", list(SOLVERS))
def test_lag_and_transfer_functions_respond_to_a_ramp_and_to_a_step(solver: str) -> None:
    m, wheel = turning_wheel()
    numerator, denominator = [3.0, 1.0, 4.0, 6.0], [1.0, 4.0, 50.0, 60.0]
    step = mb.Input(name="step", unit="1", start=1.5)
    blocks = {
        "lag": m.lag("lag", step, time_constant=0.2, gain=-3.0),
        "ramp": m.transfer_function("ramp", wheel.angle(), numerator=numerator, denominator=denominator),
    }
    blocks["chain"] = m.transfer_function("chain", blocks["lag"], numerator=[1.0, 2.0], denominator=[0.5, 1.0, 2.0])
    for name, block in blocks.items():
        m.output(name, block.value())
    result = mb.simulate(m, 1.0, solver=solver, tolerance=1e-8)
    t = result.t
    expected = {
        "lag": -4.5 * (1.0 - np.exp(-t / 0.2)),
        "ramp": RAMP * ramp_response(numerator, denominator, t, power=2),
        "chain": ramp_response([-4.5, -9.0], np.polymul([0.2, 1.0], [0.5, 1.0, 2.0]), t, power=1),
    }
    for name, exact in expected.items():
        assert result[name] == pytest.approx(exact, abs=2e-6), name


def test_realization_has_the_transfer_function_at_any_time_scale() -> None:
    rng = np.random.default_rng(1)
    for n in range(7):
        for scale in (1e-6, 1.0, 1e6):
            bottom, top = rng.uniform(0.5, 2.0, n + 1), rng.uniform(-1.0, 1.0, n + 1)
            powers = scale ** -np.arange(n, -1.0, -1.0)
            A, B, C, D = realize("a block", 1e-3 * top * powers, bottom * powers)
            s = scale * (0.3 + 0.7j)
            found = (C @ np.linalg.solve(s * np.eye(n) - A, B) + D)[0, 0]
            assert found == pytest.approx(1e-3 * np.polyval(top, s / scale) / np.polyval(bottom, s / scale), rel=1e-11)
            assert np.abs(C).max(initial=1.0) == 1.0
            assert np.abs(A).max(initial=0.0) <= 4.0 * scale


def test_blocks_start_in_the_steady_state_of_their_input() -> None:
    m, _ = turning_wheel()
    a = m.lag("a", 0.7, time_constant=0.2, gain=2.0, start_input=0.7)
    b = m.transfer_function("b", 0.7, numerator=[1.0, 3.0, 5.0], denominator=[1.0, 1.0, 2.0], start_input=0.7)
    for block in (a, b):
        m.output(block.name, block.value())
    with pytest.raises(UserError, match="which the block integrates"):
        m.transfer_function("c", 0.7, numerator=[1.0], denominator=[1.0, 0.0], start_input=0.7)
    result = mb.simulate(m, 1.0, solver="adams")
    assert result["a"] == pytest.approx(1.4, abs=1e-12)
    assert result["b"] == pytest.approx(0.7 * 2.5, abs=1e-12)
    assert steady_states("a block", np.zeros((1, 1)), np.ones((1, 1)), [0.0]) == pytest.approx([0.0])


def test_state_space_couples_states_inputs_and_outputs() -> None:
    m, wheel = turning_wheel()
    A, B = np.array([[-1.0, 3.0], [-3.0, -1.0]]), np.array([[1.0, 0.0], [0.0, 2.0]])
    C, D = np.array([[1.0, 1.0], [0.0, 1.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 1.0]])
    block = m.state_space("plant", [wheel.rate(), 0.3], A=A, B=B, C=C, D=D, units=["m", "N", "1"])
    for k in range(3):
        m.output(f"y{k}", block.value(k))
    assert [variable.unit for variable in mb.Simulation(m, mb.Settings()).variables][:3] == ["m", "N", "1"]
    result, u = mb.simulate(m, 1.0, solver="ida", tolerance=1e-8), np.array([RAMP, 0.3])
    x = np.linalg.solve(A, (expm(A) - np.eye(2)) @ B @ u)
    assert [result[f"y{k}"][-1] for k in range(3)] == pytest.approx(C @ x + D @ u, abs=1e-6)


MASS, KP, KI, LIMIT, TARGET = 2.0, 8.0, 6.0, 3.0, 1.0


def held_speed(anti_windup: float | None = None) -> Mechanism:
    """A mass whose speed a PI controller with a limited force holds."""
    m = Mechanism()
    sled = m.body("sled", m.ground, mb.Translational(axis="x"), mass=MASS)
    control = m.pid(
        "control",
        mb.Input(name="target", unit="m/s", start=TARGET),
        sled.rate(),
        proportional=KP,
        integral=KI,
        lower=-LIMIT,
        upper=LIMIT,
        tracking_time=anti_windup,
        unit="N",
    )
    m.force("drive", mb.JointForce(control), sled)
    m.output("speed", sled.rate())
    m.output("force", control.value())
    m.output("integral", control.states[0].value())
    return m


def speed_of(times: Any, tracking_time: float) -> Any:
    """Speed and integral part: the force is at its limit up to t1, and then not limited."""

    def limited(t: float) -> Any:  # I' = KI e + (LIMIT - KP e - I) / T with e = TARGET - LIMIT t / MASS
        T, slope = tracking_time, LIMIT / MASS
        a, b = (KI - KP / T) * TARGET + LIMIT / T, -(KI - KP / T) * slope  # I' + I / T = a + b t
        return slope * t, a * T - b * T * T + b * T * t - (a * T - b * T * T) * np.exp(-t / T)

    def excess(t: float) -> float:
        v, i = limited(t)
        return float(KP * (TARGET - v) + i - LIMIT)

    t1 = brentq(excess, 0.0, MASS / LIMIT * (TARGET + 2.0), xtol=1e-14)
    A = np.array([[-KP / MASS, 1.0 / MASS], [-KI, 0.0]])  # of (v - TARGET, I)
    start = np.array(limited(t1)) - [TARGET, 0.0]
    return np.array([limited(t) if t <= t1 else expm(A * (t - t1)) @ start + [TARGET, 0.0] for t in times]), t1


@pytest.mark.parametrize("solver", list(SOLVERS))
def test_limited_controller_recovers_as_its_closed_form(solver: str) -> None:
    for tracking_time in (KP / KI, 0.2):
        given = None if tracking_time == KP / KI else tracking_time  # the default is Ti
        result = mb.simulate(held_speed(given), 2.0, solver=solver, tolerance=1e-8)
        exact, t1 = speed_of(result.t, tracking_time)
        assert 0.2 < t1 < 1.0
        assert not result.warning
        assert result["speed"] == pytest.approx(exact[:, 0], abs=3e-6)
        assert result["integral"] == pytest.approx(exact[:, 1], abs=3e-5)
        assert result["force"] == pytest.approx(np.minimum(KP * (TARGET - exact[:, 0]) + exact[:, 1], LIMIT), abs=3e-5)


def test_derivative_by_a_filter_and_by_a_rate() -> None:
    m, wheel = turning_wheel()
    gains: dict[str, Any] = {"proportional": 2.0, "integral": 0.5, "derivative": 0.7}
    filtered = m.pid("filtered", 0.0, wheel.angle(), **gains, filter_time=0.1, start=0.2)
    exact = m.pid("exact", 0.0, wheel.angle(), **gains, rate=wheel.rate())
    cut = m.limiter("cut", filtered, lower=-3.0, upper=-1.0)
    total = m.weighted_sum("total", [filtered, wheel.angle(), 2.0], [3.0, -0.5, 1.0], lower=-2.0)
    for block in (filtered, exact, cut, total):
        m.output(block.name, block.value())
    result = mb.simulate(m, 1.0, solver="adams", tolerance=1e-8)
    t = result.t
    common = -2.0 * RAMP * t - 0.25 * RAMP * t**2
    expected = 0.2 + common - 0.7 * RAMP * (1.0 - np.exp(-t / 0.1))
    assert result["filtered"] == pytest.approx(expected, abs=1e-6)
    assert result["exact"] == pytest.approx(common - 0.7 * RAMP, abs=1e-6)
    assert result["cut"] == pytest.approx(np.clip(expected, -3.0, -1.0), abs=1e-6)
    weighted = 3.0 * expected - 0.5 * RAMP * t + 2.0
    assert weighted.min() < -2.0 < weighted.max()
    assert result["total"] == pytest.approx(np.maximum(weighted, -2.0), abs=3e-6)


def motor_on_wheel(voltage: Any = 24.0) -> Mechanism:
    """A wheel of 0.02 kg m2 on a motor with a gear and a rotor of 1e-4 kg m2."""
    m = Mechanism()
    wheel = m.body("wheel", m.ground, mb.Revolute(armature=5.0**2 * 1e-4), mass=1.0, inertia=(0.02, 0.02, 0.02))
    motor = m.dc_motor(
        "motor", wheel, voltage, resistance=1.2, inductance=0.06, torque_constant=0.1, ratio=5.0, nominal_current=10.0
    )
    m.output("speed", wheel.rate())
    m.output("current", motor.current())
    m.output("torque", motor.torque())
    return m


@pytest.mark.parametrize("solver", list(SOLVERS))
def test_motor_runs_up_as_its_two_exponentials(solver: str) -> None:
    inertia, k, R, L = 0.02 + 25.0 * 1e-4, 0.5, 1.2, 0.06
    a, b = np.roots([L * inertia, R * inertia, k * k])
    result = mb.simulate(motor_on_wheel(), 0.5, solver=solver, tolerance=1e-8)
    t = result.t
    speed = 24.0 / k * (1.0 + (b * np.exp(a * t) - a * np.exp(b * t)) / (a - b)).real
    current = 24.0 / (L * (a - b)) * (np.exp(a * t) - np.exp(b * t))
    assert result["speed"] == pytest.approx(speed, abs=2e-5)
    assert result["current"] == pytest.approx(current.real, abs=1e-5)
    assert result["torque"] == pytest.approx(0.5 * current.real, abs=1e-5)
    assert not result.warning


G, LENGTH = 9.81, 0.5


def held_arm(limit: float = 40.0) -> Mechanism:
    """An arm of 1 kg that a motor and a PI controller with the voltage as its output hold."""
    m = Mechanism(gravity=(0.0, -G, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=LENGTH))
    target = mb.Input(name="target", unit="rad", start=0.5)
    gains: dict[str, Any] = {"proportional": 30.0, "integral": 40.0, "derivative": 3.0, "rate": arm.rate()}
    measured = m.lag("measured", arm.angle(), time_constant=0.01, start_input=0.3, unit="rad")
    control = m.pid("control", target, measured, **gains, lower=-limit, upper=limit, nominal=10.0, unit="V")
    motor = m.dc_motor("motor", arm, control, resistance=1.5, inductance=0.02, torque_constant=0.4)
    m.output("angle", arm.angle())
    m.output("voltage", control.value())
    m.output("torque", motor.torque())
    return m


def test_steady_state_and_linear_model_contain_blocks() -> None:
    found = mb.equilibrium(held_arm())
    load = G * 0.5 * LENGTH * np.cos(0.5)
    assert found.positions()["arm"] == pytest.approx(0.5, abs=1e-9)
    states = found.states()
    assert states["motor.current"] == pytest.approx(load / 0.4, abs=1e-8)
    assert states["control.integral"] == pytest.approx(1.5 * load / 0.4, abs=1e-8)
    J = LENGTH**2 / 3.0
    A = np.zeros((5, 5))  # angle, rate, measured, integral, current
    A[0, 1] = 1.0
    A[1] = G * 0.5 * LENGTH * np.sin(0.5) / J, 0.0, 0.0, 0.0, 0.4 / J
    A[2] = 100.0, 0.0, -100.0, 0.0, 0.0
    A[3, 2] = -40.0
    A[4] = 0.0, (-3.0 - 0.4) / 0.02, -30.0 / 0.02, 1.0 / 0.02, -1.5 / 0.02
    plant = found.state_space
    assert plant.states == ("arm", "der(arm)", "measured.x1", "control.integral", "motor.current")
    assert plant.A == pytest.approx(A, rel=1e-9, abs=1e-9)
    assert plant.B.ravel() == pytest.approx([0.0, 0.0, 0.0, 40.0, 30.0 / 0.02])
    assert plant.C[1] == pytest.approx([0.0, -3.0, -30.0, 1.0, 0.0])
    assert plant.D.ravel() == pytest.approx([0.0, 30.0, 0.0])
    limited = mb.equilibrium(held_arm(5.0))
    assert np.cos(limited.positions()["arm"]) == pytest.approx(5.0 / 1.5 * 0.4 / (G * 0.5 * LENGTH), abs=1e-8)


def test_outputs_state_the_inputs_that_change_them_at_once() -> None:
    compiled = CompiledMechanism(held_arm())
    assert compiled.feedthrough() == [(), (0,), ()]
    m, wheel = turning_wheel()
    first, second = mb.Input(name="first", unit="1"), mb.Input(name="second", unit="1")
    a = m.limiter("a", first, lower=-1.0, upper=1.0)
    b = m.state_space("b", [a, second], A=[[-1.0]], B=[[1.0, 1.0]], C=[[1.0], [1.0]], D=[[2.0, 0.0], [0.0, 0.0]])
    m.output("direct", b.value(0))
    m.output("late", b.value(1))
    sled = m.body("sled", wheel, mb.Translational(axis="x"), mass=1.0)
    m.output("force", m.force("push", mb.JointForce("x * q", uses={"x": b}), sled).effort())
    assert [0 in ks for ks in CompiledMechanism(m).feedthrough()] == [True, False, True]


def test_outputs_of_blocks_with_and_without_time_are_quantities_of_events() -> None:
    m, wheel = turning_wheel()
    lead = m.transfer_function("lead", wheel.angle(), numerator=[1.0, 0.0], denominator=[1.0, 1.0])
    m.event("passed", lead.value(), crosses=1.0)
    driven = m.limiter("driven", "sin(t)", lower=0.0, upper=0.5)
    m.event("other", driven.value(), crosses=0.2)
    found = {event.name: event.time for event in mb.simulate(m, 1.0, solver="adams", tolerance=1e-8).events}
    expected = {"passed": np.log(2.0), "other": np.arcsin(0.2)}  # 2 (1 - exp(-t)) = 1
    assert found == pytest.approx(expected, abs=1e-7)


def test_sensors_in_forces_have_kernels_for_the_tangent_of_large_trees() -> None:
    """The implicit solvers of large trees call them with a state of complex numbers, and a missing one ends Python."""
    m = Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    height = arm.position("y", (0.1, 0.0, 0.0))
    m.force("pull", mb.JointForce(m.limiter("limited", height, lower=-0.02, upper=1.0)), arm)
    arrays = CompiledMechanism(m).tangent_arrays()
    assert len(arrays.parts) == 2
    assert np.all(arrays.kernels[arrays.parts["kind"]] != 0)


def _pid(m: Mechanism, arm: Any, **given: Any) -> Any:
    return m.pid("b", 1.0, arm.angle(), **given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m, arm: m.lag("b", arm.angle(), time_constant=0.0), "time_constant of block 'b' is 0.0"),
        (lambda m, arm: m.lag("b", arm.angle(), time_constant=1.0, gain=np.nan), "gain of block 'b' is nan"),
        (lambda m, arm: m.lag("b", arm.acceleration(), time_constant=1.0), "depends on forces"),
        (lambda m, arm: [m.lag("b", 1.0, time_constant=1.0), m.lag("b", 1.0, time_constant=1.0)], "named 'b'"),
        (lambda m, arm: m.lag("b", 1.0, time_constant=1.0, unit="foo"), "unit is 'foo'"),
        (lambda m, arm: m.lag("b", Mechanism().lag("c", 1.0, time_constant=1.0), time_constant=1.0), "another mechan"),
        (lambda m, arm: m.transfer_function("b", 1.0, numerator=[1, 0], denominator=[1]), "allowed: a proper transfer"),
        (lambda m, arm: m.transfer_function("b", 1.0, numerator=[1], denominator=[0, 1]), "first coefficient is zero"),
        (lambda m, arm: m.transfer_function("b", 1.0, numerator=[np.inf], denominator=[1]), "allowed: finite coeff"),
        (
            lambda m, arm: m.state_space("b", [1.0], A=[[1, 2]], B=[[1]], C=[[1]]),
            r"A of block 'b' has the shape \(1, 2",
        ),
        (lambda m, arm: m.state_space("b", [1.0], A=[[-1]], B=[[1]], C=[[1]], nominal=[1, 2]), "2 nominal values"),
        (lambda m, arm: m.state_space("b", 1.0, A=[[-1]], B=[[1]], C=[[1]]), "allowed: a list of inputs"),
        (lambda m, arm: m.limiter("b", 1.0, lower=2.0, upper=-2.0), "lower of block 'b' is 2.0, upper -2.0"),
        (lambda m, arm: m.limiter("b", 1.0, lower=np.nan, upper=1.0), "lower of block 'b' is nan"),
        (lambda m, arm: m.weighted_sum("b", [1.0], [1.0, 2.0]), r"weights of block 'b' has the shape \(1, 2"),
        (lambda m, arm: m.weighted_sum("b", 1.0, [1.0]), "allowed: a list of inputs"),
        (lambda m, arm: m.weighted_sum("b", [1.0], [1.0], lower=2.0, upper=2.0), "lower of block 'b' is 2.0, upper 2"),
        (lambda m, arm: m.weighted_sum("b", [1.0] * 9, [1.0] * 9), "has 9 inputs; allowed: 1 to 8"),
        (lambda m, arm: m.weighted_sum("b", [1.0], None), "weights of block 'b'"),
        (_pid, "has no gain"),
        (lambda m, arm: _pid(m, arm, derivative=1.0), "neither rate nor filter_time"),
        (lambda m, arm: _pid(m, arm, derivative=1.0, filter_time=0.0), "filter_time of block 'b' is 0.0"),
        (lambda m, arm: _pid(m, arm, proportional=1.0, filter_time=1.0), "no derivative part"),
        (lambda m, arm: _pid(m, arm, integral=1.0, upper=1.0), "no tracking_time follows from"),
        (
            lambda m, arm: _pid(m, arm, integral=1.0, upper=1.0, tracking_time=-1.0),
            "tracking_time of block 'b' is -1.0",
        ),
        (
            lambda m, arm: _pid(m, arm, proportional=1.0, integral=1.0, upper=1.0, start=50.0),
            "start of block 'b' is 50.0, and its output is limited to -inf to 1; allowed: a value within the limits",
        ),
        (
            lambda m, arm: _pid(m, arm, proportional=1.0, start=0.5),
            "a start of its integral part, and no integral part",
        ),
        (
            lambda m, arm: m.dc_motor("b", arm, 1.0, resistance=1, inductance=0, torque_constant=1),
            "inductance of block 'b' is 0; allowed: greater than zero.*use a JointForce with the law",
        ),
        (
            lambda m, arm: m.dc_motor("b", arm, 1.0, resistance=1, inductance=1, torque_constant=1, ratio=0),
            "ratio of block 'b' is 0",
        ),
        (lambda m, arm: m.lag("b", 1.0, time_constant=1.0).value(1), "no output 1"),
        (lambda m, arm: m.force("f", mb.JointForce(arm.angle(), uses={"x": 1.0}), arm), "leave out uses"),
        (lambda m, arm: m.force("f", mb.JointForce(arm.acceleration()), arm), "depends on forces"),
        (lambda m, arm: mb.pade_delay(0.0, 2), "delay is 0.0"),
        (lambda m, arm: mb.pade_delay(0.1, 11), "order of a delay is 11"),
    ],
)
def test_wrong_blocks_are_refused(change: Any, message: str) -> None:
    m = Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))
    with pytest.raises(UserError, match=message):
        change(m, arm)


def test_pade_delay_has_the_phase_of_the_delay() -> None:
    for order in (1, 2, 5, 10):
        numerator, denominator = mb.pade_delay(0.3, order)
        w = 0.5 * order / 0.3
        found = np.polyval(numerator, 1j * w) / np.polyval(denominator, 1j * w)
        assert abs(found) == pytest.approx(1.0, abs=1e-12)
        error = factorial(order) ** 2 / factorial(2 * order) / factorial(2 * order + 1) * (0.3 * w) ** (2 * order + 1)
        assert found == pytest.approx(np.exp(-0.3j * w), abs=1.5 * error + 1e-12)  # its first term


@pytest.mark.parametrize("name", ["adams", "ida"])
def test_blocks_do_not_depend_on_the_time_at_which_they_were_evaluated_before(name: str) -> None:
    """The energy account needs the power of a force at other times: a sine through a block and a limiter."""
    m = Mechanism()
    sled = m.body("sled", m.ground, mb.Translational(axis="x"), mass=1.0)
    push = m.limiter("push", "5 * sin(8 * t)", lower=-4.0, upper=9.0)
    m.force("push", mb.JointForce(push), sled)
    compiled = CompiledMechanism(m)
    solver = stepper(name, compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-8))
    assert solver.advance(1.3).ok
    assert solver.energy_account[0] == pytest.approx(0.5 * solver.v[0] ** 2, abs=1e-6)
