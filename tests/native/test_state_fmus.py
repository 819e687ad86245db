"""First-order states in FMUs: co-simulation with and without Python, and model exchange, against SciPy."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

import mbfmu as mb
from mbfmu.fmi.export import export
from mbfmu.modeling.model import as_model
from mbfmu.native.steady_export import explain_missing_search
from mbfmu.session.simulation import Simulation

needs_compiler = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
SETTINGS = mb.Settings(solver="adams", tolerance=1e-8)


@dataclass(frozen=True, kw_only=True)
class ControlledRod(mb.Model):
    """A rod whose angle a PI controller holds, by a sensor with a lag."""

    lag: float = mb.parameter(0.05, unit="s", min=1e-3, doc="Time constant of the sensor")
    integral_gain: float = mb.parameter(60.0, unit="N.m", min=0.0, doc="Gain of the integral")
    first: float = mb.parameter(0.2, unit="rad", doc="Reading of the sensor at the start")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
        target = mb.Input(name="target", unit="rad", start=0.5)
        own = {"start": self.first, "unit": "rad", "nominal": 0.5}
        sensor = m.state("sensor", "(a - z) / lag", uses={"a": arm.angle(), "lag": self.lag}, **own)
        integral = m.state("integral", "target - x", uses={"x": sensor, "target": target}, unit="rad.s")
        uses = {"i": integral, "x": sensor, "target": target, "ki": self.integral_gain}
        m.force("motor", mb.JointForce("30 * (target - x) + ki * i - 6 * v", uses=uses), arm)
        m.output("arm.angle", arm.angle())
        m.output("reading", sensor.value())
        m.output("integral", integral.value())
        return m

    def motion(self, times: Any, target: float = 0.5) -> Any:
        """Return (angle, rate, reading, integral) from SciPy."""

        def rates(t: float, y: Any) -> list[float]:
            angle, rate, x, i = y
            torque = 30.0 * (target - x) + self.integral_gain * i - 6.0 * rate
            return [rate, 3.0 * (torque - 0.5 * 9.81 * np.cos(angle)), (angle - x) / self.lag, target - x]

        start = (0.3, 0.0, self.first, 0.0)
        return solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13).y


@pytest.fixture(scope="module")
def native(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(ControlledRod(), tmp_path_factory.mktemp("states") / "rod.fmu", SETTINGS, native=True)


@needs_compiler
def test_states_are_variables_with_units_and_nominal_values(native: Path) -> None:
    assert validate_fmu(str(native)) == []
    description = read_model_description(str(native))
    known = {v.name: v for v in description.modelVariables}
    names = [unknown.variable.derivative.name for unknown in description.derivatives]
    assert names == ["state.position.arm", "state.velocity.arm", "state.value.sensor", "state.value.integral"]
    assert [known[name].unit for name in names] == ["rad", "rad/s", "rad", "rad.s"]
    assert float(known["state.value.sensor"].nominal) == 0.5
    assert known["der(state.value.sensor)"].unit == "rad/s"


@needs_compiler
@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("CoSimulation", {}),
        ("CoSimulation", {"lag": 0.1, "first": -0.4, "integral_gain": 20.0}),
        ("ModelExchange", {}),
        ("ModelExchange", {"lag": 0.02, "first": 0.7}),
    ],
)
def test_native_fmu_moves_as_computed_by_scipy(native: Path, kind: str, values: dict[str, float]) -> None:
    found = simulate_fmu(
        str(native), stop_time=1.5, output_interval=0.05, start_values=values, fmi_type=kind, relative_tolerance=1e-8
    )
    expected = ControlledRod(**values).motion(found["time"])
    for name, row in (("arm.angle", 0), ("reading", 2), ("integral", 3)):
        assert found[name] == pytest.approx(expected[row], abs=2e-6 if kind == "ModelExchange" else 2e-7), name


@needs_compiler
def test_native_fmu_has_the_bits_of_a_simulation_for_every_solver(tmp_path: Path) -> None:
    for solver in ("radau", "ida"):
        settings = mb.Settings(solver=solver, tolerance=1e-6)
        path = export(ControlledRod(), tmp_path / f"{solver}.fmu", settings, native=True)
        found = simulate_fmu(str(path), stop_time=0.5, output_interval=0.05)
        simulation = mb.Simulation(ControlledRod(), settings)
        for row in found[1:]:
            assert simulation.advance(row["time"]).ok
            assert [row[name] for name in ("arm.angle", "reading", "integral")] == simulation.outputs()[:3].tolist()


def test_fmu_that_calls_python_moves_as_computed_by_scipy(tmp_path: Path) -> None:
    path = export(ControlledRod(), tmp_path / "rod.fmu", SETTINGS, native=False)
    found = simulate_fmu(str(path), stop_time=0.5, output_interval=0.05, start_values={"first": 0.1})
    assert found["reading"] == pytest.approx(ControlledRod(first=0.1).motion(found["time"])[2], abs=2e-7)


@dataclass(frozen=True, kw_only=True)
class Sliding(mb.Model):
    """A spindle that turns in a bearing with friction, and a mass on a spring and a guide with friction."""

    mass: float = mb.parameter(2.0, unit="kg", min=0.1, doc="Mass on the spring")
    coulomb: float = mb.parameter(0.4, unit="N.m", min=0.01, doc="Friction of the bearing")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
        block = m.body("block", m.ground, mb.Translational(axis="y", nominal=0.1), mass=self.mass)
        m.force("guide", mb.JointFriction(coulomb=3.0, deflection=0.01), block)
        m.force("spring", mb.JointSpring(stiffness=500.0), block)
        m.output("travel", block.coordinate())
        speed = mb.SpeedInput(name="speed", unit="rad/s", start=3.0)
        turning = mb.Revolute(axis="y", drive=speed)
        spindle = m.body("spindle", m.ground, turning, mass=1.0, inertia=(0.1, 0.1, 0.1))
        friction = {"static": 1.5 * self.coulomb, "stribeck": 2.0, "viscous": 0.1, "deflection": 0.1}
        m.force("bearing", mb.JointFriction(coulomb=self.coulomb, **friction), spindle)
        m.output("drive", spindle.effort())
        return m


@needs_compiler
def test_native_fmu_starts_in_the_steady_state_with_frictions_that_slip_and_rest(tmp_path: Path) -> None:
    settings = mb.Settings(solver="adams", start_at_equilibrium=True)
    path = export(Sliding(), tmp_path / "sliding.fmu", settings, native=True)
    cases: list[dict[str, float]] = [
        {}, {"mass": 3.0}, {"speed": 5.0}, {"speed": -0.7, "coulomb": 0.9}, {"speed": 40.0, "mass": 0.5},
    ]  # fmt: skip
    for values in cases:
        known = {"mass": 2.0, "coulomb": 0.4, "speed": 3.0} | values
        speed, coulomb = known["speed"], known["coulomb"]
        sliding = coulomb * (1.0 + 0.5 * np.exp(-((speed / 2.0) ** 2)))
        wanted = [-known["mass"] * 9.81 / 500.0, np.sign(speed) * sliding + 0.1 * speed]
        found = simulate_fmu(str(path), stop_time=0.2, output_interval=0.1, start_values=values)
        for row in found:
            assert [row["travel"], row["drive"]] == pytest.approx(wanted, rel=1e-9 if row["time"] == 0.0 else 1e-4)


def held_mass(stiffness: float) -> mb.Mechanism:
    """A mass of 2 kg on a vertical guide with friction, and on a spring."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    mass = m.body("mass", m.ground, mb.Translational(axis="y", nominal=1.0), mass=2.0)
    m.force("guide", mb.JointFriction(coulomb=30.0), mass)
    m.force("spring", mb.JointSpring(stiffness=stiffness), mass)
    return m


def damped_cart() -> mb.Mechanism:
    """A cart with a rate that a damper does not let it keep, and a pole."""
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    cart = m.body("cart", m.ground, mb.Translational(axis="x", rate=2.0), mass=2.0)
    m.force("damper", mb.JointForce("-3 * v"), cart)
    m.body("pole", cart, mb.Revolute(start=-1.2), **mb.rod(mass=1.0, length=1.0))
    return m


def sampled_cart() -> mb.Mechanism:
    """A cart that a digital controller holds."""
    m = mb.Mechanism()
    cart = m.body("cart", m.ground, mb.Translational(axis="x", nominal=1.0), mass=2.0)
    m.force("spring", mb.JointSpring(stiffness=5.0, damping=5.0), cart)
    none: dict[str, Any] = {"A": [[0]], "B": [[0, 0]], "C": [[0]]}
    control = m.sampled_system("control", [1.5, cart.coordinate()], period=0.05, **none, D=[[3, -3]])
    m.force("motor", mb.JointForce(control.value()), cart)
    return m


@pytest.mark.parametrize(
    ("mechanism", "reason"),
    [
        (held_mass(500.0), ""),  # the guide does not slip, and exerts no force in the state that is found
        (held_mass(0.0), "it was found by a continuation only"),  # its friction holds the mass
        (damped_cart(), "there is no steady state with the start rates of coordinates on which nothing depends"),
        (sampled_cart(), "the model has sampled blocks"),
    ],
)
def test_the_fmu_searches_steady_states_unless_there_is_a_reason(mechanism: mb.Mechanism, reason: str) -> None:
    settings = mb.Settings(solver="radau", start_at_equilibrium=True)
    found = explain_missing_search(Simulation(as_model(mechanism), settings))
    assert found.endswith(reason)
    assert bool(found) == bool(reason)
