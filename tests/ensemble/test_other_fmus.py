"""Studies of FMUs of other tools: one in C that is built here."""

from __future__ import annotations

import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import psutil
import pytest

import mbfmu as mb
from mbfmu.ensemble.definition import define
from mbfmu.ensemble.worker import STATUS_FAILED, STATUS_OK, STATUS_SUSPECT, forget_job, run_batch
from mbfmu.util.errors import UserError

pytestmark = pytest.mark.skipif(
    not shutil.which("cc") or sys.platform != "linux" or platform.machine() != "x86_64",
    reason="needs a C compiler, and linux on x86_64",
)

DESCRIBED = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="oscillator" guid="{1}">
 <CoSimulation modelIdentifier="oscillator" canHandleVariableCommunicationStepSize="true"/>
 <DefaultExperiment startTime="0" stopTime="1" stepSize="0.01"/>
 <ModelVariables>
  <ScalarVariable name="x" valueReference="0" causality="output"><Real/></ScalarVariable>
  <ScalarVariable name="v" valueReference="1" causality="output"><Real/></ScalarVariable>
  <ScalarVariable name="k" valueReference="2" causality="parameter" variability="fixed">
   <Real start="1"/>
  </ScalarVariable>
  <ScalarVariable name="n" valueReference="3" causality="parameter" variability="fixed">
   <Integer start="1"/>
  </ScalarVariable>
  <ScalarVariable name="run" valueReference="4" causality="parameter" variability="fixed">
   <Real start="1"/>
  </ScalarVariable>
 </ModelVariables>
 <ModelStructure><Outputs><Unknown index="1"/><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("oscillator")
    library = folder / "oscillator.so"
    source = Path(__file__).with_name("oscillator.c")
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
    path = folder / "oscillator.fmu"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("modelDescription.xml", DESCRIBED)
        file.write(library, "binaries/linux64/oscillator.so")
    return path


def test_a_thousand_runs_leave_nothing_behind(oscillator: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    study = define({
        "fmu": str(oscillator), "vary": {"k": {"from": 1.0, "to": 4.0}}, "count": 1000,
        "measure": {"end": "end x", "fastest": "largest v"},
    })  # fmt: skip
    job, points = study.job(), list(enumerate(study.points()))
    process, found, sizes = psutil.Process(), [], []
    for k in range(0, 1000, 100):
        found += run_batch(job, points[k : k + 100])
        sizes.append((process.memory_info().rss, process.num_fds(), len(list(tmp_path.iterdir()))))
    k = np.array([point["k"] for _, point in points])
    assert np.array([o.measures[0] for o in found]) == pytest.approx(np.cos(np.sqrt(k)), abs=1e-6)
    memory, handles, files = (np.array(column) for column in zip(*sizes, strict=True))
    assert memory[-1] - memory[2] < 4e6
    assert handles[-1] == handles[1]
    assert files[-1] == 1
    forget_job(job)
    assert not list(tmp_path.iterdir())


def test_what_fails_is_reported(oscillator: Path):
    study = define({"fmu": str(oscillator), "vary": {"k": [1.0, -1.0, 1e7]}, "measure": {"end": "end x"}})
    job = study.job()
    good, bad, discarded = run_batch(job, list(enumerate(study.points())))
    assert discarded.status == STATUS_FAILED
    assert "ended at 0 s, before 1 s" in discarded.message
    assert good.measures == pytest.approx((np.cos(1.0),), abs=1e-6)
    assert bad.status == STATUS_FAILED
    assert "fmi2ExitInitializationMode" in bad.message
    forget_job(job)


def test_wrong_arguments_are_reported(oscillator: Path, tmp_path: Path):
    told = {"fmu": str(oscillator), "vary": {"k": [1.0]}, "measure": {"end": "end x"}}
    for change, text in (
        ({"vary": {"q": [1.0]}}, "no parameter or input 'q'"), ({"measure": {"end": "end y"}}, "no output 'y'"),
        ({"measure": {"f": "frequency 1"}}, "no steady states"), ({"vary": {"k": ["soft"]}}, "'soft'"),
        ({"vary": {"k": [True]}}, "finite number"), ({"fixed": {"n": 1.5}}, "whole number"),
        ({"stop_time": "a"}, "'a'"), ({"fmu": "."}, "ends in"),
        ({"vary": {"stop_time": [0.0]}}, "greater than zero"), ({"output_interval": 0.0}, "greater than zero"),
        ({"with": "native"}, "leave out one"), ({"vary": {"run": [1.0]}}, "column"),
        ({"fmu": str(tmp_path / "none.fmu")}, "cannot be read"),
    ):  # fmt: skip
        with pytest.raises(UserError, match=text):
            define({**told, **change})
    (tmp_path / "odd.fmu").write_text("no zip")
    with pytest.raises(UserError, match="is not an FMU"):
        define({**told, "fmu": str(tmp_path / "odd.fmu")})


def test_an_output_that_is_no_number_makes_its_run_suspect(oscillator: Path):
    study = define({"fmu": str(oscillator), "vary": {"k": [1.0, 123.0]}, "measure": {"end": "end x"}})
    job = study.job()
    good, lost = run_batch(job, list(enumerate(study.points())))
    assert (good.status, good.message) == (STATUS_OK, "")
    assert lost.status == STATUS_SUSPECT
    assert lost.message.startswith("output ")
    assert "is nan at t = 0.5" in lost.message
    assert "not a finite number" in lost.message
    forget_job(job)


def test_a_process_ends_if_a_run_does_not_return(oscillator: Path, tmp_path: Path):
    """The run within its limit is made, the one that hangs ends the process by a signal."""
    script = tmp_path / "script.py"
    script.write_text(
        "from mbfmu.ensemble.definition import define\nfrom mbfmu.ensemble.worker import run_batch\n"
        f"study = define({{'fmu': {str(oscillator)!r}, 'vary': {{'k': [1.0, 321.0]}}, 'measure': {{'end': 'end x'}}, "
        "'time_limit': 1.0})\n"
        "for k, point in enumerate(study.points()):\n"
        "    print(run_batch(study.job(), [(k, point)])[0].status, flush=True)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False, timeout=120.0)
    assert done.stdout == "ok\n"
    assert done.returncode == -signal.SIGKILL


@pytest.mark.campaign
def test_a_run_that_does_not_return_fails_after_its_time_limit(oscillator: Path, tmp_path: Path):
    study = mb.study(
        str(oscillator), {"k": [1.0, 321.0, 4.0]}, {"end": "end x"}, time_limit=1.0, folder=tmp_path / "a", workers=1
    )
    assert [row["status"] for row in study.rows] == [STATUS_OK, STATUS_FAILED, STATUS_OK]
    assert "longer than the time_limit, 1 s" in study.rows[1]["message"]
    assert study.column("end")[[0, 2]] == pytest.approx(np.cos([1.0, 2.0]), abs=1e-5)


@pytest.mark.parametrize("limit", [0, -1.0, float("nan"), "60", True, 1e9])
def test_a_time_limit_is_a_number_of_seconds(oscillator: Path, limit: object):
    with pytest.raises(UserError, match=r"time_limit is .*; allowed: a number of seconds"):
        define({"fmu": str(oscillator), "vary": {"k": [1.0]}, "measure": {"end": "end x"}, "time_limit": limit})
