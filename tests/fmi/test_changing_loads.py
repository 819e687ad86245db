"""Loads that go on between the points at which a host sets them, through the FMU."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import Input, JointForce, Mechanism, Revolute
from mbfmu.modeling import Model
from mbfmu.modeling.settings import Settings
from mbfmu.util.errors import UserError

STEPS = (0.2, 0.2, 0.1, 0.02, 0.02, 0.01)  # s; where they grow, a load changes by no more than it did


@dataclass(frozen=True, kw_only=True)
class Wheel(Model):
    """A wheel of 1 kg m2 that a torque turns."""

    name = "wheel"

    def build(self) -> Mechanism:
        m = Mechanism()
        body = m.body("wheel", m.ground, Revolute(start=0.0, fixed=True), mass=1.0, inertia=(1.0, 1.0, 1.0))
        m.force("motor", JointForce(magnitude=Input(name="torque", unit="N.m", start=2.0)), body)
        m.output("speed", body.rate())
        return m


@pytest.fixture(scope="module", params=["adams", "ida"])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = Settings(solver=request.param, tolerance=1e-8, input_interpolation="linear")
    return export(Wheel(), tmp_path_factory.mktemp("fmu") / "wheel.fmu", settings, native=False)


@pytest.fixture
def fmu(path: Path) -> Iterator[Fmu]:
    with Fmu(path) as instance:
        yield instance


def torque(t: float) -> float:
    """What the host sets, N m."""
    return 2.0 + 5.0 * t


def speed(t: float) -> float:
    """Speed, rad/s: without the rise in the first step, of which the FMU has no information."""
    first = min(t, STEPS[0])
    return 2.0 * t + 2.5 * (t * t - first * first)


def test_a_ramp_is_met_from_the_second_point_on(fmu: Fmu) -> None:
    for step in STEPS:
        fmu["torque"] = torque(fmu.t)
        fmu.step(step)
        assert fmu["speed"] == pytest.approx(speed(fmu.t), rel=1e-7)


def test_a_value_that_is_refused_and_given_again_leaves_no_trace(fmu: Fmu) -> None:
    for step in STEPS:
        fmu["torque"] = math.nan
        with pytest.raises(UserError, match="'torque' was set to nan"):
            fmu.step(step)
        fmu["torque"] = torque(fmu.t)
        fmu.step(step)
        assert fmu["speed"] == pytest.approx(speed(fmu.t), rel=1e-7)


def test_a_state_contains_the_history_of_the_load(fmu: Fmu, path: Path) -> None:
    """Before the first step, and in every point; taken up by an instance that was somewhere else."""
    with Fmu(path) as other:
        other["torque"] = -7.0
        other.step(0.3)
        for step in STEPS:
            here, state = fmu.t, fmu.save()
            fmu["torque"] = 40.0  # a step that the master takes back
            fmu.step(step)
            fmu.restore(state)
            other.restore(state)
            fmu.t = other.t = here
            for instance in (fmu, other):
                instance["torque"] = torque(here)
                instance.step(step)
                assert instance["speed"] == pytest.approx(speed(instance.t), rel=1e-7)


def test_the_speed_is_read_in_a_point_before_the_load_is_set_there(fmu: Fmu) -> None:
    """Reading outputs, and setting what was set, decide nothing."""
    for step in STEPS:
        assert fmu["speed"] == pytest.approx(speed(fmu.t), rel=1e-7)
        for _ in range(2):
            fmu["torque"] = torque(fmu.t)
            assert fmu["speed"] == pytest.approx(speed(fmu.t), rel=1e-7)
        fmu.step(step)
