"""User-defined solvers from installed packages: list of solvers, runs, FMUs, saved states, broken packages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from user_solvers import AMPLITUDE, RATE, RK4, TEXT, classes_of_one_file, oscillator  # noqa: F401  # classes_of_one_file is a fixture

import mbfmu as mb
from fmus.fourbar import FourBar
from mbfmu.cli import main
from mbfmu.fmi.harness import Fmu
from mbfmu.modeling.settings import offered_solvers
from solvers.steppers import solver_names


def test_a_class_given_to_a_program_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(mb.UserError, match=r"solver 'rk4' is a class of this program.*entry point"):
        mb.export(FourBar(), tmp_path / "out.fmu", mb.Settings(solver=RK4), native=False)


PACKAGE = {
    "rk4_plugin.py": TEXT + "\n\nnumber = 3\n",
    "ending_plugin.py": TEXT.replace(
        "return y", "if t > 0.05:\n            raise LookupError('a table ends')\n        return y"
    ),
    "broken_plugin.py": "import a_module_that_nobody_has\n",
    "plugins-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: plugins\nVersion: 1.0\n",
    "plugins-1.0.dist-info/entry_points.txt": """[mbfmu.solvers]
installed-rk4 = rk4_plugin:RK4
ending = ending_plugin:RK4
broken = broken_plugin:Solver
number = rk4_plugin:number
twice = rk4_plugin:RK4
""",
    "others-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: others\nVersion: 1.0\n",
    "others-1.0.dist-info/entry_points.txt": "[mbfmu.solvers]\ntwice = rk4_plugin:RK4\n",
}


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two packages, as pip installs them."""
    for name, text in PACKAGE.items():
        path = tmp_path / "site" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_an_installed_solver_is_listed_and_runs(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "installed-rk4" in solver_names()
    result = mb.simulate(oscillator(), 1.0, interval=0.5, solver="installed-rk4", tolerance=1e-8)
    np.testing.assert_allclose(result["x"], AMPLITUDE * np.cos(RATE * result.t), atol=1e-6)
    assert main(["run", "pendulum", "--direct", "--solver", "installed-rk4", "--stop-time", "0.1"]) == 0
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "installed-rk4" in capsys.readouterr().out


def test_a_command_fails_with_the_message_of_a_solver(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "pendulum", "--direct", "--solver", "ending", "--stop-time", "0.2"]) == 1
    assert "LookupError: a table ends (ending_plugin.py, line" in capsys.readouterr().err


def test_an_fmu_with_an_installed_solver_runs(packages: Path) -> None:
    path = mb.export(FourBar(), packages / "crank.fmu", mb.Settings(solver="installed-rk4"), native=False)
    with Fmu(path) as fmu:
        fmu.step(0.1)
        found = fmu["crank.angle"]
    assert found == pytest.approx(mb.simulate(FourBar(), 0.1, interval=0.1)["crank.angle"][-1], abs=1e-5)


def test_an_fmu_whose_solver_is_not_installed_reports_it_without_logging(packages: Path) -> None:
    path = mb.export(FourBar(), packages / "crank.fmu", mb.Settings(solver="installed-rk4"), native=False)
    script = "import fmpy, sys; fmpy.simulate_fmu(sys.argv[1], stop_time=0.1, debug_logging=False)"
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "solver is 'installed-rk4'; allowed:" in done.stderr


SAVES = """
import sys
import numpy as np
import mbfmu as mb
from mbfmu.session.simulation import Simulation
from solvers import OneStepSolver
SCALE = {scale}
class Euler(OneStepSolver):
    order = 1
    weights = np.array([{weight}])
    def step(self, f, t, y, h):
        return y + h * SCALE * self.weights[0] * f(t, y), np.zeros(len(y))
m = mb.Mechanism()
m.body("arm", m.ground, mb.Revolute(start=0.3), **mb.rod(mass=1.0, length=1.0))
run = Simulation(m, mb.Settings(solver=Euler, tolerance=1e-3))
if sys.argv[1] == "save":
    run.advance(0.01)
    open("state", "wb").write(run.save())
else:
    run.restore(open("state", "rb").read())
"""


def test_a_state_belongs_to_the_class_that_saved_it(tmp_path: Path) -> None:
    """In another process; classes of the same name differ in a number of theirs, or of their module."""

    def end(what: str, scale: float = 1.0, weight: float = 1.0) -> tuple[int, str]:
        (tmp_path / "steps.py").write_text(SAVES.format(scale=scale, weight=weight))
        command = [sys.executable, "steps.py", what]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.returncode, done.stderr

    assert end("save")[0] == end("restore")[0] == 0
    for other in ({"scale": 0.5}, {"weight": 0.5}):
        code, text = end("restore", **other)
        assert code == 1
        assert "a saved state belongs to another model" in text


def test_an_fmu_whose_solver_fails_reports_the_exception(packages: Path) -> None:
    path = mb.export(FourBar(), packages / "crank.fmu", mb.Settings(solver="ending"), native=False)
    with Fmu(path) as fmu:
        fmu.step(0.04)
        with pytest.raises(mb.UserError, match=r"LookupError: a table ends \(ending_plugin.py, line"):
            fmu.step(0.1)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("broken", ("'broken'", "'broken_plugin:Solver' of package 'plugins'", "ModuleNotFoundError", "uninstall")),
        ("number", ("'number'", "'rk4_plugin:number'", "is 3", "OneStepSolver")),
        ("twice", ("'twice'", "package 'others'", "package 'plugins'", "Uninstall")),
        ("nowhere", ("'nowhere'", "installed-rk4", "adams")),
    ],
)
def test_a_broken_package_is_named_and_concerns_nothing_else(packages: Path, name: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(mb.UserError) as error:
        mb.simulate(oscillator(), 1.0, solver=name)
    for part in parts:
        assert part in str(error.value)
    assert not mb.simulate(oscillator(), 0.1, solver="installed-rk4").failure


def test_a_comparison_leaves_a_broken_package_out(packages: Path) -> None:
    found = mb.compare(oscillator(4.0), solvers=["adams", "broken"], tolerances=[1e-4], repeats=1, outputs=["x"])
    assert [row.solver for row in found.rows] == ["adams"]
    assert any("broken_plugin" in d.text for d in found.diagnostics)


@pytest.mark.parametrize("name", ["adams", "auto"])
def test_a_package_with_the_name_of_a_solver_is_reported_and_not_used(packages: Path, name: str) -> None:
    entries = packages / "site" / "others-1.0.dist-info" / "entry_points.txt"
    entries.write_text(f"[mbfmu.solvers]\n{name} = broken_plugin:Solver\n")
    with pytest.warns(RuntimeWarning, match=f"solver '{name}' .*package 'others'.* is not used.*another name"):
        assert offered_solvers().count(name) == 1
    with pytest.warns(RuntimeWarning, match="is not used"):
        assert not mb.simulate(oscillator(), 0.1, solver="installed-rk4").failure
