"""The command line: exit codes, messages, files."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import mbfmu as mb
from mbfmu.cli import models
from mbfmu.fmi.python_fmu import own_source
from mbfmu.modeling import find
from mbfmu.modeling.scene import load_scene
from mbfmu.plotting import time_series
from mbfmu.session import run as session_run
from mbfmu.session.result import Result
from mbfmu.util.errors import UserError
from solvers import SOLVERS
from solvers.steppers import drop_unlisted

Command = Callable[..., Any]


def test_run_through_the_fmu_writes_csv_and_png(command: Command, tmp_path: Path) -> None:
    code, out, _ = command("run", "fourbar", "--solver", "adams", "--stop-time", "0.5", "-o", str(tmp_path))
    assert code == 0
    assert "steps" in out
    assert "energy error" in out
    assert out.index("wrote ") == len("".join(out.splitlines(keepends=True)[:-1]))
    assert len(out.splitlines()) <= 6
    assert "partition switches" not in out
    assert "constraints" not in out, "removed constraints are details"
    folder = tmp_path / "fourbar" / "default-adams-1e-6"
    assert f"wrote {folder}\n" in out
    assert sorted(p.name for p in folder.iterdir()) == [
        "default.toml", "motion.npz", "outputs.csv", "outputs.png", "residuals.png", "result.npz",
    ]  # fmt: skip
    assert (folder / "outputs.csv").read_text().count("\n") == 52
    assert (folder / "outputs.png").stat().st_size > 10_000
    saved = Result.load(folder / "result.npz")
    assert saved.title == "fourbar/default, adams, tolerance 1e-6"
    assert len(saved.t) == 51


def test_fmu_and_direct_write_the_same_numbers(command: Command, tmp_path: Path) -> None:
    for extra in ("--direct", "--solver=adams"):
        command(
            "run",
            "fourbar",
            "--solver=adams",
            "--stop-time=1",
            "--plot=energy",
            "-o",
            str(tmp_path / extra.strip("-")),
            extra,
        )
    direct, through_fmu = (
        (tmp_path / way / "fourbar" / "default-adams-1e-6" / "outputs.csv").read_text()
        for way in ("direct", "solver=adams")
    )
    for a, b in zip(direct.splitlines()[1:], through_fmu.splitlines()[1:], strict=True):
        for x, y in zip(a.split(","), b.split(","), strict=True):
            assert float(x) == pytest.approx(float(y), rel=0, abs=1e-12)


@pytest.mark.parametrize(
    ("found", "word"),
    [
        (mb.Diagnostic.error("collapsed-step", "it stopped"), "failed"),
        (mb.Diagnostic.warning("energy-balance", "energy is lost"), "inaccurate"),
    ],
)
def test_a_run_that_may_be_wrong_has_its_warning_in_all_outputs(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: mb.Diagnostic, word: str
) -> None:
    told = ("run", "fourbar/paper", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    assert command(*told)[0] == 0
    drawn: list[str] = []
    monkeypatch.setattr(
        "mbfmu.plotting.time_series.set_title", lambda figure, result: drawn.append(time_series.status_label(result))
    )
    monkeypatch.setattr("mbfmu.cli.run.run", lambda *a, **k: replace(session_run.run(*a, **k), diagnostics=(found,)))
    code, out, err = command(*told)
    assert code == 1
    assert err.endswith(f"mbfmu: {found.severity}: {found}\n")
    assert out.endswith(f"paper-hybrid-1e-4-{word}\n")
    assert sorted(path.name for path in (tmp_path / "fourbar").iterdir()) == [
        "paper-hybrid-1e-4",
        f"paper-hybrid-1e-4-{word}",
    ]
    assert drawn[0].startswith(word.upper())


def test_the_former_name_of_direct_is_accepted_with_a_notice(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar", "--native", "--stop-time=0.01", "--plot=energy", "-o", str(tmp_path))
    code, out, err = command(*told)
    assert code == 0
    assert "--native of `mbfmu run` is now --direct" in err
    assert "FMU" not in out


def test_a_name_is_given_one_value(command: Command) -> None:
    code, _, err = command("compare", "sheet", "--resolution", "nx=7,nx=9")
    assert (code, err) == (
        2,
        "mbfmu: --resolution 'nx=9': nx is given twice, before as 7; allowed: one value [invalid-value]\n",
    )


def test_a_model_may_import_modules_of_its_folder(tmp_path: Path) -> None:
    """Two models, each with a module of the same name next to it, do not meet."""
    for folder, length in (("a", 1.0), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "lengths.py").write_text(f"LENGTH = {length}\n")
        (tmp_path / folder / "model.py").write_text(
            "import mbfmu as mb\nfrom dataclasses import dataclass\nfrom lengths import LENGTH\n\n\n"
            "@dataclass(frozen=True, kw_only=True)\nclass Arm(mb.Model):\n    name = 'arm'\n"
            f"    length: float = mb.parameter(LENGTH, doc='of {folder}', unit='m')\n"
        )
    before = list(sys.path)
    assert [find(f"{tmp_path / folder / 'model.py'}:Arm")().length for folder in ("a", "b")] == [1.0, 2.0]
    assert sys.path == before
    assert "lengths" not in sys.modules
    with pytest.raises(
        UserError, match="model 'Arm' imports 'lengths' from the folder of its file, which is not part of"
    ):
        own_source(find(f"{tmp_path / 'a' / 'model.py'}:Arm"))


def test_models_lists_parameters_with_units(command: Command) -> None:
    code, out, _ = command("models")
    assert code == 0
    (crank,) = (line for line in out.splitlines() if line.startswith("crank_length") and "pin" in line)
    assert crank.split()[:3] == ["crank_length", "1", "m"]
    assert "tunable" in out
    assert "fixed at export" in out


def test_compare_writes_rows(command: Command, tmp_path: Path) -> None:
    scene = tmp_path / "short.toml"
    scene.write_text('model = "fourbar"\nstop_time = 0.1\n')
    rows_file = tmp_path / "rows.json"
    code, out, _ = command("compare", str(scene), "--repeats=1", "-o", str(tmp_path), "--json", str(rows_file))
    assert code == 0
    assert "adams-lu" not in out
    rows = json.loads(rows_file.read_text())
    assert len(rows) == 4 * len(drop_unlisted(SOLVERS))
    folder = tmp_path / "fourbar" / "short-compare"
    assert sorted(path.name for path in folder.iterdir()) == [
        "energy.png",
        "rows.json",
        "table.txt",
        "work_precision.png",
    ]
    assert (folder / "rows.json").read_text() == rows_file.read_text()
    assert {"solver", "rtol", "cpu_s", "spread", "error", "worst", "branch_jump", "status"} <= set(rows[0])
    assert all(row["status"] == "ok" for row in rows)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "fourbra"), "unknown model 'fourbra'"),
        (("run", "fourbar", "--set", "crank_length"), "allowed: NAME=VALUE"),
        (("run", "fourbar", "--set", "crank_length=-1"), "at least 0.001 m"),
        (("run", "fourbar", "--set", "ground_length=9"), "loop cannot close"),
        (("run", "fourbar", "--tolerance", "1e-20"), "1e-12"),
        (("run", "fourbar", "--solver", "rk4"), "solver is 'rk4'"),
        (("run", "no_such.toml"), "cannot be read"),
        (("export", "fourbar", "-o", "x.zip"), "must end in .fmu"),
        (("export", "fourbar", "-o", "/proc/x.fmu"), "'/proc/x.fmu' cannot be written"),
        (("compare", "fourbar", "--json", "/nowhere/x.json"), "'/nowhere/x.json' cannot be written"),
        (("compare", "fourbar", "--solver", "rk4"), "solver is 'rk4'"),
        (("compare", "fourbar", "--tolerance", "0.1"), "tolerance is 0.1; allowed: 1e-12 to 0.01"),
        (("compare", "fourbar", "--repeats", "0"), "repeats is 0; allowed: a whole number from 1 on"),
        (("compare", "fourbar", "--budget", "0"), "budget is 0.0 s; allowed: a number of seconds greater than zero"),
        (("compare", "fourbar", "--output", "crnk"), "model 'fourbar' has no output 'crnk'"),
        (("compare", "fourbar", "--resolution", "crank_mass=2"), "'crank_mass' is no resolution of model 'fourbar'"),
        (("compare", "fourbar", "--resolution", "coupler_modes"), "--resolution 'coupler_modes'; allowed: NAME=VALUE"),
        (("compare", "sheet", "--resolution", "nx=1,nz=5"), "parameter 'nx' of 'sheet' is 1.0; allowed"),
        (("compare", "fourbar", "--target", "-1"), "target is '-1'; allowed: a number above zero"),
        (("compare", "fourbar", "--target", "1 mi"), "target is '1 mi': unit is 'mi'; allowed"),
        (("compare", "fourbar", "--save", "x.toml"), "--save is given without --target"),
        (("compare", "fourbar", "--target", "1e-3", "--save", "x.txt"), "a file whose name ends in .toml"),
        (("cache", "warm", "nothing"), "unknown model 'nothing'"),
        (
            ("run", "fourbar", "--set", "coupler_mass=0", "--set", "crank_mass=0", "--set", "rocker_mass=0"),
            "no inertia",
        ),
        (("run", "fourbar", "--set", "start_angle=0", "--direct"), "branches of the motion cross"),
    ],
)
def test_mistakes_get_a_message_and_exit_code_2(command: Command, arguments: tuple[str, ...], message: str) -> None:
    code, _, err = command(*arguments)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_a_tolerance_that_is_not_run_is_reported(command: Command, tmp_path: Path) -> None:
    fine = ("run", "fourbar", "--direct", "--stop-time=0.1", "--plot=energy", "-o", str(tmp_path))
    assert "warning: The solver uses a tolerance of 1e-09 instead of 1e-12" in command(*fine, "--tolerance=1e-12")[1]
    assert "note:" not in command(*fine)[1]


def test_a_huge_number_is_refused_with_a_message(command: Command, tmp_path: Path) -> None:
    code, _, err = command("run", "fourbar", "--direct", "--set", "crank_length=1e200", "-o", str(tmp_path))
    assert code == 2
    assert err.startswith("mbfmu: ")


def test_python_m_is_the_command() -> None:
    found = subprocess.run((sys.executable, "-m", "mbfmu", "--version"), capture_output=True, text=True, check=True)
    assert found.stdout.startswith("mbfmu ")


def test_a_full_disk_is_reported(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_options: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(models, "command_models", full)
    monkeypatch.setattr("os.dup2", lambda *_: None)
    code, _, err = command("models")
    assert (code, err) == (2, "mbfmu: standard output: No space left on device\n")


def test_outputs_to_draw_are_chosen_by_pattern(command: Command, tmp_path: Path) -> None:
    told = ("run", "fourbar", "--direct", "--stop-time=0.1", "-o", str(tmp_path))
    code, _, err = command(*told, "--plot", "pivot.*", "--plot", "crnk.angle")
    assert (code, err) == (2, "mbfmu: no output 'crnk.angle'; did you mean 'crank.angle'? [invalid-value]\n")
    assert command(*told, "--plot", "pivot.*")[0] == 0


def test_models_and_scenes_are_listed(command: Command) -> None:
    code, out, _ = command("scenes")
    assert code == 0
    assert re.search(r"^fourbar/paper +hybrid +1e-4 +10 s +Kim and Kim's settings", out, re.MULTILINE)
    assert re.search(r"^sheet/default +ida +1e-5 +0\.5 s +default values$", out, re.MULTILINE)
    assert "governor" not in command("scenes", "fourbar")[1]
    out = command("models", "fourbar")[1]
    for title in ("Parameters", "Settings of the solver", "Outputs", "Scenes"):
        assert f"\n{title}\n" in out
    assert "at least 0.001 m" in out
    assert load_scene("fourbar/default").settings == load_scene("fourbar").settings
