"""FMUs of sheets and of the feeder with implicit solvers: bits of a simulation, rollback, and an importing tool."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from binding import OK, Binary, Instance, export_for_one_run

from fmus.feeder import Feeder
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

STEP = 2e-3  # s
CASES: dict[str, tuple[Model, str]] = {
    "sheet, ida": (Sheet(nx=7, nz=5), "ida"),
    "sheet in air, ida": (Sheet(nx=7, nz=5, damping=1e-5, drag=1.4, pressure=0.5), "ida"),
    "free sheet, ida": (Sheet(nx=7, nz=5, support="free", start_spin=20.0, gravity_y=0.0), "ida"),
    "sheet, esdirk": (Sheet(nx=7, nz=5), "esdirk"),
    "feeder, esdirk": (Feeder(), "esdirk"),
    "feeder that sticks, esdirk": (
        Feeder(path="straight", nips=1, lead=0.055, stop_at=0.06, deflection=1e-5, static_ratio=1.4, nx=9, nz=5),
        "esdirk",
    ),
}

# the export of the feeder builds it many times
MARKED = [pytest.param(name, marks=pytest.mark.campaign if "feeder" in name else ()) for name in CASES]
pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


def settings_of(solver: str) -> Settings:
    """Settings of all runs here."""
    return Settings(solver=solver, tolerance=1e-4)


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What exports a case, once, and loads it."""
    known: dict[str, Binary] = {}

    def open_(name: str) -> Binary:
        if name not in known:
            folder, (model, solver) = tmp_path_factory.mktemp("trees"), CASES[name]
            known[name] = Binary(export_for_one_run(model, folder / "model.fmu", settings_of(solver)), folder)
        return known[name]

    return open_


def begun(binary: Binary) -> Instance:
    """Return an instance that has been initialized."""
    fmu = binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    return fmu


def follow(fmu: Instance, simulation: Simulation, first: int, last: int) -> None:
    """Take steps whose outputs must be equal."""
    known = {v.name: v.valueReference for v in fmu.binary.description.modelVariables}
    wanted = [known[v.name] for v in simulation.variables]
    for k in range(first, last):
        assert fmu.step(k * STEP, STEP) == OK
        assert simulation.advance(k * STEP + STEP).ok
        np.testing.assert_array_equal(fmu.get("Real", wanted)[1], simulation.outputs())


@pytest.mark.parametrize("name", MARKED)
def test_outputs_are_those_of_a_simulation(name: str, opened: Any) -> None:
    model, solver = CASES[name]
    follow(begun(opened(name)), Simulation(model, settings_of(solver)), 0, 12)


@pytest.mark.parametrize("name", MARKED)
def test_a_state_goes_on_in_another_instance(name: str, opened: Any) -> None:
    """With esdirk bit for bit, with ida as a restored simulation does, whose history begins again."""
    (model, solver), binary = CASES[name], opened(name)
    simulation, fmu, other = Simulation(model, settings_of(solver)), begun(binary), binary.instantiate()
    follow(fmu, simulation, 0, 6)
    status, state = fmu.save()
    saved = simulation.stepper.save()
    assert status == OK
    follow(fmu, simulation, 6, 9)
    assert fmu.restore(state) == other.restore(state) == OK
    for instance in (fmu, other):  # the second was never begun
        restored = Simulation(model, settings_of(solver))
        restored.advance(6 * STEP)
        restored.stepper.restore(saved)
        follow(instance, restored, 6, 10)


def test_a_tolerance_that_is_limited_is_logged_as_in_python(opened: Any) -> None:
    binary = opened("sheet, esdirk")
    for tolerance in (1e-10, 3e-11):
        simulation = Simulation(CASES["sheet, esdirk"][0], Settings(solver="esdirk", tolerance=tolerance))
        expected = [str(d) for d in simulation.diagnostics if d.code == "limited-tolerance"]
        assert len(expected) == (tolerance < 1e-10)
        binary.logged.clear()
        fmu = binary.instantiate()
        assert fmu.set_up(0.0, None, tolerance) == OK
        assert fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
        assert [text for _, text in binary.logged if "[limited-tolerance]" in text] == expected
        fmu.free()


@pytest.mark.campaign
def test_an_importing_tool_runs_the_feeder(tmp_path: Path) -> None:
    model = Feeder()
    path = export(model, tmp_path / "feeder.fmu", settings_of("esdirk"), native=True)
    result = fmpy.simulate_fmu(
        str(path), stop_time=0.02, output_interval=2e-3, fmi_call_logger=None, fmi_type="CoSimulation"
    )
    simulation = Simulation(model, settings_of("esdirk"))
    for row in result[1:]:
        assert simulation.advance(row["time"]).ok
        told = dict(zip((v.name for v in simulation.variables), simulation.outputs(), strict=True))
        for name in set(result.dtype.names or ()) & set(told):
            assert row[name] == told[name], name


def test_ida_and_contact_are_refused_with_the_solver_to_use(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"solver is 'ida'; allowed in a native FMU: adams, hybrid, esdirk, or auto"):
        export(Feeder(), tmp_path / "feeder.fmu", settings_of("ida"), native=True)
