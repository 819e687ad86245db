"""The command under odd conditions: closed output, names that are no text, signals, long input, exit codes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mbfmu.cli import view
from mbfmu.cli.common import run_part
from mbfmu.cli.study import place
from mbfmu.mechanics import Variable
from mbfmu.modeling.scene import load_scene
from mbfmu.session.result import Result
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import MAX_MESSAGE_LENGTH, UserError, shorten
from solvers import Statistics

MBFMU = (sys.executable, "-m", "mbfmu")


@pytest.mark.parametrize("closed", ["2>&-", ">&-", ">&- 2>&-"])
def test_closed_output_is_no_traceback(closed: str, tmp_path: Path) -> None:
    told = tmp_path / "told"
    shell = f'"{sys.executable}" -X faulthandler -m mbfmu scenes pendulum 2>"{told}" {closed}; echo $?'
    done = subprocess.run(["sh", "-c", shell], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0"
    assert "Traceback" not in done.stdout + done.stderr + told.read_text()


def test_a_file_name_that_is_no_text_is_printed_as_it_is(tmp_path: Path) -> None:
    out = os.fsencode(tmp_path) + b"/r\xff"
    done = subprocess.run(
        (*MBFMU, "-q", "run", "pendulum", "--direct", "--solver", "adams", "--stop-time", "0.02", "-o", out),
        capture_output=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    folder = Path(os.fsdecode(done.stdout.rstrip(b"\n")))
    assert folder.is_dir()
    assert os.fsencode(folder).startswith(out)


@pytest.mark.parametrize("name", ["model\udcff.py:Own", "folder\udcff/scene.toml"])
def test_what_a_scene_could_not_name_is_refused(name: str, tmp_path: Path, command: Callable[..., Any]) -> None:
    code, _, err = command("run", f"{tmp_path}/{name}")
    assert code == 2
    assert "is not valid UTF-8; rename the file or its folder" in err
    assert "\\udcff" in err


@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("value", ["1e300", "-1e290"])
def test_a_gravity_that_is_no_number_of_a_motion_is_refused_as_such(value: str, command: Callable[..., Any]) -> None:
    code, _, err = command("run", "pendulum", "--direct", "--solver", "adams", "--set", f"gravity={value}")
    assert code == 2
    assert "too large for floating-point numbers. Reduce gravity" in err
    assert "t0" not in err


def test_an_ended_command_leaves_no_unfinished_folder(tmp_path: Path) -> None:
    """SIGTERM in the middle of a run: the folder that was begun is removed, and the exit code is that of shells."""
    command = (
        *MBFMU,
        "run",
        "pendulum",
        "--direct",
        "--solver",
        "adams",
        "--stop-time",
        "1e4",
        "-o",
        str(tmp_path / "r"),
    )
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    end = time.monotonic() + 60.0
    while not list(tmp_path.glob("r/*/.unfinished-*")):
        assert time.monotonic() < end
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(signal.SIGTERM)
    assert process.wait(60.0) == 143
    assert list(tmp_path.iterdir()) == []


def test_messages_do_not_repeat_long_input(command: Callable[..., Any]) -> None:
    long = 50_000 * "x"
    for given in (("run", long), ("run", "fourbar", "--set", long), ("run", "fourbar", "--solver", long)):
        code, _, err = command(*given)
        assert code == 2
        assert len(err) < MAX_MESSAGE_LENGTH + 300
        assert "characters left out" in err
    with pytest.raises(SystemExit):
        command("run", "fourbar", "--tolerance", long)
    assert shorten("short") == "short"


@pytest.mark.parametrize(
    ("diagnostics", "code", "says"),
    [
        ((), 0, ""),
        ((Diagnostic.warning("coarse-mesh", "cells bend too far"),), 0, "mbfmu: warning: cells bend too far [coarse"),
        (
            (Diagnostic.warning("energy-balance", "energy is lost"),),
            1,
            "warning: energy is lost [energy-balance]",
        ),
        ((Diagnostic.error("collapsed-step", "it stops"),), 1, "mbfmu: error: it stops [collapsed-step]"),
    ],
)
def test_view_ends_with_the_code_of_run(
    diagnostics: tuple[Diagnostic, ...],
    code: int,
    says: str,
    command: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    variables = (Variable("x", "m", ""),)
    result = Result(np.zeros(1), np.zeros((1, 1)), variables, Statistics(), 0.0, diagnostics=diagnostics)
    motion = SimpleNamespace()
    monkeypatch.setattr(view, "load", lambda _: (motion, None, [result], Path("page.html")))
    monkeypatch.setattr(view, "write_page", lambda *_: Path("page.html"))
    found, _, err = command("view", "feeder")
    assert found == code
    assert (says in err) if says else err == ""


def test_the_name_of_a_result_has_the_values_that_were_set() -> None:
    scene = load_scene("pendulum")
    plain = run_part(scene)
    assert run_part(scene, ["crank_mass=2"]) == f"{plain}-crank_mass=2"
    assert run_part(scene, [" crank_mass = 2", "gravity=1/3"]) == f"{plain}-crank_mass=2,gravity=1_3"
    assert len(run_part(scene, [f"a{k}=1" for k in range(99)])) < 200


def test_a_study_has_a_separate_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results" / "governor" / "default-sweep-spindle_speed").mkdir(parents=True)
    options = SimpleNamespace(output=None, study=Path("governor.toml"), resume=False)
    assert place(options) == Path("results/governor-study")  # type: ignore[arg-type]
    options.resume = True
    with pytest.raises(UserError, match="--resume: folder"):
        place(options)  # type: ignore[arg-type]
    (tmp_path / "results" / "governor-study").mkdir()
    (tmp_path / "results" / "governor-study" / "study.json").write_text("{}")
    assert place(options) == Path("results/governor-study")  # type: ignore[arg-type]
    options.resume = False
    assert place(options) == Path("results/governor-study-2")  # type: ignore[arg-type]
