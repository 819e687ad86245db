"""Parameters, discovery, scenes: input of users, and messages for wrong input."""

from __future__ import annotations

import copy
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description

from fmus.fourbar import FourBar
from mbfmu.fmi import export
from mbfmu.modeling.registry import find, models, reference_of
from mbfmu.modeling.scene import load_scene
from mbfmu.session.run import communication_points, run, simulate
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

MODEL = '''
from dataclasses import dataclass
from mbfmu.mechanics import Mechanism, Revolute, rod
from mbfmu.modeling import Model, parameter

@dataclass(frozen=True, kw_only=True)
class Pendulum(Model):
    """A swinging rod."""

    length: float = parameter(1.0, unit="m", min=0.1, doc="length")
    count: int = parameter(1, min=1, max=3, doc="a whole number")
    heavy: bool = parameter(False, doc="a switch")

    def build(self):
        m = Mechanism(gravity=(0, -9.81, 0))
        bar = m.body("bar", m.ground, Revolute(), **rod(mass=2.0 if self.heavy else 1.0, length=self.length))
        m.output("bar.angle", bar.angle(), "angle")
        m.output("energy", m.energy, "energy")
        return m
'''


@pytest.fixture
def pendulum_file(tmp_path: Path) -> Path:
    path = tmp_path / "my_model.py"
    path.write_text(MODEL)
    return path


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"crank_length": 0.0}, r"'crank_length' of 'fourbar' is 0\.0; allowed: at least 0\.001 m"),
        ({"crank_length": "long"}, "is 'long'; allowed: a finite number"),
        ({"gravity": float("nan")}, "is nan; allowed: a finite number"),
        ({"gravity": True}, "is True; allowed: a number"),
        ({"crank_lenght": 1.0}, "no parameter 'crank_lenght'; did you mean 'crank_length'"),
    ],
)
def test_parameters_name_what_is_wrong(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        FourBar().with_values(values)


def test_models_are_found_by_name_and_by_file(pendulum_file: Path) -> None:
    assert models()["fourbar"] is FourBar
    model = find(f"{pendulum_file}:Pendulum")
    assert model.title() == "A swinging rod."
    assert find(str(pendulum_file)) is model
    with pytest.raises(UserError, match="unknown model 'forbar'; did you mean 'fourbar'"):
        find("forbar")
    with pytest.raises(UserError, match="has no model 'Nothing'; it has: Pendulum"):
        find(f"{pendulum_file}:Nothing")
    with pytest.raises(UserError, match="does not exist"):
        find("nowhere.py:Model")


def test_whole_numbers_and_switches(pendulum_file: Path) -> None:
    model = find(str(pendulum_file))()
    changed = model.with_values({"count": "2", "heavy": "true"})
    assert (changed.count, changed.heavy) == (2, True)  # type: ignore[attr-defined]
    for values, message in (({"count": "1.5"}, "whole number"), ({"count": 4}, "1 to 3"), ({"heavy": 1}, "true or")):
        with pytest.raises(UserError, match=message):
            model.with_values(values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('model = "fourbar', "not valid TOML"),
        ("stop_time = 1.0", "model is None"),
        ('model = "fourbar"\nsolvr = "ida"', "unknown key 'solvr'; did you mean 'solver'"),
        ('model = "fourbar"\nsolver = "euler"', "solver is 'euler'"),
        ('model = "fourbar"\ntolerance = 1.0', "tolerance is 1.0; allowed: 1e-12 to 0.01"),
        ('model = "fourbar"\ntolerance = "fine"', "tolerance is 'fine'"),
        ('model = "fourbar"\nstop_time = -1.0', r"stop_time is -1\.0"),
        ('model = "fourbar"\noutput_interval = 0.0', "output_interval is 0"),
        ('model = "fourbar"\n[parameters]\ncrank_mass = -1.0', "crank_mass"),
        ('model = "fourbar"\nparameters = 3', "parameters is 3"),
        ('model = "fourbar"\nsolver = 3', "solver is 3"),
        ('model = "fourbar"\nsolver = ["ida"]', r"solver is \['ida'\]"),
        ('model = "fourbar"\ninput_interpolation = "held"', "input_interpolation is 'held'"),
        (f'model = "fourbar"\nstop_time = {"9" * 401}', "stop_time has a whole number of more than 64 bits"),
        (
            f'model = "fourbar"\n[parameters]\ncrank_length = {"9" * 401}',
            "crank_length has a whole number",
        ),
    ],
)
def test_scene_files_name_what_is_wrong(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=message):
        load_scene(str(path))


def test_scene_of_a_file_a_model_and_a_shipped_one(tmp_path: Path, pendulum_file: Path) -> None:
    path = tmp_path / "swing.toml"
    path.write_text('model = "my_model.py:Pendulum"\nsolver = "adams"\n[parameters]\nlength = 0.5\n')
    scene = load_scene(str(path))
    assert (scene.name, scene.settings.solver, scene.model.length) == ("pendulum/swing", "adams", 0.5)  # type: ignore[attr-defined]
    assert load_scene("fourbar").stop_time == 10.0
    paper = load_scene("fourbar/paper")
    assert paper.settings.max_step == 0.01
    assert paper.settings.solver == "hybrid"
    assert paper.changed(solver="ida").settings.solver == "ida"
    with pytest.raises(UserError, match="no scene 'papr'; did you mean 'paper'"):
        load_scene("fourbar/papr")


def test_settings_of_the_solver_reach_it_from_a_scene_and_python(tmp_path: Path, pendulum_file: Path) -> None:
    path = tmp_path / "swing.toml"
    numbers = "absolute_tolerance = 1e-9\nmax_order = 3\nmax_steps = 7\n"
    path.write_text(f'model = "my_model.py:Pendulum"\nsolver = "adams"\n{numbers}')
    scene = load_scene(str(path))
    options = scene.settings.options()
    assert (options.atol, options.max_order, options.max_steps) == (1e-9, 3, 7)
    stopped = simulate(scene.model, 5.0, interval=5.0, solver="adams", max_steps=7)
    assert "the maximum number of steps was reached" in stopped.failure
    low, high = (simulate(scene.model, 5.0, solver="adams", max_order=k).statistics for k in (2, 12))
    assert low.order <= 2 < high.order
    assert low.steps > 2 * high.steps
    for given in ({"max_order": 13}, {"max_steps": 0}, {"absolute_tolerance": -1.0}, {"max_order": 2.5}):
        with pytest.raises(UserError, match=next(iter(given))):
            simulate(scene.model, 1.0, **given)


def test_solver_and_tolerance_that_are_not_given_are_those_of_the_model(tmp_path: Path) -> None:
    (tmp_path / "coarse.py").write_text(MODEL + '    default_solver, tolerance = "adams", 1e-5\n')
    model = find(f"{tmp_path / 'coarse.py'}:Pendulum")()
    for given, expected in (
        ({"max_step": 0.1}, ("adams", 1e-5)),
        ({"solver": "radau"}, ("radau", 1e-5)),
        ({"tolerance": 1e-6}, ("adams", 1e-6)),  # the value that most models have
    ):
        settings = Settings(**given)
        for found in (Simulation(model, settings).settings, run(model, settings, np.array([0.0, 0.01])).settings):
            assert found is not None
            assert (found.solver, found.tolerance) == expected
        described = read_model_description(export(model, tmp_path / "model.fmu", settings, native=False))
        start = next(v.start for v in described.modelVariables if v.name == "tolerance")
        assert (float(start), float(described.defaultExperiment.tolerance)) == (expected[1], expected[1])


def test_results_do_not_depend_on_communication_points() -> None:
    """Adams steps past a communication point and interpolates: the steps are the same whatever the interval."""
    settings = Settings(solver="adams", tolerance=1e-8)
    coarse = run(FourBar(), settings, communication_points(2.0, 0.5))
    fine = run(FourBar(), settings, communication_points(2.0, 0.01))
    np.testing.assert_allclose(fine["crank.angle"][::50], coarse["crank.angle"], rtol=0, atol=1e-12)
    assert fine.statistics.steps == coarse.statistics.steps


def test_csv_has_units_and_full_precision(tmp_path: Path) -> None:
    result = run(FourBar(), Settings(solver="adams"), communication_points(0.1, 0.05))
    path = tmp_path / "r.csv"
    result.write_csv(path)
    lines = path.read_text().splitlines()
    assert lines[0].startswith("time [s],crank.angle [rad]")
    assert float(lines[2].split(",")[1]) == result["crank.angle"][1]


def test_torque_input_does_work() -> None:
    """Energy changes by torque times angle."""
    simulation = Simulation(FourBar(gravity=0.0, start_angle=0.5), Settings(solver="adams", tolerance=1e-10))
    names = [v.name for v in simulation.compiled.outputs]
    angle, energy = names.index("crank.angle"), names.index("energy")
    before = simulation.outputs().copy()
    simulation.set_input(0, 3.0)
    assert simulation.advance(0.4).ok
    after = simulation.outputs()
    assert after[energy] - before[energy] == pytest.approx(3.0 * (after[angle] - before[angle]), rel=1e-8)


@pytest.mark.parametrize("twin", [copy.copy, copy.deepcopy, pickle.dumps])
def test_no_two_share_a_history(twin: Callable[[Any], Any]) -> None:
    simulation = Simulation(FourBar(), Settings(solver="adams"))
    for one in (simulation, simulation.stepper):
        with pytest.raises(TypeError, match=r"cannot be copied or pickled: make another .* restore\(save\(\)\)"):
            twin(one)


def test_tunable_parameters_change_and_fixed_ones_do_not() -> None:
    simulation = Simulation(FourBar(), Settings(solver="adams"))
    assert simulation.advance(0.1).ok
    simulation.retune(FourBar(gravity=1.62))
    assert simulation.advance(0.2).ok
    with pytest.raises(UserError, match="'crank_mass' cannot change during a run: it is not tunable"):
        simulation.retune(FourBar(gravity=1.62, crank_mass=2.0))


def declaring(what: str, decorated: bool = True) -> str:
    """The source of a model that declares this."""
    head = MODEL[: MODEL.index("    length:")].rstrip()
    if not decorated:
        head = head.replace("@dataclass(frozen=True, kw_only=True)\n", "")
    return f"{head}\n\n    {what}\n\n    def build(self):\n        return None\n"


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (
            "name: float = parameter(1.0)",
            "'name' of model Pendulum is named as an attribute that every model has",
        ),
        ("p: float = parameter(1.0, doc=3)", "parameter 'p' of model Pendulum: doc is 3; allowed: text"),
        ("p: str = parameter('a')", "parameter 'p' of model Pendulum: the default is the text 'a'; give all"),
        ("p: str = parameter('a', choices=('a', 'a'))", "choices are ('a', 'a'); allowed: words, each once"),
        ("p: int = parameter(1, choices=(1, 2))", "choices are (1, 2); allowed: words"),
        ("p: int = parameter(1, unit='m')", "unit is 'm', but the parameter is not a real number"),
        ("p: int = parameter(2**40)", "default is 1099511627776; allowed: a whole number"),
        ("p: int = parameter(1, min=0.5)", "min is 0.5; allowed: a whole number"),
        ("p: float", "model Pendulum has a parameter without default"),
        (
            "p: int = parameter(1, resolution=(4, 2))",
            "resolution is (4, 2); allowed: numbers, each no less than the one",
        ),
        ("p: int = parameter(1, max=3, resolution=(2, 4))", "parameter 'p' of 'Pendulum' is 4; allowed: whole numbers"),
        (
            "p: int = parameter(1, resolution=(2, 4)); r: int = parameter(1, resolution=(2,))",
            "its lists of resolutions must have equal lengths; p has 2, r has 1",
        ),
        ("name = 7", "name of model Pendulum is 7; allowed: text"),
        ("raise SystemExit(3)", "cannot be imported: SystemExit: 3"),
    ],
)
def test_reserved_names_of_models_are_refused(what: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "pendulum.py"
    path.write_text(declaring(what))
    with pytest.raises(UserError, match=re.escape(message)):
        load_scene(str(path))


def test_a_model_that_is_no_dataclass_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pendulum.py"
    path.write_text(declaring("p: float = parameter(1.0)", decorated=False))
    with pytest.raises(UserError, match=r"write @dataclass\(frozen=True, kw_only=True\) above the class"):
        load_scene(str(path))


def test_no_file_has_so_long_a_name() -> None:
    with pytest.raises(UserError, match="does not exist"):
        load_scene("x" * 300 + ".py")


def test_a_model_of_a_relative_path_is_found_from_every_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another process finds it too, which compiles its kernels in another folder."""
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "swing.py").write_text(
        "from dataclasses import dataclass\nimport mbfmu as mb\n\n\n@dataclass(frozen=True, kw_only=True)\n"
        "class Swing(mb.Model):\n    def build(self):\n        return mb.Mechanism()\n"
    )
    monkeypatch.chdir(tmp_path)
    found = find("models/swing.py:Swing")
    monkeypatch.chdir(folder)
    assert find(reference_of(found)) is found
