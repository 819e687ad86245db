"""Inputs that a host sets at every communication point: what they cost, and what of the accuracy they leave."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fmus.fourbar import FourBar
from mbfmu.mechanics import (
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    RevoluteCutJoint,
    Spring,
    Translational,
    rod,
)
from mbfmu.modeling import Model, parameter
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

START, END = 0.4, 1.0
Torque = Callable[[float], float]


def exact(torque: Torque, step: float, model: FourBar, end: float = END) -> tuple[float, float]:
    """Angle and rate at the end. Equal cranks: the coupler translates, so that all is one inertia about the pivot."""
    length = model.crank_length
    inertia = (model.crank_mass + model.rocker_mass) / 3.0 + model.coupler_mass
    weight = (0.5 * (model.crank_mass + model.rocker_mass) + model.coupler_mass) * model.gravity
    y: NDArray[np.float64] = np.array([START, 0.0])
    for k in range(round(end / step)):
        held = torque(k * step)

        def rates(_t: float, y: NDArray[np.float64], held: float = held) -> list[float]:
            return [y[1], (held / length**2 - weight / length * np.cos(y[0])) / inertia]

        y = solve_ivp(rates, (0.0, step), y, rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
    return float(y[0]), float(y[1])


def moved(torque: Torque, step: float, settings: Settings, end: float = END) -> Simulation:
    simulation = Simulation(FourBar(start_angle=START), settings)
    for k in range(round(end / step)):
        simulation.set_input("crank.torque", torque(k * step))
        simulation.advance((k + 1) * step)
        assert not simulation.failure
    return simulation


def off(simulation: Simulation, goal: tuple[float, float]) -> float:
    found = dict(zip([v.name for v in simulation.variables], simulation.outputs(), strict=True))
    return max(abs(found["crank.angle"] - goal[0]), abs(found["crank.rate"] - goal[1]))


@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau"])
@pytest.mark.parametrize("step", [1e-3, 1e-2])
@pytest.mark.parametrize("amplitude", [5.0, 100.0])
def test_a_changing_torque_takes_a_step_a_point_and_no_accuracy(amplitude: float, step: float, solver: str) -> None:
    def torque(t: float) -> float:
        return float(amplitude * np.sin(7.0 * t))

    goal = exact(torque, step, FourBar())
    for tolerance in (1e-4, 1e-6, 1e-8):
        simulation = moved(torque, step, Settings(solver=solver, tolerance=tolerance))
        points = END / step
        assert off(simulation, goal) < max(tolerance, 1e-9), tolerance
        assert simulation.statistics.steps <= 1.5 * points, tolerance
        assert simulation.statistics.rhs_evals <= 10.0 * points, tolerance
        assert simulation.warning == ""


def test_single_steps_are_of_order_five() -> None:
    """A torque that changes by rounding errors at every point, so that a step ends there, at a loose tolerance."""
    steps = np.array([0.1, 0.05, 0.025])
    goal = exact(lambda _: 600.0, 0.4, FourBar(), end=0.4)  # far from where the linkage is flat
    settings = Settings(solver="adams", tolerance=1e-2)
    errors = [off(moved(lambda t: 600.0 + 1e-10 * t, step, settings, end=0.4), goal) for step in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert orders == pytest.approx(5.0, abs=0.7)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_ida_keeps_its_history_across_changes(tolerance: float) -> None:
    def torque(t: float) -> float:
        return float(5.0 * np.sin(7.0 * t))

    goal = exact(torque, 1e-3, FourBar())
    simulation = moved(torque, 1e-3, Settings(solver="ida", tolerance=tolerance))
    assert off(simulation, goal) < max(1e-5, 20.0 * tolerance) if tolerance > 1e-7 else off(simulation, goal) < 5e-7
    assert simulation.statistics.restarts <= 5
    assert simulation.statistics.rhs_evals <= 10_000  # of 1000 points
    assert simulation.warning == ""


def sine(t: float) -> float:
    return float(5.0 * np.sin(7.0 * t))


@pytest.mark.parametrize(("inputs", "order"), [("hold", 1.0), ("linear", 2.0)])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_a_load_that_goes_on_converges_with_the_square_of_the_step(solver: str, inputs: str, order: float) -> None:
    """Against the motion under the sine itself."""
    goal = exact(sine, 1e-5, FourBar(), end=0.2)  # its own error is of first order: taken twice
    goal = tuple(2.0 * b - a for a, b in zip(exact(sine, 2e-5, FourBar(), end=0.2), goal, strict=True))
    steps = np.array([0.02, 0.01, 0.005])
    settings = Settings(solver=solver, tolerance=1e-9, input_interpolation=inputs)
    errors = [off(moved(sine, step, settings, end=0.2), goal) for step in steps]
    orders = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert orders == pytest.approx(order, abs=0.25)


def test_a_load_that_is_not_set_again_is_what_it_was() -> None:
    """It continues for the step it was set for, and then stays."""
    simulation = going_on()
    for t, torque in ((0.0, 1.0), (1.0, 3.0)):
        simulation.set_input("torque", torque)
        simulation.advance(t + 1.0)
    assert simulation.outputs()[0] == pytest.approx(1.0 + 4.0, abs=1e-8)  # 1, then from 3 to 5
    simulation.advance(3.0)
    assert simulation.outputs()[0] == pytest.approx(5.0 + 3.0, abs=1e-8)
    values = np.zeros((2, len(simulation.variables)))
    assert simulation.record(np.array([3.5, 4.0]), values) == 2
    assert values[:, 0] == pytest.approx([9.5, 11.0], abs=1e-8)


def test_a_load_changes_by_no_more_than_it_did_however_long_the_step() -> None:
    simulation = going_on()
    simulation.advance(1e-4)
    simulation.set_input("torque", 1.0)
    simulation.advance(0.1)
    assert simulation.outputs()[0] == pytest.approx(1.5 * (0.1 - 1e-4), rel=1e-6)  # from 1 to 2


def test_points_that_are_recorded_are_points() -> None:
    """What comes after them continues alike."""
    found = []
    for recorded in (True, False):
        simulation = going_on()
        if recorded:
            simulation.record(np.linspace(0.1, 1.0, 10), np.zeros((10, len(simulation.variables))))
        else:
            for k in range(10):
                simulation.advance(0.1 * (k + 1))
        simulation.set_input("torque", 1.0)
        simulation.advance(1.1)
        found.append(simulation.outputs()[0])
    assert found == pytest.approx([0.15, 0.15], abs=1e-9)


def going_on() -> Simulation:
    return Simulation(wheel(), Settings(solver="adams", tolerance=1e-9, input_interpolation="linear"))


def test_what_a_load_was_is_part_of_the_state() -> None:
    settings = Settings(solver="adams", input_interpolation="linear")
    first, second = (Simulation(wheel(), settings) for _ in range(2))
    for t in (0.0, 0.1):
        first.set_input("torque", 1.0 + 5.0 * t)
        first.advance(t + 0.1)
    second.restore(first.save())
    mark = second.checkpoint()
    second.set_input("torque", -7.0)
    second.advance(0.25)
    second.rollback(mark)
    for simulation in (first, second):
        simulation.set_input("torque", 2.0)
        simulation.advance(0.3)
    assert second.outputs()[0] == pytest.approx(first.outputs()[0], rel=1e-9)
    held = Simulation(wheel(), Settings(solver="adams"))
    with pytest.raises(UserError, match="belongs to another model"):
        held.restore(first.save())


@pytest.mark.parametrize("inputs", ["hold", "linear"])
def test_a_rollback_takes_back_values_of_inputs(inputs: str) -> None:
    simulation = Simulation(wheel(), Settings(solver="adams", tolerance=1e-9, input_interpolation=inputs))
    mark = simulation.checkpoint()
    simulation.set_input("torque", 5.0)
    simulation.advance(0.1)
    simulation.rollback(mark)
    simulation.advance(1.0)
    assert simulation.outputs()[0] == pytest.approx(0.0, abs=1e-12)  # the torque is zero at the start


@pytest.mark.parametrize("way", ["rollback", "restore"])
def test_what_was_reported_of_a_discarded_step_is_reported_again(way: str) -> None:
    m = Mechanism()
    u = Input(name="u", unit="rad", rate_name="du")
    m.body("hub", m.ground, Revolute(drive=u), mass=1.0, inertia=(0.1, 0.1, 0.1))
    m.body("arm", m.bodies[-1], Revolute(), mass=1.0, com=(0.5, 0, 0), inertia=(0.1, 0.1, 0.1))
    simulation = Simulation(m, Settings(solver="adams"))
    for k in range(5):
        simulation.set_input("u", 0.01 * k)
        simulation.set_input("du", 1.0)
        simulation.advance(0.01 * (k + 1))
    mark, state, reported = simulation.checkpoint(), simulation.save(), []
    for end in (0.06, 0.055):
        if way == "rollback":
            simulation.rollback(mark)
        else:
            simulation.restore(state)
        assert not [d for d in simulation.diagnostics if d.code == "input-jump"]
        simulation.set_input("u", 0.5)
        simulation.set_input("du", 1.0)
        simulation.advance(end)
        reported.append([d for d in simulation.diagnostics if "its position differs by 0.45 rad" in d.text])
    assert [len(texts) for texts in reported] == [1, 1]


def test_a_rollback_takes_back_parameters() -> None:
    """A mass on a spring: the motion is known, whatever was tried in between."""
    simulation = Simulation(Swinger(), Settings(solver="adams", tolerance=1e-9))
    simulation.advance(0.2)
    mark = simulation.checkpoint()
    simulation.retune(Swinger(stiffness=500.0))
    simulation.advance(0.3)
    simulation.rollback(mark)
    assert simulation.model == Swinger()
    simulation.advance(1.0)
    assert simulation.outputs()[0] == pytest.approx(0.1 * np.cos(10.0), abs=1e-8)
    assert not simulation.inaccurate


def test_a_load_with_a_rate_goes_back_to_a_value_that_is_set_again() -> None:
    """A sawtooth: the torque is 0 at every point and grows by 1 N m/s in each step."""
    simulation = Simulation(wheel(rate_name="slope"), Settings(solver="adams", tolerance=1e-9))
    simulation.set_input("slope", 1.0)
    for k in range(1, 11):
        simulation.set_input("torque", 0.0)
        simulation.advance(0.1 * k)
    assert simulation.outputs()[0] == pytest.approx(10 * 0.5 * 0.1**2, rel=1e-8)


def test_other_models_and_what_is_no_checkpoint_are_refused() -> None:
    simulation = Simulation(Swinger(), Settings(solver="adams"))
    for call, text in (
        (lambda: simulation.retune(wheel()), "the model with new parameters is"),
        (lambda: simulation.retune(3), "the model with new parameters is 3; allowed: a Swinger"),  # type: ignore[arg-type]
        (lambda: simulation.rollback(None), "checkpoint is None; allowed: what checkpoint"),  # type: ignore[arg-type]
    ):
        with pytest.raises(UserError, match=text):
            call()


@dataclass(frozen=True, kw_only=True)
class Swinger(Model):
    """A mass of 1 kg on a spring, whose position is the output."""

    stiffness: float = parameter(100.0, unit="N/m", tunable=True, doc="Stiffness")

    def build(self) -> Mechanism:
        m = Mechanism()
        block = m.body("block", m.ground, Translational(axis="x", start=0.1), mass=1.0)
        m.force("spring", Spring(stiffness=self.stiffness, free=1.0, at_a=(-1.0, 0.0, 0.0)), m.ground, block)
        m.output("x", block.coordinate())
        return m


def wheel(rate_name: str = "") -> Model:
    """A wheel of 1 kg m2 that a torque turns; its speed is the first output."""
    torque = Input(name="torque", unit="N.m", rate_name=rate_name)

    class Wheel(Model):
        name = "wheel"

        def build(self) -> Mechanism:
            m = Mechanism()
            body = m.body("wheel", m.ground, Revolute(start=0.0, fixed=True), mass=1.0, inertia=(1.0, 1.0, 1.0))
            m.force("motor", JointForce(magnitude=torque), body)
            m.output("speed", body.rate())
            return m

    return Wheel()


@pytest.mark.parametrize("inputs", ["hold", "linear"])
@pytest.mark.parametrize("solver", ["adams", "hybrid", "radau", "ida"])
def test_an_input_that_is_set_to_its_present_value_changes_nothing(solver: str, inputs: str) -> None:
    """Not a bit of the motion, and no restart."""
    settings = Settings(solver=solver, input_interpolation=inputs)
    moved = []
    for sets in (False, True):
        simulation = Simulation(FourBar(start_angle=START), settings)
        simulation.set_input("crank.torque", 3.0)
        for k in range(1, 31):
            if sets and k > 3:
                simulation.set_input("crank.torque", 3.0)
            simulation.advance(0.01 * k)
        moved.append((simulation.outputs().tobytes(), simulation.statistics.restarts))
    assert moved[0] == moved[1]


def test_the_ramp_of_ida_does_not_rise_for_ever() -> None:
    """A torque that stays but for a little noise, against a damper: the speed settles, the ramp would not."""

    def build() -> Mechanism:
        m = Mechanism()
        wheel = m.body("wheel", m.ground, Revolute(), mass=1.0, inertia=(1.0, 1.0, 1.0))
        m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m")), wheel)
        m.force("brake", JointSpring(damping=1.0), wheel)
        m.output("speed", wheel.rate())
        return m

    class Wheel(Model):
        """A braked wheel."""

        def build(self) -> Mechanism:
            return build()

    simulation = Simulation(Wheel(), Settings(solver="ida", tolerance=1e-6))
    speed, step = 0.0, 0.05
    for k in range(4000):
        torque = 10.0 * (k > 0) + 1e-3 * (k % 2)
        simulation.set_input("torque", torque)
        simulation.advance((k + 1) * step)
        speed = torque + (speed - torque) * np.exp(-step)
        if k % 500 == 499:
            assert simulation.stepper.v[0] == pytest.approx(speed, rel=2e-5)
    assert simulation.warning == ""
    assert simulation.statistics.restarts < 400


def test_one_change_before_ten_thousand_points() -> None:
    """An oscillator that is loaded once continues to be as exact as one that never was, however the host steps."""
    stiffness, load, step = 4.0, 3.0, 0.01

    class Swinging(Model):
        """A mass on a spring."""

        def build(self) -> Mechanism:
            m = Mechanism()
            mass = m.body("mass", m.ground, Translational(axis="x"), mass=1.0)
            m.force("spring", JointSpring(stiffness=stiffness), mass)
            m.force("load", JointForce(magnitude=Input(name="load", unit="N")), mass)
            m.output("x", mass.coordinate())
            return m

    simulation = Simulation(Swinging(), Settings(solver="ida", tolerance=1e-8))
    for k in range(10_000):
        if k in (10, 11):  # the first change restarts, the second one is carried over
            simulation.set_input("load", load if k == 11 else 0.5 * load)
        simulation.advance((k + 1) * step)
    omega = np.sqrt(stiffness)
    first, second = 10 * step, 11 * step
    end = 10_000 * step
    exact = 0.5 * load / stiffness * (2.0 - np.cos(omega * (end - first)) - np.cos(omega * (end - second)))
    assert simulation.stepper.q[0] == pytest.approx(exact, abs=2e-5)
    assert simulation.warning == ""


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_a_jump_after_a_long_rest_is_one_of_few(solver: str) -> None:
    """Between changes that are far apart a history is worth having, and steps pass the points again."""

    def torque(t: float) -> float:
        return 20.0 * (t // 0.25)

    goal = exact(torque, 0.25, FourBar())
    simulation = Simulation(FourBar(start_angle=START), Settings(solver=solver, tolerance=1e-8))
    for k in range(1000):
        if k % 250 == 0:
            simulation.set_input("crank.torque", torque(k * 1e-3))
        simulation.advance((k + 1) * 1e-3)
    assert off(simulation, goal) < 5e-6
    assert simulation.statistics.steps < 700
    assert simulation.warning == ""


class Cranks(Model):
    """Three equal cranks on one bar, so that a cut joint's rows are redundant; of any size."""

    length = 1.0

    def build(self) -> Mechanism:
        length, m = self.length, Mechanism(gravity=(0.0, -9.81, 0.0))
        first = m.body("first", m.ground, Revolute(start=0.7, fixed=True), **rod(mass=1.0, length=length))
        bar = m.body("bar", first, Revolute(at=(length, 0.0, 0.0), start=-0.7), **rod(mass=2.0, length=3.0 * length))
        m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m")), first)
        for k in (1, 2):
            at = (1.5 * k * length, 0.0, 0.0)
            crank = m.body(f"crank{k}", m.ground, Revolute(at=at, start=0.7), **rod(mass=1.0, length=length))
            m.cut(f"pin{k}", RevoluteCutJoint(at_a=at, at_b=(length, 0.0, 0.0)), bar, crank)
        m.output("angle", first.angle())
        return m


class SmallCranks(Cranks):
    """A thousandth."""

    length = 1e-3


class LargeCranks(Cranks):
    """A thousand times."""

    length = 1e3


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
@pytest.mark.parametrize("model", [SmallCranks(), Cranks(), LargeCranks()], ids=["1 mm", "1 m", "1 km"])
def test_redundant_cranks_of_any_size(model: Cranks, solver: str) -> None:
    """The bar translates: three cranks of m l^2 / 3 and its mass; against SciPy under the torque as it was held."""
    length, step, points = model.length, 0.02 * np.sqrt(model.length), 15
    inertia, weight = 3.0 * length**2, (3.0 * 0.5 + 2.0) * 9.81 * length
    simulation = Simulation(model, Settings(solver=solver, tolerance=1e-6))
    y: NDArray[np.float64] = np.array([0.7, 0.0])
    for k in range(points):
        held = float(40.0 * length * np.sin(0.18 * k))

        def rates(_t: float, y: NDArray[np.float64], held: float = held) -> list[float]:
            return [y[1], (held - weight * np.cos(y[0])) / inertia]

        y = solve_ivp(rates, (0.0, step), y, rtol=1e-11, atol=1e-13, method="DOP853").y[:, -1]
        simulation.set_input("torque", held)
        assert simulation.advance((k + 1) * step).ok
    assert simulation.outputs()[0] == pytest.approx(y[0], abs=1e-5)
    assert simulation.warning == ""


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
def test_a_state_saved_between_changes_goes_on_bit_for_bit(solver: str) -> None:
    def torque(t: float) -> float:
        return float(5.0 * np.sin(7.0 * t))

    settings = Settings(solver=solver, tolerance=1e-6)
    first, second = moved(torque, 1e-2, settings), Simulation(FourBar(start_angle=START), settings)
    second.restore(first.save())
    for k in range(20):
        for simulation in (first, second):
            simulation.set_input("crank.torque", float(k % 3))
            simulation.advance(END + (k + 1) * 1e-2)
        np.testing.assert_array_equal(first.outputs(), second.outputs())
