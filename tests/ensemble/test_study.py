"""Studies from their files to their tables: by a pool, by a cluster that is there, killed and resumed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
import pytest

import mbfmu as mb
from mbfmu.cli import main
from mbfmu.ensemble.definition import define
from mbfmu.ensemble.engine import Workers
from mbfmu.ensemble.records import HISTORIES_FOLDER, PARTS_FOLDER, TABLE_FILE, Records
from mbfmu.ensemble.worker import STATUS_FAILED, STATUS_OK, Outcome, forget_job, run_batch
from mbfmu.util.errors import UserError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")

FOURBAR: dict[str, Any] = {"stop_time": 0.5, "vary": {"crank_length": "1 m +- 5 mm", "gravity": [1.62, 9.81]}}
FASTEST = {"fastest": "largest crank.rate"}


class Cluster(NamedTuple):
    """A scheduler and two workers, each a process that was started by hand."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    folder = tmp_path_factory.mktemp("cluster")
    told, log = folder / "scheduler.json", (folder / "log").open("wb")
    dask = [sys.executable, "-m", "dask"]
    quiet: dict[str, Any] = {"stdout": log, "stderr": log, "cwd": folder}
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(told), "--no-dashboard"],
        **quiet,
    )
    worker = [*dask, "worker", "--scheduler-file", str(told), "--nthreads", "1", "--no-dashboard"]
    workers = [subprocess.Popen([*worker, "--local-directory", str(folder / str(k))], **quiet) for k in (0, 1)]
    end = time.monotonic() + 60.0
    while not told.exists() and time.monotonic() < end:
        time.sleep(0.1)
    yield Cluster(json.loads(told.read_text())["address"], scheduler, workers)
    for process in (*workers, scheduler):
        process.terminate()
    for process in (*workers, scheduler):
        with suppress(subprocess.TimeoutExpired):
            process.wait(20.0)
        process.kill()
    log.close()


def bits(study: mb.Study) -> list[tuple[Any, ...]]:
    """What two studies that are alike have in common, bit for bit."""
    left_out = ("seconds",)
    return [tuple(repr(v) for k, v in row.items() if k not in left_out) for row in study.rows]


def test_rows_are_the_runs_that_are_made_by_hand(cluster: Cluster, tmp_path: Path):
    study = mb.study(
        "fourbar", FOURBAR["vary"], FASTEST, stop_time=0.5, count=6, scheduler=cluster.address, folder=tmp_path / "a",
        keep=["crank.angle"],
    )  # fmt: skip
    assert [row["run"] for row in study.rows] == list(range(12))
    histories = study.trajectories()
    for row in study.rows:
        model = mb.find("fourbar")(crank_length=row["crank_length"], gravity=row["gravity"])
        result = mb.simulate(model, 0.5)
        assert row["status"] == STATUS_OK
        assert row["fastest"] == result["crank.rate"].max()
        assert row["energy_error"] == np.abs(result["energy_error"]).max()
        assert np.array_equal(histories.loc[row["run"]]["crank.angle"], result["crank.angle"])
    frame = study.to_dataframe()
    assert frame.attrs["units"]["fastest"] == "rad/s"
    assert len(frame) == 12
    again = mb.load_study(tmp_path / "a")
    assert bits(again) == bits(study)


def test_settings_inputs_and_stop_times_vary(cluster: Cluster, tmp_path: Path):
    @dataclass(frozen=True, kw_only=True)
    class Driven(mb.Model):
        """A rod that a torque turns; of no module that a worker could import."""

        mass: float = mb.parameter(1.0, unit="kg", min=0.1)

        def build(self) -> mb.Mechanism:
            m = mb.Mechanism(gravity=(0.0, 0.0, 0.0))
            arm = m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=self.mass, length=1.0))
            m.force("motor", mb.JointForce(magnitude=mb.Input(name="torque", unit="N.m")), arm)
            m.output("angle", arm.angle(), "angle")
            return m

    study = mb.study(
        Driven(), {"mass": [1.0, 2.0], "torque": [0.5, 1.0], "stop_time": [1.0, 2.0], "solver": ["adams", "radau"]},
        {"angle": "end angle", "cubed": lambda result: result["angle"][-1] ** 3}, scheduler=cluster.address,
        fixed={"tolerance": 1e-8},
        folder=tmp_path / "a",
    )  # fmt: skip
    assert len(study.rows) == 16
    for row in study.rows:
        exact = 0.5 * row["torque"] / (row["mass"] / 3.0) * row["stop_time"] ** 2
        assert row["angle"] == pytest.approx(exact, rel=1e-7)
        assert row["cubed"] == row["angle"] ** 3


def test_a_user_s_file_travels_with_what_it_imports(cluster: Cluster, tmp_path: Path):
    (tmp_path / "sizes.py").write_text("LONG = 2.0\n")
    (tmp_path / "own.py").write_text(
        "from dataclasses import dataclass\nimport mbfmu as mb\nimport sizes\n"
        "@dataclass(frozen=True, kw_only=True)\nclass Own(mb.Model):\n"
        "    '''A rod.'''\n    mass: float = mb.parameter(1.0, unit='kg', min=0.1)\n"
        "    def build(self):\n        m = mb.Mechanism(gravity=(0, -9.81, 0))\n"
        "        b = m.body('bar', m.ground, mb.Revolute(start=0.1), **mb.rod(mass=self.mass, length=sizes.LONG))\n"
        "        m.output('angle', b.angle(), 'angle')\n        return m\n"
    )
    (tmp_path / "measures.py").write_text("def end(result):\n    return result['angle'][-1]\n")
    (tmp_path / "study.toml").write_text(
        'scene = "own.py:Own"\nstop_time = 0.2\n[vary]\nmass = [1.0, 2.0]\n[measure]\n'
        'own = "measures.py:end"\nshipped = "end angle"\n'
    )
    out = tmp_path / "out"
    assert main(["-q", "study", str(tmp_path / "study.toml"), "-o", str(out), "--scheduler", cluster.address]) == 0
    study = mb.load_study(out)
    assert [row["status"] for row in study.rows] == [STATUS_OK, STATUS_OK]
    assert study.column("own").tolist() == study.column("shipped").tolist()
    assert (out / "own-over.png").stat().st_size > 5000


def test_the_command_replaces_inputs_in_all_runs(
    cluster: Cluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Closed form of a mass under the force 6 t: x = t^3 / m."""
    cart = Path(__file__).parent.parent / "test_replaced_inputs.py"
    (tmp_path / "study.toml").write_text(f'scene = "{cart}:Cart"\n[vary]\nmass = [2.0, 4.0]\n[measure]\nx = "end x"\n')
    where = ["-o", str(tmp_path / "out"), "--scheduler", cluster.address]
    assert main(["study", str(tmp_path / "study.toml"), "--input", "force=6*t", *where]) == 0
    assert "  input force: 6*t\n" in capsys.readouterr().out
    study = mb.load_study(tmp_path / "out")
    assert study.replaced_inputs == ("input force: 6*t",)
    assert study.column("x").tolist() == pytest.approx([0.5, 0.25], rel=1e-4)


def test_a_run_that_fails_is_a_row_with_its_reason(cluster: Cluster, tmp_path: Path):
    def build_fails_late(result: mb.Result) -> float:
        raise RuntimeError("no")

    study = mb.study(
        "fourbar", {"crank_length": [1.0, 4.0], "gravity": {"from": -1.0, "to": 1.0, "count": 2}},
        FASTEST | {"own": build_fails_late}, stop_time=0.1, scheduler=cluster.address, folder=tmp_path / "a",
    )  # fmt: skip
    assert study.count(STATUS_FAILED) == 4
    told = [row["message"] for row in study.rows]
    assert all("'own' fails with RuntimeError: no" in text for text in told[:2])
    assert all("cannot close" in text for text in told[2:])
    assert np.isnan(study.column("fastest")).all()


def test_what_ends_its_process_ends_its_run_alone(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\nimport mbfmu as mb\n"
        "def odd(result):\n    end = result['crank.angle'][-1]\n"
        "    if end > 0.19:\n        sys.exit(4)\n    if end > 0.185:\n        os.abort()\n    return end\n"
        "if __name__ == '__main__':\n"
        "    vary = {'start_angle': [0.1, 0.15, 0.16, 0.188, 0.17, 0.2]}\n"
        "    study = mb.study('fourbar', vary, {'a': odd}, stop_time=0.01, fixed={'gravity': 0.0}, "
        f"folder={str(tmp_path / 'out')!r}, workers=2)\n"
        "    print([row['status'] for row in study.rows], study.rows[3]['message'], study.rows[5]['message'])\n"
    )
    told = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True, timeout=300.0)
    assert told.stdout.startswith(
        "['ok', 'ok', 'ok', 'failed', 'ok', 'failed'] the process of this run ended unexpectedly"
    )
    assert "SystemExit: 4" in told.stdout


def test_an_fmu_is_run_as_the_model_is(cluster: Cluster, tmp_path: Path):
    vary = {"crank_mass": [1.0, 2.0], "gravity": [9.81]}
    fast = {"fastest": "largest crank.rate", "end": "end crank.angle"}
    told: dict[str, Any] = {"stop_time": 0.5, "scheduler": cluster.address}
    direct = mb.study("fourbar", vary, fast, folder=tmp_path / "a", **told)
    path = mb.export(mb.find("fourbar")(), tmp_path / "fourbar.fmu", stop_time=0.5, native=False)
    for name, given, how in (("b", "fourbar", {"runs": "fmu"}), ("c", path, {})):
        fmu = mb.study(given, vary, fast, folder=tmp_path / name, **told, **how)
        assert fmu.column("end").tolist() == pytest.approx(direct.column("end").tolist(), rel=1e-9)
        assert [row["status"] for row in fmu.rows] == [STATUS_OK, STATUS_OK]


def test_what_is_aimed_at_is_found(cluster: Cluster, tmp_path: Path):
    told: dict[str, Any] = {"scheduler": cluster.address}
    vary, height = {"spindle_speed": {"from": 8.0, "to": 14.0}}, {"height": "equilibrium collar.height"}
    wanted = mb.equilibrium(mb.find("governor")(spindle_speed=11.0)).outputs["collar.height"]
    near = mb.study(
        "governor", vary, height, aim={"target": {"height": wanted}, "most": 60}, folder=tmp_path / "a", **told
    )
    assert near.found is not None
    assert near.found.point["spindle_speed"] == pytest.approx(11.0, rel=1e-6)
    assert near.found.at_ends == ()
    most = mb.study("governor", vary, height, aim={"maximize": "height", "most": 60}, folder=tmp_path / "b", **told)
    assert most.found is not None
    assert -most.found.cost == pytest.approx(max(most.column("height")))


SCRIPT = """
import signal, sys
import mbfmu.ensemble.engine as engine, mbfmu.ensemble.records as records
from mbfmu.cli import main
records.WRITE_INTERVAL, engine.BATCH_TIME = 0.1, 0.1
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell has it ignored by what it runs in the background
if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(scope="module")
def undisturbed(cluster: Cluster, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, mb.Study]:
    """A study, as its file and as it is where nothing disturbs it."""
    path = tmp_path_factory.mktemp("study") / "s.toml"
    path.write_text(
        'scene = "fourbar"\nstop_time = 2.0\ncount = 500\n[vary]\ncrank_length = "1 m +- 5 mm"\n'
        '[measure]\nfastest = "largest crank.rate"\n'
    )
    return path, mb.study(path, folder=path.parent / "whole", scheduler=cluster.address)


def written(folder: Path) -> int:
    """How many parts of a study are there."""
    return len(list((folder / PARTS_FOLDER).glob("*.parquet")))


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_study_that_is_killed_goes_on_where_it_was(
    cluster: Cluster, undisturbed: tuple[Path, mb.Study], tmp_path: Path, how: signal.Signals
):
    path, whole = undisturbed
    script, out = tmp_path / "script.py", tmp_path / "out"
    script.write_text(SCRIPT)
    told = ["study", str(path), "--scheduler", cluster.address, "-o", str(out)]
    process = subprocess.Popen([sys.executable, str(script), *told], stderr=subprocess.PIPE, text=True)
    while written(out) < 2 and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(how)
    said = process.communicate()[1]
    if how is signal.SIGINT:
        assert process.returncode == 130
        assert "--resume" in said
        assert "Traceback" not in said
    before = {row["key"]: row["seconds"] for row in mb.load_study(out).rows}
    assert 0 < len(before) < 500
    assert main(["-q", *told, "--resume"]) == 0
    resumed = mb.load_study(out)
    assert bits(resumed) == bits(whole)
    after = {row["key"]: row["seconds"] for row in resumed.rows}
    assert after | before == after  # what was there was not made again


def test_a_worker_that_is_killed_loses_nothing(cluster: Cluster, tmp_path: Path):
    done: list[int] = []
    killed: list[int] = []

    def watch(count: int, total: int, failed: int) -> None:
        done.append(count)
        if count > 40 and not killed:  # the process below the nanny, which starts another one
            child = psutil.Process(cluster.workers[0].pid).children(recursive=True)[-1]
            killed.append(child.pid)
            child.kill()

    study = mb.study(
        "fourbar", {"crank_length": "1 m +- 5 mm"}, FASTEST, stop_time=2.0, count=400, scheduler=cluster.address,
        folder=tmp_path / "a", progress=watch,
    )  # fmt: skip
    assert killed
    assert study.count(STATUS_OK) == 400
    assert done[-1] == 400


def test_two_studies_at_once(cluster: Cluster, tmp_path: Path):
    found: dict[str, mb.Study] = {}

    def make(name: str, gravity: float) -> None:
        found[name] = mb.study(
            "fourbar", {"crank_length": "1 m +- 5 mm", "gravity": [gravity]}, FASTEST, stop_time=0.2, count=20,
            scheduler=cluster.address, folder=tmp_path / name,
        )  # fmt: skip

    threads = [threading.Thread(target=make, args=own) for own in (("a", 1.62), ("b", 9.81))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [found[name].count(STATUS_OK) for name in "ab"] == [20, 20]
    assert set(found["a"].column("gravity")) == {1.62}
    assert found["a"].column("fastest").tolist() != found["b"].column("fastest").tolist()


def test_a_separate_pool(tmp_path: Path):
    script = tmp_path / "script.py"
    script.write_text(
        "import mbfmu as mb\nif __name__ == '__main__':\n"
        "    print(mb.study('fourbar', {'gravity': [1.62, 3.7, 9.81]}, {'a': 'end crank.angle'}, stop_time=0.1, "
        f"folder={str(tmp_path / 'out')!r}, workers=1))\n"
    )
    told = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True, timeout=300.0)
    assert told.stdout.strip() == "<Study of fourbar/default: 3 runs, 3 ok>"
    assert (tmp_path / "out" / TABLE_FILE).exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"vary": {"crank_lenght": [1.0]}}, "did you mean 'crank_length'"),
        ({"vary": {}}, "at least one parameter"),
        ({"fixed": {"gravity": 1.0}}, "fixed and varies"),
        ({"fixed": {"grafity": 1.0}}, "did you mean 'gravity'"),
        ({"fixed": {"crank_mass": -1.0}}, "'crank_mass'"),
        ({"vary": {"crank_length": [-1.0]}}, "'crank_length'"),
        ({"vary": {"solver": ["euler"]}}, "euler"),
        ({"vary": {"crank_length": {"from": 2.0, "to": 1.0}}}, "to a larger number"),
        ({"measure": {"a": "largest crank.rat"}}, "did you mean 'crank.rate'"),
        ({"measure": {"status": "largest crank.rate"}}, "'status'"),
        ({"measure": {"gravity": "largest crank.rate"}}, "'gravity'"),
        ({"measure": {"a": "nowhere.py:f"}}, "nowhere.py"),
        ({"keep": ["crank"]}, "'crank'"),
        ({"keep": "crank.rate"}, "a list"),
        ({"scene": "threebar"}, "threebar"),
        ({"fmu": "nowhere.fmu"}, "both scene and fmu, or neither"),
        ({"with": "matlab"}, "matlab"),
        ({"count": "many"}, "'many'"),
        ({"samples": 3}, "'samples'"),
        ({"stop_time": -1.0}, "stop_time"),
        ({"aim": {"minimize": "slowest"}}, "'slowest'"),
        ({"aim": {"minimize": "fastest"}}, "is a list"),
        ({"aim": {}}, "nothing to aim at"),
        ({"vary": {"coupler_modes": {"from": 0.0, "to": 2.0}}}, "a whole number"),
        ({"vary": {"solver": {"from": 0.0, "to": 2.0}}}, "solver"),
        ({"measure": {"a/b": "largest crank.rate"}}, "that is not a valid file name"),
        ({"aim": {"target": {"fastest": "high"}}}, "finite"),
        ({"aim": {"minimize": ["fastest"]}}, "no measure"),
        ({"vary": {"gravity": {"from": 1.0, "to": 2.0}}, "aim": {"minimize": "fastest"}, "sampling": "latin"}, "aim"),
        (
            {
                "vary": {"coupler_modes": {"distribution": "randint", "low": 0, "high": 4}},
                "aim": {"minimize": "fastest"},
            },
            "is a whole number",
        ),
        ({"keep": 3}, "a list"),
        ({"measure": {"a" * 61: "largest crank.rate"}}, "at most 60 letters"),
        ({"fixed": {"crank.torque": [1.0]}}, "'crank.torque'"),
        ({"fixed": {"crank.torque": float("inf")}}, "'crank.torque'"),
        ({"vary": {"gravity": [10**400]}}, "finite"),
    ],
)
def test_what_is_wrong_with_a_study_is_reported(change: dict[str, Any], told: str):
    with pytest.raises(UserError, match=told):
        define({"scene": "fourbar", **FOURBAR, "measure": FASTEST, **change})


def test_folders_are_never_written_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cluster: Cluster):
    known: dict[str, Any] = {"stop_time": 0.1, "scheduler": cluster.address}
    out = tmp_path / "out"
    mb.study("fourbar", {"gravity": [1.0]}, FASTEST, folder=out, **known)
    before = (out / TABLE_FILE).read_bytes()
    with pytest.raises(UserError, match="--resume"):
        mb.study("fourbar", {"gravity": [1.0]}, FASTEST, folder=out, **known)
    with pytest.raises(UserError, match="another study"):
        mb.study("fourbar", {"gravity": [1.0]}, {"other": "end crank.rate"}, folder=out, resume=True, **known)
    with pytest.raises(UserError, match="contains no study"):
        mb.study("fourbar", {"gravity": [1.0]}, FASTEST, folder=tmp_path / "none", resume=True, **known)
    assert (out / TABLE_FILE).read_bytes() == before
    more = mb.study("fourbar", {"gravity": [1.0, 2.0]}, FASTEST, folder=out, resume=True, **known)  # grows
    assert len(more.rows) == 2
    fewer = mb.study("fourbar", {"gravity": [2.0]}, FASTEST, folder=out, resume=True, **known)
    assert [row["gravity"] for row in fewer.rows] == [2.0]
    again = mb.study("fourbar", {"gravity": [1.0, 2.0]}, FASTEST, folder=out, resume=True, **known)
    assert [row["seconds"] for row in again.rows] == [row["seconds"] for row in more.rows]  # none was made again
    full = os.strerror(28)

    def no_space(*_: Any) -> None:
        raise OSError(28, full)

    monkeypatch.setattr("pyarrow.parquet.write_table", no_space)
    with pytest.raises(UserError, match=f"cannot be written: {full}"):
        mb.study("fourbar", {"gravity": [1.0]}, FASTEST, folder=tmp_path / "b", **known)


def test_one_process_has_a_folder(tmp_path: Path):
    given = {"scene": "fourbar", **FOURBAR, "measure": FASTEST}
    first, second = (Records(tmp_path / "a", define(given)) for _ in range(2))
    first.begin(resume=False)
    with pytest.raises(UserError, match="another process"):
        second.begin(resume=True)
    first.close()
    second.close()
    second.begin(resume=True)
    second.close()


def kept(folder: Path, measure: str) -> Records:
    """A folder with a single run and its history."""
    records = Records(folder, define({"scene": "fourbar", **FOURBAR, "measure": {measure: "end crank.rate"},
                                      "keep": ["crank.rate"]}))  # fmt: skip
    records.begin(resume=False)
    records.add([Outcome(0, (1.0,), STATUS_OK, "", 0.0, 0.1, (np.zeros(2), np.zeros((2, 1))))], [{"gravity": 1.0}])
    records.close()
    return records


def test_files_that_are_not_of_the_study_are_reported(tmp_path: Path):
    own = kept(tmp_path / "a", "end")
    kept(tmp_path / "b", "other")
    (part,) = (tmp_path / "a" / PARTS_FOLDER).iterdir()
    part.with_name("twice.parquet").write_bytes(part.read_bytes())
    assert len(mb.load_study(tmp_path / "a").rows) == 1
    (odd,) = (tmp_path / "b" / PARTS_FOLDER).iterdir()
    part.with_name("odd.parquet").write_bytes(odd.read_bytes())
    with pytest.raises(UserError, match="belongs to another study"):
        mb.load_study(tmp_path / "a")
    part.with_name("odd.parquet").write_bytes(part.read_bytes()[:100])
    with pytest.raises(UserError, match="repeats its runs"):
        own.begin(resume=True)
    own.close()


def test_a_run_whose_history_is_lost_is_made_again(tmp_path: Path):
    records = kept(tmp_path, "end")
    for lost in (False, True):
        if lost:
            for file in (tmp_path / HISTORIES_FOLDER).iterdir():
                file.unlink()
        again = Records(tmp_path, records.definition)
        again.begin(resume=True)
        assert bool(again.done) is not lost
        again.close()


def test_a_missing_worker_is_reported(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch):
    class Late:
        looks = 0

        def has_ready(self) -> bool:
            self.looks += 1
            return self.looks > 5

    monkeypatch.setattr("mbfmu.ensemble.engine.WORKER_CHECK_INTERVAL", 0.0)
    monkeypatch.setattr(Workers, "_workers", lambda _: 0)
    workers = Workers.__new__(Workers)
    workers._where = "scheduler 'tcp://here:1'"
    workers._wait(Late(), {"a": [1, 2]})
    assert [r.getMessage() for r in caplog.records] == [
        "scheduler 'tcp://here:1' has no worker: 2 runs wait for one; start one, or end this and resume"
    ]


def test_a_batch_that_takes_longer_comes_back(monkeypatch: pytest.MonkeyPatch):
    job = define({"scene": "fourbar", **FOURBAR, "measure": FASTEST, "stop_time": 0.01}).job()
    points = [(k, {"gravity": 1.0}) for k in range(3)]
    assert len(run_batch(job, points, max_time=0.0)) == 1
    assert len(run_batch(job, points)) == 3
    forget_job(job)


def test_an_invalid_address_is_reported():
    for address in ("abc", "http://host:8786", "tcp://"):
        with pytest.raises(UserError, match="such as 'tcp://host:8786'"):
            Workers(address)


def test_a_scheduler_that_is_not_there_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("mbfmu.ensemble.engine.SCHEDULER_TIMEOUT", 0.5)
    with pytest.raises(UserError, match=r"'tcp://127.0.0.1:9' does not answer"):
        mb.study(
            "fourbar", {"gravity": [1.0, 2.0]}, FASTEST, stop_time=0.1, scheduler="tcp://127.0.0.1:9",
            folder=tmp_path / "a",
        )  # fmt: skip


def test_a_worker_of_another_version_is_reported(monkeypatch: pytest.MonkeyPatch):
    job = define({"scene": "fourbar", **FOURBAR, "measure": FASTEST}).job()
    monkeypatch.setattr(mb, "__version__", "0.0.1")
    with pytest.raises(UserError, match=r"a worker has mbfmu 0\.0\.1"):
        run_batch(job, [(0, {"gravity": 1.0})])
    forget_job(job)


def test_without_dask_a_message_names_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UserError, match=r"pip install 'mbfmu\[study\]'"):
        mb.study("fourbar", {"gravity": [1.0, 2.0]}, FASTEST, stop_time=0.1, folder=tmp_path / "a")
