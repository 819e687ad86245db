"""A host written in C that does not embed Python runs FMUs and ends without an error."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from fmpy import read_model_description

from mbfmu.fmi import export
from mbfmu.modeling import models
from mbfmu.modeling.settings import Settings

PYTHON = Path(sysconfig.get_config_var("LIBDIR") or "", sysconfig.get_config_var("INSTSONAME") or "")
COMPILER = shutil.which("cc")
PLACES = [place for place in sys.path if place]  # as tests are collected: before any FMU adds to them

pytestmark = pytest.mark.skipif(
    COMPILER is None or PYTHON.suffix == ".a" or not PYTHON.is_file(), reason="no C compiler, or no shared libpython"
)


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("host") / "host"
    assert COMPILER is not None
    source = Path(__file__).with_name("host.c")
    subprocess.run([COMPILER, "-O1", "-Wall", "-Werror", "-o", program, source, "-ldl"], check=True)
    return program


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[str]]:
    """What the host needs to know of an FMU by the name of its model: library, resources and GUID."""

    def unpack(name: str) -> list[str]:
        folder = tmp_path_factory.mktemp(name)
        model = models()[name]()
        solver = "adams" if model.default_solver == "ida" else model.default_solver  # explicit ones refuse nips
        path = export(model, folder / "model.fmu", Settings(solver=solver), native=False)
        zipfile.ZipFile(path).extractall(folder)
        described = read_model_description(str(path))
        library = folder / "binaries" / "linux64" / f"{described.coSimulation.modelIdentifier}.so"
        return [str(library), (folder / "resources").as_uri(), described.guid]

    return unpack


def exit_code(host: Path, ending: str, *fmus: list[str]) -> int:
    """What the host ends with when Python is only in what it loads, as it is in most tools."""
    environment = os.environ | {
        "LD_PRELOAD": str(PYTHON),
        "PYTHONHOME": sys.base_prefix,
        "PYTHONPATH": os.pathsep.join(PLACES),
    }
    told = [argument for fmu in fmus for argument in fmu]
    return subprocess.run([host, "5", ending, *told], env=environment, timeout=600, check=False).returncode


@pytest.mark.parametrize("name", sorted(models()))
def test_it_ends_well(host: Path, unpacked: Callable[[str], list[str]], name: str) -> None:
    fmu = unpacked(name)
    for ending in ("keep", "unload"):
        assert [exit_code(host, ending, fmu) for _ in range(2)] == [0, 0]


def test_it_ends_well_with_several(host: Path, unpacked: Callable[[str], list[str]]) -> None:
    """Only the first of them holds the interpreter."""
    both = [unpacked(name) for name in ("fourbar", "pendulum")]
    for ending in ("keep", "unload"):
        assert exit_code(host, ending, *both) == 0
        assert exit_code(host, ending, *both[::-1]) == 0


def test_a_host_in_python_ends_well(unpacked: Callable[[str], list[str]]) -> None:
    library, resources, guid = unpacked("fourbar")
    script = """
import sys
from pathlib import Path
from fmpy.fmi2 import FMU2Slave
library, resources, guid = sys.argv[1:]
folder, name = Path(library).parents[2], Path(library).stem
fmu = FMU2Slave(guid=guid, unzipDirectory=str(folder), modelIdentifier=name)
fmu.instantiate()
fmu.setupExperiment()
fmu.enterInitializationMode()
fmu.exitInitializationMode()
fmu.doStep(0.0, 1e-3)
fmu.terminate()
fmu.freeInstance()
"""
    command = [sys.executable, "-c", script, library, resources, guid]
    assert [subprocess.run(command, check=False).returncode for _ in range(3)] == [0, 0, 0]
