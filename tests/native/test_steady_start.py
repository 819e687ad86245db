"""A native FMU that starts in a steady state, which the export has found for the inputs as they start."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import nan
from pathlib import Path

import pytest
from binding import ERROR, OK, Binary, Instance
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from running import needs_linker

from fmus.governor import Governor
from mbfmu.fmi import Fmu, export
from mbfmu.modeling import Model
from mbfmu.session.simulation import Settings
from mbfmu.steady.equilibrium import equilibrium

pytestmark = needs_linker

STEADY = Settings(solver="adams", start_at_equilibrium=True)
TOLERANCE = 1e-6  # of the settings
Opened = Callable[[Model], Binary]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Opened:
    """What opens the native FMU of a model, once."""

    @cache
    def known(model: Model) -> Binary:
        folder = tmp_path_factory.mktemp("fmu")
        return Binary(export(model, folder / "model.fmu", STEADY, native=True), folder)

    return known


def started(binary: Binary, values: dict[str, float], start: float = 0.0) -> tuple[int, Instance]:
    """How the initialization ends with these inputs, and the instance."""
    binary.logged.clear()
    fmu = binary.instantiate()
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    assert fmu.set_up(start) == fmu.call("EnterInitializationMode") == OK
    assert fmu.set("Real", [known[name] for name in values], list(values.values())) == OK
    return fmu.call("ExitInitializationMode"), fmu


def height(fmu: Instance) -> float:
    (reference,) = (v.valueReference for v in fmu.binary.description.modelVariables if v.name == "collar.height")
    status, (value,) = fmu.get("Real", [reference])
    return float(value) if status == OK else nan


@pytest.mark.parametrize(
    ("model", "values"),
    [
        (Governor(), {"spindle.drive": 10.0}),
        (Governor(), {"spindle.drive": 11.0174 * (1.0 + 100.0 * TOLERANCE)}),
        (Governor(spindle_speed=14.0, ball_mass=0.5), {"spindle.drive": -14.0}),
        (Governor(driven=False), {"spindle.torque": 5.0}),
    ],
)
def test_another_input_than_that_of_the_steady_state_is_refused(
    model: Model, values: dict[str, float], opened: Opened
) -> None:
    """The steady state would be another one, and the FMU has no way to find it."""
    status, fmu = started(opened(model), values)
    assert status == ERROR
    ((name, value),) = values.items()
    said = fmu.binary.logged[-1][1]
    assert said.startswith(
        f"'{name}' was set to {value:.9g} before the end of the initialization, but the steady state"
    )
    own = next(float(v.start) for v in fmu.binary.description.modelVariables if v.name == name)
    assert f"was computed at the export for {own:.9g}. Set it after the initialization" in said
    assert fmu.call("Reset") == OK  # and as it is exported it starts
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    assert fmu.step(0.0, 0.01) == OK
    fmu.free()


@pytest.mark.parametrize("start", [0.0, 100.0])
def test_the_input_of_the_steady_state_is_taken_to_the_tolerance(start: float, opened: Opened) -> None:
    wanted = equilibrium(Governor()).outputs["collar.height"]
    for speed in (11.0174, 11.0174 * (1.0 + 0.1 * TOLERANCE)):
        status, fmu = started(opened(Governor()), {"spindle.drive": speed}, start)
        assert status == OK
        for k in range(3):
            assert height(fmu) == pytest.approx(wanted, rel=1e-5)
            assert fmu.step(start + 0.1 * k, 0.1) == OK
        assert not fmu.binary.logged
        fmu.free()


def test_an_input_that_is_wrong_and_then_right_starts(opened: Opened) -> None:
    binary = opened(Governor())
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    fmu = binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == OK
    assert fmu.set("Real", [known["spindle.drive"]], [10.0]) == OK
    assert fmu.get("Real", [known["collar.height"]])[0] == ERROR  # no number is told of another state
    assert fmu.set("Real", [known["spindle.drive"]], [11.0174]) == OK
    assert fmu.call("ExitInitializationMode") == OK
    assert fmu.set("Real", [known["spindle.drive"]], [10.0]) == OK  # from now on it is a change
    assert fmu.step(0.0, 0.1) == OK
    fmu.free()


def test_a_host_does_not_get_a_wrong_start_without_an_error(tmp_path: Path, opened: Opened) -> None:
    path = export(Governor(), tmp_path / "native.fmu", STEADY, native=True)
    with pytest.raises(FMICallException):
        simulate_fmu(str(path), stop_time=0.1, start_values={"spindle.drive": 10.0})
    calls_python = export(Governor(), tmp_path / "python.fmu", STEADY, native=False)
    with Fmu(calls_python, {"spindle.drive": 10.0}) as fmu:
        wanted = equilibrium(Governor(spindle_speed=10.0)).outputs["collar.height"]
        assert fmu["collar.height"] == pytest.approx(wanted, rel=1e-8)


def test_what_else_the_export_decides_cannot_be_set(opened: Opened) -> None:
    """All parameters move the steady state, and are constants."""
    described = opened(Governor()).description.modelVariables
    settable = {v.name for v in described if v.causality in ("parameter", "input")}
    assert settable == {
        "spindle.drive",
        "tolerance",
        "absolute_tolerance",
        "max_step",
        "max_order",
        "max_steps",
        "energy_check",
    }
