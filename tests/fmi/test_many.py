"""Many runs of one compiled model: each is what a single run finds, and one that fails does not end the others."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from fmus.fourbar import FourBar
from mbfmu.fmi import harness
from mbfmu.util.errors import UserError

ANGLES, GRAVITIES = np.array([0.1, 0.2, 0.3, -0.4]), np.array([9.81, 1.62, 9.81, 3.7])
TOLERANCES, LENGTHS = np.array([1e-6, 1e-8, 1e-7, 1e-5]), np.array([0.95, 1.0, 1.04, 1.1])
VARIED = {"start_angle": ANGLES, "gravity": GRAVITIES, "tolerance": TOLERANCES}
STOP_TIME, INTERVAL = 1.0, 0.05


@dataclass(frozen=True, kw_only=True)
class Oscillator(mb.Model):
    """A mass on a spring, which an input pushes."""

    name = "oscillator"
    default_solver = "adams"
    tolerance = 1e-10
    mass: float = mb.parameter(2.0, unit="kg", min=1e-3, doc="Mass of the slider")
    stiffness: float = mb.parameter(50.0, unit="N/m", min=0.0, doc="Stiffness of the spring")
    start: float = mb.parameter(0.1, unit="m", doc="Initial displacement of the slider")
    rigid: bool = mb.parameter(False, structural=True, doc="Whether the spring is left out")

    def build(self) -> mb.Mechanism:
        """Return a slider on the ground."""
        m = mb.Mechanism()
        inertia = {"mass": self.mass, "com": (0.0, 0.0, 0.0), "inertia": np.eye(3)}
        slider = m.body("slider", m.ground, mb.Translational(axis="x", start=self.start, rate=0.0), **inertia)
        if not self.rigid:
            m.force("spring", mb.JointSpring(stiffness=self.stiffness), slider)
        push = mb.Input(name="push", unit="N", description="Force on the slider")
        m.force("push", mb.JointForce(magnitude=push), slider)
        m.output("x", slider.coordinate(), "displacement")
        return m


@pytest.fixture(scope="module")
def fourbars() -> mb.Batch:
    return mb.simulate_many(FourBar(), STOP_TIME, interval=INTERVAL, parameters=VARIED, solver="adams")


def single(tolerance: float, **parameters: float) -> mb.Result:
    model = FourBar(**{name: float(value) for name, value in parameters.items()})
    return mb.simulate(model, STOP_TIME, interval=INTERVAL, solver="adams", tolerance=float(tolerance))


def test_runs_have_the_bits_of_single_simulations(fourbars: mb.Batch):
    assert fourbars.values.shape == (len(ANGLES), 21, len(fourbars.variables))
    assert fourbars.failures == ("",) * len(ANGLES)
    for values, angle, gravity, tolerance in zip(fourbars.values, ANGLES, GRAVITIES, TOLERANCES, strict=True):
        alone = single(tolerance, start_angle=angle, gravity=gravity)
        np.testing.assert_array_equal(fourbars.t, alone.t)
        for k, name in enumerate(fourbars.names):
            np.testing.assert_array_equal(values[:, k], alone[name], err_msg=name)


def test_numbers_that_follow_lengths_differ_by_rounding_only():
    given = {"crank_length": LENGTHS, "rocker_length": LENGTHS}
    names = ["crank.angle", "coupler.position.x", "pivot.force.y"]
    found = mb.simulate_many(
        FourBar(), STOP_TIME, interval=INTERVAL, parameters=given, outputs=names, solver="adams", tolerance=1e-6
    )
    for k, length in enumerate(LENGTHS):
        alone = single(1e-6, crank_length=length, rocker_length=length)
        for name in names:
            np.testing.assert_allclose(found[name][k], alone[name], atol=1e-9 * np.abs(alone[name]).max(), err_msg=name)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_number_of_threads_changes_nothing(fourbars: mb.Batch, threads: int):
    found = mb.simulate_many(
        FourBar(),
        STOP_TIME,
        interval=INTERVAL,
        parameters=VARIED,
        outputs=["crank.angle"],
        threads=threads,
        solver="adams",
    )
    assert found.names == ("crank.angle",)
    np.testing.assert_array_equal(found["crank.angle"], fourbars["crank.angle"])


def test_a_spring_under_a_constant_force_moves_as_its_closed_form():
    """x = F / k + (x0 - F / k) cos(sqrt(k / m) t)."""
    k, m = np.array([30.0, 50.0, 80.0]), np.array([1.0, 2.0, 3.0])
    x0, force = np.array([0.1, -0.2, 0.0]), np.array([0.0, 4.0, -3.0])
    found = mb.simulate_many(
        Oscillator(),
        2.0,
        interval=0.1,
        parameters={"stiffness": k, "mass": m, "start": x0},
        inputs={"push": force},
        outputs=["x"],
    )
    rest, rate = force / k, np.sqrt(k / m)
    exact = rest[:, None] + (x0 - rest)[:, None] * np.cos(rate[:, None] * found.t)
    np.testing.assert_allclose(found["x"], exact, atol=2e-8)


def test_a_run_that_fails_states_its_reason_and_the_others_go_on():
    lengths = [1.0, 9.0, 1.0]  # no loop with a crank of 9 m closes
    found = mb.simulate_many(
        FourBar(), STOP_TIME, interval=INTERVAL, parameters={"crank_length": lengths}, solver="adams", threads=1
    )
    assert [bool(text) for text in found.failures] == [False, True, False]
    assert "pivot" in found.failures[1]
    assert np.isnan(found["crank.angle"][1]).all()
    np.testing.assert_array_equal(found["crank.angle"][2], found["crank.angle"][0])
    assert np.isfinite(found["crank.angle"][0]).all()


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"parameters": {"crank_lenght": [1.0]}}, "did you mean 'crank_length'"),
        ({"parameters": {"coupler_modes": [0, 1]}}, "mb.study"),
        ({"parameters": {"crank_length": [1.0, 1.1], "gravity": [9.81]}}, "2 of 'crank_length', 1 of 'gravity'"),
        ({"parameters": {"crank_length": 1.0}}, "one value for each run"),
        ({"parameters": {"crank_length": ["x"]}}, "needs numbers"),
        ({"parameters": {}}, "none"),
        ({"parameters": {"crank_length": [1.0]}, "outputs": ["crank.angel"]}, "did you mean 'crank.angle'"),
        ({"parameters": {"crank_length": [1.0]}, "threads": -1}, "threads"),
    ],
)
def test_what_cannot_be_varied_is_refused(given: dict[str, Any], text: str):
    with pytest.raises(UserError, match=text):
        mb.simulate_many(FourBar(), STOP_TIME, solver="adams", **given)


def test_a_run_with_a_value_that_the_fmu_refuses_fails_alone_and_names_the_value() -> None:
    masses = [2.0, 1.0, -1.0]  # the last run of the instance is the one that fails
    batch = mb.simulate_many(Oscillator(), 0.2, parameters={"mass": masses}, interval=0.1, threads=1)
    assert batch.failures[:2] == ("", "")
    assert "'mass' was set to -1; allowed" in batch.failures[2]
    assert np.isfinite(batch.values[:2]).all()
    assert np.isnan(batch.values[2]).all()


def test_one_library_is_loaded_at_a_time(fourbar_fmu: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """FMPy changes the working directory while it loads one; if that fails, it does not change it back."""
    monkeypatch.chdir(tmp_path)
    inside, largest = [], []

    class Slave:
        def __init__(self, **given: Any) -> None:
            inside.append(self)
            os.chdir(given["unzipDirectory"])
            time.sleep(0.01)
            largest.append(len(inside))
            inside.remove(self)
            raise OSError("no library")

    monkeypatch.setattr(harness, "FMU2Slave", Slave)
    with ThreadPoolExecutor(4) as pool:
        for opened in [pool.submit(harness.Fmu, fourbar_fmu) for _ in range(4)]:
            with pytest.raises(OSError, match="no library"):
                opened.result()
    assert largest == [1, 1, 1, 1]
    assert Path.cwd() == tmp_path


def test_a_working_directory_that_was_removed_is_reported(
    fourbar_fmu: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.chdir(tmp_path)
    removed = tmp_path / "removed"
    removed.mkdir()
    os.chdir(removed)
    removed.rmdir()
    with pytest.raises(UserError, match="working directory of this process has been removed"):
        harness.Fmu(fourbar_fmu)
