"""Joints that native FMUs lock and release, impulses and stops, by matrices and by recursions along a tree."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from mbfmu.fmi import Fmu
from mbfmu.fmi.export import export
from mbfmu.util.errors import UserError

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="needs a C compiler")
G, LAG, SETTINGS = 9.81, 0.3, mb.Settings(solver="adams", tolerance=1e-8)
FLYWHEEL, ROTOR = 2.0, 1.0  # kg m^2
STIFFNESS, INERTIA, START = 8.0, 2.0, 0.4  # N m/rad, kg m^2, rad: of the oscillator
NAMES = ("flywheel", "slip", "torque", "angle", "lag", "height")


@dataclass(frozen=True, kw_only=True)
class Clutches(mb.Model):
    """A clutch between two rotors, an oscillator that is held and hit, a ball on a floor, and weights on springs."""

    name = "clutches"
    weights: int = mb.parameter(1, min=1, structural=True)
    close: float = mb.parameter(0.52, unit="s", doc="Time at which the clutch closes")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        flywheel = m.body("flywheel", m.ground, mb.Revolute(rate=6.0), inertia=(1.0, 1.0, FLYWHEEL))
        rotor = m.body("rotor", flywheel, mb.Revolute(rate=-6.0), inertia=(1.0, 1.0, ROTOR))
        m.force("brake", mb.JointForce(-1.5), flywheel)
        m.event("close", at=self.close, then=mb.Lock(rotor))
        m.event("open", at=1.13, then=mb.Release(rotor))
        spring = m.body("spring", m.ground, mb.Revolute(start=START, fixed=True), inertia=(1.0, 1.0, INERTIA))
        m.force("spring", mb.JointSpring(stiffness=STIFFNESS), spring)
        lag = m.state("lag", f"(angle - z) / {LAG}", uses={"angle": spring.angle()}, unit="rad")
        m.event("catch", spring.angle(), direction="down", then=[mb.Lock(spring), mb.Impulse(spring, 100.0)])
        m.event("go", at=1.07, then=[mb.Release(spring), mb.Impulse(spring, 0.6)])
        ball = m.body("ball", m.ground, mb.Translational(axis="y", start=1.0, fixed=True), mass=1.0)
        m.force("weight", mb.JointForce(-G), ball)
        m.event("floor", ball.coordinate(), direction="down", then=mb.Bounce(0.8))
        for k in range(self.weights):
            weight = m.body(f"weight{k}", m.ground, mb.Translational(axis="x", start=0.1), mass=1.0)
            m.force(f"weight{k}", mb.JointSpring(stiffness=1.0 + k), weight)
        m.output("flywheel", flywheel.rate())
        m.output("slip", rotor.rate())
        m.output("torque", rotor.effort())
        m.output("angle", spring.angle())
        m.output("lag", lag.value())
        m.output("height", ball.coordinate())
        return m


def exact(t: float, close: float = 0.52) -> list[float]:
    """Values of NAMES: the brake decelerates the flywheel alone, then both rotors; the oscillator is caught at zero."""
    rate, slip, torque = 6.0 - 1.5 / FLYWHEEL * t, -6.0 + 1.5 / FLYWHEEL * t, 0.0
    if t > close:
        momentum = FLYWHEEL * (6.0 - 1.5 / FLYWHEEL * close)
        after = momentum / (FLYWHEEL + ROTOR)
        braking = 1.5 / (FLYWHEEL + ROTOR)
        end = min(t, 1.13)
        rate, slip, torque = after - braking * (end - close), 0.0, -ROTOR * braking
        if t > 1.13:
            rate, slip, torque = rate - 1.5 / FLYWHEEL * (t - 1.13), 1.5 / FLYWHEEL * (t - 1.13), 0.0
    w = np.sqrt(STIFFNESS / INERTIA)
    caught = 0.5 * np.pi / w
    swung, a = min(t, caught), 1.0 / LAG
    lag = START * a / (a * a + w * w) * (a * np.cos(w * swung) + w * np.sin(w * swung) - a * np.exp(-a * swung))
    angle = START * np.cos(w * swung)
    if t > caught:
        angle, lag = 0.0, lag * np.exp(-a * (min(t, 1.07) - caught))
    if t > 1.07:
        s, speed = t - 1.07, 0.6 / INERTIA
        angle = speed / w * np.sin(w * s)
        response = a * np.sin(w * s) - w * np.cos(w * s) + w * np.exp(-a * s)
        lag = lag * np.exp(-a * s) + speed / w * a / (a * a + w * w) * response
    fall, speed, s = np.sqrt(2.0 / G), np.sqrt(2.0 * G), t
    height = 1.0 - 0.5 * G * s * s
    if t > fall:
        speed, s = 0.8 * speed, t - fall
        while s > 2.0 * speed / G:
            speed, s = 0.8 * speed, s - 2.0 * speed / G
        height = speed * s - 0.5 * G * s * s
    return [rate, slip, torque, angle, lag, height]


def check(rows: Any, close: float = 0.52, error: float = 3e-6) -> None:
    found = np.array([[row[name] for name in NAMES] for row in rows])
    np.testing.assert_allclose(found, [exact(row["time"], close) for row in rows], rtol=0.0, atol=error)


@pytest.fixture(scope="module", params=[1, 70])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = Clutches(weights=request.param)
    return export(model, tmp_path_factory.mktemp(f"locks{request.param}") / "clutches.fmu", SETTINGS, native=True)


@pytest.mark.parametrize("close", [0.52, 0.3])
def test_locks_within_communication_steps(path: Path, close: float) -> None:
    arguments = {"output": NAMES, "start_values": {"close": close}, "fmi_type": "CoSimulation"}
    check(simulate_fmu(str(path), stop_time=2.0, output_interval=0.1, **arguments), close)


def test_energy_throughput_is_that_of_a_run_in_python(path: Path) -> None:
    """Both examine the kinetic energy at the ends of some of their steps, which may be later than the events."""
    weights = 70 if path.parent.name.startswith("locks70") else 1
    simulation = mb.Simulation(Clutches(weights=weights), replace(SETTINGS, max_step=1e-3))
    with Fmu(path, {"max_step": 1e-3}) as fmu:
        for t in (0.5, 0.9, 1.5, 2.0):
            fmu.step(t - fmu.t)
            assert simulation.advance(t).ok
            assert fmu["energy_throughput"] == pytest.approx(simulation.outputs()[-1], rel=5e-3)
            assert not fmu.message()


def check_saved_state(path: Path, error: float) -> None:
    """A state with a locked joint leads to the same bits in two instances."""
    with Fmu(path) as first, Fmu(path) as second:
        first.step(0.9)
        saved, ends = first.save(), []
        for fmu in (first, second, first):
            fmu.restore(saved)
            fmu.t = 0.9
            fmu.step(0.8)
            ends.append([fmu[name] for name in NAMES])
        assert ends[0] == ends[1] == ends[2]
        assert ends[0] == pytest.approx(exact(1.7), abs=error)


def test_a_locked_state_is_saved(path: Path) -> None:
    check_saved_state(path, 3e-6)


def test_locks_in_model_exchange(path: Path) -> None:
    arguments = {"output": NAMES, "fmi_type": "ModelExchange", "relative_tolerance": 1e-9, "record_events": False}
    check(simulate_fmu(str(path), stop_time=2.0, output_interval=0.1, **arguments))


@pytest.mark.campaign
@pytest.mark.parametrize("solver", ["hybrid", "radau", "ida"])
def test_locks_with_other_solvers(solver: str, tmp_path: Path) -> None:
    settings = mb.Settings(solver=solver, tolerance=1e-8)
    path = export(Clutches(), tmp_path / "clutches.fmu", settings, native=True)
    check(simulate_fmu(str(path), stop_time=2.0, output_interval=0.1, output=NAMES, fmi_type="CoSimulation"))


@dataclass(frozen=True, kw_only=True)
class Released(mb.Model):
    """A pendulum that is released without a lock."""

    name = "released"

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
        m.event("lock", at=0.7, then=mb.Lock(arm))
        m.event("early", at=0.5, then=mb.Release(arm))
        return m


def test_what_is_not_locked_is_not_released(tmp_path: Path) -> None:
    path = export(Released(), tmp_path / "released.fmu", SETTINGS, native=True)
    text = r"event 'early' releases a joint at t = 0.5 s that is not locked\. .*\[not-locked\]"
    with Fmu(path) as fmu, pytest.raises(UserError, match=text):
        fmu.step(1.0)


@pytest.mark.campaign
@pytest.mark.parametrize(("solver", "error"), [("ida", 3e-6), ("esdirk", 2e-5)])
def test_locks_in_large_models_with_implicit_solvers(solver: str, error: float, tmp_path: Path) -> None:
    settings = mb.Settings(solver=solver, tolerance=1e-8)
    path = export(Clutches(weights=70), tmp_path / "large.fmu", settings, native=True)
    for kind, relative in (("CoSimulation", None), ("ModelExchange", 1e-9)):
        how = {"fmi_type": kind, "relative_tolerance": relative, "record_events": False}
        check(simulate_fmu(str(path), stop_time=2.0, output_interval=0.1, output=NAMES, **how), error=error)
    check_saved_state(path, error)
