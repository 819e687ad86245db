"""The governor and the swing pendulum as FMUs: drives as inputs, structural parameters, starts in balance."""

from __future__ import annotations

from collections.abc import Callable
from math import degrees
from pathlib import Path

import numpy as np
import pytest
from agreement import check_against_direct
from fmpy.validation import validate_fmu

from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.fmi import Fmu, export
from mbfmu.modeling import Model
from mbfmu.session.simulation import Settings
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.util.errors import UserError

MODELS = {"governor": Governor(), "free": Governor(driven=False), "pendulum": SwingPendulum()}


@pytest.fixture(scope="session")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """All three as FMUs."""
    folder = tmp_path_factory.mktemp("driven")
    return {
        name: export(model, folder / f"{name}.fmu", Settings(solver="adams"), native=False)
        for name, model in MODELS.items()
    }


@pytest.mark.parametrize("name", MODELS)
def test_validates(fmus: dict[str, Path], name: str) -> None:
    assert validate_fmu(str(fmus[name])) == []


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_equals_the_direct_run(fmus: dict[str, Path], name: str, solver: str) -> None:
    check_against_direct(fmus[name], MODELS[name], solver, np.linspace(0.0, 0.5, 26))


def test_the_free_governor_takes_a_torque_and_the_driven_one_a_speed(fmus: dict[str, Path]) -> None:
    with Fmu(fmus["governor"]) as driven, Fmu(fmus["free"]) as free:
        assert driven.variables["spindle.drive"].causality == "input"
        assert driven.variables["spindle.drive"].unit == "rad/s"
        assert free.variables["spindle.torque"].causality == "input"
        assert "spindle.effort" not in free.variables
        assert driven.variables["driven"].variability == "constant"


def test_a_new_speed_turns_the_spindle_on_from_where_it_is(fmus: dict[str, Path]) -> None:
    with Fmu(fmus["governor"]) as fmu:
        fmu.step(0.25)
        before = fmu["spindle.angle"]
        fmu["spindle.drive"] = 20.0
        fmu.step(0.1)
        assert before == pytest.approx(0.25 * 11.0174)
        assert fmu["spindle.angle"] == pytest.approx(before + 2.0)
        assert fmu["spindle.speed"] == pytest.approx(20.0)


def test_a_torque_on_the_free_spindle_does_work(fmus: dict[str, Path]) -> None:
    with Fmu(fmus["free"], {"tolerance": 1e-9}) as fmu:
        energy, work, torque = fmu["energy"], 0.0, 300.0
        fmu["spindle.torque"] = torque
        for _ in range(50):
            angle = fmu["spindle.angle"]
            fmu.step(0.01)
            work += torque * (fmu["spindle.angle"] - angle)
        assert fmu["energy"] - energy == pytest.approx(work, rel=1e-8)


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid"])
@pytest.mark.parametrize(
    ("name", "output", "end"), [("governor", "collar.distance", 40.0), ("pendulum", "slider.distance", 6.0)]
)
def test_damped_fmu_settles_in_the_steady_state(
    fmus: dict[str, Path], name: str, output: str, end: float, solver: str
) -> None:
    model: Model = MODELS[name]
    exact = model.exact_equilibrium()
    assert exact is not None
    with Fmu(fmus[name], {**model.settling, "solver": solver, "tolerance": 1e-8}) as fmu:
        fmu.step(end)
        assert fmu[output] == pytest.approx(exact[output], rel=1e-7)


@pytest.mark.parametrize("name", ["governor", "free"])
def test_starts_in_balance(fmus: dict[str, Path], name: str) -> None:
    values = {"start_at_equilibrium": True, "tolerance": 1e-9, "spindle_speed": 14.0}
    with Fmu(fmus[name], values) as fmu:
        expected = equilibrium(Governor(spindle_speed=14.0)).outputs
        for _ in range(3):
            assert fmu["collar.distance"] == pytest.approx(expected["collar.distance"], rel=1e-8)
            assert fmu["spindle.speed"] == pytest.approx(14.0, rel=1e-9)
            fmu.step(0.5)


def test_a_drive_input_decides_the_start_in_balance(fmus: dict[str, Path]) -> None:
    with Fmu(fmus["governor"], {"start_at_equilibrium": True, "spindle.drive": 14.0}) as fmu:
        expected = equilibrium(Governor(spindle_speed=14.0)).outputs
        assert degrees(fmu["arm1.angle"]) == pytest.approx(degrees(expected["arm1.angle"]), rel=1e-9)


def test_a_start_without_a_steady_state_is_an_error(fmus: dict[str, Path], capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UserError, match="no steady state"):
        Fmu(fmus["pendulum"], {"start_at_equilibrium": True, "gravity": 9.81})
    assert "does not turn with it" in capfd.readouterr().err


@pytest.mark.parametrize("scene", ["governor/damped", "governor/free", "pendulum/damped"])
def test_scenes_run(command: Callable[..., tuple[int, str, str]], tmp_path: Path, scene: str) -> None:
    code, out, _ = command("run", scene, "--direct", "-o", str(tmp_path))
    assert code == 0, out
