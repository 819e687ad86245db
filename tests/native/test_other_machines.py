"""Native FMUs of other machines, in emulators of these where they are installed."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import read_model_description

from fmus.fourbar import FourBar
from mbfmu.fmi import export
from mbfmu.native.runtime import compiler
from mbfmu.native.targets import TARGETS, host
from mbfmu.session.simulation import Settings, Simulation

STEPS, LENGTH, TOLERANCE = 100, 0.01, 1e-6  # the second in s
EMULATORS = {  # programs that run what is built for a machine, and what else they need
    "aarch64-linux": (("qemu-aarch64", "qemu-aarch64-static"), ("QEMU_LD_PREFIX",)),
    "x86_64-windows": (("wine64", "wine"), ()),
}

pytestmark = pytest.mark.campaign  # the runtime of each machine is built anew, in minutes


def emulator(name: str) -> str:
    """Return the program; what is missing is a reason to skip."""
    programs, variables = EMULATORS[name]
    missing = [variable for variable in variables if variable not in os.environ]
    found = next(filter(None, map(shutil.which, programs)), "")
    if not found or missing or importlib.util.find_spec("ziglang") is None:
        needed = ", ".join((" or ".join(programs), *(f"{v} in the environment" for v in variables), "ziglang"))
        pytest.skip(f"needs {needed}")
    return found


@pytest.mark.skipif(not host(), reason="this machine is not known")
@pytest.mark.parametrize(
    ("name", "solver"), [*((name, "adams") for name in EMULATORS), ("x86_64-windows", "ida")], ids=str
)
def test_another_machine_gets_the_same_motion(name: str, solver: str, tmp_path: Path):
    program, settings = emulator(name), Settings(solver=solver, tolerance=TOLERANCE)
    path = export(FourBar(), tmp_path / "model.fmu", settings, native=True, fmi=3, platforms=[name])
    zipfile.ZipFile(path).extractall(tmp_path)
    described = read_model_description(str(path))
    library = tmp_path / "binaries" / name / f"{described.coSimulation.modelIdentifier}{TARGETS[name].suffix}"
    simulation = Simulation(FourBar(), settings)
    references = {v.name: str(v.valueReference) for v in described.modelVariables}
    names = [v.name for v in simulation.variables][:-2]
    alone, headers = tmp_path / "host.exe", Path(fmpy.__file__).parent / "c-code"
    source = Path(__file__).with_name("host.c")
    subprocess.run([*compiler(name), "-std=c2x", "-O1", f"-I{headers}", source, "-o", alone], check=True)
    told = ["3", library.relative_to(tmp_path), "resources", described.instantiationToken, "out.bin", STEPS, LENGTH]
    run = [program, alone, *told, len(names), *(references[name] for name in names)]
    subprocess.run(list(map(str, run)), cwd=tmp_path, check=True)
    wanted = [simulation.outputs()[:-2].copy()]
    for k in range(1, STEPS + 1):
        assert simulation.advance(k * LENGTH).ok
        wanted.append(simulation.outputs()[:-2].copy())
    found, size = np.fromfile(tmp_path / "out.bin").reshape(STEPS + 1, -1), np.abs(wanted).max(axis=0)
    off = np.abs(found - wanted) / np.maximum(size, 1.0)
    assert off.max() < 100.0 * TOLERANCE
