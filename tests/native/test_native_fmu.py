"""Native FMUs do what simulations do, bit for bit, in hosts that have no Python."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Callable, Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import numpy as np
import pytest
from binding import DISCARD, ERROR, OK, Binary, Instance
from flexible_models import SwungBracket
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.native import data
from mbfmu.native.parameters import find_settable
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import TARGETS, host
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.util.errors import UserError

STEPS = 200  # of runs
GRID = {"nx": 9, "nz": 7}

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)

MODELS: dict[str, tuple[Model, str, float]] = {  # with their solver, and the length of a step, s
    "four-bar": (FourBar(), "adams", 0.01),
    "four-bar, hybrid": (FourBar(), "hybrid", 0.01),
    "four-bar, radau": (FourBar(), "radau", 0.01),
    "elastic coupler": (FourBar(coupler_modes=2), "adams", 0.01),
    "body of finite elements": (SwungBracket(), "radau", 0.01),
    "governor": (Governor(), "adams", 0.01),
    "pendulum": (SwingPendulum(), "radau", 0.01),
    "four-bar, ida": (FourBar(), "ida", 0.01),
    "elastic coupler, ida": (FourBar(coupler_modes=2), "ida", 0.01),
    "governor, ida": (Governor(), "ida", 0.01),
    "pendulum, ida": (SwingPendulum(), "ida", 0.01),
    "sheet": (Sheet(**GRID), "adams", 2e-4),
}


class Unpacked(NamedTuple):
    """An FMU in its folder."""

    path: Path
    library: Path
    resources: Path
    token: str
    references: dict[str, int]  # of real outputs
    elements: list[str]  # names of all their numbers


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Model, str, int], Unpacked]:
    """What exports a model with its solver for a version of FMI, once."""
    known: dict[tuple[Model, str, int], Unpacked] = {}

    def unpack(model: Model, solver: str, fmi: int) -> Unpacked:
        key = (model, solver, fmi)
        if key not in known:
            folder = tmp_path_factory.mktemp("native")
            path = export(model, folder / "model.fmu", Settings(solver=solver), native=True, fmi=fmi)
            zipfile.ZipFile(path).extractall(folder)
            (library,) = (folder / "binaries").glob(f"*/*{TARGETS[host()].suffix}")
            described = read_model_description(str(path))
            outputs = [v for v in described.modelVariables if v.causality == "output" and v.type in ("Real", "Float64")]
            token = described.guid or described.instantiationToken
            several = {name: np.ravel(names).tolist() for name, names in model.arrays().items()} if fmi == 3 else {}
            elements = [name for v in outputs for name in several.get(v.name, [v.name])]
            references = {v.name: v.valueReference for v in outputs}
            known[key] = Unpacked(path, library, folder / "resources", token, references, elements)
        return known[key]

    return unpack


@pytest.fixture(scope="module")
def lone_host(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Unpacked, int, float], NDArray[np.float64]]:
    """What runs an FMU by a C program in an empty environment, and returns its outputs."""
    folder = tmp_path_factory.mktemp("host")
    program, headers = folder / "host", Path(fmpy.__file__).parent / "c-code"
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    assert compiler is not None
    source = Path(__file__).with_name("host.c")
    subprocess.run(
        [compiler, "-std=c2x", "-O1", "-Wall", "-Werror", f"-I{headers}", "-o", program, source, "-ldl"], check=True
    )

    def run(fmu: Unpacked, fmi: int, length: float) -> NDArray[np.float64]:
        out = folder / "out.bin"
        resources = fmu.resources.as_uri() if fmi == 2 else str(fmu.resources)
        references = list(fmu.references.values())
        told = [str(fmi), str(fmu.library), resources, fmu.token, str(out), str(STEPS), str(length)]
        numbers = map(str, (len(fmu.elements), *references))
        done = subprocess.run(
            [str(program), *told, *numbers], env={}, cwd="/", capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert not done.stderr
        return np.fromfile(out).reshape(-1, len(fmu.elements))

    return run


def rows_of(model: Model, solver: str, length: float, names: list[str]) -> NDArray[np.float64]:
    """Outputs of a simulation at the same points."""
    simulation = Simulation(model, Settings(solver=solver))
    columns = [[v.name for v in simulation.variables].index(name) for name in names]
    rows = [simulation.outputs().copy()]
    for k in range(1, STEPS + 1):
        assert simulation.advance((k - 1) * length + (k * length - (k - 1) * length)).ok
        rows.append(simulation.outputs().copy())
    return np.array(rows)[:, columns]


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_a_host_without_python_gets_the_bits_of_a_simulation(
    name: str,
    fmi: int,
    unpacked: Callable[[Model, str, int], Unpacked],
    lone_host: Callable[[Unpacked, int, float], NDArray[np.float64]],
):
    model, solver, length = MODELS[name]
    fmu = unpacked(model, solver, fmi)
    found = lone_host(fmu, fmi, length)
    np.testing.assert_array_equal(found, rows_of(model, solver, length, fmu.elements))


@pytest.mark.parametrize("fmi", [2, 3])
def test_descriptions_are_valid(fmi: int, unpacked: Callable[[Model, str, int], Unpacked]):
    for model, solver, _ in MODELS.values():
        assert validate_fmu(str(unpacked(model, solver, fmi).path)) == []


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory, unpacked: Callable[[Model, str, int], Unpacked]) -> Binary:
    """The four-bar's FMU of FMI 2, by its C functions."""
    return Binary(unpacked(FourBar(), "adams", 2).path, tmp_path_factory.mktemp("binary"))


@pytest.fixture
def fmu(binary: Binary) -> Iterator[Instance]:
    binary.logged.clear()
    instance = binary.instantiate()
    yield instance
    instance.free()


def references(binary: Binary) -> dict[str, int]:
    return {v.name: v.valueReference for v in binary.description.modelVariables}


def begin(fmu: Instance, **values: float) -> None:
    known = references(fmu.binary)
    assert fmu.set("Real", [known[name] for name in values], list(values.values())) == OK
    assert fmu.set_up() == OK
    assert fmu.call("EnterInitializationMode") == OK
    assert fmu.call("ExitInitializationMode") == OK, fmu.binary.logged


def outputs(fmu: Instance) -> NDArray[np.float64]:
    described = fmu.binary.description.modelVariables
    status, values = fmu.get(
        "Real", [v.valueReference for v in described if v.causality == "output" and v.type == "Real"]
    )
    assert status == OK
    return np.array(values)


CHANGES: list[dict[str, float]] = [
    {"gravity": 1.62},
    {"crank_mass": 2.5, "start_angle": 0.7},
    {"start_angle": -0.4, "start_rate": 3.0},
    {"crank_length": 0.8, "rocker_length": 0.8, "coupler_length": 2.5, "ground_length": 2.5},
    {"tolerance": 1e-9},
    {"tolerance": 1e-4, "max_step": 1e-3},
]


@pytest.mark.parametrize("values", CHANGES, ids=",".join)
def test_changed_parameters_do_what_they_do_in_python(values: dict[str, float], fmu: Instance):
    settings = {name: value for name, value in values.items() if name in ("tolerance", "max_step")}
    model = FourBar(**{name: value for name, value in values.items() if name not in settings})  # type: ignore[arg-type]
    simulation = Simulation(model, Settings(solver="adams", **settings))  # type: ignore[arg-type]
    begin(fmu, **values)
    np.testing.assert_allclose(outputs(fmu)[:-2], simulation.outputs()[:-2], rtol=1e-11, atol=1e-11)
    for k in range(100):
        assert fmu.step(0.01 * k, 0.01) == OK
        assert simulation.advance(0.01 * k + 0.01).ok
    expected = simulation.outputs()
    loose = 100.0 * settings.get("tolerance", 1e-6)
    np.testing.assert_allclose(outputs(fmu)[:-2], expected[:-2], rtol=loose, atol=loose * np.abs(expected[:-2]).max())


def test_a_torque_and_gravity_that_change_on_the_way_give_the_bits_of_a_simulation(fmu: Instance):
    known = references(fmu.binary)
    simulation = Simulation(FourBar(), Settings(solver="adams"))
    begin(fmu)
    for k in range(100):
        torque = np.sin(0.2 * (k + 1))  # one that is set to what it is changes nothing
        if k == 50:
            assert fmu.set("Real", [known["gravity"]], [3.7]) == OK
            simulation.retune(FourBar(gravity=3.7))
        assert fmu.set("Real", [known["crank.torque"]], [torque]) == OK
        simulation.set_input("crank.torque", torque)
        assert fmu.step(0.01 * k, 0.01) == OK
        assert simulation.advance(0.01 * k + 0.01).ok
        np.testing.assert_array_equal(outputs(fmu), simulation.outputs())


def test_a_state_goes_on_in_another_instance_to_the_bit(fmu: Instance):
    begin(fmu)
    for k in range(50):
        assert fmu.step(0.01 * k, 0.01) == OK
    status, state = fmu.save()
    assert status == OK
    other = fmu.binary.instantiate()
    status, taken = other.from_bytes(fmu.to_bytes(state))
    assert status == OK
    assert other.restore(taken) == OK
    for k in range(50, 100):
        assert fmu.step(0.01 * k, 0.01) == other.step(0.01 * k, 0.01) == OK
        np.testing.assert_array_equal(outputs(fmu), outputs(other))
    assert fmu.restore(state) == OK  # and back
    assert fmu.step(0.5, 0.01) == OK
    for own in (state, taken):
        fmu.release(own)
    other.free()


def test_a_damaged_state_or_another_model_s_is_refused(fmu: Instance):
    begin(fmu)
    _, state = fmu.save()
    data = fmu.to_bytes(state)
    for bad in (data[:-1], data[:100], data[:2000] + bytes([data[2000] ^ 1]) + data[2001:], b""):
        assert fmu.from_bytes(bad)[0] == ERROR
    assert "not one of this FMU" in fmu.binary.logged[-1][1]
    assert fmu.step(0.0, 0.01) == OK
    fmu.release(state)


def test_a_reset_makes_the_first_run_again(fmu: Instance):
    runs = []
    for _ in range(2):
        begin(fmu, start_angle=0.3)
        for k in range(20):
            assert fmu.step(0.01 * k, 0.01) == OK
        runs.append(outputs(fmu))
        assert fmu.call("Reset") == OK
    np.testing.assert_array_equal(*runs)


def test_mistakes_of_a_host_are_errors_that_change_nothing(fmu: Instance):
    known = references(fmu.binary)
    assert fmu.step(0.0, 0.1) == ERROR
    assert "a step is not allowed in the present state of the FMU: it is instantiated" in fmu.binary.logged[-1][1]
    assert fmu.set("Real", [known["crank.angle"]], [1.0]) == ERROR
    assert "'crank.angle' was set to 1, but it is an output" in fmu.binary.logged[-1][1]
    assert fmu.get("Real", [9999])[0] == ERROR
    assert fmu.get("Integer", [known["gravity"]])[0] == ERROR
    assert "of type Real" in fmu.binary.logged[-1][1]
    begin(fmu)
    assert fmu.call("EnterInitializationMode") == ERROR
    assert fmu.set("Real", [known["crank_length"]], [2.0]) == ERROR
    assert "it can be changed only before the end of the initialization" in fmu.binary.logged[-1][1]
    before = outputs(fmu)
    for t, length in ((0.5, 0.1), (0.0, -0.1), (0.0, float("nan")), (float("nan"), 0.1)):
        assert fmu.step(t, length) == DISCARD
    np.testing.assert_array_equal(outputs(fmu), before)
    assert fmu.step(0.0, 0.0) == OK
    assert fmu.step(0.0, 0.01) == OK


def test_a_refused_value_stops_steps_until_it_is_given_right(fmu: Instance):
    known = references(fmu.binary)
    begin(fmu)
    assert fmu.set("Real", [known["crank.torque"]], [float("nan")]) == ERROR
    assert fmu.step(0.0, 0.01) == DISCARD
    assert "'crank.torque' was set to a value that is not allowed" in fmu.binary.logged[-1][1]
    assert fmu.set("Real", [known["crank.torque"]], [0.0]) == OK
    assert fmu.step(0.0, 0.01) == OK


def test_a_loop_that_cannot_close_is_reported_with_constraint_and_gap(fmu: Instance):
    known = references(fmu.binary)
    assert fmu.set("Real", [known["ground_length"]], [9.0]) == OK
    assert fmu.call("EnterInitializationMode") == OK
    assert fmu.call("ExitInitializationMode") == ERROR
    with pytest.raises(UserError) as error:
        Simulation(FourBar(ground_length=9.0), Settings(solver="adams"))
    told, said = fmu.binary.logged[-1][1], str(error.value)
    assert told.startswith("loop cannot close: constraint 'pivot.x' is violated by")
    assert told.partition("violated by ")[2].partition(" ")[2] == said.partition("violated by ")[2].partition(" ")[2]
    assert fmu.step(0.0, 0.1) == ERROR
    assert fmu.call("Reset") == OK
    begin(fmu)


def test_a_step_that_fails_leaves_all_as_it_was(fmu: Instance):
    known = references(fmu.binary)
    assert fmu.set("Integer", [known["max_steps"]], [40]) == OK
    begin(fmu)
    assert fmu.step(0.0, 1e-3) == OK
    before = outputs(fmu)
    assert fmu.step(1e-3, 5.0) == DISCARD
    assert "the maximum number of steps" in fmu.binary.logged[-1][1]
    np.testing.assert_array_equal(outputs(fmu), before)
    assert fmu.step(1e-3, 1e-3) == OK


def test_variables_are_those_of_the_fmu_that_calls_python(binary: Binary, tmp_path: Path):
    other = read_model_description(
        str(export(FourBar(), tmp_path / "model.fmu", Settings(solver="adams"), native=False))
    )
    native = {v.name: v for v in binary.description.modelVariables}
    assert [name for name in native if "state." not in name] == [v.name for v in other.modelVariables]
    constant = {"solver", "input_interpolation", "start_at_equilibrium"}
    for v in other.modelVariables:
        mine = native[v.name]
        assert (mine.valueReference, mine.type, mine.unit, mine.start) == (v.valueReference, v.type, v.unit, v.start)
        assert mine.causality == ("local" if v.name in constant else v.causality), v.name


def test_nothing_is_called_but_the_c_library_and_nothing_else_is_offered(
    unpacked: Callable[[Model, str, int], Unpacked],
):
    library = unpacked(FourBar(), "adams", 3).library
    told = subprocess.run(("nm", "-D", str(library)), capture_output=True, text=True, check=True).stdout.splitlines()
    offered = {line.split()[-1] for line in told if line.split()[-2] == "T"}
    headers = Path(fmpy.__file__).parent / "c-code"
    wanted = set()
    for version in (2, 3):
        text = (headers / f"fmi{version}Functions.h").read_text()
        wanted |= set(re.findall(rf"FMI{version}_Export\s+\w+\s+(fmi{version}\w+);", text))
    assert len(wanted) > 110
    assert offered == wanted
    needed = {line.split()[-1].partition("@")[0] for line in told if line.split()[-2] == "U"}
    assert not [name for name in needed if name.startswith(("Py", "NRT_", "numba"))]
    linked = subprocess.run(("ldd", str(library)), capture_output=True, text=True, check=True).stdout
    names = {line.split()[0].rpartition("/")[2].partition(".")[0] for line in linked.splitlines()}
    assert names <= {"linux-vdso", "libc", "libm", "libdl", "ld-linux-x86-64", "ld-linux-aarch64"}


def test_equal_models_make_equal_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(data, "find_settable", find_settable)  # the parameters are searched for each file
    files = [export(FourBar(), tmp_path / f"{k}.fmu", Settings(solver="adams"), native=True) for k in range(2)]
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"fmi": 1}, "fmi is 1; allowed: 2 or 3"),
        ({"platforms": ["amiga"]}, "unknown platform 'amiga'; allowed: x86_64-linux"),
        ({"platforms": ["aarch64-linux"]}, "FMI 2 has no name for platform 'aarch64-linux'"),
    ],
)
def test_what_cannot_be_exported_is_refused(more: dict[str, Any], told: str, tmp_path: Path):
    with pytest.raises(UserError, match=told):
        export(FourBar(), tmp_path / "model.fmu", native=True, **more)


def test_the_solver_that_auto_selects_is_reported(tmp_path: Path):
    told: list[str] = []
    export(
        Sheet(**GRID), tmp_path / "model.fmu", Settings(solver="auto", tolerance=1e-6), native=True, report=told.append
    )
    assert any("solver 'adams' selected: " in line for line in told)
    assert any("are constants in this FMU" in line for line in told)


def test_a_start_in_a_steady_state_is_that_of_a_simulation(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory):
    settings = Settings(solver="adams", start_at_equilibrium=True)
    path = export(Governor(), tmp_path / "model.fmu", settings, native=True)
    fmu = Binary(path, tmp_path_factory.mktemp("steady")).instantiate()
    simulation = Simulation(Governor(), settings)
    begin(fmu)
    for k in range(20):
        np.testing.assert_array_equal(outputs(fmu), simulation.outputs())
        assert fmu.step(0.01 * k, 0.01) == OK
        assert simulation.advance(0.01 * k + 0.01).ok
    fmu.free()


def test_a_host_reads_that_a_sheet_is_too_coarse_and_then_that_it_folds(tmp_path: Path):
    model = Sheet(nx=4, nz=3, support="free", start_spin=600.0)
    path = export(model, tmp_path / "sheet.fmu", Settings(solver="adams"), native=True)
    told: list[str] = []
    rows = simulate_fmu(
        str(path), stop_time=0.05, output_interval=1e-3, debug_logging=True,
        logger=lambda _, name, status, category, text: told.append(text.decode()),
    )  # fmt: skip
    simulation = Simulation(model, Settings(solver="adams"))
    times = takewhile(lambda t: simulation.advance(t).ok and not simulation.failure, 1e-3 * np.arange(1, 51))
    assert rows["time"][-1] == pytest.approx(list(times)[-1])  # the host ends there
    coarse, folded = told
    assert re.fullmatch(
        r"the mesh is too coarse at t = .* s: adjacent cells are rotated by up to \d\d deg; allowed: about 15 deg\. .*",
        coarse,
    )
    assert re.fullmatch(r"a cell is folded at t = 0.01\d* s: adjacent cells are rotated by .*\. Move it .*", folded)


def test_parameters_and_gravity_of_a_sheet_are_those_of_one_that_is_built(
    unpacked: Callable[[Model, str, int], Unpacked],
):
    given = {"thickness": 0.4e-3, "density": 1300.0}
    rows = simulate_fmu(
        str(unpacked(Sheet(**GRID), "adams", 2).path), stop_time=0.01, output_interval=2e-3,
        start_values={**given, "gravity.x": 2.0},
    )  # fmt: skip
    simulation = Simulation(Sheet(**GRID, **given), Settings(solver="adams"), inputs={"gravity.x": 2.0})
    names = [v.name for v in simulation.compiled.outputs]
    for k, row in enumerate(rows):
        assert simulation.advance(2e-3 * k).ok
        wanted = simulation.outputs()[: len(names)]
        # explicit steps at the limit of stability carry noise of the tolerance, also where symmetry makes zero
        np.testing.assert_allclose([row[name] for name in names], wanted, rtol=1e-5, atol=1e-7)
