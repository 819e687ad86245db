"""What the start time means: motions of inputs begin there, and functions of time are evaluated at the time itself."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from binding import OK, Binary

from fmus.governor import Governor
from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import (
    Harmonic,
    Input,
    JointForce,
    Mechanism,
    Polynomial,
    Revolute,
    SpeedInput,
    Sum,
    Translational,
    rod,
)
from mbfmu.modeling import Model, parameter
from mbfmu.modeling.settings import Settings
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Simulation

TIMES = (100.0, -7.25, 1e4)  # s
ADAMS = Settings(solver="adams", tolerance=1e-8)
needs_linker = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@dataclass(frozen=True, kw_only=True)
class Carried(Model):
    """A bar on a turntable on a sled, moved by inputs of every kind, of any size."""

    size: float = parameter(1.0, unit="m", min=1e-6, doc="length of the bar")

    def build(self) -> Mechanism:
        size = self.size
        m = Mechanism(gravity=(0.0, -9.81 * size, 0.0))
        place = Input(name="sled.x", unit="m", rate_name="sled.v", start=0.3 * size)
        sled = m.body("sled", m.ground, Translational(axis="x", drive=place), mass=1.0)
        table = m.body("table", sled, Revolute(axis="y", drive=SpeedInput(name="speed", unit="rad/s", start=3.0)))
        bar = m.body("bar", table, Revolute(start=0.4), **rod(mass=1.0, length=size))
        m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", rate_name="torque.rate")), bar)
        for name, body in (("sled", sled), ("table", table), ("bar", bar)):
            m.output(f"{name}.at", body.coordinate())
            m.output(f"{name}.rate", body.rate())
        return m


@dataclass(frozen=True, kw_only=True)
class Timed(Model):
    """A bar on a base that follows a function of time."""

    def build(self) -> Mechanism:
        m = Mechanism()
        motion = Sum(Polynomial((0.1, 0.02)), Harmonic(amplitude=0.2, frequency=0.37))
        base = m.body("base", m.ground, Translational(axis="x", drive=motion), mass=1.0)
        bar = m.body("bar", base, Revolute(start=0.4), **rod(mass=1.0, length=1.0))
        m.output("base.at", base.coordinate())
        m.output("bar.at", bar.coordinate())
        return m


def named(simulation: Simulation) -> dict[str, float]:
    """The outputs by their names, without those of the energy check."""
    return dict(zip([v.name for v in simulation.compiled.outputs], simulation.outputs().tolist(), strict=False))


@pytest.mark.parametrize("t0", TIMES)
@pytest.mark.parametrize("speed", [None, 0.011, 1.1e3])
def test_a_speed_of_an_input_turns_its_joint_from_the_start_time_on(t0: float, speed: float | None) -> None:
    """In closed form: nothing at the start, and speed times the time since then."""
    given = {} if speed is None else {"spindle.drive": speed}
    simulation = Simulation(Governor(), ADAMS, t0, given)
    speed = 11.0174 if speed is None else speed
    found = named(simulation)
    assert found["spindle.angle"] == 0.0
    assert found["spindle.speed"] == speed
    length = 0.3 / speed
    assert simulation.advance(t0 + length).ok
    assert named(simulation)["spindle.angle"] == pytest.approx(speed * (simulation.t - t0), rel=1e-9)


@pytest.mark.parametrize("t0", TIMES)
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_inputs_of_every_kind_begin_at_the_start_time(t0: float, size: float, interpolation: str) -> None:
    """Nothing there depends on time itself, so the motion is that of time zero."""
    settings = Settings(solver="adams", tolerance=1e-8, input_interpolation=interpolation)
    given = {"torque.rate": 0.01 * size**2, "speed": -2.0, "sled.v": 0.5 * size, "torque": 0.2 * size**2}
    early, late = (Simulation(Carried(size=size), settings, t, given) for t in (0.0, t0))
    assert named(late)["table.at"] == 0.0
    assert named(late)["sled.at"] == 0.3 * size
    assert named(late) == named(early)
    for k in range(1, 4):
        assert early.advance(0.1 * k).ok
        assert late.advance(t0 + 0.1 * k).ok
        first, second = named(early), named(late)
        for name, value in first.items():
            unit = size if name.startswith("sled") else 1.0
            assert second[name] == pytest.approx(value, abs=1e-6 * unit, rel=1e-6), name


@pytest.mark.parametrize("t0", [100.0, -7.25])
def test_a_function_of_time_is_evaluated_at_the_time_itself(t0: float) -> None:
    wanted = 0.1 + 0.02 * t0 + 0.2 * np.sin(2.0 * np.pi * 0.37 * t0)
    assert named(Simulation(Timed(), ADAMS, t0))["base.at"] == pytest.approx(wanted, rel=1e-12)


def test_a_steady_state_is_the_same_at_every_start_time() -> None:
    settings = Settings(solver="adams", start_at_equilibrium=True)
    first, *others = (named(Simulation(Governor(), settings, t0, {"spindle.drive": 10.0})) for t0 in (0.0, *TIMES))
    assert first["spindle.angle"] == 0.0
    for found in others:
        assert found == pytest.approx(first, rel=1e-9, abs=1e-9)


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(Governor(), tmp_path_factory.mktemp("fmu") / "governor.fmu", ADAMS, native=False)


@pytest.mark.parametrize("t0", TIMES)
def test_an_fmu_that_calls_python_begins_its_motions_at_the_start_time(python: Path, t0: float) -> None:
    for values, speed in (({}, 11.0174), ({"spindle.drive": 8.0}, 8.0), ({"spindle_speed": 9.0}, 9.0)):
        with Fmu(python, values, start_time=t0) as fmu:
            assert fmu["spindle.angle"] == 0.0
            fmu.step_to(t0 + 0.25)
            assert fmu["spindle.angle"] == pytest.approx(speed * (fmu.t - t0), rel=1e-9)


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Model], Binary]:
    """What exports a model as machine code and loads it."""

    def load(model: Model) -> Binary:
        folder = tmp_path_factory.mktemp("fmu")
        return Binary(export(model, folder / "model.fmu", ADAMS, native=True), folder)

    return load


@needs_linker
@pytest.mark.parametrize("model", [Governor(), Carried()], ids=lambda model: model.name)
def test_a_native_fmu_begins_its_motions_at_the_start_time(model: Model, opened: Callable[[Model], Binary]) -> None:
    """To the bits of a simulation, whether inputs were set or not."""
    binary = opened(model)
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    for t0 in TIMES:
        for given in ({}, {name: 2.5 for name in ("spindle.drive", "speed") if name in known}):
            fmu, simulation = binary.instantiate(), Simulation(model, ADAMS, t0, given)
            names = [v.name for v in simulation.compiled.outputs]
            assert fmu.set("Real", [known[name] for name in given], list(given.values())) == OK
            assert fmu.set_up(t0) == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
            for k in range(3):
                assert fmu.get("Real", [known[name] for name in names]) == (OK, list(named(simulation).values()))
                assert fmu.step(t0 + 0.25 * k, 0.25) == OK
                assert simulation.advance(t0 + 0.25 * k + 0.25).ok
            fmu.free()
