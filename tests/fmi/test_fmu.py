"""The four-bar FMU, used by a host."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from agreement import check_against_direct, check_continuation
from fmpy import simulate_fmu
from fmpy.validation import validate_fmu

from fmus.fourbar import FourBar
from mbfmu.fmi import Fmu, export
from mbfmu.fmi.documentation import licenses
from mbfmu.fmi.slave import ModelSlave
from mbfmu.session.simulation import Settings
from mbfmu.util.errors import UserError


def test_validates(fourbar_fmu: Path) -> None:
    assert validate_fmu(str(fourbar_fmu)) == []


def test_every_variable_has_a_description(fourbar_fmu: Path) -> None:
    with Fmu(fourbar_fmu) as fmu:
        for name, variable in fmu.variables.items():
            assert variable.description, name
        assert fmu.variables["crank.torque"].unit == "N.m"
        assert fmu.variables["gravity"].variability == "tunable"
        assert fmu.description.defaultExperiment.stopTime in ("10.0", 10.0)  # text or number, by the version of fmpy


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_equals_the_direct_run(fourbar_fmu: Path, solver: str) -> None:
    check_against_direct(fourbar_fmu, FourBar(), solver, np.linspace(0.0, 1.5, 76))


@pytest.mark.parametrize("solver", ["adams", "hybrid"])
def test_a_second_instance_continues_bit_for_bit(fourbar_fmu: Path, solver: str) -> None:
    with Fmu(fourbar_fmu, {"solver": solver}) as first, Fmu(fourbar_fmu, {"solver": solver}) as second:
        first["crank.torque"] = 2.0
        check_continuation(first, second, before=40, after=60)


def test_a_second_instance_continues_within_tolerance_with_ida(fourbar_fmu: Path) -> None:
    values = {"solver": "ida", "tolerance": 1e-8}
    with Fmu(fourbar_fmu, values) as first, Fmu(fourbar_fmu, values) as second:
        first.step(0.5)
        second.restore(first.save())
        second.t = first.t
        first.step(0.4)
        second.step(0.4)
        assert first["crank.angle"] == pytest.approx(second["crank.angle"], abs=1e-6)


def test_two_hundred_lives_and_two_at_once(fourbar_fmu: Path) -> None:
    places = len(sys.path)
    with Fmu(fourbar_fmu) as a:
        for _ in range(200):
            a.slave.reset()
            a.t = 0.0
            a.start({})
            a.step(0.01)
        for _ in range(5):
            with Fmu(fourbar_fmu, {"start_angle": 0.5}) as b:
                b.step(0.02)
                a.step(0.01)
                assert b["crank.angle"] > a["crank.angle"]
        assert len(sys.path) <= places + 2  # the wrapper adds a folder with every instance


def test_the_log_reports_constraint_equations_that_become_singular(fourbar_fmu: Path) -> None:
    said: list[str] = []
    simulate_fmu(
        str(fourbar_fmu),
        stop_time=0.02,
        debug_logging=True,
        logger=lambda _env, _name, _status, category, message: said.append(f"{category.decode()}: {message.decode()}"),
    )
    removed = "loop 'pivot': 3 of its 5 constraints are trivially satisfied (z, zx, zy) and removed"
    assert any(removed in line for line in said), said


def test_steps_of_zero_and_of_three_seconds(fourbar_fmu: Path) -> None:
    with Fmu(fourbar_fmu, {"tolerance": 1e-8}) as fmu:
        before = fmu.reals()
        fmu.step(0.0)
        np.testing.assert_array_equal(fmu.reals(), before)
        fmu.step(3.0)
        exact = FourBar().exact(np.array([0.0, 3.0]))
        assert exact is not None
        assert fmu["crank.angle"] == pytest.approx(exact["crank.angle"][1], abs=1e-6)


def test_inputs_and_tunable_parameters_act_between_steps(fourbar_fmu: Path) -> None:
    with Fmu(fourbar_fmu) as fmu:
        fmu.step(0.1)
        fmu["gravity"] = 0.0
        fmu["crank.torque"] = 7.0
        fmu.step(0.01)
        assert fmu["solver.restarts"] >= 1
        accelerated = fmu["crank.rate"]
        fmu.step(0.01)
        assert fmu["crank.rate"] > accelerated


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"crank_length": -1.0}, "'crank_length' of 'fourbar' is -1.0"),
        ({"ground_length": 50.0}, "loop cannot close"),
        ({"solver": 8}, r"'solver' was set to 8; allowed: 1 \(ida\), 2 \(adams\)"),
        ({"crank.torque": float("nan")}, "'crank.torque' was set to nan"),
        ({"coupler_mass": 0.0, "crank_mass": 0.0, "rocker_mass": 0.0}, "no inertia"),
    ],
)
def test_bad_start_values_are_refused_with_a_reason(
    fourbar_fmu: Path, values: dict[str, float | str], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UserError, match=message):
        Fmu(fourbar_fmu, values)
    assert re.search(message, capfd.readouterr().err)


def test_a_start_time_that_is_no_number_is_refused(fourbar_fmu: Path) -> None:
    with pytest.raises(UserError, match="start time is nan"):
        Fmu(fourbar_fmu, start_time=float("nan"))


def test_nan_between_steps_keeps_the_last_good_state(fourbar_fmu: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with Fmu(fourbar_fmu) as fmu:
        fmu.step(0.1)
        good = fmu.reals()
        fmu["crank.torque"] = float("nan")
        with pytest.raises(UserError, match=r"'crank\.torque' was set to nan"):
            fmu.step(0.1)
        np.testing.assert_array_equal(fmu.reals(), good)
        assert "allowed: a finite number" in capfd.readouterr().err


def test_equal_models_give_equal_bytes(tmp_path: Path) -> None:
    first = export(FourBar(), tmp_path / "a.fmu", native=False).read_bytes()
    assert export(FourBar(), tmp_path / "b.fmu", native=False).read_bytes() == first
    assert export(FourBar(crank_mass=2.0), tmp_path / "c.fmu", native=False).read_bytes() != first


def test_a_model_from_a_file_travels_in_the_fmu(tmp_path: Path) -> None:
    from mbfmu.modeling import find

    source = tmp_path / "swing.py"
    source.write_text(
        "from dataclasses import dataclass\n"
        "from mbfmu.mechanics import Mechanism, Revolute, rod\n"
        "from mbfmu.modeling.model import Model\n"
        "from mbfmu.modeling.parameters import parameter\n"
        "@dataclass(frozen=True, kw_only=True)\n"
        "class Swing(Model):\n"
        "    '''A swing.'''\n"
        "    length: float = parameter(1.0, unit='m', min=0.1, doc='length')\n"
        "    def build(self):\n"
        "        m = Mechanism(gravity=(0, -9.81, 0))\n"
        "        bar = m.body('bar', m.ground, Revolute(), **rod(mass=1.0, length=self.length))\n"
        "        m.output('bar.angle', bar.angle(), 'angle')\n"
        "        return m\n"
    )
    path = export(find(str(source))(), tmp_path / "swing.fmu", Settings(solver="adams"), native=False)
    source.unlink()
    assert validate_fmu(str(path)) == []
    with Fmu(path, {"length": 0.5}) as fmu:
        fmu.step(0.1)
        assert fmu["bar.angle"] < 0.0


def test_a_fresh_process_ends_well(fourbar_fmu: Path) -> None:
    program = (
        "import sys, fmpy\n"
        "r = fmpy.simulate_fmu(sys.argv[1], stop_time=0.2, output_interval=0.01)\n"
        "assert len(r) == 21, len(r)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(fourbar_fmu)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_archive_contains_description_documentation_and_sources(fourbar_fmu: Path) -> None:
    names = zipfile.ZipFile(fourbar_fmu).namelist()
    assert {f"documentation/{name}" for name in ("index.html", "licenses/mbfmu.txt", "licenses/pythonfmu.txt")} <= {
        *names
    }
    assert "resources/requirements.txt" in names
    assert names == sorted(names)


def test_native_fmus_contain_the_license_of_the_headers_they_are_compiled_with() -> None:
    texts = licenses(native=True)
    assert set(texts) == {"mbfmu.txt", "fmi-headers.txt", "license.txt"}
    for words in (b"Modelica Association", b"2-Clause BSD", b"Redistributions in binary form", b"AS IS"):
        assert words in texts["fmi-headers.txt"]


def test_a_fault_at_the_very_end_of_the_initialization_is_reported(
    fourbar_fmu: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fault(_: ModelSlave) -> None:
        raise AttributeError("no such thing")

    monkeypatch.setattr(ModelSlave, "_log_new", fault)
    with pytest.raises(UserError, match="AttributeError: no such thing"):
        Fmu(fourbar_fmu)
