"""The front of FMUs that call Python: any folder, any address, and a reason if there is no suitable Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from collections.abc import Mapping
from ctypes import byref, c_size_t, c_void_p
from pathlib import Path
from typing import NamedTuple

import pytest
from binding import ERROR, OK, Binary
from fmpy import read_model_description

import mbfmu
from fmus.fourbar import FourBar
from mbfmu.fmi import export, python_front
from mbfmu.fmi.guards import WRAPPER
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings
from mbfmu.util.errors import UserError

FOLDERS = (
    "plain", "with space", "ü", "'", "#", "%20", "%", "(1)", "a+b&c=d", "日本", "q?x", "tab\tnew\nline", "[x];,:@!$*",
)  # fmt: skip
SINGLE_FOLDERS = [pytest.param(name, marks=pytest.mark.campaign) for name in FOLDERS[1:]]
ADDRESSES = ("file:{}", "file://{}", "file://localhost{}", "{}")  # of an encoded path; the last is the path itself
INSTANTIATE = 12  # of host.c: there is no instance
COMPILER = next(filter(None, map(shutil.which, COMPILERS)), None)
LIBPYTHON = Path(sysconfig.get_config_var("LIBDIR") or "", sysconfig.get_config_var("INSTSONAME") or "")
PLACES = [place for place in sys.path if place]  # as tests are collected: before any FMU adds to them

pytestmark = pytest.mark.skipif(
    COMPILER is None or host() != python_front.PLATFORM or LIBPYTHON.suffix == ".a" or not LIBPYTHON.is_file(),
    reason="needs a C compiler, x86-64 Linux and a shared libpython",
)


class Unpacked(NamedTuple):
    """An FMU in a folder."""

    folder: Path
    identifier: str
    guid: str

    @property
    def binary(self) -> Path:
        return self.folder / "binaries" / "linux64" / f"{self.identifier}.so"

    @property
    def resources(self) -> Path:
        return self.folder / "resources"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("host") / "host"
    source = Path(__file__).with_name("host.c")
    subprocess.run([str(COMPILER), "-O1", "-Wall", "-Werror", "-o", made, source, "-ldl"], check=True)
    return made


@pytest.fixture
def fmu(fourbar_fmu: Path, tmp_path: Path) -> Unpacked:
    return unpack(fourbar_fmu, tmp_path / "fmu")


@pytest.fixture(scope="module")
def bare_python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a Python without packages."""
    place = tmp_path_factory.mktemp("venv")
    venv.create(place, with_pip=False, symlinks=True)
    return place / "bin"


def unpack(path: Path, folder: Path) -> Unpacked:
    zipfile.ZipFile(path).extractall(folder)
    described = read_model_description(str(path))
    return Unpacked(folder, described.coSimulation.modelIdentifier, described.guid)


def run(
    program: Path,
    fmu: Unpacked,
    address: str = "",
    path: Path = Path(sys.executable).parent,
    places: tuple[str, ...] = tuple(PLACES),
    more: Mapping[str, str] | None = None,
) -> tuple[int, str]:
    """Run the FMU in a C program whose environment only has the path of Python; return exit code and log."""
    environment = {"PATH": str(path), "PYTHONPATH": os.pathsep.join(places), **(more or {})}
    if cache := os.environ.get("NUMBA_CACHE_DIR"):
        environment["NUMBA_CACHE_DIR"] = cache
    location = address or fmu.resources.as_uri()
    arguments = [program, "5", "keep", str(fmu.binary), location, fmu.guid]
    done = subprocess.run(arguments, env=environment, timeout=600, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def logged_by(program: Path, fmu: Unpacked, **options: object) -> str:
    """Return the only message of a host that gets no instance."""
    code, text = run(program, fmu, **options)  # type: ignore[arg-type]
    assert code == INSTANTIATE, text
    (line,) = text.splitlines()
    return line


@pytest.mark.parametrize(
    "name",
    [FOLDERS[0], "/".join(FOLDERS[1:]), *(pytest.param(name, marks=pytest.mark.campaign) for name in FOLDERS[1:])],
)
def test_any_folder(program: Path, fourbar_fmu: Path, tmp_path: Path, name: str) -> None:
    """In a host in C, without a locale; nothing remains in the folder of temporary files."""
    fmu = unpack(fourbar_fmu, tmp_path / name / "fmu")
    (tmp_path / "temporary").mkdir()
    code, text = run(program, fmu, more={"TMPDIR": str(tmp_path / "temporary")})
    assert code == 0, text
    assert not any((tmp_path / "temporary").iterdir())


def test_any_folder_in_fmpy(fourbar_fmu: Path, tmp_path: Path) -> None:
    folders = [str(unpack(fourbar_fmu, tmp_path / name / "fmu").folder) for name in FOLDERS]
    (tmp_path / "temporary").mkdir()
    script = """
import fmpy, sys
for folder in sys.argv[1:]:
    print(fmpy.simulate_fmu(folder, stop_time=0.01, output_interval=0.01)["time"][-1])
"""
    environment = os.environ | {"TMPDIR": str(tmp_path / "temporary")}
    command = [sys.executable, "-c", script, *folders]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["0.01"] * len(FOLDERS)), done.stderr
    assert not any((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize("form", ADDRESSES)
def test_any_address(program: Path, fourbar_fmu: Path, tmp_path: Path, form: str) -> None:
    fmu = unpack(fourbar_fmu, tmp_path / "ü 1")
    place = str(fmu.resources) if form == "{}" else fmu.resources.as_uri().removeprefix("file://")
    code, text = run(program, fmu, form.format(place))
    assert code == 0, text


def test_another_python_in_path(program: Path, fmu: Unpacked, bare_python: Path) -> None:
    """The reason names the Python that was found; MBFMU_PYTHON selects another one."""
    text = logged_by(program, fmu, path=bare_python, places=())
    assert text.startswith("Python 3.")
    assert f"('{bare_python / 'python3'}') cannot import mbfmu (ModuleNotFoundError" in text
    assert f"this FMU requires mbfmu {mbfmu.__version__}. Set the environment variable MBFMU_PYTHON" in text
    assert text.endswith("[no-python]")
    code, text = run(program, fmu, path=bare_python, more={"MBFMU_PYTHON": sys.executable})
    assert code == 0, text


def test_a_library_of_python_that_is_loaded_before(program: Path, fmu: Unpacked) -> None:
    code, text = run(program, fmu, more={"LD_PRELOAD": str(LIBPYTHON)})
    assert code == 0, text


def test_no_python(program: Path, fmu: Unpacked, tmp_path: Path) -> None:
    text = logged_by(program, fmu, path=tmp_path)
    assert f"but the folders of PATH ('{tmp_path}') contain no program 'python3'" in text
    text = logged_by(program, fmu, more={"MBFMU_PYTHON": str(tmp_path / "none")})
    assert f"'{tmp_path / 'none'}' cannot be started: No such file or directory" in text


def test_a_python_that_does_not_start(program: Path, fmu: Unpacked, tmp_path: Path) -> None:
    text = logged_by(program, fmu, places=(), more={"PYTHONHOME": str(tmp_path)})
    assert "the Python program 'python3' cannot start: ModuleNotFoundError: No module named 'encodings'" in text
    text = logged_by(program, fmu, more={"MBFMU_PYTHON": "/bin/false"})
    assert "the Python program '/bin/false' cannot start: it prints nothing. Set" in text


def test_another_version(program: Path, fmu: Unpacked, tmp_path: Path) -> None:
    """In a host in C the Python is examined before it starts, in FMPy by the FMU."""
    (tmp_path / "mbfmu.py").write_text("print('noise')\n__version__ = '0.0.1'\n")
    text = logged_by(program, fmu, places=(str(tmp_path),))
    assert f"has mbfmu 0.0.1; this FMU requires mbfmu {mbfmu.__version__}" in text
    script = "import fmpy, sys; fmpy.simulate_fmu(sys.argv[1])"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *PLACES])}
    command = [sys.executable, "-P", "-c", script, str(fmu.folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "Failed to instantiate" in done.stderr
    assert f"has mbfmu 0.0.1; this FMU requires mbfmu {mbfmu.__version__}" in done.stdout + done.stderr


def test_wrong_arguments(fourbar_fmu: Path, tmp_path: Path) -> None:
    """What PythonFMU does not examine, or ends the process at."""
    binary = Binary(fourbar_fmu, tmp_path)
    assert binary.component(0, logging=False) is None
    assert binary.logged.pop()[1].startswith("model exchange is not supported: this FMU is for co-simulation.")
    guid, binary.description.guid = binary.description.guid, "another"
    assert binary.component(logging=False) is None
    assert binary.logged.pop()[1].startswith(f"the GUID is 'another'; required: '{guid}'")
    binary.description.guid, resources = guid, binary.resources
    for wrong in (tmp_path.as_uri(), (tmp_path / "none").as_uri(), "", "file:", "http://x/y", "file:///%00"):
        binary.resources = wrong
        assert binary.component(logging=False) is None
        assert "Unzip the FMU again [fmu-files]" in binary.logged.pop()[1]
    binary.resources = resources
    (script,) = (tmp_path / "resources").glob("mbfmu_*.py")
    script.rename(tmp_path / "script")
    assert binary.component(logging=False) is None
    assert "does not contain the files of the FMU" in binary.logged.pop()[1]
    (tmp_path / "script").rename(script)
    arguments = b"one", 1, guid.encode(), resources.encode(), None, 0, 1
    component = binary.functions.fmi2Instantiate(*arguments)  # without a logger
    assert component
    binary.functions.fmi2FreeInstance(c_void_p(component))


def test_states_that_are_not_there(fourbar_fmu: Path, tmp_path: Path) -> None:
    fmu = Binary(fourbar_fmu, tmp_path).instantiate(logging=False)
    status, state = fmu.save()
    assert status == OK
    assert state.value
    assert fmu.release(state) == OK
    assert state.value is None
    assert fmu.release(state) == OK
    assert fmu.restore(state) == ERROR
    assert fmu.call("SerializedFMUstateSize", state, byref(c_size_t())) == ERROR
    fmu.free()


def test_without_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The FMU is PythonFMU's, and the export states this in one line."""
    said: list[str] = []

    def no_front() -> bytes:
        raise UserError("nothing here compiles C for x86_64-linux. Install a C compiler", "no-runtime")

    monkeypatch.setattr(python_front, "front_library", no_front)
    path = export(FourBar(), tmp_path / "a.fmu", Settings(solver="adams"), native=False, report=said.append)
    (line,) = (text for text in said if text.endswith("[no-front]"))
    assert line.startswith("this FMU is written without a front: ")
    assert "Install a C compiler" in line
    names = zipfile.ZipFile(path).namelist()
    assert [name for name in names if name.startswith("binaries/linux64/")] == [
        f"binaries/linux64/{read_model_description(str(path)).coSimulation.modelIdentifier}.so"
    ]
    assert not any(WRAPPER in name for name in names)
    Binary(path, tmp_path).instantiate().free()
