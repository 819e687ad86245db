"""Native FMUs do what simulations do, bit for bit, in hosts that have no Python."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import fmpy
import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from mbfmu.fmi import export
from mbfmu.model import Model
from mbfmu.native.runtime import COMPILERS
from mbfmu.native.targets import TARGETS, host
from mbfmu.simulation import Settings, Simulation

STEPS, LENGTH = 200, 0.01  # of runs; the second in s

pytestmark = pytest.mark.skipif(
    not host() or not any(map(shutil.which, COMPILERS)), reason="needs a C compiler, and a machine that is known"
)

MODELS: dict[str, tuple[Model, str]] = {
    "four-bar": (FourBar(), "adams"),
    "four-bar, hybrid": (FourBar(), "hybrid"),
    "four-bar, radau": (FourBar(), "radau"),
    "elastic coupler": (FourBar(coupler_modes=2), "adams"),
    "governor": (Governor(), "adams"),
    "pendulum": (SwingPendulum(), "radau"),
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
def lone_host(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Unpacked, int], NDArray[np.float64]]:
    """What runs an FMU by a C program in an empty environment, and returns its outputs."""
    folder = tmp_path_factory.mktemp("host")
    program, headers = folder / "host", Path(fmpy.__file__).parent / "c-code"
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    assert compiler is not None
    source = Path(__file__).with_name("host.c")
    subprocess.run(
        [compiler, "-std=c2x", "-O1", "-Wall", "-Werror", f"-I{headers}", "-o", program, source, "-ldl"], check=True
    )

    def run(fmu: Unpacked, fmi: int) -> NDArray[np.float64]:
        out = folder / "out.bin"
        resources = fmu.resources.as_uri() if fmi == 2 else str(fmu.resources)
        references = list(fmu.references.values())
        told = [str(fmi), str(fmu.library), resources, fmu.token, str(out), str(STEPS), str(LENGTH)]
        done = subprocess.run(
            [str(program), *told, *map(str, references)], env={}, cwd="/", capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert not done.stderr
        return np.fromfile(out).reshape(-1, len(references))

    return run


def rows_of(model: Model, solver: str) -> NDArray[np.float64]:
    """What a simulation tells at the same points."""
    simulation = Simulation(model, Settings(solver=solver))
    rows = [simulation.outputs().copy()]
    for k in range(1, STEPS + 1):
        assert simulation.advance((k - 1) * LENGTH + (k * LENGTH - (k - 1) * LENGTH)).ok
        rows.append(simulation.outputs().copy())
    return np.array(rows)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", MODELS)
def test_a_host_without_python_gets_the_bits_of_a_simulation(
    name: str,
    fmi: int,
    unpacked: Callable[[Model, str, int], Unpacked],
    lone_host: Callable[[Unpacked, int], NDArray[np.float64]],
):
    model, solver = MODELS[name]
    np.testing.assert_array_equal(lone_host(unpacked(model, solver, fmi), fmi), rows_of(model, solver))


@pytest.mark.parametrize("fmi", [2, 3])
def test_descriptions_are_valid(fmi: int, unpacked: Callable[[Model, str, int], Unpacked]):
    for model, solver in MODELS.values():
        assert validate_fmu(str(unpacked(model, solver, fmi).path)) == []
