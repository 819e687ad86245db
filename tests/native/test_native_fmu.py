"""Native FMUs do what simulations do, bit for bit, in hosts that have no Python."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import fmpy
import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.model import Model
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import TARGETS, host
from mbfmu.simulation import Settings, Simulation

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
    "governor": (Governor(), "adams", 0.01),
    "pendulum": (SwingPendulum(), "radau", 0.01),
    "sheet": (Sheet(**GRID), "adams", 2e-4),
}


class Unpacked(NamedTuple):
    """An FMU in its folder."""

    path: Path
    library: Path
    resources: Path
    token: str
    references: dict[str, int]  # of real outputs


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
            known[key] = Unpacked(
                path, library, folder / "resources", token, {v.name: v.valueReference for v in outputs}
            )
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
        done = subprocess.run(
            [str(program), *told, *map(str, references)], env={}, cwd="/", capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert not done.stderr
        return np.fromfile(out).reshape(-1, len(references))

    return run


def rows_of(model: Model, solver: str, length: float) -> NDArray[np.float64]:
    """What a simulation tells at the same points."""
    simulation = Simulation(model, Settings(solver=solver))
    rows = [simulation.outputs().copy()]
    for k in range(1, STEPS + 1):
        assert simulation.advance((k - 1) * length + (k * length - (k - 1) * length)).ok
        rows.append(simulation.outputs().copy())
    return np.array(rows)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_a_host_without_python_gets_the_bits_of_a_simulation(
    name: str,
    fmi: int,
    unpacked: Callable[[Model, str, int], Unpacked],
    lone_host: Callable[[Unpacked, int, float], NDArray[np.float64]],
):
    model, solver, length = MODELS[name]
    found = lone_host(unpacked(model, solver, fmi), fmi, length)
    np.testing.assert_array_equal(found, rows_of(model, solver, length))


@pytest.mark.parametrize("fmi", [2, 3])
def test_descriptions_are_valid(fmi: int, unpacked: Callable[[Model, str, int], Unpacked]):
    for model, solver, _ in MODELS.values():
        assert validate_fmu(str(unpacked(model, solver, fmi).path)) == []


def test_a_host_reads_that_a_sheet_is_too_coarse_and_then_that_it_folds(tmp_path: Path):
    model = Sheet(nx=4, nz=3, support="free", start_spin=600.0)
    path = export(model, tmp_path / "sheet.fmu", Settings(solver="adams"), native=True)
    told: list[str] = []
    rows = simulate_fmu(
        str(path), stop_time=0.05, output_interval=1e-3,
        logger=lambda _, name, status, category, text: told.append(text.decode()),
    )  # fmt: skip
    simulation = Simulation(model, Settings(solver="adams"))
    times = takewhile(lambda t: not simulation.advance(t).ok or not simulation.failure, 1e-3 * np.arange(1, 51))
    assert rows["time"][-1] == pytest.approx(list(times)[-1])
    coarse, folded = told
    assert re.fullmatch(r"cells bend by up to \d\d degrees, and are good to about 15: refine .*", coarse)
    assert re.fullmatch(r"a cell is folded: cells bend by .* \(t = 0.01\d* s\)\. Move it .*", folded)


def test_parameters_and_gravity_of_a_sheet_are_those_of_one_that_is_built(
    unpacked: Callable[[Model, str, int], Unpacked],
):
    given = {"thickness": 0.4e-3, "density": 1300.0}
    rows = simulate_fmu(
        str(unpacked(Sheet(**GRID), "adams", 2).path), stop_time=0.02, output_interval=2e-3,
        start_values={**given, "gravity.x": 2.0},
    )  # fmt: skip
    simulation = Simulation(Sheet(**GRID, **given), Settings(solver="adams"), inputs={"gravity.x": 2.0})
    names = [v.name for v in simulation.plant.outputs]
    for k, row in enumerate(rows):
        assert simulation.advance(2e-3 * k).ok
        wanted = simulation.outputs()[: len(names)]
        np.testing.assert_allclose([row[name] for name in names], wanted, rtol=1e-5, atol=1e-7)
