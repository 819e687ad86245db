"""Native FMUs of other machines, in emulators of these where they are installed."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import mechanisms as loops
import numpy as np
import pytest
from fmpy import read_model_description

from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.fmi import export
from mbfmu.modeling import Model
from mbfmu.modeling.model import as_model
from mbfmu.native.runtime import compiler
from mbfmu.native.targets import TARGETS, host
from mbfmu.session.simulation import Settings, Simulation

STEPS, LENGTH, TOLERANCE = 100, 0.01, 1e-6  # the second in s
EMULATORS = {  # programs that run what is built for a machine, and what else they need
    "aarch64-linux": (("qemu-aarch64", "qemu-aarch64-static"), ("QEMU_LD_PREFIX",)),
    "x86_64-windows": (("wine64", "wine"), ()),
}

pytestmark = pytest.mark.campaign  # the runtime of each machine is built again, in minutes


def emulator(name: str) -> str:
    """Return the program; what is missing is a reason to skip."""
    programs, variables = EMULATORS[name]
    missing = [variable for variable in variables if variable not in os.environ]
    found = next(filter(None, map(shutil.which, programs)), "")
    if not found or missing or importlib.util.find_spec("ziglang") is None:
        needed = ", ".join((" or ".join(programs), *(f"{v} in the environment" for v in variables), "ziglang"))
        pytest.skip(f"needs {needed}")
    return found


def run_elsewhere(name: str, source: str, path: Path, folder: Path, *numbers: object) -> np.ndarray:
    """Run an FMU of FMI 3 in a C program for a machine, in its emulator; return what the program writes."""
    program = emulator(name)
    zipfile.ZipFile(path).extractall(folder)
    described = read_model_description(str(path))
    library = folder / "binaries" / name / f"{described.coSimulation.modelIdentifier}{TARGETS[name].suffix}"
    alone, headers = folder / "host.exe", Path(fmpy.__file__).parent / "c-code"
    source_path = Path(__file__).with_name(source)
    subprocess.run([*compiler(name), "-std=c2x", "-O1", f"-I{headers}", source_path, "-o", alone], check=True)
    told = ["3", library.relative_to(folder), "resources", described.instantiationToken, "out.bin", *numbers]
    subprocess.run(list(map(str, [program, alone, *told])), cwd=folder, check=True)
    return np.fromfile(folder / "out.bin")


MODELS: dict[str, Model] = {
    "four-bar": FourBar(),
    "governor": Governor(),
    "pendulum": SwingPendulum(),
    "sheet": Sheet(nx=7, nz=5),
}
SOLVERS = {
    (machine, model, solver)
    for machine in EMULATORS
    for model in MODELS
    for solver in ("adams", "hybrid", "radau", "ida")
    if (model != "sheet" or solver == "adams") and (machine, solver) != ("aarch64-linux", "ida")
}


@pytest.mark.skipif(not host(), reason="this machine is not known")
@pytest.mark.parametrize(("name", "model", "solver"), sorted(SOLVERS), ids=str)
def test_another_machine_gets_the_same_motion(name: str, model: str, solver: str, tmp_path: Path):
    emulator(name)
    settings = Settings(solver=solver, tolerance=TOLERANCE)
    path = export(MODELS[model], tmp_path / "model.fmu", settings, native=True, fmi=3, platforms=[name])
    simulation = Simulation(MODELS[model], settings)
    references = {v.name: v.valueReference for v in read_model_description(str(path)).modelVariables}
    told = [(k, v.name) for k, v in enumerate(simulation.variables[:-2]) if v.name in references]  # others: in arrays
    if model == "sheet":  # rounding errors of another C library excite fast modes: rates and forces differ by more
        told = [(k, own) for k, own in told if not own.startswith(("reaction", "tip.velocity"))]
    outputs = [k for k, _ in told]
    numbers = STEPS, LENGTH, len(outputs), *(references[simulation.variables[k].name] for k in outputs)
    found = run_elsewhere(name, "host.c", path, tmp_path, *numbers).reshape(STEPS + 1, -1)
    wanted = [simulation.outputs()[outputs]]
    for k in range(1, STEPS + 1):
        assert simulation.advance(k * LENGTH).ok
        wanted.append(simulation.outputs()[outputs])
    off = np.abs(found - wanted) / np.maximum(np.abs(wanted).max(axis=0), 1.0)
    assert off.max() < 100.0 * TOLERANCE


@pytest.mark.skipif(not host(), reason="this machine is not known")
@pytest.mark.parametrize("name", EMULATORS)
def test_another_machine_integrates_a_model_exchange(name: str, tmp_path: Path):
    """A parallelogram, through its singular configurations."""
    emulator(name)
    case = loops.parallelogram(start=-20.0)
    settings = Settings(solver="adams", tolerance=TOLERANCE)
    path = export(as_model(case.mechanism), tmp_path / "model.fmu", settings, native=True, fmi=3, platforms=[name])
    variables = read_model_description(str(path)).modelVariables
    states = [v.valueReference for v in variables if v.name.startswith("state.")]
    steps, length = 600, 2e-3
    numbers = steps, length, len(states), *states
    rows = run_elsewhere(name, "exchange_host.c", path, tmp_path, *numbers).reshape(steps + 1, -1)
    q, v = case.exact(length * np.arange(steps + 1))  # type: ignore[misc]
    np.testing.assert_allclose(rows, np.hstack((q, v)), atol=1e-7)
