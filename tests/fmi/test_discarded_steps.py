"""A step that is discarded leaves no trace: the run continues to the bit as one that never tried it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import Input, Mechanism, Revolute, Translational, rod
from mbfmu.modeling import Model
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.util.diagnostics import without_details
from mbfmu.util.errors import UserError

RUNS: dict[str, tuple[Model, str, float, int]] = {  # solver, length of a step (s), most steps of one call
    "adams": (FourBar(), "adams", 0.02, 60),
    "hybrid": (FourBar(), "hybrid", 0.02, 60),
    "radau": (SwingPendulum(), "radau", 0.02, 60),
    "driven": (Governor(), "adams", 0.02, 40),
    "large": (Sheet(nx=9, nz=7), "adams", 1e-4, 400),
    "implicit": (Sheet(nx=9, nz=7), "esdirk", 1e-3, 12),
}
SET: dict[str, str] = {
    "implicit": "gravity.x",
    "adams": "crank.torque",
    "hybrid": "crank.torque",
    "driven": "spindle.drive",
}
Made = Callable[[str], Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """What exports the model of a run, once."""

    @cache
    def make(name: str) -> Path:
        model, solver, *_ = RUNS[name]
        settings = Settings(solver=solver, tolerance=1e-6)
        return export(model, tmp_path_factory.mktemp("fmu") / "model.fmu", settings, native=False)

    return make


def told(fmu: Fmu) -> tuple[list[float], dict[str, Any]]:
    """Outputs, and what the solver has done."""
    counters = [name for name in fmu.variables if name.startswith("solver.") and name != "solver.message"]
    return fmu.reals().tolist(), {name: fmu[name] for name in counters}


def go(fmu: Fmu, count: int, length: float, name: str) -> list[Any]:
    """Make steps with an input that changes; return the outputs after each."""
    rows = []
    for k in range(count):
        if name in SET:
            fmu[SET[name]] = fmu[SET[name]] + 0.01 * (1 + k % 3)
        fmu.step(length)
        rows.append(told(fmu))
    return rows


@pytest.mark.parametrize("name", RUNS)
def test_it_leaves_outputs_counts_and_the_run_to_come_as_they_were(name: str, made: Made) -> None:
    _, _, length, most = RUNS[name]
    with Fmu(made(name), {"max_steps": most}) as tried, Fmu(made(name), {"max_steps": most}) as other:
        assert go(tried, 8, length, name) == go(other, 8, length, name)
        before = told(tried)
        for _ in range(3):
            with pytest.raises(UserError, match="maximum number of steps"):
                tried.step(1e4 * length)
            assert told(tried) == before
        for first, second in zip(go(tried, 12, length, name), go(other, 12, length, name), strict=True):
            assert first == second


@dataclass(frozen=True, kw_only=True)
class Pulled(Model):
    """A pendulum under a sled that the host moves."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        drive = Input(name="sled.x", unit="m", rate_name="sled.v")
        sled = m.body("sled", m.ground, Translational(axis="x", drive=drive), mass=1.0)
        bar = m.body("bar", sled, Revolute(start=0.4), **rod(mass=1.0, length=1.0))
        m.output("sled.at", sled.coordinate())
        m.output("bar.at", bar.coordinate())
        m.output("bar.rate", bar.rate())
        return m


def test_it_leaves_supports_on_their_way() -> None:
    """A step in which a support departs, with a jump, is discarded; another place is given then."""
    settings = Settings(solver="adams", max_steps=40)
    tried, other = Simulation(Pulled(), settings), Simulation(Pulled(), settings)
    for k in range(6):
        for simulation in (tried, other):
            simulation.set_input("sled.x", 0.01 * k)
            simulation.set_input("sled.v", 0.5)
            assert simulation.advance(0.02 * (k + 1)).ok
    assert not without_details(tried.diagnostics)
    mark = tried.checkpoint()
    tried.set_input("sled.x", 1e3)
    assert not tried.advance(100.0).ok
    assert any("input 'sled.x' at t = " in text for text in map(str, tried.diagnostics))
    tried.rollback(mark)
    assert tried.failure == ""
    assert not without_details(tried.diagnostics)
    for k in range(6, 12):
        for simulation in (tried, other):
            simulation.set_input("sled.x", 0.01 * k)
            assert simulation.advance(0.02 * (k + 1)).ok
        np.testing.assert_array_equal(tried.outputs(), other.outputs())
        assert tried.statistics == other.statistics
    assert tried.save() == other.save()


def test_ida_goes_on_within_its_tolerance_and_counts_no_discarded_work(tmp_path: Path) -> None:
    path = export(FourBar(), tmp_path / "model.fmu", Settings(solver="ida", tolerance=1e-8), native=False)
    with Fmu(path, {"max_steps": 3000}) as tried, Fmu(path, {"max_steps": 3000}) as other:
        for fmu in (tried, other):
            for _ in range(10):
                fmu.step(0.02)
        before = told(tried)
        with pytest.raises(UserError, match="maximum number of steps"):
            tried.step(1e4)
        assert told(tried) == before
        rows: list[NDArray[np.float64]] = []
        for fmu in (tried, other):
            for _ in range(10):
                fmu.step(0.02)
            rows.append(fmu.reals()[:4])
        np.testing.assert_allclose(rows[0], rows[1], rtol=1e-5, atol=1e-6)
        assert told(tried)[1]["solver.restarts"] == told(other)[1]["solver.restarts"] + 1  # SUNDIALS keeps its history
        assert told(tried)[1]["solver.steps"] < told(other)[1]["solver.steps"] + 200
