"""FMUs of mechanisms with many loops and 'ida': bits of a simulation, saved states, changed inputs, model exchange.

The simulations themselves are compared with exact motions in tests/loops.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mechanisms as loops
import numpy as np
import pytest
from binding import DISCARD, OK, Binary, Instance, export_for_one_run
from exchange_models import many_loops
from importer import importing
from towers import tower

import solvers.steppers
from mbfmu.fmi import export
from mbfmu.mechanics import Mechanism
from mbfmu.modeling.model import as_model
from mbfmu.native.entries import family_of, image_of
from mbfmu.native.exchange_states import explain_missing_derivatives, explain_missing_exchange
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings, Simulation, UnstartedSimulation

IDA = Settings(solver="ida", tolerance=1e-6)
STEP = 0.1  # s
Opened = Callable[[str], Binary]


def with_angles(case: Any) -> Mechanism:
    """The mechanism of a case with the angles of its joints as outputs."""
    mechanism: Mechanism = case.mechanism
    for body in mechanism.bodies[1:]:
        mechanism.output(f"{body.name}.angle", body.angle())
    return mechanism


CASES: dict[str, Callable[[], Mechanism]] = {
    "row": lambda: with_angles(loops.n_four_bar(40)),  # with matrices; all loops are singular at once at 0.7 s
    "ladder": lambda: with_angles(loops.ladder(35)),
    "controlled tower": lambda: tower(19),
    "row with a torque": lambda: many_loops(31, torque=True),
}
pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """What exports a case, once, and loads it."""
    known: dict[str, Binary] = {}

    def open_(name: str) -> Binary:
        if name not in known:
            folder, model = tmp_path_factory.mktemp("loops"), as_model(CASES[name]())
            known[name] = Binary(export_for_one_run(model, folder / "model.fmu", IDA), folder)
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


@pytest.mark.parametrize("name", CASES)
def test_outputs_are_those_of_a_simulation(name: str, opened: Opened) -> None:
    simulation = Simulation(CASES[name](), IDA)
    assert family_of(simulation) == "eliminated_ida"
    follow(begun(opened(name)), simulation, 0, 2 if name == "controlled tower" else 15)


def test_an_input_that_changes_restarts_the_history_as_in_python(opened: Opened) -> None:
    binary, simulation = opened("row with a torque"), Simulation(CASES["row with a torque"](), IDA)
    known, fmu = {v.name: v.valueReference for v in binary.description.modelVariables}, begun(binary)
    for k in range(6):
        value = 2.0 + np.sin(1.0 + k)
        assert fmu.set("Real", [known["torque"]], [value]) == OK
        simulation.set_input("torque", value)
        follow(fmu, simulation, k, k + 1)
    assert simulation.statistics.restarts == 5  # the first value is there when the first history begins


@pytest.mark.parametrize("name", ["row", "row with a torque"])
def test_a_state_goes_on_as_a_restored_simulation_does(name: str, opened: Opened) -> None:
    """The history of IDA begins again. The stiffness that Newton's matrix had at the saved state is restored too."""
    binary, simulation = opened(name), Simulation(CASES[name](), IDA)
    fmu, other = begun(binary), binary.instantiate()
    follow(fmu, simulation, 0, 6)
    status, state = fmu.save()
    saved = simulation.stepper.save()
    assert status == OK
    follow(fmu, simulation, 6, 9)
    assert fmu.restore(state) == other.restore(state) == OK
    for instance in (fmu, other):  # the second was never begun
        restored = Simulation(CASES[name](), IDA)
        restored.advance(6 * STEP)
        restored.stepper.restore(saved)
        follow(instance, restored, 6, 10)


@pytest.mark.campaign
def test_model_exchange_follows_the_exact_motion(tmp_path: Path) -> None:
    case, times, rtol = loops.n_four_bar(40), np.array([0.0, 1.0, 2.0]), 1e-6
    q, v = case.exact(times)  # type: ignore[misc]
    path = export(as_model(CASES["row"]()), tmp_path / "model.fmu", IDA, native=True)
    with importing(Binary(path, tmp_path)) as own:
        run = own.integrate(times, rtol, info=own.start())
    assert np.abs(run.x - np.hstack((q, v))).max() < 200.0 * rtol
    assert run.warned == 0


def test_exchange_and_derivatives_are_supported() -> None:
    simulation = UnstartedSimulation(loops.ladder(35).mechanism, IDA)
    assert explain_missing_exchange(simulation) == explain_missing_derivatives(simulation) == ""


@pytest.mark.campaign
def test_an_image_has_no_history_of_matrices() -> None:
    simulation = UnstartedSimulation(loops.ladder(100).mechanism, IDA)
    n, m = simulation.compiled.system.n, simulation.compiled.system.m
    assert image_of(simulation)[1].saved < 8 * m * n


def test_a_near_miss_that_rounding_hides_ends_a_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A parallelogram whose loop misses its singular configuration by 1e-11 m."""
    monkeypatch.setattr(solvers.steppers, "MIN_ELIMINATION_COORDINATES", 0)
    monkeypatch.setattr(solvers.steppers, "MIN_ELIMINATION_CONSTRAINTS", 0)
    settings, model = Settings(solver="ida", tolerance=1e-8), as_model(loops.parallelogram(1e-11).mechanism)
    assert family_of(UnstartedSimulation(model, settings)) == "eliminated_ida"
    binary = Binary(export_for_one_run(model, tmp_path / "model.fmu", settings), tmp_path)
    assert begun(binary).step(0.0, 1.0) == DISCARD
    assert binary.logged[-1][1].endswith("[close-branches]")
