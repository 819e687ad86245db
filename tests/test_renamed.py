"""Names of earlier versions: the message gives the present name."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import mbfmu as mb
from mbfmu import mechanics, sheets
from mbfmu.cli import main
from mbfmu.modeling import Model
from mbfmu.modeling.model import as_model
from mbfmu.modeling.scene import SCENE_KEYS, read_scene
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import RENAMED, SHEET_NAMES, UserError


def pendulum() -> Model:
    m = mb.Mechanism()
    m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
    return as_model(m)


@cache
def simulation() -> Simulation:
    return Simulation(pendulum(), mb.Settings())


ATTRIBUTES: dict[str, Callable[[], object]] = {
    "recommend_solver": lambda: mb.choose,
    "Recommendation": lambda: mb.TargetChoice,
    "add_contact": lambda: mechanics.add_touch,
    "SurfaceContactHandle": lambda: mechanics.TouchHandle,
    "show_outputs": lambda: mb.Mechanism().readout,
    "element": lambda: mb.Mechanism().plate,
    "meshes": lambda: mb.Mechanism().sheets,
    "mechanics.CompiledMechanism": lambda: mechanics.Plant,
    "RevoluteCutJoint": lambda: mechanics.RevoluteCut,
    "compile": lambda: pendulum().plant,
    "compiled": lambda: simulation().plant,
    "checkpoint": lambda: simulation().mark,
    "rollback": lambda: simulation().rewind,
    "solver_choice": lambda: simulation().pick,
    "discontinuity_work": lambda: simulation().work_of_jumps,
}
ARGUMENTS: dict[str, Callable[[], object]] = {
    "energy_check": lambda: mb.Settings(audit=False),
    "input_interpolation": lambda: mb.Settings(inputs="linear"),
    "rotational_stiffness": lambda: mb.Bushing(turning_stiffness=1.0),
    "rotational_damping": lambda: mb.Bushing(turning_damping=1.0),
}


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_an_attribute_that_was_renamed(name: str) -> None:
    with pytest.raises(AttributeError, match=f"it is now called '{name}'"):
        ATTRIBUTES[name]()


def test_a_property_of_a_model_that_fails_is_not_called_missing() -> None:
    class Broken(Model):
        @property
        def size(self) -> float:
            raise AttributeError("no such length")

    with pytest.raises(AttributeError, match="no such length"):
        _ = Broken.__new__(Broken).size


@pytest.mark.parametrize("name", SHEET_NAMES)
def test_a_name_that_is_in_another_package_now(name: str) -> None:
    assert hasattr(sheets, name)
    with pytest.raises(AttributeError, match=r"it is now in mbfmu\.sheets"):
        getattr(mechanics, name)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_an_argument_that_was_renamed(name: str) -> None:
    with pytest.raises(UserError, match=f"it is now called '{name}'"):
        ARGUMENTS[name]()


@pytest.mark.parametrize("old", sorted(RENAMED.keys() & {"audit", "inputs"}))
def test_a_key_of_a_scene_file_that_was_renamed(tmp_path: Path, old: str) -> None:
    assert RENAMED[old] in SCENE_KEYS
    (tmp_path / "old.toml").write_text(f'model = "pendulum"\n{old} = true\n')
    with pytest.raises(UserError, match=f"{old}.*; .*it is now called '{RENAMED[old]}'"):
        read_scene(tmp_path / "old.toml")


def test_an_output_that_was_renamed() -> None:
    m = mb.Mechanism()
    arm = m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
    m.output("arm.angle", arm.angle())
    result = mb.simulate(m, 0.1)
    with pytest.raises(UserError, match="it is now called 'energy_error'"):
        result["energy_imbalance"]


def test_an_option_of_the_command_that_was_renamed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "pendulum", "--no-audit"])
    assert "'audit' is now called 'energy-check'" in capsys.readouterr().err


def test_an_unknown_argument_is_named_with_the_nearest_one() -> None:
    with pytest.raises(UserError, match="Spring has no argument 'stifness'; did you mean 'stiffness'"):
        mb.Spring(stifness=1.0)
