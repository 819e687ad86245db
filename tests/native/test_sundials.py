"""Native FMUs with IDA: bits of a simulation whatever the host does, and messages where SUNDIALS fails."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from binding import DISCARD, OK, WARNING, Binary, Instance

from fmus.fourbar import FourBar
from fmus.governor import Governor
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.native import sundials_files
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.sundials_files import libraries
from mbfmu.native.targets import host
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

IDA = Settings(solver="ida")
STEP = 0.01  # s

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Model], Binary]:
    """What exports a model with IDA, once, and loads it."""
    known: dict[Model, Binary] = {}

    def open_(model: Model) -> Binary:
        if model not in known:
            folder = tmp_path_factory.mktemp("ida")
            known[model] = Binary(export(model, folder / "model.fmu", IDA, native=True), folder)
        return known[model]

    return open_


def begun(binary: Binary) -> Instance:
    """Return an instance that has been initialized."""
    fmu = binary.instantiate()
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    return fmu


def references(binary: Binary, simulation: Simulation) -> list[int]:
    """Return the value references of the variables of a simulation."""
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    return [known[v.name] for v in simulation.variables]


def follow(fmu: Instance, simulation: Simulation, first: int, last: int) -> None:
    """Take steps whose outputs must be equal."""
    wanted = references(fmu.binary, simulation)
    for k in range(first, last):
        assert fmu.step(k * STEP, STEP) == OK
        assert simulation.advance(k * STEP + STEP).ok
        np.testing.assert_array_equal(fmu.get("Real", wanted)[1], simulation.outputs())


def test_inputs_and_parameters_that_change_on_the_way_leave_the_bits(opened: Callable[[Model], Binary]):
    binary, simulation = opened(FourBar()), Simulation(FourBar(), IDA)
    known = {v.name: v.valueReference for v in binary.description.modelVariables}
    fmu = begun(binary)
    for k in range(40):
        value = 0.5 * np.sin(0.3 * k + 0.1)  # never what it was: an equal value is no change to an FMU
        assert fmu.set("Real", [known["crank.torque"]], [value]) == OK
        simulation.set_input("crank.torque", value)
        follow(fmu, simulation, k, k + 1)
    assert simulation.statistics.restarts <= 2, "the history goes on"


def test_a_run_after_a_reset_has_the_bits_of_the_first(opened: Callable[[Model], Binary]):
    fmu = begun(opened(Governor()))
    follow(fmu, Simulation(Governor(), IDA), 0, 20)
    assert fmu.call("Reset") == OK
    assert fmu.set_up() == fmu.call("EnterInitializationMode") == fmu.call("ExitInitializationMode") == OK
    follow(fmu, Simulation(Governor(), IDA), 0, 20)


def test_a_state_goes_on_as_a_restored_simulation_does(opened: Callable[[Model], Binary]):
    binary, simulation = opened(FourBar()), Simulation(FourBar(), IDA)
    fmu, other = begun(binary), binary.instantiate()
    follow(fmu, simulation, 0, 30)
    status, state = fmu.save()
    saved = simulation.stepper.save()
    assert status == OK
    follow(fmu, simulation, 30, 40)
    assert fmu.restore(state) == other.restore(state) == OK
    for instance in (fmu, other):  # the second was never begun
        restored = Simulation(FourBar(), IDA)
        restored.advance(30 * STEP)
        restored.stepper.restore(saved)
        follow(instance, restored, 30, 45)


def test_a_step_that_fails_leaves_the_state_and_may_be_repeated_shorter(tmp_path: Path):
    """A long step needs more steps of the solver than are allowed."""
    model = FourBar()
    settings = Settings(solver="ida", max_steps=40)
    binary = Binary(export(model, tmp_path / "model.fmu", settings, native=True), tmp_path)
    fmu, reference = begun(binary), Simulation(model, settings)
    wanted = references(binary, reference)
    before = fmu.get("Real", wanted)
    assert fmu.step(0.0, 5.0) == DISCARD
    assert "maximum number of steps" in binary.logged[-1][1]
    assert fmu.get("Real", wanted) == before
    for k in range(20):
        assert fmu.step(k * STEP, STEP) == OK
        assert reference.advance(k * STEP + STEP).ok
    np.testing.assert_array_equal(fmu.get("Real", wanted)[1], reference.outputs())


def test_what_sundials_reports_of_a_step_that_fails_is_logged_before_the_reason(opened: Callable[[Model], Binary]):
    binary = opened(FourBar())
    fmu, known = begun(binary), {v.name: v.valueReference for v in binary.description.modelVariables}
    assert fmu.step(0.0, STEP) == OK
    assert fmu.set("Real", [known["crank.torque"]], [1e30]) == OK
    assert fmu.step(STEP, STEP) == DISCARD
    (first, reported), (second, told) = binary.logged[-2:]
    assert (first, second) == (WARNING, DISCARD)
    assert " reports: At t = 0.01 and h = " in reported
    assert reported.endswith("[sundials-error]")
    assert "(t = 0.01 s)" in told
    assert told.endswith("[collapsed-step]")
    assert fmu.set("Real", [known["crank.torque"]], [0.0]) == OK
    assert fmu.step(STEP, STEP) == OK
    assert binary.logged[-1] == (second, told), "the next step is silent"


@pytest.mark.parametrize("name", ["core", "ida", "sunlinsolspgmr"])
def test_a_library_that_is_missing_or_none_is_named(name: str, tmp_path: Path):
    binary = Binary(export(FourBar(), tmp_path / "model.fmu", IDA, native=True), tmp_path)
    (path,) = (tmp_path / "binaries").glob(f"*/libsundials_{name}-*")
    data = path.read_bytes()
    path.unlink()
    assert binary.component() is None
    assert f"libsundials_{name}" in binary.logged[-1][1]
    assert binary.logged[-1][1].endswith("[fmu-files]")
    for wrong in (b"no library", data[:1000], data[: len(data) // 2], data[:-1], data + b"\0", bytes(len(data))):
        path.write_bytes(wrong)  # the loader of the system would end the process for some of these
        assert binary.component() is None
        assert f"libsundials_{name}" in binary.logged[-1][1]
        assert "the file is damaged, or belongs to another FMU; unzip the FMU again" in binary.logged[-1][1]
    path.write_bytes(data)
    assert begun(binary).step(0.0, STEP) == OK


def test_the_fmu_contains_the_libraries_and_their_license(tmp_path: Path):
    path = export(FourBar(), tmp_path / "model.fmu", IDA, native=True)
    with ZipFile(path) as archive:
        names = {Path(name).name for name in archive.namelist()}
        assert set(libraries(host())) <= names
        assert "SUNDIALS" in archive.read("documentation/licenses/sundials.txt").decode()
        assert "sundials.txt" in archive.read("documentation/licenses/license.txt").decode()
    with ZipFile(export(FourBar(), path, Settings(solver="adams"), native=True)) as archive:
        names = {Path(name).name for name in archive.namelist()}
        assert not names & {*libraries(host()), "sundials.txt"}


def test_a_platform_without_a_wheel_is_refused_with_a_way_out():
    if host() == "aarch64-linux":
        pytest.skip("it is this machine")
    with pytest.raises(UserError, match=r"for aarch64-linux: scikit-sundae has none. Use another solver, or leave"):
        libraries("aarch64-linux")


def downloads(files: dict[str, str]) -> Callable[..., Any]:
    """Return what stands for pip: it writes a wheel of these files, or fails if there are none."""

    def run(command: list[str]) -> tuple[int, list[str]]:
        folder = Path(command[command.index("--dest") + 1])
        assert command[-1].startswith("scikit-sundae==")
        assert command[command.index("--platform") + 1] == "win_amd64"
        if files:
            with ZipFile(folder / "one.whl", "w") as wheel:
                for name, text in files.items():
                    wheel.writestr(name, text)
        return (0, []) if files else (1, ["ERROR: no network"])

    return run


def test_libraries_of_another_platform_come_from_its_wheel_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sundials_files, "host", lambda: "x86_64-linux")
    monkeypatch.setattr(sundials_files, "shared_cache_dir", lambda: tmp_path / "cache")
    names = ("core", "nvecserial", "sunmatrixdense", "sunlinsoldense", "sunlinsolspgmr", "ida", "cvode")
    wheel = {f"scikit_sundae.libs/sundials_{name}-0123.dll": name for name in names} | {"sksundae/ida.py": ""}
    for wrong, why in (({}, "pip reports 'ERROR: no network'"), (dict([*wheel.items()][1:]), "has other files")):
        monkeypatch.setattr(sundials_files, "run_program", downloads(wrong))
        with pytest.raises(UserError, match=rf"libraries of SUNDIALS for x86_64-windows: .*{why}"):
            libraries("x86_64-windows")
    monkeypatch.setattr(sundials_files, "run_program", downloads(wheel))
    found = libraries("x86_64-windows")
    assert found == {f"sundials_{name}-0123.dll": name.encode() for name in names[:-1]}
    monkeypatch.setattr(sundials_files, "run_program", downloads({}))
    assert libraries("x86_64-windows") == found, "it was kept"
