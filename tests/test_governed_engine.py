"""The engine and its governor: the co-simulation against statics, one differential equation, and two SSP hosts."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from math import log2
from pathlib import Path

import governed_engine as example
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from governed_engine import ENGINE, SPEEDS, STEP, STOP_TIME, SYSTEM, Fmus, error, settled
from ssp_system import Run

from mbfmu.cli import main
from mbfmu.fmi import Fmu

PAGE = (Path(__file__).parents[1] / "docs" / "cosimulation.md").read_text()
GOAL = settled(ENGINE.load_after)


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Fmus:
    return example.build(tmp_path_factory.mktemp("governed_engine"))


@pytest.fixture(scope="module")
def ssp(fmus: Fmus) -> Path:
    return SYSTEM.write(fmus.engine.with_name("governed_engine.ssp"), fmus._asdict(), STOP_TIME)


@pytest.fixture(scope="module")
def coupled(fmus: Fmus) -> Run:
    return example.co_simulate(fmus, STEP)


def test_both_fmus_validate(fmus: Fmus) -> None:
    assert validate_fmu(str(fmus.engine)) == []
    assert validate_fmu(str(fmus.governor)) == []


def test_starts_where_the_governor_holds_the_first_load(coupled: Run) -> None:
    start = settled(ENGINE.load_before)
    assert pytest.approx(start.speed, abs=1e-6) == ENGINE.start_speed
    before = coupled["time"] < ENGINE.load_time
    for name in SPEEDS:
        np.testing.assert_allclose(coupled[name][before], start.speed, atol=1e-6)


def test_settles_at_the_derived_state(coupled: Run) -> None:
    for name in SPEEDS:
        assert coupled[name][-1] == pytest.approx(GOAL.speed, abs=1e-6)
    assert coupled["governor.collar.height"][-1] == pytest.approx(GOAL.height, abs=1e-8)
    assert ENGINE.max_torque * coupled["engine.throttle"][-1] == pytest.approx(ENGINE.load_after, abs=1e-4)


def test_the_load_is_caught(coupled: Run) -> None:
    speed, since = coupled["engine.speed"], coupled["time"] - ENGINE.load_time
    assert speed.min() > GOAL.speed - 0.15
    assert np.abs(speed - GOAL.speed)[since > 1.5].max() < 0.005
    assert coupled["engine.throttle"].max() < 1.0


def test_the_one_equation_settles_there_too() -> None:
    exact = example.one_equation(np.array([0.5, 20.0]))
    for name in SPEEDS:
        assert exact[name] == pytest.approx([settled(ENGINE.load_before).speed, GOAL.speed], abs=1e-6)


@pytest.mark.parametrize(("second_order", "order"), [(False, 1.0), (True, 2.0)])
def test_order_of_the_coupling_and_speed_that_does_not_depend_on_it(
    fmus: Fmus, second_order: bool, order: float
) -> None:
    runs = [example.co_simulate(fmus, step, second_order=second_order) for step in (8e-3, 4e-3, 2e-3)]
    errors = [error(run) for run in runs]
    assert [log2(a / b) for a, b in pairwise(errors)] == pytest.approx([order, order], abs=0.1)
    for run in runs:
        assert run["engine.speed"][-1] == pytest.approx(GOAL.speed, abs=1e-6)


@pytest.mark.parametrize("host", ["fmpy", "libcosim"])
def test_the_ssp_runs_and_agrees_to_the_order_of_the_coupling(ssp: Path, coupled: Run, host: str) -> None:
    if host == "libcosim":
        pytest.importorskip("libcosimpy")
    run_in: Callable[[Path, float, float], Run] = getattr(SYSTEM, f"run_in_{host}")
    coarse, fine = (run_in(ssp, STOP_TIME, step) for step in (2 * STEP, STEP))
    assert log2(error(coarse) / error(fine)) == pytest.approx(1.0, abs=0.1)
    assert error(fine) < 2.0 * error(coupled)
    for name in SPEEDS:
        assert fine[name][-1] == pytest.approx(coupled[name][-1], abs=1e-7)
    assert fine["governor.collar.height"][-1] == pytest.approx(GOAL.height, abs=1e-8)


@pytest.mark.skipif(find_spec("libcosimpy") is None, reason="libcosimpy is not installed")
def test_libcosim_carries_the_start_values_over(ssp: Path) -> None:
    run = SYSTEM.run_in_libcosim(ssp, STOP_TIME, 4e-3)
    before = run["time"] < ENGINE.load_time
    for name in SPEEDS:
        np.testing.assert_allclose(run[name][before], settled(ENGINE.load_before).speed, atol=1e-6)


BLOCKS = dict(
    zip(("write", "fmpy", "libcosim"), re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL), strict=True)
)


def test_the_page_writes_the_same_ssp(ssp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ssp.parent)
    before = ssp.read_bytes()
    ssp.unlink()
    exec(compile(BLOCKS["write"], "docs/cosimulation.md", "exec"), {})
    assert ssp.read_bytes() == before


def test_the_page_s_command_runs(ssp: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ssp.parent)
    (command,) = re.findall(r"^mbfmu ssp .*?(?=```)", PAGE, flags=re.DOTALL | re.MULTILINE)
    assert main(shlex.split(command.replace("\\\n", ""))[1:]) == 0
    assert Path("default_governor.ssp").is_file()


@pytest.mark.parametrize("host", ["fmpy", "libcosim"])
def test_the_page_s_lines_run(
    ssp: Path, host: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if host == "libcosim":
        pytest.importorskip("libcosimpy")
    monkeypatch.chdir(ssp.parent)
    exec(compile(BLOCKS[host], "docs/cosimulation.md", "exec"), {})
    assert float(capsys.readouterr().out.strip("[]\n")) == pytest.approx(GOAL.speed, abs=1e-6)


def test_the_engine_steps_over_its_load_step_and_by_zero(fmus: Fmus) -> None:
    with Fmu(fmus.engine, {"collar_height": ENGINE.closed_height, "spindle_speed": ENGINE.start_speed}) as engine:
        engine.step(0.0)
        assert engine["speed"] == ENGINE.start_speed
        engine.step(2.0)  # shut throttle, load before and after its step, the shaft drags along a spindle that turns on
        assert engine["load"] == ENGINE.load_after
        lost = ENGINE.load_before * 1.0 + ENGINE.load_after * 1.0 + engine["shaft_torque"] * 2.0
        assert engine["speed"] == pytest.approx(ENGINE.start_speed - lost / ENGINE.inertia, abs=1e-9)


def test_the_script_writes_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(example, "STEPS", (8e-3, 4e-3))
    monkeypatch.setattr(sys, "argv", ["governed_engine.py", "-o", str(tmp_path / "out")])
    example.main()
    names = {"engine.fmu", "governor.fmu", "governed_engine.ssp", "governed_engine.png"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    assert "Gauss-Seidel" in capsys.readouterr().out
