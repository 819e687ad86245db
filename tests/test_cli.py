"""The command line: exit codes, messages, files."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mbfmu import native
from mbfmu.cli import models
from solvers import SOLVERS
from solvers.compiled import cache

Command = Callable[..., Any]


def test_run_through_the_fmu_writes_csv_and_png(command: Command, tmp_path: Path) -> None:
    code, out, _ = command("run", "fourbar", "--solver", "adams", "--stop-time", "0.5", "-o", str(tmp_path))
    assert code == 0
    assert "steps" in out
    assert "energy imbalance" in out
    assert "loop 'pivot': 3 of 5 rows are void (z, zx, zy)" in out
    assert (tmp_path / "fourbar_adams.csv").read_text().count("\n") == 52
    assert (tmp_path / "fourbar_adams.png").stat().st_size > 10_000


def test_fmu_and_native_write_the_same_numbers(command: Command, tmp_path: Path) -> None:
    for extra in ("--native", "--solver=adams"):
        command("run", "fourbar", "--solver=adams", "--stop-time=1", "-o", str(tmp_path / extra.strip("-")), extra)
    native = (tmp_path / "native" / "fourbar_adams.csv").read_text()
    through_fmu = (tmp_path / "solver=adams" / "fourbar_adams.csv").read_text()
    for a, b in zip(native.splitlines()[1:], through_fmu.splitlines()[1:], strict=True):
        for x, y in zip(a.split(","), b.split(","), strict=True):
            assert float(x) == pytest.approx(float(y), rel=0, abs=1e-12)


def test_a_run_that_fails_leaves_what_went_well(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = ("run", "fourbar/paper", "--native", "--stop-time=0.1", "-o", str(tmp_path))
    assert command(*told)[0] == 0
    before = (tmp_path / "fourbar_paper_hybrid.csv").read_text()
    monkeypatch.setattr("mbfmu.cli.run.run", lambda *a, **k: replace(native.run(*a, **k), failure="it stopped"))
    code, out, err = command(*told)
    assert code == 1
    assert "it stopped" in err
    assert "fourbar_paper_hybrid_failed.csv" in out
    assert (tmp_path / "fourbar_paper_hybrid.csv").read_text() == before


def test_models_lists_parameters_with_units(command: Command) -> None:
    code, out, _ = command("models")
    assert code == 0
    assert "crank_length = 1 m" in out
    assert "changes between steps" in out


def test_compare_writes_rows(command: Command, tmp_path: Path) -> None:
    scene = tmp_path / "short.toml"
    scene.write_text('model = "fourbar"\nstop_time = 0.1\n')
    rows_file = tmp_path / "rows.json"
    code, out, _ = command("compare", str(scene), "--repeats=1", "-o", str(tmp_path), "--json", str(rows_file))
    assert code == 0
    assert "adams-lu" in out
    rows = json.loads(rows_file.read_text())
    assert len(rows) == 16
    assert {"solver", "rtol", "wall_s", "max_error", "branch_jump", "status", "partition_switches"} <= set(rows[0])
    assert all(row["status"] == "ok" for row in rows)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "fourbra"), "unknown model 'fourbra'"),
        (("run", "fourbar", "--set", "crank_length"), "write NAME=VALUE"),
        (("run", "fourbar", "--set", "crank_length=-1"), "at least 0.001 m"),
        (("run", "fourbar", "--set", "ground_length=9"), "loop cannot close"),
        (("run", "fourbar", "--tolerance", "1e-20"), "1e-12"),
        (("run", "fourbar", "--solver", "rk4"), "solver is 'rk4'"),
        (("run", "no_such.toml"), "cannot be read"),
        (("export", "fourbar", "-o", "x.zip"), "must end in .fmu"),
        (("export", "fourbar", "-o", "/proc/x.fmu"), "'/proc/x.fmu' cannot be written"),
        (("compare", "fourbar", "--json", "/nowhere/x.json"), "'/nowhere/x.json' cannot be written"),
        (("cache", "warm", "nothing"), "unknown model 'nothing'"),
        (
            ("run", "fourbar", "--set", "coupler_mass=0", "--set", "crank_mass=0", "--set", "rocker_mass=0"),
            "no inertia",
        ),
        (("run", "fourbar", "--set", "start_angle=0", "--native"), "branches of the motion cross"),
    ],
)
def test_mistakes_get_a_message_and_exit_code_2(command: Command, arguments: tuple[str, ...], message: str) -> None:
    code, _, err = command(*arguments)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_a_tolerance_that_is_not_run_is_told(command: Command, tmp_path: Path) -> None:
    fine = ("run", "fourbar", "--native", "--stop-time=0.1", "--interval=0.05", "-o", str(tmp_path))
    assert "note: 'ida' runs a loop at a tolerance of 1e-09, not 1e-12" in command(*fine, "--tolerance=1e-12")[1]
    assert "note:" not in command(*fine)[1]


def test_a_huge_number_is_refused_in_words(command: Command, tmp_path: Path) -> None:
    code, _, err = command("run", "fourbar", "--native", "--set", "crank_length=1e200", "-o", str(tmp_path))
    assert code == 2
    assert err.startswith("mbfmu: ")


def test_the_first_run_says_why_it_takes_long(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a terminal, as soon as something has to be compiled, and once."""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)

    def starts(_options: object) -> int:
        cache.tell_listeners()
        cache.tell_listeners()
        return 0

    monkeypatch.setattr(models, "command_models", starts)
    assert command("models")[2].count("compiling, once on this machine") == 1


def test_the_cache_says_where_it_is(command: Command) -> None:
    code, out, _ = command("cache")
    assert code == 0
    assert str(cache.home()) in out
    assert "MB of machine code" in out


def test_the_cache_is_warmed_for_a_model(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[str] = []
    monkeypatch.setattr("mbfmu.cli.cache.Simulation", lambda _model, settings: started.append(settings.name))
    code, out, _ = command("cache", "warm", "pendulum")
    assert code == 0
    assert started == list(SOLVERS)
    assert "MB of machine code" in out


def test_python_m_is_the_command() -> None:
    found = subprocess.run((sys.executable, "-m", "mbfmu", "--version"), capture_output=True, text=True, check=True)
    assert found.stdout.startswith("mbfmu ")


def test_two_models_of_one_file_and_two_solvers_keep_their_results(command: Command, tmp_path: Path) -> None:
    source = tmp_path / "two.py"
    model = "class {}(FourBar):\n    pass\n"
    source.write_text("from fmus.fourbar import FourBar\n" + model.format("First") + model.format("Second"))
    for name, solver in (("First", "adams"), ("Second", "adams"), ("Second", "ida")):
        told = (f"{source}:{name}", f"--solver={solver}", "--native", "--stop-time=0.02", "-o", str(tmp_path))
        assert command("run", *told)[0] == 0
    assert sorted(p.name for p in tmp_path.glob("*.csv")) == ["first_adams.csv", "second_adams.csv", "second_ida.csv"]


def test_a_folder_in_the_place_of_a_result_is_told_before_the_run(command: Command, tmp_path: Path) -> None:
    for kind in ("csv", "png", "npz"):
        (tmp_path / kind / f"fourbar_ida.{kind}").mkdir(parents=True)
        code, out, err = command("run", "fourbar", "--native", "-o", str(tmp_path / kind))
        assert (code, out) == (2, "")
        assert err.endswith(f"fourbar_ida.{kind}' cannot be written: it is a folder\n")


def test_a_full_disk_is_told_in_words(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_options: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(models, "command_models", full)
    monkeypatch.setattr("os.dup2", lambda *_: None)
    code, _, err = command("models")
    assert (code, err) == (2, "mbfmu: standard output: No space left on device\n")
