"""FMUs are native if possible, and call Python otherwise; a native run compiles nothing if the runtime exists."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from zipfile import ZipFile

import pytest
from fmpy import read_model_description

from fmus.fourbar import FourBar
from mbfmu.fmi import native_fmu
from mbfmu.fmi.export import FmuKind, export, export_scene
from mbfmu.modeling.scene import load_scene
from mbfmu.modeling.settings import Settings
from mbfmu.native.contents import Contents
from mbfmu.native.runtime import COMPILERS, library
from mbfmu.native.targets import host
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError
from solvers.compiled.cache import (
    CompilationNeeded,
    cache_root,
    forbid_compilation,
    is_notified,
    notify_listeners,
    when_compiling,
)

EXPORT, RUNTIME = sys.modules[export_scene.__module__], sys.modules[library.__module__]

Command = Callable[..., tuple[int, str, str]]

NATIVE, COUPLED = "native FMU: ", "FMU that calls Python: "
OWN = '''
from dataclasses import dataclass
from mbfmu.mechanics import Function, Mechanism, Revolute, rod
from mbfmu.modeling import Model

@dataclass(frozen=True, kw_only=True)
class Waved(Model):
    """A bar that is waved as a function of time says."""

    def build(self):
        m = Mechanism()
        bar = m.body("bar", m.ground, Revolute(drive=Function("sin(t)")))
        m.body("tip", bar, Revolute(at=(1.0, 0.0, 0.0)), **rod(mass=1.0, length=1.0))
        m.output("bar.angle", bar.angle())
        return m
'''

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@contextmanager
def refused() -> Iterator[None]:
    """As where nothing has been compiled yet."""

    @contextmanager
    def refuse() -> Iterator[None]:
        raise CompilationNeeded
        yield

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(EXPORT, "forbid_compilation", refuse)
        yield


@pytest.fixture(scope="module")
def runtime() -> Path:
    return library(host(), Contents("adams", ("mechanisms", "equations", "steps")))


@pytest.mark.parametrize("scene", ["fourbar/paper", "fourbar", "governor", "pendulum"])
def test_a_scene_runs_as_a_native_fmu_to_the_bits_of_a_direct_run(
    scene: str, runtime: Path, command: Command, tmp_path: Path
):
    solver = [] if "fourbar" in scene else ["--solver=radau"]  # the four-bar's own: adams in the paper, else ida
    found = {}
    for way in ("direct", "fmu"):
        more = ["--direct"] if way == "direct" else []
        told = ("-v", "run", scene, *solver, "--stop-time=0.5", "-o", str(tmp_path / way), *more)
        code, out, _ = command(*told)
        assert code == 0
        assert (NATIVE in out) == (way == "fmu")
        (folder,) = (tmp_path / way).glob("*/*")
        found[way] = (folder / "outputs.csv").read_text()
        assert (folder / "motion.npz").is_file()  # what a repeat needs is compiled here
    assert found["fmu"] == found["direct"]
    loops = [line for line in out.splitlines() if line.startswith("  note: loop")]
    assert bool(loops) == ("fourbar" in scene)


def test_loops_are_reported_for_a_native_run_too(runtime: Path, command: Command, tmp_path: Path):
    _, out, _ = command("-v", "run", "fourbar", "--solver=adams", "--stop-time=0.1", "-o", str(tmp_path))
    assert NATIVE in out
    assert "  note: loop 'pivot': 3 of its 5 constraints are trivially satisfied (z, zx, zy) and removed [" in out


def test_what_a_native_fmu_logs_is_a_note_and_not_among_the_paths(runtime: Path, command: Command, tmp_path: Path):
    free = ("--set=nx=4", "--set=nz=3", "--set=support=free", "--set=start_spin=600", "--solver=adams")
    told = ("run", "sheet", *free, "--stop-time=0.01", "--interval=1e-3", "-o", str(tmp_path))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("mbfmu.cli.run.MAX_REPEATED_RUN_TIME", 0.0)  # a repeated run has other notes
        _, out, err = command(*told)
        _, quiet, _ = command("-q", *told)
    assert NATIVE in out
    assert re.search(
        r"^mbfmu: warning: the mesh is too coarse at t = .*: adjacent cells are rotated by up to \d\d deg",
        err,
        re.MULTILINE,
    )
    assert quiet == f"{tmp_path / 'sheet' / 'default-adams-1e-5-nx=4,nz=3,support=free,start_spin=600-2'}\n"


@pytest.fixture
def without_runtime(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which no runtime can be had."""
    monkeypatch.setattr(RUNTIME, "cached_library", lambda *_: None)
    monkeypatch.setattr(RUNTIME, "COMPILERS", ())
    monkeypatch.setattr(RUNTIME, "has_zig", lambda: False)
    monkeypatch.setattr(RUNTIME, "ZIG", "no-such-package-of-mbfmu @ file:///nowhere/zig.whl")


@pytest.mark.usefixtures("without_runtime")
def test_without_a_runtime_the_fmu_calls_python_and_one_line_gives_the_reason(command: Command, tmp_path: Path):
    why = f"nothing here compiles C for {host()}, and zig cannot be downloaded: pip reports "
    _, out, _ = command("run", "fourbar", "--solver=adams", "--stop-time=0.1", "-o", str(tmp_path))
    assert COUPLED in out
    assert out.count("[python-fmu]") == out.count(f"the run uses an FMU that calls Python: {why}") == 1
    path = tmp_path / "model.fmu"
    code, out, _ = command("export", "fourbar", "-o", str(path))
    assert (code, out.count("[python-fmu]"), out.count(f"requires mbfmu where it runs: {why}")) == (0, 1, 1)
    assert not read_model_description(str(path)).modelExchange
    code, out, _ = command("-q", "export", "fourbar", "-o", str(path))
    assert (code, out) == (0, f"{path}\n")
    with pytest.warns(UserWarning, match=r"this FMU calls Python, .* \[python-fmu\]$"):
        export(FourBar(), path)


@pytest.mark.usefixtures("without_runtime")
@pytest.mark.parametrize("requested", [("--native",), ("--fmi=3",), ("--platforms=x86_64-windows",)])
def test_an_fmu_that_cannot_call_python_is_not_replaced(requested: tuple[str], command: Command, tmp_path: Path):
    path = tmp_path / "model.fmu"
    code, _, err = command("export", "fourbar", *requested, "-o", str(path))
    assert (code, path.exists()) == (2, False)
    assert "nothing here compiles C for" in err
    assert err.rstrip().endswith("[no-runtime]")


def test_a_solver_that_is_not_native_calls_python(
    runtime: Path, command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(native_fmu, "refuse_solver", partial(native_fmu.refuse_solver, supported=("adams",)))
    times = ("--stop-time=1e-3", "--interval=1e-3")
    _, out, _ = command("run", "fourbar", "--solver=radau", *times, "-o", str(tmp_path))
    assert COUPLED in out
    assert "solver is 'radau'; allowed in a native FMU: " in out


def test_a_native_fmu_is_the_default_and_python_an_option(runtime: Path, command: Command, tmp_path: Path):
    path = tmp_path / "model.fmu"
    for options, native in (((), True), (("--native",), True), (("--python",), False)):
        code, _, err = command("export", "fourbar", "--solver=adams", *options, "-o", str(path))
        assert code == 0, err
        with ZipFile(path) as archive:
            assert ("resources/model.bin" in archive.namelist()) == native
            assert any(name.endswith(".py") for name in archive.namelist()) != native
    code, _, err = command("export", "fourbar", "--python", "--fmi=3", "-o", str(path))
    assert (code, "FMUs that call Python have FMI 2 and one platform" in err) == (2, True)
    assert export(FourBar(), path, Settings(solver="adams")) == path
    assert read_model_description(str(path)).modelExchange


def test_a_model_with_a_function_of_time_runs_as_machine_code(runtime: Path, command: Command, tmp_path: Path):
    (tmp_path / "waved.py").write_text(OWN)
    told = ("run", str(tmp_path / "waved.py"), "--solver=adams", "--stop-time=0.1", "-o", str(tmp_path))
    code, out, err = command(*told)
    assert code == 0, err
    assert NATIVE in out


def test_nothing_is_compiled_for_a_native_run(runtime: Path, tmp_path: Path):
    cache = tmp_path / "cache"
    kept = cache / "mbfmu" / runtime.relative_to(cache_root()).parent
    kept.mkdir(parents=True)
    shutil.copy(runtime, kept)
    told = [sys.executable, "-m", "mbfmu", "-v", "run", "fourbar", "--solver=adams", "--plot=energy", "-o", "results"]
    own = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(told, env=own, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert NATIVE in done.stdout
    assert "compil" not in done.stderr
    assert not list(cache.rglob("*.nb?"))
    assert not list(tmp_path.glob("results/**/motion.npz"))
    assert "use `mbfmu view fourbar`" in done.stdout


def test_compilation_is_reported_after_work_was_given_up():
    told: list[str] = []
    with when_compiling(lambda: told.append("compiling")):
        for _ in range(2):
            with pytest.raises(CompilationNeeded), forbid_compilation():
                notify_listeners()
        assert not told
        assert not is_notified()
        notify_listeners()
        notify_listeners()
        assert is_notified()
    assert told == ["compiling"]
    assert not is_notified()


def test_interpreted_kernels_make_the_bytes_of_compiled_ones(runtime: Path, tmp_path: Path):
    scene = load_scene("fourbar/paper").changed(model=FourBar(coupler_modes=2, start_angle=0.3))
    paths = tmp_path / "compiled.fmu", tmp_path / "interpreted.fmu"
    found: tuple[list[Diagnostic], list[Diagnostic]] = [], []
    export_scene(scene, paths[0], FmuKind.ONE_RUN, report=found[0].append)
    with refused():
        export_scene(scene, paths[1], FmuKind.ONE_RUN, report=found[1].append)
    assert found[0] == found[1]
    assert [d.text for d in found[0]] == [
        "loop 'pivot': 3 of its 5 constraints are trivially satisfied (z, zx, zy) and removed"
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_an_export_without_a_compiler_has_the_bytes_and_the_messages_of_another_one(runtime: Path, tmp_path: Path):
    scene, told = load_scene("fourbar").changed(solver="radau"), ([], [])
    paths = tmp_path / "compiled.fmu", tmp_path / "interpreted.fmu"
    export_scene(scene, paths[0], FmuKind.NATIVE, fmi=3, report=told[0].append)
    with refused():
        export_scene(scene, paths[1], FmuKind.NATIVE, fmi=3, report=told[1].append)
    assert told[0] == told[1]
    assert not [d.text for d in told[0] if d.code == "constant-parameter"]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_what_is_wrong_with_a_model_is_reported_without_a_compiler_too(runtime: Path, tmp_path: Path):
    scene = load_scene("fourbar").changed(solver="radau", model=FourBar(ground_length=9.0))
    for kind in (FmuKind.NATIVE, FmuKind.ONE_RUN):
        wrong = pytest.raises(UserError, match=r"^loop cannot close: constraint 'pivot.x' is violated by [^\n]*$")
        with refused(), wrong:
            export_scene(scene, tmp_path / "model.fmu", kind)
