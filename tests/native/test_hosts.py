"""Native FMUs in hosts that run them otherwise than one after the other, and in those that others have written."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import NamedTuple

import fmpy
import numpy as np
import pytest
from binding import OK, Binary
from exchange_models import many_loops
from fmpy import read_model_description, simulate_fmu

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.modeling.model import as_model
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings, Simulation

UNABLE = 77
WAYS = {  # of odd_hosts.c, and how many FMUs each needs
    "two models": 2, "another's state": 2, "loaded again": 1, "forked": 1, "threads": 1, "many": 1, "flushed": 1,
    "counted": 1, "comma": 1, "restored": 1, "nothing": 1,
}  # fmt: skip
NOT_WITH_IDA = ("restored",)  # the history is not in a state
ODD_FOLDER = "a b#c%41%zz ü+é&=?"

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


class Told(NamedTuple):
    """An FMU in its folder, and the arguments of odd_hosts.c for it."""

    path: Path
    folder: Path
    arguments: list[str]


def unpacked(model: Model, folder: Path, fmi: int = 2, solver: str = "adams") -> Told:
    """Return the native FMU of a model, unpacked into the folder."""
    path = export(model, folder / "model.fmu", Settings(solver=solver), native=True, fmi=fmi)
    zipfile.ZipFile(path).extractall(folder)
    described = read_model_description(str(path))
    (library,) = (folder / "binaries").glob("*/*.so")
    variables = described.modelVariables
    outputs = [str(v.valueReference) for v in variables if v.causality == "output" and v.type in ("Real", "Float64")]
    (given,) = (str(v.valueReference) for v in variables if v.causality == "input")
    token = described.guid or described.instantiationToken
    return Told(path, folder, [str(library), (folder / "resources").as_uri(), token, ",".join(outputs), given])


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> list[Told]:
    """The four-bar and a free governor."""
    return [unpacked(model, tmp_path_factory.mktemp("fmu")) for model in (FourBar(), Governor(driven=False))]


@pytest.fixture(scope="module")
def fmus_with_ida(tmp_path_factory: pytest.TempPathFactory) -> list[Told]:
    """The same with IDA."""
    models = FourBar(), Governor(driven=False)
    return [unpacked(model, tmp_path_factory.mktemp("fmu"), solver="ida") for model in models]


@pytest.fixture(scope="module")
def odd_hosts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program, headers = tmp_path_factory.mktemp("host") / "odd_hosts", Path(fmpy.__file__).parent / "c-code"
    compiler = next(filter(None, map(shutil.which, COMPILERS)), "")
    source = Path(__file__).with_name("odd_hosts.c")
    flags = ["-std=c2x", "-O1", "-Wall", "-Werror", f"-I{headers}", "-rdynamic"]
    subprocess.run([compiler, *flags, "-o", program, source, "-ldl", "-lm", "-pthread"], check=True)
    return program


@pytest.fixture(scope="module")
def german(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a locale of decimal commas, if one can be made."""
    folder = tmp_path_factory.mktemp("locales")
    if shutil.which("localedef"):
        made = ["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / "de_DE.UTF-8")]
        subprocess.run(made, capture_output=True, check=False)
    return folder


@pytest.mark.parametrize("way", WAYS)
def test_hosts_do_what_hosts_may_do(way: str, fmus: list[Told], odd_hosts: Path, german: Path):
    do(way, fmus, odd_hosts, german)


@pytest.mark.parametrize("way", [way for way in WAYS if way not in NOT_WITH_IDA])
def test_hosts_do_what_they_may_do_with_ida(way: str, fmus_with_ida: list[Told], odd_hosts: Path, german: Path):
    do(way, fmus_with_ida, odd_hosts, german)


def test_steps_of_radau_allocate_nothing(odd_hosts: Path, german: Path, tmp_path: Path):
    do("counted", [unpacked(FourBar(), tmp_path, solver="radau")], odd_hosts, german)


@pytest.fixture(scope="module")
def loops(tmp_path_factory: pytest.TempPathFactory) -> Told:
    """A large model with loops, whose constraints are eliminated."""
    return unpacked(as_model(many_loops(31, torque=True)), tmp_path_factory.mktemp("fmu"))


@pytest.mark.parametrize("way", ["counted", "restored"])
def test_hosts_do_what_they_may_do_with_large_loops(way: str, loops: Told, odd_hosts: Path, german: Path):
    do(way, [loops], odd_hosts, german)


def do(way: str, fmus: list[Told], odd_hosts: Path, german: Path) -> None:
    """Run FMUs in an odd host."""
    told = [argument for fmu in fmus[: WAYS[way]] for argument in fmu.arguments]
    locales = {"LOCPATH": str(german)} if any(german.iterdir()) else {}
    done = subprocess.run([str(odd_hosts), way, *told], capture_output=True, text=True, check=False, env=locales)
    if done.returncode == UNABLE:
        pytest.skip("this machine has no such mode")
    assert done.returncode == 0, done.stderr


def test_the_folder_may_have_any_name(tmp_path: Path):
    folder = tmp_path / ODD_FOLDER
    folder.mkdir()
    binary = Binary(unpacked(FourBar(), folder).path, folder)
    assert "%25zz" in binary.resources
    instances = [binary.instantiate()]
    binary.resources = str(folder / "resources") + "/"  # no location as FMI has it, but hosts give it
    instances.append(binary.instantiate())
    for fmu in instances:
        assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
        assert fmu.step(0.0, 0.01) == OK
        assert fmu.call("Reset") == OK  # the file is read again
        assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
        fmu.free()


def test_the_folder_may_have_any_name_for_fmi_3(tmp_path: Path):
    folder = tmp_path / ODD_FOLDER
    folder.mkdir()
    fmu = unpacked(FourBar(), folder, 3)
    rows = simulate_fmu(str(folder), stop_time=0.05, output_interval=0.01, fmi_type="CoSimulation")
    assert len(rows) == 6, fmu


def test_libcosim_runs_it_to_the_same_bits(fmus: list[Told]):
    libcosim = pytest.importorskip("libcosimpy.CosimExecution", reason="needs libcosimpy, which has no wheel for all")
    observers = pytest.importorskip("libcosimpy.CosimObserver")
    slaves = pytest.importorskip("libcosimpy.CosimSlave")
    execution = libcosim.CosimExecution.from_step_size(step_size=10_000_000)  # ns
    index = execution.add_local_slave(slaves.CosimLocalSlave(fmu_path=str(fmus[0].path), instance_name="one"))
    observer = observers.CosimObserver.create_last_value()
    execution.add_observer(observer)
    described = read_model_description(str(fmus[0].path))
    references = {v.name: v.valueReference for v in described.modelVariables}
    simulation = Simulation(FourBar(), Settings(solver="adams"))
    wanted = [references[v.name] for v in simulation.variables]
    for k in range(100):
        assert execution.step()
        begin, end = 1e7 * k / 1e9, 1e7 * (k + 1) / 1e9
        assert simulation.advance(begin + (end - begin)).ok  # as it reckons the length of a step
        np.testing.assert_array_equal(observer.last_real_values(index, wanted), simulation.outputs())
